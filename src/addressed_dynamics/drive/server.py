"""The page and its socket, on 127.0.0.1 and for nobody else: each page that is open has a drive of its own."""

from __future__ import annotations

import asyncio
import errno
import json
import signal
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import NoReturn

from aiohttp import WSCloseCode, WSMsgType, web
from aiohttp.typedefs import Handler

from addressed_dynamics.base.errors import AddressedDynamicsError, DriveError
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.drive.session import Said, Session

HOST = "127.0.0.1"
PORT = 8642
MOST_PAGES = 16
"""Pages that may drive at the same time."""
LONGEST_MESSAGE = 64 * 1024
"""Bytes of a message that is still read."""
HEARTBEAT_SECONDS = 20.0
MOST_LATE_SECONDS = 0.1
FAREWELL_SECONDS = 0.1
"""So long a page may take to answer that the server ends; those here take milliseconds."""
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
PALETTE = "palette.css"
"""Colours and fonts, which are those of the report; the file is kept with its templates."""
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
"""The page may ask for nothing but what this server has."""

MakeSession = Callable[[int], Session]
"""From the number of a page to its drive."""
Tell = Callable[[str], None]
"""Says a line to the person who started the server."""


class DriveServer:
    """Serves the page until it is stopped."""

    def __init__(self, make_session: MakeSession, tell: Tell) -> None:
        """Prepare it.

        Args:
            make_session: makes a drive for each page.
            tell: is told of logs that were completed because a page left.
        """
        self._make_session = make_session
        self._tell = tell
        self._sockets = set[web.WebSocketResponse]()
        self._pages = 0
        self._page = {path.name: path.read_bytes() for path in page_files()}

    def application(self) -> web.Application:
        """Return it as what aiohttp serves."""
        application = web.Application(middlewares=[_only_here])
        application.router.add_get("/drive", self._drive)
        application.router.add_get("/", self._file)
        application.router.add_get("/{name}", self._file)
        application.on_shutdown.append(self._leave)
        return application

    async def _file(self, request: web.Request) -> web.Response:
        name = request.match_info.get("name", "index.html")
        if name not in self._page:
            raise web.HTTPNotFound(text=f"there is no {name} here\n", headers=HEADERS)
        kind = TYPES[Path(name).suffix]
        return web.Response(body=self._page[name], content_type=kind, charset="utf-8", headers=HEADERS)

    async def _drive(self, request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse(
            heartbeat=HEARTBEAT_SECONDS, max_msg_size=LONGEST_MESSAGE, compress=False, timeout=1.0
        )
        if not socket.can_prepare(request).ok:
            raise web.HTTPBadRequest(text="the page speaks WebSocket here\n", headers=HEADERS)
        await socket.prepare(request)
        if len(self._sockets) >= MOST_PAGES:
            await _send(socket, [_fatal(f"{MOST_PAGES} pages drive already; close one of them and reload this one")])
            await socket.close()
            return socket
        self._sockets.add(socket)
        try:
            await self._serve(socket)
        finally:
            self._sockets.discard(socket)
        return socket

    async def _serve(self, socket: web.WebSocketResponse) -> None:
        number, self._pages = self._pages, self._pages + 1
        try:
            session = self._make_session(number)
        except AddressedDynamicsError as error:
            await _send(socket, [_fatal(str(error))])
            await socket.close()
            return
        try:
            await _send(socket, [session.hello(), session.reset()])
            await _listen_to(socket, session)
        except* ConnectionError:
            pass  # the page has left while it was answered
        except* Exception as errors:
            # Of this drive alone: the others go on.
            words = "; ".join(f"{type(each).__name__}: {each}" for each in errors.exceptions)
            self._tell(f"a drive has failed ({words})")
            await _send(socket, [_fatal(f"The drive has failed ({words}). Reload this page to start anew.")])
            await socket.close()
        finally:
            self._close(session)

    def _close(self, session: Session) -> None:
        try:
            log = session.close()
        except DriveError as error:
            self._tell(str(error))
            return
        if log is not None:
            self._tell(f"the page has left; what it recorded is in {log}")

    async def _leave(self, _application: web.Application) -> None:
        await asyncio.gather(*map(_take_leave, self._sockets))


async def _take_leave(socket: web.WebSocketResponse) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(FAREWELL_SECONDS):
            await socket.close(code=WSCloseCode.GOING_AWAY, message=b"the server was stopped")


async def _listen_to(socket: web.WebSocketResponse, session: Session) -> None:
    """Do what a page says while its drive goes on, until it leaves."""
    changed = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        ticking = group.create_task(_tick(socket, session, changed))
        async for message in socket:
            if message.type is WSMsgType.TEXT:
                await _send(socket, session.hear(message.data))
                changed.set()
            else:
                await _send(socket, [{"type": "refused", "message": "messages are text, but this one is not"}])
        ticking.cancel()


async def _tick(socket: web.WebSocketResponse, session: Session, changed: asyncio.Event) -> None:
    """Step a drive at its rate and send what there is to see, until the page leaves.

    What is lost because a step came late is made up for, up to `MOST_LATE_SECONDS`; beyond it the drive is slower, and
    no step is skipped.
    """
    clock = asyncio.get_running_loop()
    due = clock.time()
    while not socket.closed:
        changed.clear()
        if session.paused:
            await changed.wait()
            due = clock.time()
            continue
        due = max(due + 1.0 / session.rate, clock.time() - MOST_LATE_SECONDS)
        await asyncio.sleep(max(0.0, due - clock.time()))
        if not session.paused:
            await _send(socket, session.tick())


async def _send(socket: web.WebSocketResponse, messages: Iterable[Said]) -> None:
    for each in messages:
        if not socket.closed:
            await socket.send_str(json.dumps(each, allow_nan=False, separators=(",", ":")))


def _fatal(message: str) -> Said:
    return {"type": "fatal", "message": message}


@web.middleware
async def _only_here(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Refuse who asks for another host or comes from another page: both are ways to here from a foreign web site."""
    port = request.transport.get_extra_info("sockname")[1] if request.transport else 0
    here = {f"{name}:{port}" for name in (HOST, "localhost")}
    if request.host not in here:
        raise web.HTTPForbidden(text=f"this server answers for {HOST}:{port} alone\n", headers=HEADERS)
    origin = request.headers.get("Origin")
    upgrades = request.path == "/drive"
    if (origin is None and upgrades) or (origin is not None and origin not in {f"http://{each}" for each in here}):
        raise web.HTTPForbidden(text="only the page of this server may drive\n", headers=HEADERS)
    return await handler(request)


def page_files() -> list[Path]:
    """Return the files of the page, which are in the package."""
    folder = Path(str(files("addressed_dynamics.drive") / "page"))
    palette = Path(str(files("addressed_dynamics.reporting.common") / "templates" / PALETTE))
    return [palette, *sorted(path for path in folder.iterdir() if path.suffix in TYPES)]


def serve(make_session: MakeSession, port: int, tell: Tell) -> None:
    """Serve the page until Ctrl-C or a signal to end; recordings that are open are completed.

    Args:
        make_session: makes a drive for each page.
        port: where; 0 for any that is free.
        tell: is told the address, and of logs that were completed.

    Raises:
        DriveError: the port is in use.
    """
    asyncio.run(_run(make_session, port, tell))


async def _run(make_session: MakeSession, port: int, tell: Tell) -> None:
    runner = web.AppRunner(
        DriveServer(make_session, tell).application(), handle_signals=False, access_log=None, shutdown_timeout=1.0
    )
    await runner.setup()
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    try:
        await _listen(runner, port)
        prepare_torch(threads=1)
        tell(f"http://{HOST}:{runner.addresses[0][1]} in a browser; Ctrl-C ends it")
        await stopped.wait()
    finally:
        await runner.cleanup()


async def _listen(runner: web.AppRunner, port: int) -> None:
    try:
        await web.TCPSite(runner, HOST, port).start()
    except OSError as error:
        _refuse_port(port, error)


def _refuse_port(port: int, error: OSError) -> NoReturn:
    if error.errno == errno.EADDRINUSE:
        message = f"port {port} of {HOST} is in use; choose another one: --port {port + 1 if port < 65535 else 8642}"
    else:
        message = f"port {port} of {HOST} cannot be used ({error.strerror}); choose another one with --port"
    raise DriveError(message) from error
