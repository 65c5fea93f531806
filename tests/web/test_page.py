"""The page in a real browser, against the real server: what a person does, and what they then
see.
"""

import json
import re
from collections.abc import Callable
from typing import Any
from urllib.parse import parse_qs, urljoin, urlsplit

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, WebSocket, WebSocketRoute, expect

from tests.web.visits import (
    BROWSER,
    FINAL_MS,
    box_of,
    drag,
    middle,
    open_final,
    open_shown,
    pixels,
    query_of,
    shoot,
    slide,
    stage_of,
    unfold,
    wait_final,
    without_sockets,
)

ROLES = "slider|combobox|switch|button|spinbutton|progressbar"
KNOBS = ("isovalue", "azimuth", "elevation", "distance", "yaw", "pitch", "roll")

pytestmark = BROWSER


def at_defaults(page: Page, base: str, shading: str) -> Page:
    """The page at the scene's defaults but for the shading, its picture final; opened where it is
    not yet.
    """
    if not page.url.startswith(base):
        page.goto(base)
    unfold(page).click("#reset")
    for choice, value in (("shading", shading), ("overlay", "none")):
        page.select_option(f"#{choice}", value)
    return wait_final(page)


@pytest.fixture
def shown(steady: Page, live_server: str) -> Page:
    """The page at the scene's defaults, its picture final."""
    return at_defaults(steady, live_server, "gi")


@pytest.fixture
def sketched(steady: Page, live_server: str) -> Page:
    """The page at the scene's defaults but for its shading, for which nothing is baked."""
    return at_defaults(steady, live_server, "lambert")


def difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).mean())


def numbers_of(page: Page) -> dict[str, float]:
    return {name: float(value) for name, value in query_of(page).items() if name in KNOBS}


def drag_until_drafts(
    page: Page, drafts: Callable[[], list[dict[str, Any]]]
) -> list[dict[str, Any]]:
    """Drag to and fro until a draft is shown, as a hand does on a machine that is slow to
    answer.
    """
    x, y = middle(page.locator("#stage"))
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(600):
        page.mouse.move(x + 20 + step % 40, y)
        page.wait_for_timeout(50)
        if drafts():
            break
    page.mouse.up()
    return drafts()


def turned(after: float, before: float) -> float:
    """Degrees from ``before`` to ``after``, within ±180."""
    return (after - before + 180.0) % 360.0 - 180.0


class Stream:
    """What goes over a page's stream: the ``views`` and ``receipts`` that it sends, and the
    ``answers`` that come.
    """

    def __init__(self) -> None:
        self.views: list[dict[str, Any]] = []
        self.receipts: list[int] = []
        self.answers: list[dict[str, Any]] = []

    def follow(self, socket: WebSocket) -> None:
        socket.on("framesent", self._sent)
        socket.on(
            "framereceived",
            lambda data: isinstance(data, str) and self.answers.append(json.loads(data)),
        )

    def _sent(self, data: str | bytes) -> None:
        message = json.loads(data)
        if "shown" in message:
            self.receipts.append(message["shown"])
        else:
            self.views.append(message)


def watched(page: Page) -> Stream:
    """The stream that the page is going to open."""
    stream = Stream()
    page.on("websocket", stream.follow)
    return stream


def scene_of(page: Page, base: str) -> dict[str, Any]:
    """What the server says about its first scene, which is the one that the page opens."""
    scenes = page.request.get(f"{base}/v1/scenes").json()["scenes"]
    facts: dict[str, Any] = page.request.get(f"{base}/v1/scenes/{scenes[0]['id']}").json()
    return facts


