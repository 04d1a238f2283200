"""A real browser without a driver of its own: Chromium by its DevTools protocol, over a WebSocket."""

import asyncio
import base64
import itertools
import json
import shutil
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import aiohttp
import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
"""The browser; None if there is none."""
needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="there is no Chromium, in which the page would be looked at"
)
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-default-apps", "--disable-extensions",
    "--disable-features=Translate,OptimizationHints,MediaRouter", "--remote-debugging-port=0",
)  # fmt: skip
"""Options under which it asks nobody on the network for anything of its own."""
KEYS = {
    "ArrowLeft": 37,
    "ArrowRight": 39,
    "ArrowUp": 38,
    "Space": 32,
    "KeyM": 77,
    "KeyR": 82,
    "KeyW": 87,
    "Period": 190,
}


class Page:
    """A page in a browser."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self.requests: list[str] = []
        """Addresses that it has asked for."""
        self.complaints: list[str] = []
        """Errors in its scripts."""
        self._reading = asyncio.create_task(self._read())

    async def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Do what the protocol calls `method`."""
        number = next(self._numbers)
        answer = self._waiting[number] = asyncio.get_running_loop().create_future()
        await self._socket.send_json({"id": number, "method": method, "params": params})
        return await asyncio.wait_for(answer, 20)

    async def open(self, address: str, *, width: int = 1200, height: int = 1000, dark: bool = False) -> None:
        """Go to a page."""
        for domain in ("Page", "Runtime", "Network"):
            await self.call(f"{domain}.enable")
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        await self.call("Emulation.setEmulatedMedia", features=[scheme])
        await self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        await self.call("Page.navigate", url=address)

    async def value(self, script: str) -> Any:
        """Return what an expression is, a promise's outcome included."""
        found = await self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise AssertionError(found["exceptionDetails"])
        return found["result"].get("value")

    async def until(self, script: str, seconds: float = 10.0) -> Any:
        """Wait until an expression is true; until what it needs is there, it fails."""
        for _ in range(round(seconds / 0.05)):
            with suppress(AssertionError):
                if found := await self.value(script):
                    return found
            await asyncio.sleep(0.05)
        raise AssertionError(f"never true: {script}; the page says: {await self.value('document.body.innerText')}")

    async def key(self, code: str, *, down: bool = True, up: bool = True) -> None:
        """Press a key, or let it go."""
        for kind, wanted in (("keyDown", down), ("keyUp", up)):
            if wanted:
                await self.call("Input.dispatchKeyEvent", type=kind, code=code, windowsVirtualKeyCode=KEYS[code])

    async def picture(self, path: Path, *, whole: bool = True) -> None:
        """Keep a picture of the page."""
        found = await self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))

    async def _read(self) -> None:
        async for message in self._socket:
            said = json.loads(message.data)
            params = said.get("params", {})
            match said.get("method"):
                case None:
                    answer = self._waiting.pop(said["id"])
                    if not answer.done():
                        answer.set_result(said.get("result", {"exceptionDetails": said.get("error")}))
                case "Network.requestWillBeSent":
                    self.requests.append(params["request"]["url"])
                case "Network.webSocketCreated":
                    self.requests.append(params["url"])
                case "Runtime.exceptionThrown":
                    self.complaints.append(json.dumps(params["exceptionDetails"]))

    async def close(self) -> None:
        """Leave it."""
        self._reading.cancel()
        with suppress(asyncio.CancelledError):
            await self._reading
        await self._socket.close()


@asynccontextmanager
async def browser() -> AsyncIterator["Browser"]:
    """A browser with nothing in it."""
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        process = await asyncio.create_subprocess_exec(
            CHROMIUM, *QUIET, f"--user-data-dir={folder}", "about:blank",
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        try:
            port = await _port(Path(folder) / "DevToolsActivePort")
            async with aiohttp.ClientSession(f"http://127.0.0.1:{port}") as session:
                yield Browser(session)
        finally:
            process.kill()
            await process.wait()


class Browser:
    """A browser that opens pages."""

    def __init__(self, session: aiohttp.ClientSession) -> None:
        self._session = session

    @asynccontextmanager
    async def page(self) -> AsyncIterator[Page]:
        """A page of its own."""
        async with self._session.put("/json/new?about:blank") as answer:
            target = await answer.json(content_type=None)
        socket = await self._session.ws_connect(target["webSocketDebuggerUrl"], max_msg_size=0)
        page = Page(socket)
        try:
            yield page
        finally:
            await page.close()


async def _port(file: Path) -> int:
    for _ in range(400):
        with suppress(OSError, ValueError, IndexError):
            return int(file.read_text().splitlines()[0])
        await asyncio.sleep(0.05)
    raise AssertionError(f"{file}: the browser did not say where it listens")
