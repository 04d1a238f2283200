"""Files in an object store make the logs that the same files make here; what the store refuses is one line."""

import gzip
import json
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import fsspec
import polars
import pytest
from foreign_logs import SECOND, json_log, save, source, states_and_commands
from foreign_tables import TABLE
from fsspec.implementations.memory import MemoryFileSystem

from addressed_dynamics.base.errors import AddressedDynamicsError, LogError
from addressed_dynamics.importing import import_logs, importer
from addressed_dynamics.importing.assessing import assess
from addressed_dynamics.importing.stores import copy, find_remote

STORE = "memory://fleet/logs/*.mcap"


@pytest.fixture(autouse=True)
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[MemoryFileSystem]:
    monkeypatch.chdir(tmp_path)
    found = fsspec.filesystem("memory")
    found.store.clear()
    yield found
    found.store.clear()


def two_logs() -> dict[str, bytes]:
    return {f"run_{n}": json_log(states_and_commands(1.0, (100 + 2 * n) * SECOND)) for n in range(2)}


def keep(store: MemoryFileSystem, **logs: bytes) -> None:
    for name, log in logs.items():
        store.pipe_file(f"/fleet/logs/{name}.mcap", log)


def imported(folder: str, cores: int = 1, **changes: Any) -> dict[str, bytes] | str:
    try:
        import_logs(source(**changes), Path(folder), name="arm", progress=lambda _: None, cores=cores)
    except AddressedDynamicsError as error:
        left = [
            path.name for path in Path().rglob("*") if "partial" in path.as_posix() or importer.COPIES in path.parts
        ]
        assert left == [], "what is whole goes with the folder of the stage"
        return str(error)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in Path(folder).rglob("*")}


class Served(SimpleHTTPRequestHandler):
    """Files of the current folder, each the way that the name of the folder above says."""

    protocol_version = "HTTP/1.1"
    refusals: ClassVar = {"busy": 503, "shut": 403}

    def do_GET(self) -> None:
        self._serve(super().do_GET)

    def do_HEAD(self) -> None:
        self._serve(super().do_HEAD)

    def _serve(self, as_it_is: Callable[[], None]) -> None:
        _, way, *_ = self.path.split("/")
        path = Path("logs", Path(self.path).name)
        if way in self.refusals:
            self.send_error(self.refusals[way])
        elif way == "packed" and "gzip" in self.headers.get("Accept-Encoding", ""):
            body = gzip.compress(path.read_bytes())[:-20]
            self._answer(body, {"Content-Encoding": "gzip", "Content-Length": len(body)})
        elif way == "packed":
            self._answer(path.read_bytes(), {"Content-Length": path.stat().st_size})
        elif way == "unsized":
            self._answer(path.read_bytes(), {"Connection": "close"})
        else:
            as_it_is()
            if way == "moving" and self.command == "GET":
                os.utime(self.path[1:], (1, 1))

    def _answer(self, body: bytes, headers: dict[str, str | int]) -> None:
        self.send_response(200)
        for name, value in headers.items():
            self.send_header(name, str(value))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def web() -> Iterator[str]:
    """The address of a web server for the current folder."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Served) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("way", ["logs", "packed"])
def test_files_of_a_web_server_make_the_logs_of_the_same_files(web: str, way: str) -> None:
    save(Path(), **two_logs())
    names = ("run_0.mcap", "run_1.mcap")
    there = imported("there", files=[f"{web}/{way}/{name}" for name in names])
    here = imported("here", files=[f"logs/{name}" for name in names])
    assert isinstance(there, dict), there
    assert isinstance(here, dict)
    account = json.loads(there.pop("import.json").replace(f"{web}/{way}".encode(), b"logs"))
    assert list(account.pop("copied")) == [f"logs/{name}" for name in names]
    assert account == json.loads(here.pop("import.json"))
    assert there == here


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("logs/none.mcap", "no object matches"),
        ("busy/run_0.mcap", "the store cannot be asked (ClientResponseError 503)"),
        ("shut/run_0.mcap", "the store cannot be asked (ClientResponseError 403)"),
        ("unsized/run_0.mcap", "the store does not say how long the object is"),
        ("logs/*.mcap", "a web server does not say reliably which files it has; name each of them"),
        ("logs/run_0.mcap#1", "without a query or a fragment"),
    ],
)
def test_a_web_server_that_refuses_is_told_from_one_without_the_file(web: str, place: str, words: str) -> None:
    save(Path(), **two_logs())
    assert words in str(imported("out", files=[f"{web}/{place}"]))


def test_a_web_server_that_gets_busy_is_told_from_one_that_lost_the_file(
    web: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    save(Path(), **two_logs())
    found = find_remote(f"{web}/logs/run_0.mcap", Path())
    monkeypatch.setattr(Served, "refusals", {"logs": 503})
    with pytest.raises(LogError, match=r"the store cannot be asked \(ClientResponseError 503\)"):
        copy(found[0])


def test_a_file_that_changes_on_a_web_server_while_it_is_copied_is_refused(web: str) -> None:
    """Python's own server says when a file changed, and nothing else."""
    save(Path(), **two_logs())
    Path("logs").rename("moving")
    message = str(imported("out", files=[f"{web}/moving/run_0.mcap"]))
    assert "run_0.mcap: the object changed while it was copied" in message


def test_a_web_server_that_is_not_there_is_one_line() -> None:
    with socket.socket() as taken:  # bound, and nobody listens
        taken.bind(("127.0.0.1", 0))
        message = str(imported("out", files=[f"http://127.0.0.1:{taken.getsockname()[1]}/run_0.mcap"]))
    assert "see that the store can be reached" in message
    assert "\n" not in message


