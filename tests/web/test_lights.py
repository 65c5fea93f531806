"""Light on the page: chosen, kept in the address, brought as a file, and turned by the ball that
mirrors it.
"""

from base64 import b64encode
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from isogi_core.files.radiance import write_hdr
from isogi_core.model.view import orbit, quaternion_from_angles, rotation_matrix
from tests.server.sockets import wait_for
from tests.server.uploads.site import Site
from tests.web.visits import (
    BROWSER,
    DROP,
    FINAL_MS,
    box_of,
    drag,
    give,
    middle,
    open_final,
    open_shown,
    pixels,
    slide,
    wait_final,
)

pytestmark = BROWSER


@pytest.fixture
def probe(tmp_path: Path) -> bytes:
    """A blue light, brighter from above, as a file."""
    image = np.full((16, 32, 3), (0.1, 0.2, 0.9))
    image[:4] *= 4.0
    write_hdr(tmp_path / "blue.hdr", image)
    return (tmp_path / "blue.hdr").read_bytes()


def exposure(page: Page) -> str:
    return page.inner_text("output[for=exposure]")


def test_a_light_is_chosen_and_the_picture_follows(page: Page, live_server: str) -> None:
    own = pixels(open_final(page, live_server))
    page.select_option("#environment", "evening")
    expect(page.locator("#volume-facts")).to_contain_text("Clear sky in the evening")
    evening = pixels(wait_final(page))
    assert np.abs(evening - own).mean() > 2.0
    assert "environment=evening" in page.url
    assert exposure(page) == "0 stops", "as bright as the new light's own"
    page.go_back()
    expect(page.locator("#environment")).to_have_value("")
    assert np.abs(pixels(wait_final(page)) - own).mean() < 1.0


