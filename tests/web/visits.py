"""What every visit to the page does."""

import io
import math
from base64 import b64decode
from pathlib import Path
from typing import Any, Literal
from urllib.parse import parse_qsl, urljoin, urlsplit

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import FloatRect, Locator, Page

Button = Literal["left", "middle", "right"]
CHROMIUM = Path("/usr/bin/chromium")
WITHOUT = [
    *(
        "WebUIOmniboxPopup",
        "WebUIOmniboxAimPopup",
        "AimEnabled",
        "PreconnectToSearch",
        "NetworkTimeServiceQuerying",
    ),
    *("OptimizationHints", "MediaRouter", "HttpsUpgrades", "PaintHolding"),
]
"""Features that Chromium goes without: popups of an address bar that nobody sees take it longer
than a page of ours.
"""

FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    f"--disable-features={','.join(WITHOUT)}",
]
VIEWPORTS = [(1280, 800), (1920, 1080), (390, 844)]
"""Screens that the page is looked at on: a laptop's, a desk's and a phone's."""

SHOTS = Path(__file__).resolve().parents[2] / "test-results" / "page"
BROWSER = pytest.mark.skipif(
    not CHROMIUM.exists(), reason=f"no Chromium at {CHROMIUM}: install Debian's chromium"
)
"""Skips tests of the page where there is no Chromium; the fixture ``browser`` marks them."""

DROP = """([text, name]) => {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const data = new DataTransfer();
  data.items.add(new File([bytes], name));
  const event = new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true });
  document.querySelector("#stage").dispatchEvent(event);
}"""
"""Drops a file on the picture."""

