"""Files in object stores, named by URL: found, and copied to this machine while they are read.

Any store that [fsspec](https://filesystem-spec.readthedocs.io) knows: `s3://` with the package s3fs, `gs://` with
gcsfs, `abfs://` with adlfs. Who may read is said where that package looks for it, for S3 in the environment or
`~/.aws`: never in a URL, which stands in params and in what an import says of itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from addressed_dynamics.base.errors import LogError, ParamsError
from addressed_dynamics.base.files import atomic_path

COPIES = ".copies.partial"
"""Folder of the copies among the logs that an import writes, while it lasts."""
MOST_AT_ONCE = 8
"""Objects that a process copies at the same time: to ask for one takes longer than to send a small one."""
VERSIONS = (
    "ETag", "etag", "md5Hash", "content_md5", "Content-MD5", "Digest", "md5", "version_id", "mtime", "LastModified",
    "Last-Modified", "created",
)  # fmt: skip
"""What stores say of an object that changes with its contents; the first that one says counts."""
WEB = ("http", "https")
"""Kinds of stores that have no list of what is in them."""
HERE = ("file", "local")
"""What fsspec calls the files of this machine."""
IDENTITY = {"Accept-Encoding": "identity"}
"""Asks a web server for a file as it is: one that is packed on the way is taken for whole where it breaks off."""

Answer = TypeVar("Answer")
_WILDCARD = re.compile(r"[*?\[]")
_URL = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]*)://(?P<place>.*)", re.DOTALL)


@dataclass(frozen=True)
class Remote:
    """An object in a store, and where its copy goes."""

    url: str
    copy: Path
    size: int
    """Bytes, as far as the store says it."""


def is_url(pattern: str) -> bool:
    """Whether a pattern is of files in a store."""
    return _URL.fullmatch(pattern) is not None


def find_remote(pattern: str, folder: Path) -> list[Remote]:
    """Return the objects in a store that match a pattern; their copies go to a folder.

    Raises:
        ParamsError: the URL has a password in it, is several in one or a path, or has a wildcard for a web server.
        LogError: the store cannot be asked, refuses, or has no such object.
    """
    scheme = _scheme(pattern)
    found = _ask(pattern, _named if scheme in WEB else _matching)
    remote = []
    for name, about in sorted(found.items()):
        if about.get("type") == "directory":
            continue
        path = str(name).removeprefix(f"{scheme}://").lstrip("/")
        if {"", ".", ".."} & {*path.split("/")}:
            message = f"{pattern}: an object there is called '{name}', which is no path; give it another name"
            raise LogError(message)
        remote.append(Remote(f"{scheme}://{path}", folder / COPIES / scheme / path, int(about.get("size") or 0)))
    if not remote:
        message = f"no object matches '{pattern}'; correct the 'files' of the source"
        raise LogError(message)
    return remote


@contextmanager
def copied(remote: Sequence[Remote]) -> Iterator[dict[str, dict[str, Any]]]:
    """Have copies of objects meanwhile; yield what the store says of each, by its URL.

    Raises:
        LogError: as in `copy`.
    """
    try:
        with ThreadPoolExecutor(MOST_AT_ONCE) as pool:  # it starts no thread without work
            about = list(pool.map(copy, remote))
        yield {each.url: found for each, found in zip(remote, about, strict=True)}
    finally:
        for each in remote:
            each.copy.unlink(missing_ok=True)


def copy(remote: Remote) -> dict[str, Any]:
    """Copy an object; return its `bytes`, and its `version` if the store says one.

    Raises:
        LogError: the store cannot be asked or refuses, the object has gone or changes meanwhile, or the disk is full.
    """
    about = _ask(remote.url, _info)
    with atomic_path(remote.copy) as temporary:
        _ask(remote.url, lambda store, place: store.get_file(place, str(temporary)))
        size = temporary.stat().st_size
        after = _ask(remote.url, _info)
        version = _version(about)
        if about.get("size") is None:
            message = f"{remote.url}: the store does not say how long the object is, so that a part would pass for it"
            raise LogError(message)
        if size != about["size"] or _version(after) != version:
            message = f"{remote.url}: the object changed while it was copied ({size} bytes); import again"
            raise LogError(message)
    return {"bytes": size} | ({} if version is None else {"version": version})


def said(value: Any, folder: Path) -> Any:
    """Return texts, and whatever holds some, with the URLs of objects in place of the paths of their copies."""
    if isinstance(value, str):
        return re.sub(rf"{re.escape((folder / COPIES).as_posix())}/([^/]+)/", r"\1://", value)
    if isinstance(value, dict):
        return {said(key, folder): said(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [said(each, folder) for each in value]
    return value


def _scheme(url: str) -> str:
    """Return which store a URL is of.

    Raises:
        ParamsError: as in `find_remote`; nothing secret is in what is said.
    """
    found = _URL.fullmatch(url)
    assert found is not None
    scheme, place = found["scheme"].lower(), found["place"]
    user, at, _ = place.partition("/")[0].rpartition("@")
    if at and ":" in user:
        message = f"source.files: a URL of '{scheme}' has a password in it; take it out, and say it in the environment"
        raise ParamsError(message)
    shown = re.split("[?#]", url)[0]
    if "::" in url or "://" in place or (scheme in WEB and shown != url):
        message = f"source.files: '{shown}' should be the URL of files in one store, without a query or a fragment"
        raise ParamsError(message)
    if scheme in WEB and _WILDCARD.search(place):
        message = f"source.files: '{shown}': a web server does not say reliably which files it has; name each of them"
        raise ParamsError(message)
    if scheme in HERE:
        message = f"source.files: '{url}' is no object in a store; give the path alone, without '{scheme}://'"
        raise ParamsError(message)
    return scheme


def _ask(url: str, question: Callable[[Any, str], Answer]) -> Answer:
    """Ask the store of a URL, for what it calls that place.

    Raises:
        LogError: it does not answer what is asked. Only what we know to be harmless of its own words is repeated: some
            errors hold a request with its signature.
    """
    import fsspec

    scheme = _scheme(url)
    if scheme not in fsspec.available_protocols():
        message = f"{url}: fsspec knows no store of the kind '{scheme}'; correct the 'files' of the source"
        raise LogError(message)
    try:
        options = {"client_kwargs": {"headers": IDENTITY}} if scheme in WEB else {}
        return question(*fsspec.url_to_fs(scheme + url[len(scheme) :], **options))
    except ImportError as error:
        message = f"{url}: to read from '{scheme}', install what fsspec needs for it ({_plain(error)})"
        raise LogError(message) from error
    except FileNotFoundError as error:
        message = f"{url}: there is no such object; correct the 'files' of the source"
        raise LogError(message) from error
    except PermissionError as error:
        message = f"{url}: the store refuses access; say who may read where it looks for that, outside of the project"
        raise LogError(message) from error
    except OSError as error:
        reason = error.strerror or type(error).__name__
        message = (
            f"{url}: the object cannot be copied ({reason}); see that the store can be reached and the disk has room"
        )
        raise LogError(message) from error
    except Exception as error:  # every store has errors of its own
        what = " ".join(str(each) for each in (type(error).__name__, getattr(error, "status", None)) if each)
        message = f"{url}: the store cannot be asked ({what}); see its address and who may read there"
        raise LogError(message) from error


def _matching(store: Any, pattern: str) -> dict[str, dict[str, Any]]:
    """Return what a store says of the objects that match a pattern."""
    store.invalidate_cache()
    found: dict[str, dict[str, Any]] = store.glob(pattern, detail=True)
    return found


def _named(store: Any, place: str) -> dict[str, dict[str, Any]]:
    """Return what a store says of the one object that is named, if it is there."""
    try:
        return {place: _info(store, place)}
    except FileNotFoundError:
        return {}


def _info(store: Any, place: str) -> dict[str, Any]:
    """Return what a store says of an object.

    For fsspec's HTTP an object is not there, too, if its server is down or refuses; to read of it says which.
    """
    store.invalidate_cache()  # what it said when it was listed may be of another version
    try:
        about: dict[str, Any] = store.info(place)
    except FileNotFoundError:
        store.cat_file(place, start=0, end=1)
        raise
    return about


def _plain(error: Exception) -> str:
    return " ".join(str(error).split())


def _version(about: dict[str, Any]) -> str | None:
    value = next((about[name] for name in VERSIONS if about.get(name)), None)
    return None if value is None else str(value).strip('"')