@pytest.mark.journey
def test_becomes_final_without_a_reload_and_asks_only_the_server(
    page: Page, live_server: str
) -> None:
    loads = list[str]()
    asked = list[str]()
    page.on("framenavigated", lambda frame: loads.append(frame.url))
    page.on("request", lambda request: asked.append(request.url))
    open_final(page, live_server)
    assert len(loads) == 1
    assert asked
    here = urlsplit(live_server).netloc
    assert {urlsplit(url).netloc for url in asked if not url.startswith(("blob:", "data:"))} == {
        here
    }
    expect(page.locator("#status-line")).to_have_text(re.compile(r"^Done, .* error$"))
    expect(page.locator("#progress")).to_have_attribute("aria-valuenow", "100")
    expect(page.locator("#badge")).to_be_hidden()
    assert pixels(page).std() > 5.0, "the picture shows nothing"
    shoot(page, "final")


def test_says_what_the_scene_needs_and_what_was_left_out(shown: Page, live_server: str) -> None:
    scene = scene_of(shown, live_server)
    shown.click("#plan summary")
    facts = shown.inner_text("#plan")
    assert scene["plan"]["representation"] in facts
    assert f"{scene['plan']['bytes_per_texel']}, instead of 300" in facts
    assert all(note in facts for note in scene["plan"]["notes"])
    assert facts.count("° across at azimuth") == len(scene["plan"]["lobes"])
    for item in scene["plan"]["left_out"]:
        assert item["what"] in facts and item["why"] in facts
        assert all(saved["unit"] in facts for saved in item["saves"])
    assert shown.locator("#plan-left-out li").count() == len(scene["plan"]["left_out"])
    assert shown.evaluate("document.documentElement.scrollWidth <= innerWidth"), (
        "nothing sticks out"
    )
    shoot(shown, "plan", full_page=True)
    shown.click("#volume summary")
    assert " × ".join(str(side) for side in scene["volume"]["size"]) in shown.inner_text("#volume")


def test_a_scene_of_one_isovalue_locks_its_slider(page: Page, live_server: str) -> None:
    def single(route: Route) -> None:
        scene = route.fetch().json()
        scene["ranges"]["isovalue"] = {"min": 0.5, "max": 0.5}
        route.fulfill(json=scene)

    page.route("**/v1/scenes/small", single)
    open_final(page, live_server)
    expect(page.locator("#isovalue")).to_be_disabled()
    expect(page.locator("#isovalue-number")).to_be_disabled()
    expect(page.locator("#isovalue-number")).to_have_value("0.5")
    assert box_of(page.locator("#histogram .bars").first)["width"] > 100


@pytest.mark.journey
def test_isovalue_slider_changes_picture_and_address(sketched: Page) -> None:
    before = pixels(sketched)
    slide(sketched, "isovalue", 0.35)
    low = numbers_of(sketched)["isovalue"]
    slide(sketched, "isovalue", 0.6)
    high = numbers_of(sketched)["isovalue"]
    assert high > low
    assert float(sketched.input_value("#isovalue-number")) == pytest.approx(high)
    wait_final(sketched)
    assert difference(pixels(sketched), before) > 0.5


def test_isovalue_can_be_typed(sketched: Page) -> None:
    least, most = (
        float(sketched.get_attribute("#isovalue-number", limit) or "nan")
        for limit in ("min", "max")
    )
    wanted = round(least + 0.4 * (most - least), 3)
    sketched.fill("#isovalue-number", str(wanted))
    sketched.press("#isovalue-number", "Enter")
    sketched.wait_for_url(lambda url: f"isovalue={wanted:g}&" in url)
    assert numbers_of(sketched)["isovalue"] == wanted


@pytest.mark.journey
def test_drag_turns_the_object_as_if_held(sketched: Page) -> None:
    before = pixels(sketched)
    start = scene_angles(sketched)
    drag(sketched, middle(sketched.locator("#stage")), 90, 40)
    after = numbers_of(sketched)
    assert -90.0 < turned(after["azimuth"], start["azimuth"]) < -5.0
    assert after["elevation"] > start["elevation"]
    wait_final(sketched)
    assert difference(pixels(sketched), before) > 0.5


def test_wheel_zooms(sketched: Page) -> None:
    start = scene_angles(sketched)
    sketched.hover("#stage")
    sketched.mouse.wheel(0, -240)
    near = numbers_of(sketched)["distance"]
    sketched.mouse.wheel(0, 480)
    far = numbers_of(sketched)["distance"]
    assert near < start["distance"] < far