TWO_FRAMES = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Ends when all that happened before is on the screen."""

FINAL_MS = 180_000  # baking a view for the first time on a small machine


def load_modules(page: Page) -> None:
    """Have the page load its modules one by one in place of the single script that is sent: a test
    changes those that it imports.
    """
    page.route(
        "**/web/page-*.js",
        lambda route: route.fulfill(body='import "./main.js";', content_type="text/javascript"),
    )


def open_shown(page: Page, address: str) -> Page:
    """The page with a picture, whichever that is."""
    page.goto(address)
    page.wait_for_selector("#picture:not([hidden])", timeout=FINAL_MS)
    return page


def open_final(page: Page, address: str) -> Page:
    page.goto(address)
    return wait_final(page)


def wait_final(page: Page) -> Page:
    """Wait until the view rests, its picture is final, and the browser has it on the screen."""
    page.evaluate(
        TWO_FRAMES
    )  # a view that changes loses its sharpness at once, one of another size in the next frame
    page.wait_for_selector(
        "#stage[data-state=final][data-sharp]:not([data-busy])", timeout=FINAL_MS
    )
    page.evaluate(TWO_FRAMES)
    return page


def written(page: Page) -> str:
    """The address with all that has changed: the page writes it 150 ms later, and timers come in
    their order.
    """
    return str(
        page.evaluate("() => new Promise((done) => setTimeout(() => done(location.href), 160))")
    )


def unfold(page: Page) -> Page:
    """Open what the page folds away for those who want to know more."""
    page.eval_on_selector("#details", "details => { details.open = true; }")
    return page


def slide(page: Page, knob: str, share: float) -> None:
    """Put a slider at a share of its range, as a hand would."""
    page.eval_on_selector(
        f"input[name={knob}]",
        """(slider, share) => {
          slider.value = Number(slider.min) + share * (Number(slider.max) - Number(slider.min));
          slider.dispatchEvent(new Event("input", { bubbles: true }));
        }""",
        share,
    )


def give(page: Page, name: str, content: bytes) -> None:
    """Choose a file, as in the dialog that the button opens."""
    page.set_input_files(
        "#upload-file", {"name": name, "mimeType": "application/octet-stream", "buffer": content}
    )


def without_sockets(page: Page) -> Page:
    """A browser that has no sockets: the page asks for one picture after the other."""
    page.add_init_script("delete window.WebSocket")
    return page


PIXELS = """([picture, size]) => {
  const shown = document.querySelector(picture);
  const side = size || shown.width;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = side;
  const paint = canvas.getContext("2d");
  paint.drawImage(shown, 0, 0, side, side);
  const bytes = paint.getImageData(0, 0, side, side).data;
  return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
}"""
"""RGBA of a picture as one text: as a list of numbers it takes a second on its way here."""


def pixels(page: Page, picture: str = "#picture", size: int | None = 96) -> np.ndarray:
    """A picture as float RGB (size, size, 3) within 0..255, scaled to that; None is the width of a
    canvas.
    """
    flat = np.frombuffer(b64decode(page.evaluate(PIXELS, [picture, size])), np.uint8)
    side = math.isqrt(len(flat) // 4)
    return flat.reshape(side, side, 4)[..., :3].astype(float)


def box_of(locator: Locator) -> FloatRect:
    """Where something is on the screen."""
    box = locator.bounding_box()
    assert box is not None
    return box


def middle(locator: Locator) -> tuple[float, float]:
    """The middle of something on the screen."""
    box = box_of(locator)
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def are_apart(one: FloatRect, other: FloatRect) -> bool:
    """Whether neither of two boxes lies over the other."""
    pairs = ((one, other), (other, one))
    return any(a["x"] + a["width"] <= b["x"] or a["y"] + a["height"] <= b["y"] for a, b in pairs)


def stage_of(page: Page) -> tuple[float, float, int, int]:
    """Left, top, width and height of the stage."""
    box = box_of(page.locator("#stage"))
    return box["x"], box["y"], round(box["width"]), round(box["height"])


def drag(
    page: Page, place: tuple[float, float], right: float, down: float, button: Button = "left"
) -> None:
    """Drag from a place on the screen."""
    x, y = place
    page.mouse.move(x, y)
    page.mouse.down(button=button)
    page.mouse.move(x + right, y + down, steps=5)
    page.mouse.up(button=button)


def query_of(page: Page) -> dict[str, str]:
    """The knobs in the address bar, with all that has changed."""
    return dict(parse_qsl(urlsplit(written(page)).query))


def surface_of(page: Page) -> np.ndarray:
    """World positions (h, w, 3) of the surface that the view of the address shows, NaN where it
    shows none.
    """
    *_, width, height = stage_of(page)
    view = {
        name: value for name, value in query_of(page).items() if name not in ("scene", "exposure")
    }
    asked: dict[str, Any] = {**view, "f": "npy", "width": width, "height": height}
    answer = page.request.get(urljoin(page.url, "/v1/scenes/small/frame"), params=asked)
    assert answer.ok, answer.text()
    planes: np.ndarray = np.load(io.BytesIO(answer.body()))
    return np.where(planes[..., 3:4] > 0, planes[..., 6:], np.nan)


def shoot(shown: Page | Locator, name: str, **options: Any) -> Path:
    """A screenshot among those of the page; its file."""
    SHOTS.mkdir(parents=True, exist_ok=True)
    shown.screenshot(path=SHOTS / f"{name}.png", **options)
    return SHOTS / f"{name}.png"


def click(page: Page, column: int, row: int) -> None:
    """Click the middle of a pixel of the stage."""
    left, top, *_ = stage_of(page)
    page.mouse.click(left + column + 0.5, top + row + 0.5)


def fact(page: Page, name: str) -> str:
    """What the card of a point says by this name."""
    return page.locator(f"#point dt:text-is('{name}') + dd").inner_text()


def position(page: Page) -> list[float]:
    """Where the card says that its point is."""
    return [float(x.replace("−", "-")) for x in fact(page, "Position").split(",")]


def findings(page: Page) -> list[str]:
    """What axe-core finds: rule, help, and the first place."""
    violations = Axe().run(page).response["violations"]
    return [f"{v['id']}: {v['help']} at {v['nodes'][0]['target']}" for v in violations]
