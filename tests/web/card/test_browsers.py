"""Journeys through the page and through a published one, alike in Chromium, Firefox and WebKitGTK;
each draws by a card in software.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from isogi_core.plan.assembly import load_scene
from isogi_server.api.app import create_app
from isogi_server.cli.command import run
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from isogi_worker import pool
from tests.live import live
from tests.server.inline import InlinePool
from tests.web.browsers import Driven, Size, free_port, missing, opened
from tests.web.plain_server import shared

pytestmark = [pytest.mark.browser, pytest.mark.long]

SIZE: Size = (520, 440)
PHONE: Size = (390, 844)
SIZES: list[Size] = [(620, 500), (460, 420), (560, 460), SIZE]
STILL = "document.querySelector('#stage[data-lit][data-still]') !== null"
FINAL = "document.querySelector('#stage[data-state=final]:not([data-busy])') !== null"
CARD_HAS_DRAWN = "document.querySelector('#live:not([hidden])') !== null"
GROUND = 3
"""What the channels of a pixel behind the surface may be away from the corner's."""

FRAME = b"""<!doctype html><body style="margin: 0">
<iframe src="index.html" style="width: 560px; height: 420px; border: 0"></iframe></body>"""

WATCH = """(() => {
  window.frames_asked = 0;
  const ask = window.requestAnimationFrame;
  window.requestAnimationFrame = (run) => {
    window.frames_asked += 1;
    return ask.call(window, run);
  };
  return true;
})()"""
"""Counts the animation frames that the page asks for."""

LOSE = """(() => {
  const gl = document.querySelector("CANVAS").getContext("webgl2");
  window.loss = gl.getExtension("WEBGL_lose_context");
  window.loss.loseContext();
  return true;
})()"""


