"""The panel of the estimated error in a real browser: its course, its words, and when it begins
anew.
"""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, Route, expect

from tests.web.visits import BROWSER, open_final, shoot, slide, unfold, wait_final, without_sockets

pytestmark = BROWSER

COURSE = [
    (1.0, "final=0.000, converging=0.000, provisional=1.000"),
    (0.3, "final=0.250, converging=0.500, provisional=0.250"),
    (0.04, "final=0.609, converging=0.391, provisional=0.000"),
]


def staged(time_left: str | None, end: bool) -> Callable[[Route], None]:
    """Pictures of the server, whose headers follow COURSE frame by frame, and are then final, or
    the last again.
    """
    frames = iter(COURSE)

    def answer(route: Route) -> None:
        if "f=jpeg" in route.request.url:
            return route.continue_()  # a draft: no part of the history
        true = route.fetch()
        step = next(frames, None)
        error, coverage = step or (
            (0.015, "final=1.000, converging=0.000, provisional=0.000") if end else COURSE[-1]
        )
        headers = {name: text for name, text in true.headers.items() if name != "isogi-time-left"}
        headers |= {"isogi-error": f"{error:.5f}", "isogi-coverage": coverage}
        over = end and step is None
        headers |= {
            "isogi-provisional": "?0" if over else "?1",
            "isogi-chunks": f"needed=4, final={4 if over else 3}",
        }
        route.fulfill(
            response=true, headers=headers | ({"isogi-time-left": time_left} if time_left else {})
        )

    return answer


def course(page: Page) -> list[tuple[float, float]]:
    """The points of the error's line, in pixels from the top left."""
    points = page.get_attribute("#error polyline", "points") or ""
    return [(float(x), float(y)) for x, y in (point.split(",") for point in points.split())]


def area(page: Page, state: str) -> float:
    """Square pixels of a state in the drawing, by the shoelace formula."""
    points = page.get_attribute(f"#error polygon.{state}", "points") or ""
    corners = [tuple(map(float, point.split(","))) for point in points.split()]
    pairs = zip(corners, corners[1:] + corners[:1], strict=True)
    return abs(sum(x * v - u * y for (x, y), (u, v) in pairs)) / 2


def test_the_error_falls_until_the_view_is_final(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?isovalue=0.201")  # far from what other tests have baked
    points = course(unfold(page))
    assert len(points) >= 3
    assert points[-1][1] > points[0][1] + 10.0, "a smaller error is lower in the drawing"
    assert [x for x, _ in points] == sorted(x for x, _ in points)
    assert area(page, "final") > 0.0
    expect(page.locator("#error .note")).to_have_text(re.compile(r"^done after [\d.]+ s$"))
    expect(page.locator("#error .tail")).to_have_text(
        re.compile(r"^1 % of pixels are off by more than [\d.]+ % \(")
    )
    expect(page.locator("#error .legend .final b")).to_have_text("100 %")
    words = page.locator("#error svg").get_attribute("aria-label") or ""
    assert re.search(
        r"error from \d+ % to [\d.]+ %, target 50 %; .* from \d+ % to 100 %; over", words
    )
    shown = page.inner_text("#error .value")
    assert shown in words and shown in page.inner_text("#status-line")


@pytest.mark.long
def test_the_drawing_is_to_scale(fresh: Page, live_server: str) -> None:
    without_sockets(fresh).route("**/frame?*", staged(None, end=True))
    open_final(fresh, live_server)
    first, second, third, final, held = (y for _, y in course(unfold(fresh)))
    per_decade = second - first
    assert (third - first) / per_decade == pytest.approx(1.3979 / 0.5229, rel=0.02), (
        "log10 of 25, of 3.33"
    )
    assert final == held > third
    line = re.match(r"M[\d.]+ ([\d.]+)H", fresh.get_attribute("#error path.target", "d") or "")
    assert line is not None
    assert (float(line[1]) - first) / per_decade == pytest.approx(0.3010 / 0.5229, rel=0.02), (
        "the target is 50 %"
    )
    fresh.set_viewport_size({"width": 390, "height": 844})
    wait_final(fresh)
    assert max(x for x, _ in course(fresh)) < 390
    shoot(fresh.locator("#error"), "panel-390")


def test_a_new_view_begins_a_new_history_and_exposure_does_not(
    fresh: Page, live_server: str
) -> None:
    without_sockets(fresh).route("**/frame?*", staged(None, end=True))
    before = course(unfold(open_final(fresh, live_server)))
    slide(fresh, "exposure", 0.6)
    wait_final(fresh)
    assert course(fresh) == before
    for knob in ("azimuth", "isovalue", "yaw"):
        fresh.route("**/frame?*", lambda route: None)  # no answer
        slide(fresh, knob, 0.3)
        assert course(fresh) == []
        expect(fresh.locator("#error .value")).to_have_text("")
        expect(fresh.locator("#error .note")).to_have_text("Waiting for the picture of this view.")
        fresh.unroute("**/frame?*")
        fresh.route("**/frame?*", staged(None, end=True))
        slide(fresh, knob, 0.32)
        wait_final(fresh)
        assert 2 <= len(course(fresh)) <= len(before), (
            "an answer to the view in between is no part of it"
        )


def test_an_error_of_zero_has_no_place_on_a_logarithmic_axis(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?shading=lambert_fog")
    assert course(page) == []
    assert area(page, "final") > 0.0
    expect(page.locator("#error .value")).to_have_text("0 %")
    expect(page.locator("#error .note")).to_have_text(re.compile("nothing to estimate$"))
