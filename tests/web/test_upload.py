"""Volumes of one's own on the page: opened, dropped, refused and deleted."""

from base64 import b64encode
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.files.formats.dicom_files import write_series
from tests.files.formats.phantom import affine, letter
from tests.server.uploads.files import FIELDS, ball, headed
from tests.server.uploads.site import Site
from tests.web.visits import BROWSER, DROP, FINAL_MS, box_of, give, open_shown, shoot

pytestmark = BROWSER


DROP_ALL = """(files) => {
  const data = new DataTransfer();
  for (const [text, name] of files) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    data.items.add(new File([bytes], name));
  }
  const event = new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true });
  document.querySelector("#stage").dispatchEvent(event);
}"""
"""Drops files on the picture, together."""

SENT = """() => {
  XMLHttpRequest.prototype.send = function () {
    this.upload.dispatchEvent(new ProgressEvent("progress", { loaded: 9, total: 9 }));
    window.fail = () => this.dispatchEvent(new Event("error"));
  };
}"""
"""A file is sent at once, and the answer is late: a request that a test holds back tells nothing of
its progress.
"""


@pytest.fixture
def shown(page: Page, site: Site) -> Page:
    return open_shown(page, str(site.client.base_url))


def test_without_uploads_the_page_offers_none(page: Page, live_server: str) -> None:
    open_shown(page, live_server)
    expect(page.locator("#upload-open")).to_be_hidden()


def test_a_file_becomes_a_scene_and_is_deleted_again(shown: Page, site: Site) -> None:
    expect(shown.locator("#upload-delete")).to_be_hidden(timeout=FINAL_MS)
    give(shown, "My ball.nrrd", ball(10))
    shown.wait_for_url("**scene=*", timeout=FINAL_MS)
    expect(shown.locator("#scene option:checked")).to_have_text("My ball")
    (kept,) = site.client.get("/v1/volumes").json()["volumes"]
    assert kept["id"] in shown.url
    shown.once("dialog", lambda dialog: dialog.accept())
    shown.click("#upload-delete")
    expect(shown.locator("#upload-delete")).to_be_hidden(timeout=FINAL_MS)
    shown.wait_for_selector("#picture:not([hidden])", timeout=FINAL_MS)
    assert site.client.get("/v1/volumes").json()["volumes"] == []


def test_a_file_can_be_dropped_on_the_picture(shown: Page, site: Site) -> None:
    shown.evaluate(DROP, [b64encode(ball(9)).decode(), "Dropped.nrrd"])
    shown.wait_for_url("**scene=*", timeout=FINAL_MS)
    (kept,) = site.client.get("/v1/volumes").json()["volumes"]
    assert kept["name"] == "Dropped"
    shown.goto("about:blank")  # a page that asks on for what is deleted complains
    site.client.delete(kept["href"])


def test_a_folder_of_slices_becomes_a_volume(shown: Page, site: Site, tmp_path: Path) -> None:
    """A folder that is chosen, and slices of it that are dropped together."""
    pytest.importorskip("pydicom")
    folder = write_series(tmp_path / "scan", letter(), np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine())
    shown.set_input_files("#upload-files", folder)
    shown.wait_for_url("**scene=*", timeout=FINAL_MS)
    (kept,) = site.client.get("/v1/volumes").json()["volumes"]
    assert kept["name"] == "scan" and kept["size"] == list(letter().shape[::-1])
    open_shown(shown, str(site.client.base_url))
    slices = [[b64encode(path.read_bytes()).decode(), path.name] for path in folder.iterdir()]
    shown.evaluate(DROP_ALL, slices)
    shown.wait_for_url(f"**scene={kept['id']}*", timeout=FINAL_MS)
    shown.goto("about:blank")
    site.client.delete(kept["href"])


def test_a_header_comes_with_its_data(shown: Page, site: Site) -> None:
    header = FIELDS.replace("raw", "raw\ndata file: a.bin")
    files = {"a.nhdr": headed(header, b""), "a.bin": bytes(range(24))}
    shown.evaluate(DROP_ALL, [[b64encode(data).decode(), name] for name, data in files.items()])
    shown.wait_for_url("**scene=*", timeout=FINAL_MS)
    (kept,) = site.client.get("/v1/volumes").json()["volumes"]
    assert kept["name"] == "a" and kept["size"] == [4, 3, 2]
    shown.goto("about:blank")
    site.client.delete(kept["href"])


def test_what_is_compiled_for_a_file_is_said(shown: Page) -> None:
    shown.evaluate(SENT)
    give(shown, "My ball.nrrd", ball(8))
    note = shown.locator("#upload-note p")
    expect(note).to_have_text("The server reads My ball.nrrd…")
    compiling = {"done": 3, "total": 12, "seconds": 21}
    shown.route(
        "**/readyz",
        lambda route: route.fulfill(json={"ready": True, "reasons": [], "compiling": compiling}),
    )
    expect(note).to_have_text(
        "Compiling what draws My ball.nrrd, once on this machine: 3 of 12, about 21 s left"
    )
    expect(shown.locator("#upload-note progress")).to_have_js_property("value", 0.25)
    shown.evaluate("fail()")
    expect(note).to_contain_text("when the server is back")
    expect(shown.locator("#upload-note progress")).to_be_hidden()


def test_a_scene_keeps_its_name_on_a_narrow_screen(shown: Page) -> None:
    shown.set_viewport_size({"width": 390, "height": 844})
    scene = box_of(shown.locator(".scene"))
    action = box_of(shown.locator("#upload-open"))
    assert scene["width"] > 300
    assert scene["y"] >= action["y"] + action["height"]
    shoot(shown, "upload-390")


@pytest.mark.long
def test_why_a_file_is_refused_is_said(browser: Browser, site: Site) -> None:
    """On a page of its own: browsers complain of any answer that is a refusal."""
    page = open_shown(browser.new_page(), str(site.client.base_url))
    give(page, "a.nrrd", headed("type: block\n"))
    expect(page.locator("#upload-note p")).to_contain_text(
        "header of 'a' has no dimension", timeout=FINAL_MS
    )
    expect(page.locator("#upload-note progress")).to_be_hidden()
    give(page, "a.nhdr", headed(FIELDS.replace("raw", "raw\ndata file: a.bin"), b""))
    expect(page.locator("#upload-note p")).to_contain_text(
        "a.bin: send both together", timeout=FINAL_MS
    )
    give(page, "slice.nrrd", b"\x89PNG\r\n\x1a\n" + bytes(64))
    expect(page.locator("#upload-note p")).to_contain_text(
        "seems to be a picture", timeout=FINAL_MS
    )
    page.close()
