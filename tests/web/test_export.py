"""What the page hands out: lines that make the same picture, pictures and meshes as files, and
keyframes of a film.
"""

import io
import json
import math
import re
import subprocess
import sys
from base64 import b64decode
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import BrowserContext, Page, Route, expect

from isogi_server.cli.film_path import views_in
from tests.web.visits import BROWSER, FINAL_MS, open_final, query_of, shoot, unfold, wait_final

pytestmark = BROWSER


VIEW = "isovalue=0.45&azimuth=-70.5&shading=phong"


@pytest.fixture
def panel(page: Page, live_server: str) -> Page:
    """A view with the panel of files open."""
    page.goto(f"{live_server}/?{VIEW}")
    page.click("#save-button:enabled")
    return page


def test_the_surface_comes_as_a_mesh_with_its_light(
    panel: Page, live_server: str, tmp_path: Path
) -> None:
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
    assert [each.get_attribute("value") for each in kinds.all()] == ["glb", "usdz", "ply"], (
        "half a lattice"
    )

    def whole(route: Route) -> None:
        scene = route.fetch().json()
        scene["plan"]["texels"]["total"] = math.prod(scene["volume"]["size"])
        route.fulfill(json=scene)

    panel.route("**/v1/scenes/small", whole)
    panel.reload()
    expect(kinds.last).to_have_attribute("value", "vti")


def test_an_export_is_stopped(panel: Page, live_server: str) -> None:
    panel.route(
        "**/v1/jobs/*",
        lambda route: route.continue_() if route.request.method == "DELETE" else route.abort(),
    )
    panel.click("#export-start")
    expect(panel.locator("#export .note")).to_contain_text("continues by itself")
    with panel.expect_response(lambda answer: answer.request.method == "DELETE") as stopped:
        panel.click("#export-stop")
    assert stopped.value.status == 200
    expect(panel.locator("#export .note")).to_have_text("Stopped, nothing is saved.")
    expect(panel.locator("#export-start")).to_be_visible()


def test_views_are_kept_shown_again_and_saved_for_films(
    page: Page, live_server: str, tmp_path: Path
) -> None:
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
    assert (first["isovalue"], first["azimuth"]) == ("0.45", "-70.5") and second[
        "azimuth"
    ] != "-70.5"
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


PLAIN = "shading=phong"
"""What is final without any light."""

SHARED_VIEW = f"{PLAIN}&isovalue=0.45&azimuth=-70.5&overlay=error"


def line(page: Page, name: str) -> str:
    """One of the lines of the open menu."""
    expect(page.locator(f"#share-{name}")).not_to_be_empty()
    return page.inner_text(f"#share-{name}")


def shared(page: Page, address: str) -> Page:
    """The page with its menu open, its picture final."""
    open_final(page, address).click("#share-button")
    return page


@pytest.fixture
def menu(steady: Page, live_server: str) -> Page:
    """A view with its menu open, its picture final; opened where it is not yet."""
    if steady.url.startswith(live_server):
        return steady
    return shared(steady, f"{live_server}/?{SHARED_VIEW}")


def picture_on(page: Page) -> np.ndarray:
    """The picture on the stage, at its full size."""
    address = page.evaluate(
        """() => {
          const image = document.querySelector("#picture");
          const canvas = document.createElement("canvas");
          Object.assign(canvas, { width: image.naturalWidth, height: image.naturalHeight });
          canvas.getContext("2d").drawImage(image, 0, 0);
          return canvas.toDataURL("image/png");
        }"""
    )
    return pixels_in(b64decode(address.partition(",")[2]))


