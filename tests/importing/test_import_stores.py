"""Files in an object store make the logs that the same files make here; what the store refuses is one line."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import nullcontext
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import fsspec
import polars
import pytest
from foreign_logs import SECOND, json_log, save, source, states_and_commands
from foreign_tables import TABLE
from fsspec.implementations.memory import MemoryFileSystem

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.importing import import_logs, importer
from addressed_dynamics.importing.assessing import assess

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
    """Files of the current folder; those below `busy` cannot be had now, and those below `shut` by nobody."""

    def do_GET(self) -> None:
        refusals = {"busy": 503, "shut": 403}
        if refused := refusals.get(self.path.split("/")[1]):
            self.send_error(refused)
        else:
            super().do_GET()

    do_HEAD = do_GET

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def web() -> Iterator[str]:
    """The address of a web server for the current folder."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Served) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize("names", [("*",), ("run_0", "run_1")])
def test_files_of_a_web_server_make_the_logs_of_the_same_files(web: str, names: tuple[str, ...]) -> None:
    save(Path(), **two_logs())
    there = imported("there", files=[f"{web}/logs/{name}.mcap" for name in names])
    here = imported("here", files=[f"logs/{name}.mcap" for name in names])
    assert isinstance(there, dict)
    assert isinstance(here, dict)
    account = json.loads(there.pop("import.json").replace(f"{web}/".encode(), b""))
    assert list(account.pop("copied")) == ["logs/run_0.mcap", "logs/run_1.mcap"]
    assert account == json.loads(here.pop("import.json"))
    assert there == here


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("logs/none.mcap", "no object matches"),
        ("none/*.mcap", "no object matches"),
        ("busy/run_0.mcap", "the store cannot be asked (ClientResponseError 503)"),
        ("busy/*.mcap", "the store cannot be asked (ClientResponseError 503)"),
        ("shut/run_0.mcap", "the store cannot be asked (ClientResponseError 403)"),
        ("shut/*.mcap", "the store cannot be asked (ClientResponseError 403)"),
    ],
)
def test_a_web_server_that_refuses_is_told_from_one_without_the_file(web: str, place: str, words: str) -> None:
    save(Path(), **two_logs())
    assert words in str(imported("out", files=[f"{web}/{place}"]))


@pytest.mark.parametrize("name", ["run_0.mcap", "*.mcap"])
def test_a_web_server_that_is_not_there_is_one_line(name: str) -> None:
    with socket.socket() as taken:  # bound, and nobody listens
        taken.bind(("127.0.0.1", 0))
        message = str(imported("out", files=[f"http://127.0.0.1:{taken.getsockname()[1]}/{name}"]))
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
    ],
)
def test_what_is_no_url_of_objects_is_one_line(url: str, words: str) -> None:
    message = str(imported("out", files=[url]))
    assert words in message
    assert "SECRET" not in message


def test_an_object_does_not_get_out_of_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"/fleet/logs/../../../../escaped.mcap": {"type": "file", "size": 1}}
    monkeypatch.setattr(MemoryFileSystem, "glob", lambda *_, **__: found)
    assert "which is no path" in str(imported("out", files=[STORE]))


def test_a_look_at_what_is_in_a_store_is_refused() -> None:
    with pytest.raises(AddressedDynamicsError, match="in an object store, which only an import reads"):
        assess(source(files=[STORE]))
