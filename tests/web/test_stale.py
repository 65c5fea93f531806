"""Nothing stale without saying so: random changes of all controls, against a server that is three
seconds away.

What looks for lies is in `slow_server.js`: after each frame of the screen it compares what the page
says with the picture that it shows, whose colour says what it was drawn for, or with what the card
has drawn.
"""

import json
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import sleep
from typing import Any, Literal

import pytest
from playwright.sync_api import Page, Route

from tests.web.visits import BROWSER, SHOTS, load_modules, slide, stage_of

pytestmark = BROWSER
SLOW_SERVER = Path(__file__).with_name("slow_server.js")
FAR = 3.0
PAUSES = {0.03: 45, 0.25: 25, 0.7: 18, 3.4: 9, 7.0: 3}
"""Seconds after a change, and how often of a hundred."""

SHADINGS = ("lambert", "gi", "phong_shadow")
LIGHTS = 3
BUTTONS: tuple[Literal["left", "right", "middle"], ...] = ("left", "right", "middle")
SIZES = ((900, 640), (760, 640), (900, 560))
Hand = Callable[[Page, random.Random], None]


def away(page: Page) -> None:
    """A page whose stream is slow; other scenes are slow to open, and pictures beside are there at
    once.
    """
    load_modules(page)
    page.add_init_script(path=SLOW_SERVER)
    page.route("**/v1/scenes", twins)
    page.route(
        "**/v1/scenes/twin*",
        lambda route: route.continue_(url=route.request.url.replace("/twin", "/small")),
    )
    page.route(
        "**/v1/scenes/twin/**",
        lambda route: route.continue_(url=route.request.url.replace("/twin", "/small")),
    )
    page.route("**/frame?*", lambda route: route.abort())


def twins(route: Route) -> None:
    """Two scenes in place of one."""
    answer = route.fetch().json()
    (scene,) = answer["scenes"]
    route.fulfill(json={**answer, "scenes": [scene, {**scene, "id": "twin", "name": "twin"}]})


def late(route: Route) -> None:
    """The document of another scene, three seconds away."""
    sleep(FAR)
    route.continue_()


def slider(*names: str) -> Hand:
    return lambda page, dice: slide(page, dice.choice(names), dice.random())


def key(*names: str) -> Hand:
    def press(page: Page, dice: random.Random) -> None:
        page.focus("#stage")
        page.keyboard.press(dice.choice(names))

    return press


def choice(name: str, *values: str) -> Hand:
    return lambda page, dice: choose(page, name, dice.choice(values))


def choose(page: Page, name: str, value: str) -> None:
    """Choose an option, also of a list that is folded away."""
    script = "([name, value]) => { const list = document.getElementById(name); list.value = value; "
    page.evaluate(
        script + "list.dispatchEvent(new Event('change', { bubbles: true })); }", [name, value]
    )


def light(page: Page, dice: random.Random) -> None:
    ids = page.eval_on_selector_all("#environment option", "all => all.map(each => each.value)")
    choose(page, "environment", dice.choice(ids[: LIGHTS + 1]))


def turn(page: Page, dice: random.Random) -> None:
    """Drag the picture, by any button."""
    left, top, width, height = stage_of(page)
    x = left + width / 2
    y = top + 0.9 * height
    page.mouse.move(x, y)
    button = dice.choice(BUTTONS)
    page.mouse.down(button=button)
    for _ in range(dice.randint(2, 12)):
        x, y = x + dice.randint(-30, 30), y + dice.randint(-20, 20)
        page.mouse.move(x, y)
        page.wait_for_timeout(16)
    page.mouse.up(button=button)


def plane(page: Page, dice: random.Random) -> None:
    names = page.eval_on_selector_all("#cut-sliders input", "all => all.map(each => each.name)")
    slide(page, dice.choice(names), dice.random())


def handle(page: Page, dice: random.Random) -> None:
    """Drag a handle of the cut."""
    page.eval_on_selector("#cuts", "cuts => { cuts.open = true; }")
    box = page.locator("#handles button").nth(dice.randrange(6)).bounding_box()
    if box is None:
        return
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + dice.randint(-60, 60), y + dice.randint(-60, 60), steps=6)
    page.mouse.up()


