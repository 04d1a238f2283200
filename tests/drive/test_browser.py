"""The page in a real browser: what one sees when one presses a key."""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from aiohttp.test_utils import TestServer
from chromium import Page, browser, needs_browser
from driven import CAR_ENVIRONMENT, driven, walker

from addressed_dynamics.drive.server import DriveServer
from addressed_dynamics.drive.session import Session
from addressed_dynamics.logs import read_log

pytestmark = needs_browser
COUNT = "[window.drive.frames, window.drive.drawn, performance.now() / 1000]"
PIXELS = "[...document.querySelectorAll('#truth, #model')].map((each) => each.toDataURL())"


def look(make_session: Callable[[int], Session], use: Callable[[Page, str], Awaitable[None]]) -> None:
    """Open the page of a server in a browser."""

    async def run() -> None:
        application = DriveServer(make_session, lambda _line: None).application()
        async with TestServer(application, host="127.0.0.1") as here, browser() as chromium, chromium.page() as page:
            await page.open(f"http://127.0.0.1:{here.port}/")
            await use(page, f"127.0.0.1:{here.port}")

    asyncio.run(run())


def test_keys_move_the_car_in_both_pictures_and_nothing_is_asked_of_others(tmp_path: Path) -> None:
    world = driven("car", environment=CAR_ENVIRONMENT)

    async def use(page: Page, here: str) -> None:
        await page.until("window.drive.drawn > 2")
        await page.key("Space")
        await page.until("document.getElementById('pause').textContent === 'Go on'")
        still, state = await page.value(PIXELS), await page.value("window.drive.frame")
        assert len(still) == 2
        await page.key("KeyM")
        await page.key("ArrowRight", up=False)
        await page.key("Space")
        frame = await page.until(f"window.drive.frame.step > {state['step'] + 20} && window.drive.frame")
        assert frame["action"] == 2
        moved = await page.value(PIXELS)
        assert [before != after for before, after in zip(still, moved, strict=True)] == [True, True]
        assert frame["truth"][0] > state["truth"][0]
        await page.key("ArrowRight", down=False)
        await page.until("window.drive.frame.action === 1")
        await page.key("KeyM")
        said = await page.until("document.getElementById('notice').textContent.includes('steps are in') && 'yes'")
        assert said == "yes"
        assert page.complaints == []
        assert {address.split("/")[2] for address in page.requests} == {here}
        assert any(address.startswith("ws://") for address in page.requests)

    look(lambda number: world.session(number, tmp_path), use)
    (log,) = tmp_path.iterdir()
    actions = read_log(log).transitions.action.tolist()
    assert actions.count(2) >= 20


def test_a_button_of_the_page_is_held_by_the_keyboard_too(tmp_path: Path) -> None:
    world = driven("car", environment=CAR_ENVIRONMENT)
    pressed = "document.querySelector('.hands [aria-pressed=true]').textContent"

    async def use(page: Page, _here: str) -> None:
        await page.until("window.drive.drawn > 2")
        assert "no push" in await page.value(pressed)
        await page.value("document.querySelector('.hands button').focus()")
        await page.key("Space", up=False)
        await page.until("window.drive.frame.action === 0")
        assert "push left" in await page.value(pressed)
        await page.key("Space", down=False)
        await page.until("window.drive.frame.action === 1")
        assert await page.value("document.getElementById('pause').textContent") == "Pause"
        assert page.complaints == []

    look(lambda number: world.session(number, tmp_path), use)


def test_a_gamepad_acts_and_a_tilted_stick_is_enough(tmp_path: Path) -> None:
    world = driven("car", environment=CAR_ENVIRONMENT)

    async def use(page: Page, _here: str) -> None:
        await page.until("window.drive.drawn > 2")
        await page.value("void (navigator.getGamepads = () => [null, {axes: [-0.4, 0, 0, 0], buttons: []}])")
        await page.until("window.drive.frame.action === 0")
        await page.value("void (navigator.getGamepads = () => [null, {axes: [-0.1, 0, 0, 0], buttons: []}])")
        await page.until("window.drive.frame.action === 1")
        assert page.complaints == []

    look(lambda number: world.session(number, tmp_path), use)


def test_a_character_walks_and_both_pictures_change(tmp_path: Path) -> None:
    async def use(page: Page, _here: str) -> None:
        await page.until("window.drive.drawn > 2")
        await page.key("ArrowUp", up=False)
        frame = await page.until("window.drive.frame.command[1] > 2 && window.drive.frame")
        before = await page.value("[...document.querySelectorAll('canvas')].map((each) => each.toDataURL())")
        await page.until(f"window.drive.frame.step > {frame['step']} + 20")
        after = await page.value("[...document.querySelectorAll('canvas')].map((each) => each.toDataURL())")
        assert [one != other for one, other in zip(before, after, strict=True)] == [True, True]
        assert page.complaints == []

    look(lambda _number: walker(tmp_path), use)


def test_frames_arrive_at_fifty_a_second_or_more(tmp_path: Path) -> None:
    world = driven("car", environment=CAR_ENVIRONMENT)
    fastest = """(() => { const speed = document.getElementById('speed');
        speed.value = 1; speed.dispatchEvent(new Event('input')); })()"""
    second = "new Promise((done) => setTimeout(() => done(1), 1000)).then(() => " + COUNT + ")"

    async def use(page: Page, _here: str) -> None:
        await page.until("window.drive.drawn > 2")
        await page.value(fastest)
        await page.until("document.getElementById('speed-words').textContent.startsWith('60 steps/s')")
        best, drawn = 0.0, 0
        # A machine that does something else meanwhile may be late once, not five times.
        for _ in range(5):
            before, after = await page.value(COUNT), await page.value(second)
            best = max(best, (after[0] - before[0]) / (after[2] - before[2]))
            drawn = max(drawn, after[1] - before[1])
            if best >= 50:
                break
        assert best >= 50
        assert drawn > 10

    look(lambda number: world.session(number, tmp_path), use)


def test_a_browser_without_websocket_is_told_so() -> None:
    async def use(page: Page, here: str) -> None:
        await page.call("Page.addScriptToEvaluateOnNewDocument", source="delete window.WebSocket")
        await page.open(f"http://{here}/")
        words = "document.getElementById('subtitle').textContent"
        await page.until(f"{words}.includes('no WebSocket')")

    world = driven("car")
    look(lambda number: world.session(number, Path("nowhere")), use)


@pytest.mark.parametrize("kind", ["arm", "boat"])
def test_sliders_act_where_actions_are_continuous(tmp_path: Path, kind: str) -> None:
    world = driven(kind)
    name = "action" if kind == "arm" else "exogenous"
    slide = f"""(() => {{ const slider = document.querySelector('.slider.{name} input');
        slider.value = 1.25; slider.dispatchEvent(new Event('input')); }})()"""

    async def use(page: Page, _here: str) -> None:
        await page.until("window.drive.drawn > 2")
        assert await page.value("document.querySelectorAll('.chart canvas').length") == 2
        await page.value(slide)
        await page.until(f"window.drive.frame.{name}[0] === 1.25")
        assert page.complaints == []

    look(lambda number: world.session(number, tmp_path), use)
