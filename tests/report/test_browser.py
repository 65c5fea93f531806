"""A report's page in a real browser: what it asks for, and whether it can be read in both schemes
and on a phone.
"""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page

from isogi_report.journal import Entry
from isogi_report.page import write_report
from tests.report.samples import report_of, sections
from tests.web.visits import BROWSER

SHOTS = Path(__file__).resolve().parents[2] / "test-results" / "report"
Scheme = Literal["light", "dark"]
WIDTHS = {"wide": 1100, "phone": 390}

pytestmark = BROWSER


@pytest.fixture(scope="module")
def address(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page of the samples, as a file."""
    entries = [Entry(section, 1.0) for section in sections()]
    report = report_of(small_scene, entries, ["Something is missing."])
    return write_report(tmp_path_factory.mktemp("report"), report).as_uri()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
def test_it_can_be_read(browser: Browser, address: str, scheme: Scheme, width: str) -> None:
    context = browser.new_context(viewport={"width": WIDTHS[width], "height": 800})
    page = context.new_page()
    page.emulate_media(color_scheme=scheme)
    asked: list[str] = []
    complaints: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(address)
    assert [url for url in asked if not url.startswith("data:")] == [address]
    assert complaints == []
    assert page.evaluate("document.documentElement.scrollWidth") == WIDTHS[width]
    assert all(size >= 8 for size in text_sizes(page))
    SHOTS.mkdir(parents=True, exist_ok=True)
    shot = SHOTS / f"{width}-{scheme}.png"
    page.screenshot(path=shot, full_page=True)
    with Image.open(shot) as picture:
        paper = np.asarray(picture.convert("L"))[2, 2]
    assert paper > 230 if scheme == "light" else paper < 40
    context.close()


def text_sizes(page: Page) -> list[float]:
    """Pixels of the letters of every label in a plot."""
    sizes: list[float] = page.evaluate(
        """() => [...document.querySelectorAll(".plot svg text")].map((label) => {
             const { a, b } = label.getScreenCTM();
             return parseFloat(getComputedStyle(label).fontSize) * Math.hypot(a, b);
           })"""
    )
    assert len(sizes) > 5
    return sizes