def test_keys(sketched: Page) -> None:
    start = scene_angles(sketched)
    sketched.focus("#stage")
    for key in ("ArrowRight", "ArrowDown", "+", "]", "Shift+ArrowRight", "o"):
        sketched.keyboard.press(key)
    after = numbers_of(sketched)
    assert turned(after["azimuth"], start["azimuth"]) == pytest.approx(-5.0, abs=0.02)
    assert after["elevation"] == pytest.approx(start["elevation"] + 5.0, abs=0.02)
    assert after["distance"] < start["distance"]
    assert after["isovalue"] > start["isovalue"]
    assert turned(after["yaw"], start["yaw"]) == pytest.approx(10.0, abs=0.02)
    assert query_of(sketched)["overlay"] == "provisional"
    sketched.keyboard.press("0")
    assert numbers_of(sketched) == pytest.approx(start, rel=1e-3, abs=0.01)
    sketched.keyboard.press("?")
    expect(sketched.locator("#help")).to_be_visible()
    sketched.keyboard.press("Escape")
    expect(sketched.locator("#help")).to_be_hidden()


def test_arrows_in_a_slider_belong_to_the_slider(sketched: Page) -> None:
    start = scene_angles(sketched)
    sketched.focus("#isovalue")
    sketched.keyboard.press("ArrowRight")
    after = numbers_of(sketched)
    assert after["azimuth"] == pytest.approx(start["azimuth"], abs=0.01)
    assert after["isovalue"] > start["isovalue"]


def test_light_can_be_turned(shown: Page) -> None:
    start = scene_angles(shown)["yaw"]
    for hand in ("right button", "shift", "slider", "ball"):
        before = pixels(shown)
        yaw = numbers_of(shown).get("yaw", start)
        turn_light(shown, hand)
        assert abs(turned(numbers_of(shown)["yaw"], yaw)) > 5.0, hand
        wait_final(shown)
        assert difference(pixels(shown), before) > 0.3, hand


@pytest.mark.parametrize(
    ("rotating", "note"),
    [(True, "The light is the same from all sides."), (False, "The light of this scene is fixed.")],
)
def test_light_that_turns_in_vain_has_no_knobs(
    page: Page, live_server: str, rotating: bool, note: str
) -> None:
    def still(route: Route) -> None:
        route.fulfill(json={**route.fetch().json(), "turns": False, "rotating": rotating})

    page.route("**/v1/scenes/small", still)
    open_final(page, live_server)
    expect(page.locator("#light-note")).to_have_text(note)
    assert page.locator("#globe").is_hidden() == rotating, "fixed light has sides to show"
    expect(page.locator("#yaw")).to_be_hidden()
    before = pixels(page)
    drag(page, middle(page.locator("#stage")), 60, 20, "right")
    wait_final(page)
    assert difference(pixels(page), before) > 0.3, "the object turns instead"
    assert float(query_of(page).get("yaw", 0.0)) == 0.0


def test_shading_choice(shown: Page, live_server: str) -> None:
    before = pixels(shown)
    offered = shown.eval_on_selector_all("#shading option", "options => options.map(o => o.value)")
    assert offered == scene_of(shown, live_server)["shadings"]
    shown.select_option("#shading", "lambert_fog")
    assert query_of(shown)["shading"] == "lambert_fog"
    wait_final(shown)
    assert difference(pixels(shown), before) > 0.3


def test_overlay_marks_what_is_provisional(page: Page, live_server: str) -> None:
    views = watched(page).views
    page.goto(f"{live_server}/?overlay=provisional&azimuth=211&elevation=-17")
    page.wait_for_selector(
        "#stage[data-state=provisional], #stage[data-state=final]", timeout=FINAL_MS
    )
    assert unfold(page).input_value("#overlay") == "provisional"
    for overlay in ("none", "error", "provisional"):
        page.select_option("#overlay", overlay)
        page.wait_for_timeout(100)
        assert views[-1]["view"]["overlay"] == overlay
        assert query_of(page).get("overlay", "none") == overlay
        expect(page.locator("#error-scale")).to_be_visible(
            visible=overlay == "error"
        )  # with the picture