def zoom(page: Page, dice: random.Random) -> None:
    page.hover("#stage", position={"x": 300, "y": 200})
    page.mouse.wheel(0, dice.choice([-240, -120, 120, 240]))


def resize(page: Page, dice: random.Random) -> None:
    width, height = dice.choice(SIZES)
    page.set_viewport_size({"width": width, "height": height})


def other_scene(page: Page, dice: random.Random) -> None:
    """Choose the other scene, and wait until its page is there."""
    now = page.input_value("#scene")
    wanted = "small" if now == "twin" else "twin"
    page.route(f"**/?scene={wanted}", late)
    page.evaluate("document.documentElement.dataset.former = 'true'")
    choose(page, "scene", wanted)
    page.wait_for_selector("html:not([data-former]) #controls:not([inert])", state="attached")
    page.unroute(f"**/?scene={wanted}")


HANDS: dict[str, tuple[int, Hand]] = {
    "isovalue": (10, slider("isovalue")),
    "camera": (8, slider("azimuth", "elevation", "distance", "fov")),
    "turn": (12, turn),
    "zoom": (6, zoom),
    "keys": (
        10,
        key("ArrowLeft", "ArrowUp", "+", "-", "]", "[", "x", "Z", "w", "Shift+ArrowLeft", "o"),
    ),
    "light's turn": (5, slider("yaw", "pitch", "roll")),
    "light": (6, light),
    "exposure": (6, slider("exposure")),
    "shading": (5, choice("shading", *SHADINGS)),
    "background": (3, choice("background", "dark", "light")),
    "overlay": (4, choice("overlay", "none", "provisional", "error")),
    "projection": (3, choice("projection", "perspective", "orthographic")),
    "compare": (2, choice("compare", "", "lambert_fog")),
    "cut": (5, plane),
    "handle": (6, handle),
    "let light in": (2, lambda page, _: page.eval_on_selector("#opened", "box => box.click()")),
    "show all of it": (
        2,
        lambda page, _: page.eval_on_selector("#uncut", "button => button.click()"),
    ),
    "reset": (5, lambda page, _: page.click("#reset")),
    "resize": (2, resize),
    "scene": (1, other_scene),
}
"""What a hand may do, and how often."""


def tried(page: Page, server: str, changes: int, seed: int) -> dict[str, Any]:
    """What was found in so many random changes."""
    dice = random.Random(seed)
    away(page)
    page.goto(f"{server}/?scene=small")
    page.wait_for_function("() => report.rests()", timeout=60_000)
    weights = [weight for weight, _ in HANDS.values()]
    for count in range(changes):
        if count == changes // 2:
            name = "scene"
        else:
            name = dice.choices(list(HANDS), weights)[0]
        page.evaluate("name => report.begin(name)", name)
        HANDS[name][1](page, dice)
        page.wait_for_timeout(1000 * dice.choices(list(PAUSES), list(PAUSES.values()))[0])
    report: dict[str, Any] = page.evaluate("report")
    page.wait_for_function("() => report.rests()", timeout=60_000)
    return report


def summary(report: dict[str, Any]) -> str:
    """How many changes a lie of each kind followed, and the first of each."""
    lies = report["lies"]
    first = {lie["kind"]: lie for lie in reversed(lies)}
    lines = [
        f"{count} × {kind}, first after {first[kind].get('after', 'opening')}: {first[kind]['why']}"
        for kind, count in Counter(lie["kind"] for lie in lies).items()
    ]
    changes = len({lie["change"] for lie in lies})
    looks = f"{report['looks']} looks, {report['drawn']} of them at the card's pictures"
    return "\n".join([f"{changes} of {report['changes']} changes, {looks}", *lines])


@pytest.mark.long
def test_random_changes_are_followed_by_no_lie(careless: Page, live_server: str) -> None:
    report = tried(careless, live_server, 18, seed=50)
    assert report["looks"] > 90 and report["drawn"] > 20
    assert not report["lies"], summary(report)


@pytest.mark.long
def test_a_thousand_random_changes_have_no_lie(careless: Page, live_server: str) -> None:
    report = tried(careless, live_server, 1000, seed=1)
    SHOTS.mkdir(parents=True, exist_ok=True)
    (SHOTS / "stale.json").write_text(json.dumps(report, indent=1))
    assert report["drawn"] > 1000
    assert not report["lies"], summary(report)