def pixels_in(picture: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"))


@pytest.mark.journey
def test_the_curl_line_saves_the_picture_that_is_shown(menu: Page, tmp_path: Path) -> None:
    command = line(menu, "curl")
    subprocess.run(
        ["bash", "-c", command], cwd=tmp_path, check=True, timeout=60, capture_output=True
    )
    assert np.array_equal(pixels_in((tmp_path / "small-0.45.png").read_bytes()), picture_on(menu))
    assert all(part in command for part in ("azimuth=-70.5", "overlay=error", "wait_ms=10000"))
    assert "yaw" not in command and "exposure" not in command, (
        "what the scene's defaults say is left out"
    )
    assert "Authorization" not in command


def test_the_python_line_asks_for_the_picture_that_is_shown(
    menu: Page, live_server: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: dict[str, Any] = {}

    class Isogi:
        def __init__(self, address: str) -> None:
            called["address"] = address

        def frame(self, scene: str, *, wait: str, **view: Any) -> SimpleNamespace:
            called.update(scene=scene, wait=wait, view=view)
            return SimpleNamespace(save=lambda file: called.update(file=file))

    monkeypatch.setitem(sys.modules, "isogi.client", SimpleNamespace(Isogi=Isogi))
    exec(line(menu, "python"), {})
    assert (called["address"], called["scene"]) == (live_server, "small")
    assert (called["wait"], called["file"]) == ("final", "small-0.45.png")
    answer = menu.request.get(
        f"{called['address']}/v1/scenes/{called['scene']}/frame", params=called["view"]
    )
    assert np.array_equal(pixels_in(answer.body()), picture_on(menu))


def test_copying_copies_and_says_so(menu: Page) -> None:
    context: BrowserContext = menu.context
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    for name, button in (
        ("link", "Copy link"),
        ("curl", "Copy curl line"),
        ("python", "Copy Python line"),
    ):
        menu.get_by_role("button", name=button).click()
        said = {"link": "Link", "curl": "curl line", "python": "Python line"}[name]
        expect(menu.locator("#share [role=status]")).to_have_text(f"{said} copied")
        assert menu.evaluate("navigator.clipboard.readText()") == line(menu, name)
    assert line(menu, "link") == menu.url


def test_where_a_token_is_wanted_the_line_names_its_variable(page: Page, live_server: str) -> None:
    def behind_a_token(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(
            response=answer, headers={**answer.headers, "cache-control": "private, no-cache"}
        )

    page.route("**/v1/scenes", behind_a_token)
    assert '-H "Authorization: Bearer $ISOGI_TOKEN"' in line(
        shared(page, f"{live_server}/?{PLAIN}"), "curl"
    )


def test_a_picture_is_saved_large_and_final_with_its_notes(
    page: Page, live_server: str, tmp_path: Path
) -> None:
    open_final(page, f"{live_server}/?{SHARED_VIEW}").click("#save-button")
    choose_large(page)
    with page.expect_download(timeout=FINAL_MS) as download:
        page.click("#save-start")
    assert download.value.suggested_filename == "small-0.45.png"
    download.value.save_as(tmp_path / "saved.png")
    with Image.open(tmp_path / "saved.png") as picture:
        picture.load()
        assert picture.width == 1920
        assert (
            picture.info["Source"].startswith(f"{live_server}/?")
            and "azimuth=-70.5" in picture.info["Source"]
        )
        assert "at 0.45" in picture.info["Title"]
        comment = picture.info["Comment"]
    assert comment.startswith("Done, 1920 × ")
    expect(page.locator("#save > .note")).to_have_text(f"Saved small-0.45.png: {comment}.")


def choose_large(page: Page) -> None:
    """Choose a size of 1920 pixels, which the stage does not have."""
    large = page.locator("#save-size option", has_text=re.compile("^1920 "))
    page.select_option("#save-size", large.get_attribute("value"))


def test_a_finished_picture_is_a_file_at_once(page: Page, live_server: str, tmp_path: Path) -> None:
    """Also without a server: the size that is offered first is that of the picture shown."""
    open_final(page, f"{live_server}/?{PLAIN}").click("#save-button")
    expect(page.locator("#save-size option").first).to_contain_text("as seen, at once")
    page.route("**/frame?*", lambda route: route.abort())
    shown = picture_on(page)
    assert np.array_equal(saved(page, tmp_path / "a.png"), shown)


def saved(page: Page, path: Path) -> np.ndarray:
    """The picture that the open panel saves, as linear numbers (h, w, 3)."""
    with page.expect_download(timeout=FINAL_MS) as download:
        page.click("#save-start")
    download.value.save_as(path)
    with Image.open(path) as picture:
        assert "Comment" in picture.info
        return np.asarray(picture.convert("RGB"), float)


def test_scale_and_axes_are_in_a_saved_picture_on_wish(
    page: Page, live_server: str, tmp_path: Path
) -> None:
    open_final(page, f"{live_server}/?{PLAIN}").click("#save-button")
    plain = saved(page, tmp_path / "plain.png")
    page.check("#save-rulers")
    stamped = saved(page, tmp_path / "stamped.png")
    rows, columns = np.nonzero(np.abs(stamped - plain).max(axis=-1) > 2)
    high, wide, _ = plain.shape
    assert len(rows) > 1000
    assert (
        rows.min() > 0.7 * high
        and rows.max() < high
        and columns.min() >= 0
        and columns.max() < 0.4 * wide
    )


@pytest.mark.long
def test_saving_survives_a_lost_server_and_can_be_stopped(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?{PLAIN}").click("#save-button")
    choose_large(page)
    page.route("**/frame?*", lambda route: route.abort())
    page.click("#save-start")
    note = page.locator("#save > .note")
    expect(note).to_contain_text("continues by itself")
    page.click("#save-close")
    expect(note).to_have_text("Stopped, nothing is saved.")
    page.click("#save-start")
    expect(note).to_contain_text("continues by itself")
    with page.expect_download(timeout=FINAL_MS):
        page.unroute("**/frame?*")
    page.keyboard.press("Escape")
    page.focus("#save-close")
    page.keyboard.press("Escape")
    expect(page.locator("#save")).to_be_hidden()


def test_what_cannot_become_final_is_saved_as_it_is(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?{PLAIN}").click("#save-button")
    choose_large(page)
    page.route("**/frame?*", stuck())
    with page.expect_download(timeout=FINAL_MS) as download:
        page.click("#save-start")
    assert download.value.suggested_filename.endswith("-preview.png")
    expect(page.locator("#save > .note")).to_contain_text(
        "the target of 50 % is not reached, no more light is coming"
    )


def stuck() -> Callable[[Route], None]:
    """A server whose picture stays provisional: one of its chunks cannot be baked."""

    def answer(route: Route) -> None:
        if route.request.headers.get("if-none-match"):
            return route.fulfill(status=304)
        true = route.fetch()
        state = {
            "isogi-provisional": "?1",
            "isogi-chunks": "needed=4, final=3",
            "isogi-error": "0.7",
        }
        route.fulfill(response=true, headers=true.headers | state)

    return answer


def test_the_times_of_frames_are_listed(page: Page, live_server: str) -> None:
    unfold(open_final(page, f"{live_server}/?{PLAIN}")).click("#times summary")
    page.locator("#times dt").last.wait_for()  # a fold tells of itself a little later
    names = page.locator("#times dt").all_inner_texts()
    assert {"Making the file", "All", "Drafts a second, last moved"} <= set(names)
    page.focus("#stage")
    for _ in range(6):
        page.keyboard.press("ArrowLeft")
        page.wait_for_timeout(120)
    wait_final(page)
    rate = page.locator("#times dd").last.inner_text()
    assert 1 <= int(rate) <= 60
