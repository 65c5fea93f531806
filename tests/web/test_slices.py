"""Slices beside the picture: linked by a cross hair, with the surface's contour; what a cut takes
away is hatched.
"""

import io
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect

from tests.live import serving
from tests.web.visits import (
    BROWSER,
    VIEWPORTS,
    are_apart,
    box_of,
    click,
    drag,
    findings,
    middle,
    open_shown,
    position,
    query_of,
    shoot,
    slide,
    stage_of,
    written,
)

ADDRESS = "?shading=lambert&azimuth=25&elevation=15&distance=3"
SIZE = (24, 20, 16)
VOXEL = (12, 10, 8)
"""The middle of the volume: where the cross hair is at first."""

pytestmark = BROWSER


def sliced(page: Page, address: str, voxel: tuple[int, ...] = VOXEL) -> Page:
    """The page with slices, their values on the screen."""
    return settled(open_shown(page, f"{address}&slices={','.join(map(str, voxel))}"))


def settled(page: Page) -> Page:
    """The page once it has the values of all slices that it wants."""
    expect(page.locator("#slices figure")).to_have_count(3)
    expect(page.locator("#slices figure[data-old]")).to_have_count(0)
    return page


def figure(page: Page, axis: str) -> Locator:
    return page.locator(f"#slices figure[data-axis={axis}]")


def plane(page: Page, axis: str) -> Locator:
    """The slice itself, without what is black around it."""
    return figure(page, axis).locator(".plane")


def line(page: Page, axis: str, plane: str) -> Locator:
    """The line of a plane in a slice."""
    return figure(page, axis).get_by_role("slider", name=f"Cut, {plane}")


def place(page: Page, axis: str, right: float, up: float) -> tuple[float, float]:
    """The place on the screen where a slice has a voxel, by its indices along the slice's two
    axes.
    """
    box = box_of(plane(page, axis))
    (wide, high) = {"z": SIZE[:2], "y": SIZE[::2], "x": SIZE[1:]}[axis]
    return box["x"] + (right + 0.5) / wide * box["width"], box["y"] + (1 - (up + 0.5) / high) * box[
        "height"
    ]


def share(line: Locator) -> float:
    """How far to the right a line is, in shares of its slice."""
    return float((line.locator(".line").get_attribute("x1") or "").removesuffix("%")) / 100


def cut_of(page: Page) -> str:
    return query_of(page).get("cut", "")


def cross_hair(page: Page) -> list[float]:
    """The voxel of the cross hair, and black and white where they were chosen, as a link has
    them.
    """
    return [float(number) for number in query_of(page).get("slices", "").split(",") if number]


def values_on(url: str, axis: str, at: int) -> np.ndarray:
    answer = httpx.get(f"{url}/v1/scenes/small/slice", params={"axis": axis, "at": at, "f": "npy"})
    values: np.ndarray = np.load(io.BytesIO(answer.content))
    return values


def grey(locator: Locator) -> np.ndarray:
    """What is on the screen there."""
    return np.asarray(Image.open(io.BytesIO(locator.screenshot())).convert("L"), float)


def contour(page: Page, axis: str, beside: bool = False) -> np.ndarray:
    """Where the contour is on a slice, or those of surfaces beside: x and y of its pixels, in
    voxels of the slice.
    """
    rgba = page.evaluate(
        """([axis, beside]) => {
          const canvas = document.querySelector(`#slices [data-axis=${axis}] .lines`);
          const { width, height } = canvas;
          const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
          const found = [];
          for (let i = 0; i < width * height; i += 1) {
            const [red, , blue, alpha] = data.subarray(4 * i, 4 * i + 4);
            if (alpha <= 200 || (beside ? red <= 150 || blue <= 220 : blue <= 2 * red)) continue;
            found.push([(i % width + 0.5) / width, 1 - (Math.floor(i / width) + 0.5) / height]);
          }
          return found;
        }""",
        [axis, beside],
    )
    wide, high = {"z": SIZE[:2], "y": SIZE[::2], "x": SIZE[1:]}[axis]
    return np.array(rgba).reshape(-1, 2) * (wide, high) - 0.5