def test_moving_shows_small_jpeg_and_rest_the_full_picture(page: Page, live_server: str) -> None:
    """Each of them is acknowledged."""
    stream = watched(page)
    open_final(page, live_server)
    before = len(stream.answers)
    drafts = drag_until_drafts(
        page, lambda: [answer for answer in stream.answers[before:] if answer["draft"]]
    )
    wait_final(page)
    assert drafts[0]["media_type"] == "image/jpeg"
    last = stream.answers[-1]
    assert (last["media_type"], last["final"], last["id"]) == (
        "image/png",
        True,
        stream.views[-1]["id"],
    )
    assert drafts[0]["width"] < last["width"]
    assert last["width"] == pytest.approx(stage_of(page)[2], abs=1)
    assert stream.receipts == [answer["id"] for answer in stream.answers]


def test_without_sockets_drafts_are_small_jpegs(fresh: Page, live_server: str) -> None:
    shown = open_final(without_sockets(fresh), live_server)
    asked: list[dict[str, list[str]]] = []
    shown.on("request", lambda request: asked.append(parse_qs(urlsplit(request.url).query)))
    drag(shown, middle(shown.locator("#stage")), 60, 0)
    wait_final(shown)
    frames = [query for query in asked if "isovalue" in query]
    assert frames[0]["f"] == ["jpeg"]
    assert frames[-1]["f"] == ["png"]
    assert int(frames[0]["width"][0]) < int(frames[-1]["width"][0])
    assert int(frames[-1]["width"][0]) == pytest.approx(stage_of(shown)[2], abs=1)


def test_reload_restores_the_view(shown: Page) -> None:
    slide(shown, "isovalue", 0.45)
    drag(shown, middle(shown.locator("#stage")), -70, -25)
    drag(shown, middle(shown.locator("#stage")), 50, 30, "right")
    shown.select_option("#shading", "lambert")
    wait_final(shown)
    address = query_of(shown)
    before = pixels(shown)
    shown.reload()
    wait_final(shown)
    assert difference(pixels(shown), before) == 0.0
    assert float(shown.input_value("#isovalue-number")) == pytest.approx(float(address["isovalue"]))
    assert shown.input_value("#shading") == "lambert"


def test_address_without_meaning_is_put_right(page: Page, live_server: str) -> None:
    open_final(
        page, f"{live_server}/?isovalue=1e300&azimuth=765&pitch=abc&shading=none&scene=nothing"
    )
    most = float(page.get_attribute("#isovalue", "max") or "nan")
    assert float(page.input_value("#isovalue")) == pytest.approx(most)
    assert float(page.input_value("#azimuth")) == 45.0
    expect(page.locator("#trouble")).to_be_hidden()
    expect(page.locator("#notice")).to_contain_text(
        "There is no scene “nothing”: this is small. No surface at 1e+300:"
    )


def test_narrow_screens_scroll_only_down(browser: Browser, live_server: str) -> None:
    context = browser.new_context(viewport={"width": 320, "height": 844}, has_touch=True)
    page = open_final(context.new_page(), live_server)
    for summary in page.locator("#controls summary").all():
        if summary.is_visible():
            summary.click()
    for width in (320, 390, 768):
        page.set_viewport_size({"width": width, "height": 844})
        wait_final(page).evaluate("scrollTo(0, 0)")
        stage, controls = (box_of(page.locator(each)) for each in ("#stage", "#controls"))
        assert stage["y"] + stage["height"] <= controls["y"]
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        shoot(page, f"width-{width}", full_page=True)
    context.close()