def test_a_link_opens_in_its_light(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?environment=studio")
    expect(page.locator("#environment option:checked")).to_have_text("Studio, two soft boxes")
    assert exposure(page) == "0 stops"
    page.click("#reset")
    expect(page.locator("#environment")).to_have_value("")
    wait_final(page)
    page.goto(f"{live_server}/?environment=moon")
    expect(page.locator("#notice")).to_have_text("There is no light “moon” here.", timeout=FINAL_MS)
    expect(page.locator("#environment")).to_have_value("")


def test_intensity_stays_as_many_stops(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?environment=studio")
    slide(page, "exposure", 0.625)
    assert exposure(page) == "+1 stop"
    page.select_option("#environment", "overcast")
    expect(page.locator("#volume-facts")).to_contain_text("Overcast sky")
    expect(page.locator("output[for=exposure]")).to_have_text("+1 stop")
    wait_final(page)


def test_a_probe_is_opened_shown_and_deleted(page: Page, site: Site, probe: bytes) -> None:
    open_shown(page, str(site.client.base_url))
    expect(page.locator("#environment-delete")).to_be_hidden()
    give(page, "blue.hdr", probe)
    page.wait_for_url("**environment=*", timeout=FINAL_MS)
    expect(page.locator("#environment option:checked")).to_have_text("blue", timeout=FINAL_MS)
    page.wait_for_selector("#picture:not([hidden])", timeout=FINAL_MS)
    assert [each["name"] for each in site.client.get("/v1/environments").json()["environments"]][
        -1
    ] == "blue"
    picture = pixels(wait_final(page))
    middle = picture[40:56, 40:56].mean(axis=(0, 1))
    assert middle[2] > 1.3 * middle[0], "the surface is blue"
    page.once("dialog", lambda dialog: dialog.accept())
    page.click("#environment-delete")
    expect(page.locator("#environment")).to_have_value("")
    expect(page.locator("#environment-delete")).to_be_hidden()
    assert len(site.client.get("/v1/environments").json()["environments"]) == 5


def test_a_probe_can_be_dropped_on_the_picture(page: Page, site: Site, probe: bytes) -> None:
    open_shown(page, str(site.client.base_url))
    page.evaluate(DROP, [b64encode(probe).decode(), "sky.HDR"])
    page.wait_for_url("**environment=*", timeout=FINAL_MS)
    expect(page.locator("#environment option:checked")).to_have_text("sky", timeout=FINAL_MS)


@pytest.mark.long
def test_why_a_probe_is_refused_is_said(browser: Browser, site: Site) -> None:
    """On a page of its own: browsers complain of any answer that is a refusal."""
    page = browser.new_page()
    open_shown(page, str(site.client.base_url))
    give(page, "flat.hdr", b"#?RADIANCE\n\n-Y 8 +X 8\n" + bytes(256))
    expect(page.locator("#upload-note p")).to_contain_text(
        "twice as wide as high", timeout=FINAL_MS
    )
    page.close()


SUN = (30.0, 50.0)  # azimuth and elevation in the scene


def opened(page: Page, address: str) -> Page:
    page.goto(address)
    page.wait_for_selector("#globe[data-painted]")
    return page


def sun_on(page: Page) -> np.ndarray:
    """Where the ball shows the sun, x to the right and y up, in radii of the ball."""
    light = pixels(page, "#globe", None).sum(axis=2)
    size = len(light)
    rows, columns = np.nonzero(light > 0.97 * light.max())
    return np.array([(2 * columns.mean() + 1) / size - 1, 1 - (2 * rows.mean() + 1) / size])


def mirrored(
    azimuth: float, elevation: float, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0
) -> np.ndarray:
    """Where a mirror ball shows the sun: where its normal is half-way between the sun and the
    eye.
    """
    camera = orbit((0.0, 0.0, 0.0), 1.0, azimuth, elevation, 1.0, 30.0)
    sun = (
        rotation_matrix(quaternion_from_angles(yaw, pitch, roll))
        @ orbit((0.0, 0.0, 0.0), 1.0, *SUN, 1.0, 30.0).eye
    )
    halfway = sun + camera.eye
    right, up, _ = camera.basis()
    return np.array([halfway @ right, halfway @ up]) / np.linalg.norm(halfway)


def dragged(page: Page, right: int, down: int) -> np.ndarray:
    """How far the sun moves, in pixels right and down, when the ball is dragged."""
    before = sun_on(page)
    page.locator("#globe").scroll_into_view_if_needed()
    drag(page, middle(page.locator("#globe")), right, down)
    radius = 0.5 * box_of(page.locator("#globe"))["width"]
    return (sun_on(page) - before) * (radius, -radius)


TURNED = (
    {"azimuth": 30, "elevation": 20},
    {"azimuth": -20, "elevation": 70},
    {"azimuth": 60, "elevation": 0, "yaw": 80, "pitch": -30, "roll": 20},
)
"""Views and lights, in degrees."""


def test_the_sun_is_where_a_mirror_shows_it(page: Page, live_server: str) -> None:
    for angles in TURNED:
        query = "&".join(f"{name}={value}" for name, value in angles.items())
        opened(page, f"{live_server}/?shading=lambert&{query}")
        assert sun_on(page) == pytest.approx(mirrored(**angles), abs=0.05), angles


@pytest.mark.long
def test_what_is_mirrored_follows_the_pointer(page: Page, live_server: str) -> None:
    for elevation in (40, 90):
        opened(page, f"{live_server}/?shading=lambert&azimuth=30&elevation={elevation}")
        for wanted in ((14, 0), (-14, 10)):
            way = np.divide(wanted, np.hypot(*wanted))
            moved = dragged(page, *wanted)
            assert 0.5 < moved @ way / np.hypot(*wanted) < 1.2, (
                "less than the pointer, away from the ball's middle"
            )
            assert np.linalg.norm(moved - moved @ way * way) < 0.25 * np.hypot(*wanted), elevation


def test_arrows_turn_it_and_its_knobs_follow(page: Page, live_server: str) -> None:
    opened(page, f"{live_server}/?shading=lambert&azimuth=30&elevation=20")
    before = sun_on(page)
    azimuth = page.input_value("#azimuth")
    page.focus("#globe")
    page.keyboard.press("ArrowRight")
    # The globe is drawn in the next frame of the screen, which a busy machine draws late.
    assert wait_for(lambda: sun_on(page)[0] > before[0] + 0.04)
    after = sun_on(page)
    page.keyboard.press("ArrowDown")
    assert wait_for(lambda: sun_on(page)[1] < after[1] - 0.04)
    assert float(page.input_value("#yaw")) > 5
    assert page.input_value("#azimuth") == azimuth, "the object stays"


def test_a_light_that_is_fixed_is_shown_and_cannot_be_turned(page: Page, live_server: str) -> None:
    def still(route: Route) -> None:
        route.fulfill(json={**route.fetch().json(), "turns": False, "rotating": False})

    page.route("**/v1/scenes/small", still)
    opened(page, f"{live_server}/?shading=lambert&azimuth=0&elevation=10")
    assert sun_on(page) == pytest.approx(mirrored(0, 10), abs=0.05)
    assert dragged(page, 14, 0) == pytest.approx((0, 0), abs=0.1)
    expect(page.locator("#globe")).to_have_attribute("role", "img")
    expect(page.locator("#yaw")).to_be_hidden()


def test_without_a_sky_picture_the_light_still_turns(page: Page, live_server: str) -> None:
    page.route("**/sky?*", lambda route: route.abort())
    open_shown(page, f"{live_server}/?shading=lambert").focus("#globe")
    page.keyboard.press("ArrowRight")
    assert float(page.input_value("#yaw")) > 5