def field(x: np.ndarray | float, y: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """The values of the scene ``small``, by its formula."""
    balls = [
        np.exp(-(((x - at) / 5) ** 2) - ((np.asarray(y) - 9.5) / 5) ** 2 - ((z - 7.5) / 4) ** 2)
        for at in (8, 16)
    ]
    return np.asarray(sum(balls))


def marked(page: Page) -> tuple[float, float]:
    """Where a pinhole camera sees the voxel of the cross hair, which looks at the middle of the
    volume.
    """
    query = query_of(page)
    (left, top, width, height) = stage_of(page)
    azimuth, elevation = np.radians([float(query[name]) for name in ("azimuth", "elevation")])
    out = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(out, right)
    length = np.array(SIZE) - 1
    away = np.array(cross_hair(page)[:3]) - length / 2  # this volume's spacing is 1
    depth = float(query["distance"]) * np.linalg.norm(length) / 2 - away @ out
    scale = height / (2 * depth * np.tan(np.radians(float(query["fov"])) / 2))
    return left + width / 2 + scale * (away @ right), top + height / 2 - scale * (away @ up)


def test_a_button_and_a_key_open_slices_where_a_point_is(page: Page, live_server: str) -> None:
    asked: list[str] = []
    page.on(
        "request", lambda request: asked.append(request.url) if "/slice?" in request.url else None
    )
    open_shown(page, f"{live_server}/{ADDRESS}")
    assert asked == [] and page.locator("#slices").is_hidden()
    page.click("#slices-button")
    expect(page.locator("#slices-place")).to_have_text("voxel 12, 10, 8")
    expect(page.locator("#slices-button")).to_have_attribute("aria-expanded", "true")
    queries = [dict(parse_qsl(urlsplit(url).query)) for url in asked]
    assert {query["axis"]: int(query["at"]) for query in queries} == dict(
        zip("xyz", VOXEL, strict=True)
    )
    page.keyboard.press("v")
    expect(page.locator("#slices")).to_be_hidden()
    assert "slices" not in query_of(page)
    *_, width, height = stage_of(page)
    click(page, width // 2 + 20, height // 2 - 10)
    page.click("#point-slices")
    settled(page)
    assert cross_hair(page) == [round(x) for x in position(page)], "this volume's spacing is 1"
    expect(page.locator("#point-slices")).to_be_hidden()
    *_, width, height = stage_of(page)
    click(page, width // 2 - 15, height // 2)
    expect(page.locator("#point")).to_be_visible()
    page.wait_for_function(
        "([x]) => document.querySelector('#slices-place').textContent !== x",
        arg=["voxel 12, 10, 8"],
    )
    settled(page)
    assert cross_hair(page) == [round(x) for x in position(page)], "a point that is read moves it"


@pytest.mark.parametrize(("width", "height"), VIEWPORTS)
def test_nothing_hides_under_the_fold(
    page: Page, live_server: str, width: int, height: int
) -> None:
    page.set_viewport_size({"width": width, "height": height})
    sliced(page, f"{live_server}/{ADDRESS}")
    boxes = [box_of(page.locator("#stage")), *(box_of(figure(page, axis)) for axis in "zxy")]
    for number, box in enumerate(boxes):
        assert (
            box["x"] >= 0
            and box["x"] + box["width"] <= width
            and box["y"] + box["height"] <= height
        )
        assert box["width"] >= 0.3 * min(width, 860) and box["height"] >= 0.2 * height, "large"
        assert all(are_apart(box, other) for other in boxes[:number]), "none lies over another"
    for part in ("#slices-place", "#slices-level", "#status-line"):
        assert box_of(page.locator(part))["y"] + box_of(page.locator(part))["height"] <= height
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    shoot(page, f"slices-{width}")


def test_slices_are_of_one_scale(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    scales = []
    for axis, lengths in {"z": SIZE[:2], "y": SIZE[::2], "x": SIZE[1:]}.items():
        box = box_of(plane(page, axis))
        scales += [box["width"] / lengths[0], box["height"] / lengths[1]]
    assert max(scales) - min(scales) < 0.1


def test_a_click_or_a_drag_moves_the_cross_hair(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    page.mouse.click(*place(page, "z", 5, 14))
    settled(page)
    assert cross_hair(page) == [5, 14, 8]
    value = values_on(live_server, "z", 8)[SIZE[1] - 1 - 14, 5]
    assert float(page.inner_text("#slices-voxel").removeprefix("value ")) == pytest.approx(
        value, rel=1e-5
    )
    expect(page.locator("#slices-place")).to_have_text("voxel 5, 14, 8")
    assert marked(page) == pytest.approx(middle(page.locator("#marks .line.cross")), abs=0.6), (
        "also in the picture"
    )
    assert figure(page, "x").locator("figcaption span").inner_text() == "x 5"
    page.mouse.move(*place(page, "y", 5, 8))
    page.mouse.down()
    page.mouse.move(*place(page, "y", 20, 3), steps=4)
    expect(page.locator("#slices-place")).to_have_text("voxel 20, 14, 3")
    page.mouse.move(5, 5)
    page.mouse.up()
    settled(page)
    assert cross_hair(page) == [0, 14, 15], "it stays in the volume"
    page.mouse.move(*place(page, "y", 5, 8))
    expect(page.locator("#slices-place")).to_have_text("voxel 0, 14, 15")


def test_the_wheel_goes_through_slices(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    page.mouse.move(*place(page, "z", 3, 3))
    for turn, at in ((-120, 9), (-120, 10), (120, 9)):
        page.mouse.wheel(0, turn)
        expect(figure(page, "z").locator("figcaption span")).to_have_text(f"z {at}")
    settled(page)
    assert cross_hair(page) == [12, 10, 9]
    assert page.evaluate("scrollY") == 0
    level, window = (float(page.input_value(f"#slices-{name}")) for name in ("level", "window"))
    expected = np.clip((values_on(live_server, "z", 9) - level) / window + 0.5, 0, 1)
    assert np.abs(grey_values(page, "z") - 255 * expected).max() < 2


def grey_values(page: Page, axis: str) -> np.ndarray:
    """The greys (rows, columns) of a slice's values, one for each voxel."""
    rows = page.evaluate(
        """(axis) => {
          const canvas = document.querySelector(`#slices [data-axis=${axis}] .values`);
          const { width, height } = canvas;
          const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
          return [height, width, ...Array.from({ length: width * height }, (_, i) => data[4 * i])];
        }""",
        axis,
    )
    return np.array(rows[2:], float).reshape(rows[0], rows[1])


@pytest.mark.parametrize("axis", ["z", "y", "x"])
def test_the_contour_is_where_the_isosurface_is(page: Page, live_server: str, axis: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}&isovalue=0.4", (8, 9, 7))
    for isovalue in (0.4, 0.7):
        page.fill("#isovalue-number", str(isovalue))
        page.keyboard.press("Enter")
        page.wait_for_timeout(100)  # two frames of a busy machine
        found = contour(page, axis)
        assert len(found) > 100
        right, up = found.T
        told = {"z": (right, up, 7.0), "y": (right, 9.0, up), "x": (8.0, right, up)}[axis]
        assert np.abs(field(*told) - isovalue).max() < 0.06, (
            "a line of 1.5 pixels has steps of a tenth of a voxel"
        )


def test_the_contour_follows_the_slider_without_the_server(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}&isovalue=0.4", (8, 9, 7))
    page.route("**/slice?*", lambda route: route.abort())
    before = contour(page, "z")
    slide(page, "isovalue", 0.95)
    page.wait_for_timeout(100)
    after = contour(page, "z")
    assert 0 < len(after) < 0.8 * len(before)


@pytest.mark.long
def test_surfaces_beside_have_contours_of_their_own(
    page: Page, small_scene: Path, tmp_path: Path
) -> None:
    pinned = small_scene.with_name("pinned.toml")
    pinned.write_text(small_scene.read_text() + "[[surfaces]]\nisovalue = 0.75\nclear = 0.5\n")
    with serving(pinned, tmp_path) as url:
        sliced(page, f"{url}/{ADDRESS}&isovalue=0.4", (8, 9, 7))
        for isovalue, found in ((0.4, contour(page, "z")), (0.75, contour(page, "z", beside=True))):
            assert len(found) > 100
            assert np.abs(field(*found.T, 7.0) - isovalue).max() < 0.06
        page.locator("#beside summary").click()
        page.locator("#surface-rows input[type=checkbox]").uncheck()
        page.wait_for_timeout(100)
        assert len(contour(page, "z", beside=True)) == 0 < len(contour(page, "z"))
        page.goto("about:blank")  # before the server goes


@pytest.mark.long
def test_a_right_drag_sets_window_and_level(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    window, level = (float(page.input_value(f"#slices-{name}")) for name in ("window", "level"))
    before = grey_values(page, "y")
    expect(page.locator("#slices-reset")).to_be_disabled()
    drag(page, middle(plane(page, "y")), -100, 20, "right")
    expect(page.locator("#slices-reset")).to_be_enabled()
    assert float(page.input_value("#slices-window")) == pytest.approx(window / 2, rel=0.01)
    assert float(page.input_value("#slices-level")) == pytest.approx(level + window / 10, rel=0.01)
    assert np.abs(grey_values(page, "y") - before).max() > 30
    voxel = cross_hair(page)[:3]
    (black, white) = cross_hair(page)[3:]
    assert voxel == list(VOXEL), "a right drag leaves the cross hair"
    assert (white - black, (black + white) / 2) == pytest.approx(
        (window / 2, level + window / 10), rel=0.01
    )
    page.mouse.dblclick(*place(page, "z", 12, 10))
    expect(page.locator("#slices-reset")).to_be_disabled()
    assert float(page.input_value("#slices-window")) == window
    assert len(cross_hair(page)) == 3
    np.testing.assert_array_equal(grey_values(page, "y"), before)
    page.fill("#slices-window", "0.25")
    page.keyboard.press("Enter")
    assert cross_hair(page)[3:] == pytest.approx([level - 0.125, level + 0.125], abs=1e-3)
    page.fill("#slices-window", "-1")
    page.keyboard.press("Enter")
    expect(page.locator("#slices-window")).to_have_value("0.25")


def test_keys_move_the_cross_hair_in_a_slice(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    azimuth = query_of(page)["azimuth"]
    plane(page, "x").focus()
    for key in (
        "ArrowRight",
        "ArrowUp",
        "ArrowUp",
        "PageDown",
        "Shift+PageDown",
        "Shift+ArrowLeft",
    ):
        page.keyboard.press(key)
    expect(page.locator("#slices-place")).to_have_text("voxel 1, 1, 10")
    assert query_of(page)["azimuth"] == azimuth, "arrows turn nothing there"
    expect(plane(page, "x")).to_have_attribute(
        "aria-label",
        (
            "Slice across x. Arrow keys move the cross hair, page keys go through slices, with "
            "Shift by ten."
        ),
    )
    assert page.locator("#slices [role=status]").inner_text().startswith("voxel 1, 1, 10 value 0.0")
    assert findings(page) == []


def test_a_link_shows_the_same_slices(page: Page, live_server: str) -> None:
    open_shown(
        settled(open_shown(page, f"{live_server}/{ADDRESS}&slices=3,4,5,0.25,0.75")), written(page)
    )
    settled(page)
    assert cross_hair(page) == [3, 4, 5, 0.25, 0.75]
    assert [page.input_value(f"#slices-{name}") for name in ("window", "level")] == ["0.5", "0.5"]
    values = values_on(live_server, "x", 3)
    assert np.abs(grey_values(page, "x") - 255 * np.clip((values - 0.25) / 0.5, 0, 1)).max() < 2
    page.click("#reset")
    assert cross_hair(page) == [3, 4, 5, 0.25, 0.75]


def test_slices_that_a_server_owes_come_when_it_is_back(page: Page, live_server: str) -> None:
    page.route("**/slice?*", lambda route: route.abort())
    open_shown(page, f"{live_server}/{ADDRESS}&slices=3,4,5")
    expect(page.locator("#slices-voxel")).to_have_text("value …")
    expect(page.locator("#slices figure[data-old]")).to_have_count(3)
    page.unroute("**/slice?*")
    settled(page)
    expect(page.locator("#slices-voxel")).not_to_have_text("value …")


def test_what_a_cut_takes_away_is_hatched(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    whole = grey(plane(page, "z"))
    assert cut_of(page) == ""
    expect(figure(page, "z").get_by_role("slider")).to_have_count(0)
    page.eval_on_selector("#cuts", "details => { details.open = true; }")
    page.focus("#cut-y-to")
    page.keyboard.press("PageDown")
    y = float(cut_of(page).removeprefix("y>"))
    hatched = np.abs(grey(plane(page, "z")) - whole)
    row = round(len(whole) * (1 - (y + 0.5) / SIZE[1]))
    assert hatched[3 : row - 3].mean() > 10
    assert np.median(hatched[row + 5 :]) < 1
    expect(line(page, "z", "y to")).to_be_visible()
    expect(line(page, "x", "y to")).to_be_visible()
    expect(line(page, "y", "y to")).to_be_hidden()
    expect(figure(page, "z").get_by_role("slider")).to_have_count(4)
    assert share(line(page, "x", "y to")) == pytest.approx((y + 0.5) / SIZE[1])
    page.click("#add-plane")
    expect(line(page, "z", "plane 1")).to_be_visible()


@pytest.mark.long
def test_a_line_is_dragged_and_the_cut_follows(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}&cut=x%3E14")
    dragged = line(page, "z", "x to")
    other = line(page, "y", "x to")
    assert share(dragged) == share(other) == pytest.approx(14.5 / SIZE[0])
    (x, y) = middle(dragged)
    width = box_of(plane(page, "z"))["width"]
    page.mouse.move(x, y - 20)
    page.mouse.down()
    page.mouse.move(x - width / 4, y - 15, steps=4)
    expect(other.locator(".line")).not_to_have_attribute("x1", f"{100 * 14.5 / SIZE[0]}%")
    page.wait_for_timeout(100)
    assert share(other) == pytest.approx(8.5 / SIZE[0], abs=0.01), "while it is held"
    page.mouse.up()
    assert float(cut_of(page).removeprefix("x>")) == pytest.approx(8, abs=0.2)
    assert cross_hair(page) == list(VOXEL), "a line that is dragged leaves the cross hair"
    page.mouse.move(x, y)
    assert float(cut_of(page).removeprefix("x>")) == pytest.approx(8, abs=0.2), "it was let go"


def test_keys_move_lines_as_arrows_point(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}&cut=x%3E14")
    turned = query_of(page)["azimuth"]
    line(page, "z", "x to").focus()
    page.keyboard.press("ArrowLeft")
    assert cut_of(page) == "x>13.8"
    page.keyboard.press("PageUp")
    assert cut_of(page) == "x>15.8"
    line(page, "y", "z from").focus()
    page.keyboard.press("ArrowUp")
    assert cut_of(page) == "x>15.8;z<0.1"
    page.keyboard.press("Home")
    assert cut_of(page) == "x>15.8"
    assert query_of(page)["azimuth"] == turned, "arrows turn nothing there"
    assert cross_hair(page) == list(VOXEL)


def test_cut_here_cuts_along_the_slice_on_the_near_side(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}", (13, 11, 9))
    page.keyboard.press("c")
    asked: list[str] = []
    page.on(
        "request", lambda request: asked.append(request.url) if "/slice?" in request.url else None
    )
    for axis, at in (("y", 11), ("z", 9)):  # the eye is at plus x, y and z
        figure(page, axis).get_by_role("button", name="Cut here").click()
        taken, limit = cut_of(page).split(";")[-1].split(">")
        assert taken == axis and float(limit) == pytest.approx(at, abs=0.01)
    expect(page.locator("#cuts")).to_have_attribute("open", "")
    expect(page.locator("#slices figure")).to_have_count(3)
    assert share(line(page, "x", "y to")) == pytest.approx(11.5 / SIZE[1], abs=1e-3)
    assert findings(page) == []
    page.focus("#stage")
    page.keyboard.press("Shift+X")
    figure(page, "x").get_by_role("button", name="Cut here").click()
    sides = dict(term.split("<") for term in cut_of(page).split(";") if "<" in term)
    assert float(sides["x"]) == pytest.approx(13, abs=0.01), "now from the other side"
    assert asked == [], "slices stay at the cross hair"


def test_a_finger_moves_cross_hair_and_lines_on_a_phone(browser: Browser, live_server: str) -> None:
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )
    page = open_shown(context.new_page(), f"{live_server}/{ADDRESS}&cut=x%3E14")
    left, top, width, height = stage_of(page)
    page.touchscreen.tap(left + width / 2, top + 0.45 * height)
    page.locator("#point-slices").tap()
    settled(page)
    stage = box_of(page.locator("#stage"))
    card = box_of(page.locator("#point"))
    assert card["x"] >= stage["x"] and card["x"] + card["width"] <= stage["x"] + stage["width"]
    assert card["height"] < 0.6 * stage["height"], "the picture can be seen"
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.touchscreen.tap(*place(page, "y", 4, 12))
    settled(page)
    assert cross_hair(page)[::2] == [4, 12]
    dragged = line(page, "z", "x to")
    (x, y) = middle(dragged)
    wide = box_of(plane(page, "z"))["width"]
    session = context.new_cdp_session(page)
    for step in range(6):
        points = [{"x": x - step / 5 * wide / 4, "y": y + 4 * step, "id": 1}]
        session.send(
            "Input.dispatchTouchEvent",
            {"type": "touchMove" if step else "touchStart", "touchPoints": points},
        )
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    assert float(cut_of(page).removeprefix("x>")) == pytest.approx(8, abs=0.4)
    assert middle(line(page, "z", "x to"))[1] == pytest.approx(y, abs=1), (
        "the page has not scrolled"
    )
    shoot(page, "slices-390-cut")
    context.close()
