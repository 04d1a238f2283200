"""The page's server: for this machine alone, a drive for each page, and an end that leaves nothing half-done."""

import asyncio
import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from aiohttp.test_utils import TestServer
from driven import CAR_ENVIRONMENT, driven, write_drift

from addressed_dynamics.base.errors import DriveError
from addressed_dynamics.drive import server
from addressed_dynamics.drive.server import DriveServer, page_files, serve
from addressed_dynamics.logs import read_log
from addressed_dynamics.reporting.common.blocks import Report
from addressed_dynamics.reporting.common.render import render_html


class Here:
    """A server that runs, and somebody who asks it."""

    def __init__(self, running: TestServer, client: aiohttp.ClientSession, told: list[str]) -> None:
        self.address = f"http://127.0.0.1:{running.port}"
        self.client, self.told, self.running = client, told, running

    async def page(self, origin: str | None = "own") -> aiohttp.ClientWebSocketResponse:
        """Open the socket as a page does."""
        headers = {} if origin is None else {"Origin": self.address if origin == "own" else origin}
        return await self.client.ws_connect(f"{self.address}/drive", headers=headers)


@asynccontextmanager
async def running(folder: Path) -> AsyncIterator[Here]:
    told: list[str] = []
    world = driven("car", environment=CAR_ENVIRONMENT)
    drive = DriveServer(lambda page: world.session(page, folder), told.append)
    async with TestServer(drive.application(), host="127.0.0.1") as here, aiohttp.ClientSession() as client:
        yield Here(here, client, told)


def with_server(folder: Path, use: Callable[[Here], Awaitable[None]]) -> None:
    async def run() -> None:
        async with running(folder) as here:
            await use(here)

    asyncio.run(run())


async def heard(page: aiohttp.ClientWebSocketResponse, kind: str, **wanted: Any) -> dict[str, Any]:
    """Listen until a message of some kind comes."""
    while True:
        message = await page.receive_json(timeout=20)
        if message["type"] == kind and wanted.items() <= message.items():
            return dict(message)


def test_the_page_is_served_and_may_ask_nobody_else(tmp_path: Path) -> None:
    async def use(here: Here) -> None:
        for name in ("", *(path.name for path in page_files())):
            async with here.client.get(f"{here.address}/{name}") as answer:
                assert answer.status == 200
                assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
                text = await answer.text()
                assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
                assert "https://" not in text
        for name in ("server.py", "..%2fserver.py", "page/index.html", "drive.py"):
            async with here.client.get(f"{here.address}/{name}") as answer:
                assert answer.status == 404

    with_server(tmp_path, use)


def test_its_colours_are_those_of_the_report() -> None:
    files = {path.name: path.read_text(encoding="utf-8") for path in page_files()}
    assert re.findall(r'rel="stylesheet" href="([a-z.]+)"', files["index.html"]) == ["palette.css", "drive.css"]
    report = render_html(Report("", "", "", None, ()))
    assert files["palette.css"] in report
    shared, own, others = (
        {*re.findall(r"--([a-z]+):", style)}
        for style in (files["palette.css"], files["drive.css"], report.replace(files["palette.css"], ""))
    )
    assert len(shared) >= 8
    assert not shared & own
    assert not shared & others
    used = {*re.findall(r"var\(--([a-z]+)\)", files["drive.css"])}
    assert used <= shared | own


def test_who_comes_from_elsewhere_is_refused(tmp_path: Path) -> None:
    async def use(here: Here) -> None:
        port = here.running.port
        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port}.evil.example"):
            async with here.client.get(f"{here.address}/", headers={"Host": host}) as answer:
                assert answer.status == 403
        async with here.client.get(f"http://localhost:{port}/", headers={"Host": f"localhost:{port}"}) as answer:
            assert answer.status == 200
        async with here.client.get(f"{here.address}/", headers={"Origin": "http://evil.example"}) as answer:
            assert answer.status == 403
        for origin in (None, "null", "http://evil.example", f"https://127.0.0.1:{port}", "http://127.0.0.1:1"):
            with pytest.raises(aiohttp.WSServerHandshakeError) as error:
                await here.page(origin)
            assert error.value.status == 403
        async with here.client.get(f"{here.address}/drive", headers={"Origin": here.address}) as answer:
            assert answer.status == 400

    with_server(tmp_path, use)


def test_a_page_drives_and_what_is_no_message_does_no_harm(tmp_path: Path) -> None:
    async def use(here: Here) -> None:
        page = await here.page()
        assert (await page.receive_json())["type"] == "hello"
        assert (await page.receive_json())["step"] == 0
        await page.send_bytes(b"\x00\x01")
        assert "are text" in (await heard(page, "refused"))["message"]
        await page.send_json({"type": "act", "action": 7})
        assert "push_left" in (await heard(page, "refused"))["message"]
        await page.send_json({"type": "act", "action": 2})
        frame = await heard(page, "frame", action=2)
        await page.send_json({"type": "pause"})
        await heard(page, "status", paused=True)
        await page.send_json({"type": "step"})
        assert (await heard(page, "frame"))["step"] > frame["step"]
        await page.send_json({"type": "resume"})
        await heard(page, "frame")
        await page.close()

    with_server(tmp_path, use)