@pytest.mark.parametrize(("width", "height", "first"), [(1280, 800, 3), (390, 844, 0)])
def test_light_and_camera_come_first(
    browser: Browser, live_server: str, width: int, height: int, first: int
) -> None:
    context = browser.new_context(viewport={"width": width, "height": height})
    page = open_shown(context.new_page(), live_server)
    tops = [box_of(page.locator(f"#{name}-title")) for name in ("isovalue", "light", "camera")]
    ends = [box["y"] + box["height"] for box in tops]
    assert ends == sorted(ends)
    assert all(end < height for end in ends[:first])
    assert not re.search(
        r"\b(texels?|chunks?|void|SH|noise|[Mm]arks|provisional)\b", page.inner_text("body")
    )
    expect(page.locator("#error")).to_be_hidden()
    context.close()


def test_dark_scheme(browser: Browser, live_server: str) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="dark")
    page = open_final(context.new_page(), live_server)
    ink, paper = (
        page.evaluate(f"getComputedStyle(document.body).{what}")
        for what in ("color", "backgroundColor")
    )
    assert brightness(ink) > 200
    assert brightness(paper) < 60
    shoot(page, "dark")
    context.close()


@pytest.mark.journey
def test_server_gone_and_back(fresh: Page, live_server: str) -> None:
    away = False
    open_streams = list[WebSocketRoute]()

    def pass_on(stream: WebSocketRoute) -> None:
        if away:
            stream.close(code=1001)
        else:
            stream.connect_to_server()
            open_streams.append(stream)

    fresh.route_web_socket("**/stream", pass_on)
    open_final(fresh, live_server)
    away = True
    open_streams[0].close(code=1012)
    expect(fresh.locator("#trouble h2")).to_have_text("The server does not answer")
    fresh.focus("#stage")
    fresh.keyboard.press("ArrowLeft")
    expect(fresh.locator("#status-line")).to_have_text(re.compile("^Not up to date"))
    shoot(fresh, "gone")
    away = False
    expect(fresh.locator("#trouble")).to_be_hidden(timeout=FINAL_MS)
    wait_final(fresh)


def test_server_away_at_the_start(page: Page, live_server: str) -> None:
    page.route("**/v1/**", lambda route: route.abort())
    page.goto(live_server)
    expect(page.locator("#trouble h2")).to_have_text("The server does not answer")
    page.unroute("**/v1/**")
    wait_final(page)
    expect(page.locator("#trouble")).to_be_hidden()


def test_every_control_has_a_name(shown: Page) -> None:
    tree = shown.locator("body").aria_snapshot()
    assert re.findall(rf'^\s*- (?:{ROLES}) "', tree, re.MULTILINE)
    assert re.findall(rf"^\s*- (?:{ROLES})(?! \").*$", tree, re.MULTILINE) == []
    expect(shown.locator("#picture")).to_have_attribute("alt", re.compile("^Isosurface of "))


def scene_angles(page: Page) -> dict[str, float]:
    """The knobs where the page starts, asked of the server that it came from."""
    base = urljoin(page.url, "/").rstrip("/")
    width, height = page.eval_on_selector(
        "#stage", "stage => [stage.clientWidth, stage.clientHeight]"
    )
    fit = page.request.get(
        f"{base}/v1/scenes/small/fit", params={"width": width, "height": height}
    ).json()
    start = {**scene_of(page, base)["defaults"], **fit}
    return {name: float(start[name]) for name in KNOBS}


def turn_light(page: Page, hand: str) -> None:
    if hand == "slider":
        slide(page, "yaw", 0.8)
    elif hand == "ball":
        page.locator("#globe").drag_to(
            page.locator("#light label").first, source_position={"x": 40, "y": 58}
        )
    elif hand == "shift":
        page.keyboard.down("Shift")
        drag(page, middle(page.locator("#stage")), 120, 0)
        page.keyboard.up("Shift")
    else:
        drag(page, middle(page.locator("#stage")), 120, 0, "right")


def brightness(colour: str) -> float:
    """Mean of the three channels of ``rgb(r, g, b)``."""
    return float(np.mean([int(part) for part in re.findall(r"\d+", colour)[:3]]))
