"""Files with light from the page, in a real browser: a mesh, where there are volumes, and keyframes of a film."""

import json
import math
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from server.cli.film_path import views_in
from tests.web.visits import BROWSER, FINAL_MS, query_of, shoot

pytestmark = BROWSER
VIEW = "isovalue=0.45&azimuth=-70.5&shading=phong"


@pytest.fixture
def panel(page: Page, live_server: str) -> Page:
    """A view with the panel of files open."""
    page.goto(f"{live_server}/?{VIEW}")
    page.click("#save-button:enabled")
    return page


def test_the_surface_comes_as_a_mesh_with_its_light(panel: Page, live_server: str, tmp_path: Path) -> None:
    with panel.expect_download(timeout=FINAL_MS) as download:
        panel.click("#export-start")
        expect(panel.locator("#export progress")).to_be_visible()
    assert download.value.suggested_filename == "small-0.45.glb"
    download.value.save_as(tmp_path / "a.glb")
    assert (tmp_path / "a.glb").read_bytes()[:4] == b"glTF"
    expect(panel.locator("#export .note")).to_contain_text("100% of its light final")
    shoot(panel, "export")


def test_a_volume_is_offered_where_texels_are_voxels(panel: Page, live_server: str) -> None:
    kinds = panel.locator("#export-kind option")
    assert [each.get_attribute("value") for each in kinds.all()] == ["glb", "usdz", "ply"], "half a lattice"

    def whole(route: Route) -> None:
        scene = route.fetch().json()
        scene["plan"]["texels"]["total"] = math.prod(scene["volume"]["size"])
        route.fulfill(json=scene)

    panel.route("**/v1/scenes/small", whole)
    panel.reload()
    expect(kinds.last).to_have_attribute("value", "vti")


def test_an_export_is_stopped(panel: Page, live_server: str) -> None:
    panel.route("**/v1/jobs/*", lambda route: route.continue_() if route.request.method == "DELETE" else route.abort())
    panel.click("#export-start")
    expect(panel.locator("#export .note")).to_contain_text("continues by itself")
    with panel.expect_response(lambda answer: answer.request.method == "DELETE") as stopped:
        panel.click("#export-stop")
    assert stopped.value.status == 200
    expect(panel.locator("#export .note")).to_have_text("Stopped, nothing is saved.")
    expect(panel.locator("#export-start")).to_be_visible()


def test_views_are_kept_shown_again_and_saved_for_films(page: Page, live_server: str, tmp_path: Path) -> None:
    page.goto(f"{live_server}/?{VIEW}")
    page.click("#share-button:enabled")
    expect(page.locator("#views-save")).to_be_disabled()
    page.click("#views-keep")
    page.keyboard.press("Escape")
    page.focus("#stage")
    page.keyboard.press("ArrowRight")
    page.click("#share-button")
    page.click("#views-keep")
    with page.expect_download() as download:
        page.click("#views-save")
    download.value.save_as(tmp_path / "keys.json")
    first, second = views_in(json.loads((tmp_path / "keys.json").read_text()))
    assert (first["isovalue"], first["azimuth"]) == ("0.45", "-70.5") and second["azimuth"] != "-70.5"
    expect(page.locator("#views-line code")).to_have_text(
        "isogi film small.toml --views-file small-views.json -o small.mp4"
    )
    shoot(page, "views")
    page.locator("#views-list .go").first.click()
    assert query_of(page)["azimuth"] == "-70.5"
    page.reload()
    page.click("#share-button:enabled")
    expect(page.locator("#views-list li")).to_have_count(2)
    page.click("[aria-label='Forget view 1']")
    expect(page.locator("#views-list li")).to_have_count(1)