@pytest.mark.parametrize("episode", [{"by": "file"}, {"by": "gap", "seconds": 3.0}])
def test_objects_make_the_logs_of_the_same_files(store: MemoryFileSystem, episode: dict[str, Any]) -> None:
    keep(store, **two_logs())
    save(Path(), **two_logs())
    there = imported("there", files=[STORE], episode=episode)
    here = imported("here", files=["logs/*.mcap"], episode=episode)
    assert isinstance(there, dict)
    assert isinstance(here, dict)
    account = json.loads(there.pop("import.json").replace(b"memory://fleet/", b""))
    copied = account.pop("copied")
    assert {name: each["bytes"] for name, each in copied.items()} == {
        f"logs/{name}.mcap": len(log) for name, log in two_logs().items()
    }
    assert account == json.loads(here.pop("import.json"))
    assert there == here


def test_several_processes_copy_what_they_read(store: MemoryFileSystem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here it is this one that does their work, which alone sees the store."""
    keep(store, **two_logs())
    alone = imported("alone", files=[STORE])
    monkeypatch.setattr(importer, "WORKER_BYTES", 1)
    most: list[int] = []

    def watched(*arguments: Any) -> importer._Attempt:
        most.append(len([path for path in Path().rglob("*.mcap") if importer.COPIES in path.parts]))
        return attempt(*arguments)

    attempt = importer._attempt
    monkeypatch.setattr(importer, "_attempt", watched)
    monkeypatch.setattr(importer, "worker_processes", lambda _: nullcontext(map))
    assert imported("together", cores=2, files=[STORE]) == alone
    assert most == [0], "the copy of the first has gone before the second is read"


def test_tables_are_read_from_a_store_in_the_order_of_their_times(store: MemoryFileSystem) -> None:
    for number, start in enumerate([10.0, 0.0]):
        rows = polars.DataFrame({"t": [start + each / 10 for each in range(20)], "q": 1.0, "u": 0.5})
        store.pipe_file(f"/fleet/{number}.csv", rows.write_csv().encode())
    asked = source(**TABLE | {"files": ["memory://fleet/*.csv"], "clock": {"column": "t"}, "rate_hz": 10.0})
    import_logs(asked, Path("out"), name="arm", progress=lambda _: None)
    account = json.loads(Path("out/import.json").read_text())
    assert list(account["files"]) == ["memory://fleet/1.csv", "memory://fleet/0.csv"]


def test_a_damaged_object_is_told_by_its_url_and_nothing_is_left(store: MemoryFileSystem) -> None:
    logs = two_logs()
    keep(store, run_0=logs["run_0"], run_1=logs["run_1"][:-300])
    message = imported("out", files=[STORE])
    assert str(message).startswith("memory://fleet/logs/run_1.mcap: byte")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError("signed with SECRET"), "the store refuses access; say who may read"),
        (FileNotFoundError("SECRET"), "there is no such object"),
        (OSError(28, "No space left on device"), "the object cannot be copied (No space left on device)"),
        (OSError("SECRET"), "the object cannot be copied (OSError)"),
        (RuntimeError("Authorization: SECRET"), "the store cannot be asked (RuntimeError)"),
    ],
)
def test_a_store_that_refuses_is_one_line_without_its_secrets(
    store: MemoryFileSystem, monkeypatch: pytest.MonkeyPatch, error: Exception, words: str
) -> None:
    keep(store, **two_logs())

    def refuse(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(MemoryFileSystem, "get_file", refuse)
    message = str(imported("out", files=[STORE]))
    assert message.startswith("memory://fleet/logs/run_0.mcap: ")
    assert words in message
    assert "SECRET" not in message
    assert "\n" not in message


def test_an_object_that_changes_while_it_is_copied_is_refused(
    store: MemoryFileSystem, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep(store, **two_logs())
    get_file = MemoryFileSystem.get_file

    def change(self: MemoryFileSystem, place: str, path: str) -> None:
        get_file(self, place, path)
        self.pipe_file(place, b"another")

    monkeypatch.setattr(MemoryFileSystem, "get_file", change)
    assert "run_0.mcap: the object changed while it was copied" in str(imported("out", files=[STORE]))


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("memory://fleet/none/*.mcap", "no object matches 'memory://fleet/none/*.mcap'; correct the 'files'"),
        ("nowhere://fleet/*.mcap", "fsspec knows no store of the kind 'nowhere'"),
        ("sftp://me:SECRET@host/a.mcap", "a URL of 'sftp' has a password in it; take it out"),
        ("https://host/a.mcap?X-Amz-Signature=SECRET", "'https://host/a.mcap' should be the URL of files in one store"),
        ("memory://a::memory://b", "should be the URL of files in one store"),
        ("file:///fleet/a.mcap", "is no object in a store; give the path alone, without 'file://'"),
    ],
)
def test_what_is_no_url_of_objects_is_one_line(url: str, words: str) -> None:
    message = str(imported("out", files=[url]))
    assert words in message
    assert "SECRET" not in message


@pytest.mark.parametrize("name", ["/fleet/logs/../../../../escaped.mcap", "/fleet/logs//run_0.mcap"])
def test_an_object_does_not_get_out_of_its_folder_nor_into_anothers_place(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    found = {name: {"type": "file", "size": 1}}
    monkeypatch.setattr(MemoryFileSystem, "glob", lambda *_, **__: found)
    assert "which is no path" in str(imported("out", files=[STORE]))


def test_a_store_may_be_named_in_capitals(store: MemoryFileSystem) -> None:
    keep(store, **two_logs())
    assert isinstance(imported("out", files=[STORE.replace("memory", "MEMORY")]), dict)


def test_a_look_at_what_is_in_a_store_is_refused() -> None:
    with pytest.raises(AddressedDynamicsError, match="in an object store, which only an import reads"):
        assess(source(files=[STORE]))