@pytest.fixture(scope="module")
def published(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a published page, and with the same as one file, ``page.html``."""
    folder = tmp_path_factory.mktemp("published")
    words = ["--interactive", "--isovalue", "0.4:0.6", "--target-error", "0.3"]
    words += ["--background", "light", "--store", str(folder / "store")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "WorkerPool", InlinePool)
        for name in ("site", "page.html"):
            assert run(["publish", str(small_scene), "-o", str(folder / name), *words]) == 0
    return folder


@pytest.fixture(scope="module")
def address(published: Path) -> Iterator[str]:
    """Where the published folder is served."""
    with shared(published / "site", {"/frame.html": FRAME}) as url:
        yield url


@pytest.fixture(scope="module", params=["chromium", "firefox", "webkit"])
def driven(request: pytest.FixtureRequest, browser: Browser) -> Iterator[Driven]:
    """A browser, for all journeys."""
    if reason := missing(request.param):
        pytest.skip(reason)
    with opened(request.param, browser, SIZE) as each:
        yield each


def box_of(driven: Driven, selector: str) -> tuple[int, int, int, int]:
    """Left, top, width and height of an element, pixels of the window."""
    left, top, width, height = driven.js(
        f"(() => {{ const b = document.querySelector('{selector}').getBoundingClientRect();"
        "return [b.left, b.top, b.width, b.height].map(Math.round); })()"
    )
    return left, top, width, height


def stage_of(driven: Driven) -> np.ndarray:
    """What the stage shows, (h, w, 3) int."""
    left, top, width, height = box_of(driven, "#stage")
    return driven.shot()[top : top + height, left : left + width].astype(int)


def is_black(picture: np.ndarray) -> bool:
    """Whether a canvas was emptied and not drawn."""
    return float((picture.max(axis=2) < 6).mean()) > 0.2


def assert_whole(picture: np.ndarray) -> None:
    """The object is in the picture, large, and nowhere cut off."""
    seen = (np.abs(picture - picture[2, 2]) > GROUND).any(axis=2)
    seen[-60:, :180] = False  # scale bar and axes
    assert seen.mean() > 0.03
    border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
    assert not border.any(), "the object is cut off"


def slide(driven: Driven, name: str, share: float) -> None:
    """Put a slider at a share of its range, as a hand would."""
    driven.js(
        f"(() => {{ const s = document.querySelector('input[type=range][name={name}]');"
        f"s.value = +s.min + {share} * (s.max - s.min);"
        "for (const kind of ['input', 'change'])"
        "s.dispatchEvent(new Event(kind, { bubbles: true })); return true; })()"
    )


def turn(driven: Driven, shift: bool = False, release: bool = True) -> None:
    """Drag over the middle of the stage."""
    left, top, width, height = box_of(driven, "#stage")
    x, y = left + width / 2, top + height / 2
    driven.drag([(x + 8 * step, y) for step in range(6)], shift, release)


def turn_by_card(driven: Driven) -> None:
    """Drag until the card, which takes on the scene once a view rests, draws what moves."""
    for _ in range(20):
        turn(driven)
        if driven.js(CARD_HAS_DRAWN):
            return
        driven.until(FINAL)
    raise AssertionError("the card draws nothing")


def changed(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether two pictures of one size show different things."""
    return before.shape == after.shape and bool(
        (np.abs(before - after).max(axis=2) > 8).mean() > 0.01
    )


def test_a_published_page_is_turned_lit_and_cut_through(driven: Driven, address: str) -> None:
    driven.goto(address)
    driven.until(STILL)
    first = stage_of(driven)
    assert_whole(first)
    for what in ("drag", "light", "isovalue"):
        before = stage_of(driven)
        if what == "isovalue":
            slide(driven, "isovalue", 1.0)
        else:
            turn(driven, shift=what == "light")
        driven.until(STILL)
        assert changed(before, stage_of(driven)), what
    driven.js("(document.querySelector('#reset').click(), true)")
    driven.until(STILL)
    assert not changed(first, stage_of(driven)), "reset goes back to the first view"


def test_a_published_page_is_never_black_on_resize(driven: Driven, address: str) -> None:
    driven.goto(address)
    driven.until(STILL)
    for size in SIZES:
        driven.resize(size)
        assert not is_black(stage_of(driven)), size
    driven.until(STILL)
    assert_whole(stage_of(driven))


def test_a_published_page_says_that_its_card_is_lost(driven: Driven, address: str) -> None:
    driven.goto(address)
    driven.until(STILL)
    before = stage_of(driven)
    driven.js(WATCH)
    driven.js(LOSE.replace("CANVAS", "canvas"))
    driven.until("document.querySelector('#lost:not([hidden])') !== null")
    slide(driven, "azimuth", 0.2)
    asked = "new Promise((done) => setTimeout(() => done(window.frames_asked), 1000))"
    assert driven.js(asked) <= 3, "it waits, and asks for no frames for ever"
    slide(driven, "azimuth", 0.5)
    driven.js("(document.querySelector('#reset').click(), window.loss.restoreContext(), true)")
    driven.until("document.querySelector('#lost').hidden")
    driven.until(STILL)
    assert not changed(before, stage_of(driven)), "the card is back, with all light"
    driven.js(LOSE.replace("CANVAS", "canvas"))
    driven.until("document.querySelector('#lost:not([hidden])') !== null")
    driven.js("(setTimeout(() => document.querySelector('#lost button').click()), true)")
    driven.until("document.querySelector('#lost').hidden")
    driven.until(STILL)


def test_a_published_page_fits_a_phone_and_a_frame(driven: Driven, address: str) -> None:
    try:
        driven.resize(PHONE)
        driven.goto(address)
        driven.until(STILL)
        picture = stage_of(driven)
        assert_whole(picture)
        assert picture.shape[0] > 0.5 * PHONE[1]
        driven.resize((600, 460))
        driven.goto(f"{address}frame.html")
        inside = "document.querySelector('iframe').contentDocument"
        driven.until(STILL.replace("document", inside))
        left, top, width, height = driven.js(
            f"(() => {{ const b = {inside}.querySelector('#stage').getBoundingClientRect();"
            "return [b.left, b.top, b.width, b.height].map(Math.round); })()"
        )
        assert height > 0.55 * 420 and width > 0.9 * 560
        assert_whole(driven.shot()[top : top + height, left : left + width].astype(int))
    finally:
        driven.resize(SIZE)


def test_a_page_in_one_file_opens_from_a_disk(driven: Driven, published: Path) -> None:
    driven.goto((published / "page.html").as_uri())
    driven.until(STILL)
    assert_whole(stage_of(driven))


@pytest.mark.live
def test_the_page_is_turned_lit_cut_and_reloaded(driven: Driven, live_server: str) -> None:
    driven.goto(f"{live_server}/?draw=card&background=light")
    driven.until(FINAL)
    drawn = False
    for what in ("drag", "light", "isovalue", "cut"):
        before = stage_of(driven)
        if what == "isovalue":
            slide(driven, "isovalue", 0.45)
        elif what == "cut":
            driven.js("(document.querySelector('#cuts').open = true)")
            driven.js(
                "(() => { const s = document.querySelectorAll('#cuts input[type=range]')[1];"
                "s.value = (+s.min + +s.max) / 2; for (const kind of ['input', 'change'])"
                "s.dispatchEvent(new Event(kind, { bubbles: true })); return true; })()"
            )
        else:
            turn(driven, shift=what == "light")
        driven.until(FINAL)
        assert changed(before, stage_of(driven)), what
        drawn = drawn or driven.js(CARD_HAS_DRAWN)
    assert drawn, "the card drew what moved"
    for size in SIZES:
        driven.resize(size)
        assert not is_black(stage_of(driven)), size
    driven.js("(location.reload(), true)")
    driven.until(FINAL)
    assert not is_black(stage_of(driven))


@pytest.mark.live
def test_the_page_goes_on_after_a_lost_card(driven: Driven, live_server: str) -> None:
    driven.goto(f"{live_server}/?draw=card&background=light")
    driven.until(FINAL)
    turn_by_card(driven)
    driven.until(FINAL)
    driven.js(LOSE.replace("CANVAS", "#live"))
    before = stage_of(driven)
    turn(driven)
    driven.until(FINAL)
    assert changed(before, stage_of(driven)), "the server draws"
    driven.js("(window.loss.restoreContext(), true)")
    turn(driven)
    driven.until(FINAL)
    assert not is_black(stage_of(driven))


@pytest.mark.live
def test_the_card_draws_while_the_server_is_away(
    driven: Driven, small_scene: Path, tmp_path: Path
) -> None:
    port = free_port()
    strip = "document.querySelector('#trouble[data-strip]:not([hidden]) h2')?.textContent ?? ''"

    @contextmanager
    def served(scene: Path) -> Iterator[str]:
        engine = RenderEngine([load_scene(scene)], str(tmp_path / "store"), workers=1)
        with live(create_app(engine, Settings()), port=port) as url:  # type: ignore[call-arg]
            yield url

    with served(small_scene) as url:
        driven.goto(f"{url}/?draw=card&background=light")
        driven.until(FINAL)
        turn_by_card(driven)
        driven.until(FINAL)
    driven.until(f"({strip}).includes('does not answer')")
    before = stage_of(driven)
    turn(driven)
    driven.until("document.querySelector('#stage').dataset.state === 'away'")
    after = stage_of(driven)
    assert changed(before, after) and not is_black(after), "the card draws"
    assert "drawn here" in driven.js("document.querySelector('#status-line').textContent")
    with served(small_scene):
        driven.until(FINAL)
        assert driven.js("document.querySelector('#trouble').hidden")
    other = tmp_path / "other.toml"
    text = small_scene.read_text().replace("small.nrrd", str(small_scene.with_name("small.nrrd")))
    other.write_text(text)
    with served(other):
        driven.until(f"({strip}).includes('another scene')")
        turn(driven)
        driven.until("document.querySelector('#stage').dataset.state === 'away'")
        driven.js("(setTimeout(() => document.querySelector('#trouble button').click()), true)")
        driven.until(FINAL)
        assert "other" in driven.js("document.title")
