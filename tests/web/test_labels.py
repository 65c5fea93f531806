"""Labels on the page: hidden by keys, kept in the address, and named in a saved picture."""

from collections.abc import Iterator
from pathlib import Path

import nrrd
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from tests.live import serving
from tests.web.visits import BROWSER, FINAL_MS, open_final, wait_final

pytestmark = BROWSER


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of a segmentation of two halves, one red and one green."""
    folder, parts = tmp_path_factory.mktemp("labels"), np.zeros((12, 12, 12), np.uint8)
    parts[2:10, 2:10, 2:6], parts[2:10, 2:10, 6:10] = 3, 8
    nrrd.write(str(folder / "seg.nrrd"), parts, index_order="C")
    tables = ((3, "liver", "#c02020"), (8, "spleen", "#20a040"))
    labels = "".join(f'[[labels]]\nvalue = {v}\nname = "{name}"\ncolour = "{code}"\n' for v, name, code in tables)
    lit = '[[lights]]\ntype = "constant"\nradiance = 1.0\n'
    plain = 'volume = "seg.nrrd"\nbounces = 0\ntarget_error = 0.3\nprojected = false\n'
    (folder / "parts.toml").write_text(plain + lit + labels)
    with serving(folder / "parts.toml", folder / "store") as url:
        yield url


def greenness(path: Path) -> np.ndarray:
    """Which pixels of a picture are clearly green; (h, w) bool."""
    with Image.open(path) as picture:
        red, green, _ = np.moveaxis(np.asarray(picture.convert("RGB"), int), -1, 0)
    return np.asarray(green > red + 30)


def test_a_label_is_hidden_by_keys_and_named_in_a_saved_picture(page: Page, address: str, tmp_path: Path) -> None:
    open_final(page, address)
    page.get_by_label("spleen").focus()
    page.keyboard.press("Space")
    expect(page.get_by_label("liver")).to_be_disabled()  # one is always shown
    wait_final(page)
    assert "hide=8" in page.url
    page.click("#save-button")
    found = []
    for _ in range(2):
        with page.expect_download(timeout=FINAL_MS) as download:
            page.click("#save-start")
        download.value.save_as(path := tmp_path / f"{len(found)}.png")
        found.append(np.asarray(Image.open(path).convert("RGB"), int))
        page.check("#save-legend")
    assert not greenness(tmp_path / "0.png").any(), "the spleen is gone"
    rows, columns = np.nonzero(np.abs(found[1] - found[0]).max(axis=-1) > 2)
    high, wide, _ = found[0].shape
    assert len(rows) > 500 and rows.min() > 0.8 * high and columns.min() > 0.7 * wide, "a row for the liver"
    page.keyboard.press("Escape")
    page.click("#labels-all")
    wait_final(page)
    assert "hide" not in page.url
