"""Light on the page: chosen, kept in the address, brought as a file, and deleted again."""

from base64 import b64encode
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from isogi_core.files.radiance import write_hdr
from tests.server.uploads.site import Site
from tests.web.visits import BROWSER, DROP, FINAL_MS, give, open_final, open_shown, pixels, slide, wait_final

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
    assert exposure(page) == "+1 stops"
    page.select_option("#environment", "overcast")
    expect(page.locator("#volume-facts")).to_contain_text("Overcast sky")
    expect(page.locator("output[for=exposure]")).to_have_text("+1 stops")
    wait_final(page)


def test_a_probe_is_opened_shown_and_deleted(page: Page, site: Site, probe: bytes) -> None:
    open_shown(page, str(site.client.base_url))
    expect(page.locator("#environment-delete")).to_be_hidden()
    give(page, "blue.hdr", probe)
    page.wait_for_url("**environment=*", timeout=FINAL_MS)
    expect(page.locator("#environment option:checked")).to_have_text("blue", timeout=FINAL_MS)
    page.wait_for_selector("#picture:not([hidden])", timeout=FINAL_MS)
    assert [each["name"] for each in site.client.get("/v1/environments").json()["environments"]][-1] == "blue"
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


def test_why_a_probe_is_refused_is_said(browser: Browser, site: Site) -> None:
    """On a page of its own: browsers complain of any answer that is a refusal."""
    page = browser.new_page()
    open_shown(page, str(site.client.base_url))
    give(page, "flat.hdr", b"#?RADIANCE\n\n-Y 8 +X 8\n" + bytes(256))
    expect(page.locator("#upload-note p")).to_contain_text("twice as wide as high", timeout=FINAL_MS)
    page.close()