def test_a_message_that_is_too_long_ends_that_page_and_no_other(tmp_path: Path) -> None:
    async def use(here: Here) -> None:
        page, other = await here.page(), await here.page()
        await page.send_str("x" * (server.LONGEST_MESSAGE + 1))
        while not page.closed:
            await page.receive(timeout=20)
        assert page.close_code == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
        await heard(other, "frame")

    with_server(tmp_path, use)


def test_each_page_has_a_drive_of_its_own_up_to_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MOST_PAGES", 2)

    async def use(here: Here) -> None:
        first, second = await here.page(), await here.page()
        starts = [(await heard(page, "frame", step=0))["truth"] for page in (first, second)]
        assert starts[0] != starts[1]
        await first.send_json({"type": "pause"})
        await heard(first, "status", paused=True)
        await heard(second, "frame", step=2)
        third = await here.page()
        assert "2 pages drive already" in (await heard(third, "fatal"))["message"]
        await second.close()
        assert (await third.receive(timeout=20)).type in {aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED}

    with_server(tmp_path, use)


def test_a_page_that_leaves_while_it_records_leaves_a_complete_log(tmp_path: Path) -> None:
    async def use(here: Here) -> None:
        page = await here.page()
        await page.send_json({"type": "record"})
        await heard(page, "recording", on=True)
        frame = await heard(page, "frame", recorded=3)
        assert frame["step"] >= 3
        await page.close()
        while not here.told:
            await asyncio.sleep(0.01)

    with_server(tmp_path, use)
    (log,) = tmp_path.iterdir()
    assert len(read_log(log).transitions) >= 3


def test_a_page_that_does_not_answer_holds_up_no_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(*_: Any, **_given: Any) -> None:
        await asyncio.Event().wait()

    async def use(here: Here) -> None:
        page, other = await here.page(), await here.page()
        for each in (page, other):
            await heard(each, "frame")
        monkeypatch.setattr(server.web.WebSocketResponse, "close", never)
        await asyncio.wait_for(here.running.app.shutdown(), timeout=20)
        monkeypatch.undo()

    with_server(tmp_path, use)


def test_a_drive_that_cannot_begin_says_why(tmp_path: Path) -> None:
    def refuse(_page: int) -> Any:
        raise DriveError("the environment is gone")

    async def use() -> None:
        application = DriveServer(refuse, lambda _line: None).application()
        async with TestServer(application, host="127.0.0.1") as here, aiohttp.ClientSession() as client:
            page = await Here(here, client, []).page()
            assert await page.receive_json() == {"type": "fatal", "message": "the environment is gone"}
            assert (await page.receive(timeout=20)).type in {aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED}

    asyncio.run(use())
    assert not list(tmp_path.iterdir())


def test_a_drive_that_fails_says_so_and_leaves_the_others_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    world = driven("car", environment=CAR_ENVIRONMENT)

    def make(number: int) -> Any:
        session = world.session(number, tmp_path)
        if number == 0:
            monkeypatch.setattr(session, "step", lambda: 1 / 0)
        return session

    async def use() -> None:
        application = DriveServer(make, told.append).application()
        async with TestServer(application, host="127.0.0.1") as running, aiohttp.ClientSession() as client:
            here = Here(running, client, [])
            page, other = await here.page(), await here.page()
            assert "has failed (ZeroDivisionError: division by zero)" in (await heard(page, "fatal"))["message"]
            assert (await page.receive(timeout=20)).type in {aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED}
            await heard(other, "frame", step=2)

    asyncio.run(use())
    assert told == ["a drive has failed (ZeroDivisionError: division by zero)"]


def test_a_port_in_use_is_named_with_what_to_do(tmp_path: Path) -> None:
    world = driven("car")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(DriveError, match=rf"port {port} of 127\.0\.0\.1 is in use; choose another one: --port \d+"):
            serve(lambda page: world.session(page, tmp_path), port, lambda _line: None)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_it_at_once_and_completes_what_is_recorded(tmp_path: Path, number: signal.Signals) -> None:
    folder = write_drift(tmp_path / "drift")
    command = [sys.executable, "-c", "from addressed_dynamics.cli.main import main; main()", "drive", str(folder)]
    options = ["--candidate", "total_parameters", "--port", "0", "--record-to", str(tmp_path / "logs")]
    with subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    ) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = line.split(" ")[0]
        assert address.startswith("http://127.0.0.1:"), line + process.communicate()[1]

        async def drive() -> int | None:
            async with aiohttp.ClientSession() as client:
                page = await client.ws_connect(f"{address}/drive", headers={"Origin": address})
                await page.send_json({"type": "speed", "rate": 60})
                await page.send_json({"type": "record"})
                await heard(page, "frame", recorded=5)
                process.send_signal(number)
                while not page.closed:
                    await page.receive(timeout=20)
                return page.close_code

        assert asyncio.run(drive()) == aiohttp.WSCloseCode.GOING_AWAY
        out, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (0, "")
    (log,) = (tmp_path / "logs").iterdir()
    assert out == f"the page has left; what it recorded is in {log}\n"
    assert len(read_log(log).transitions) >= 5
    assert json.loads(json.dumps(read_log(log).run.kwargs))["model"] == str(folder)
