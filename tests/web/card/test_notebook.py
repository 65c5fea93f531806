"""The widget of notebooks in a browser: its card draws what moves, and the kernel has the server's
pictures.
"""

import io
import queue
import time
from base64 import b64encode
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page

from isogi.client import Isogi
from tests.live import serving
from tests.web.card.lab import lab_in
from tests.web.visits import middle

pytest.importorskip("anywidget", reason="anywidget is not installed")

SECONDS = 120.0
MODEL = """
window.made = (state, esm) => {
  const listeners = {}, sent = [];
  let changed = {};
  const fire = (event, ...given) => [...(listeners[event] ?? [])].forEach((each) => each(...given));
  const codes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const bytes = (text) => new DataView(codes(text).buffer);
  const put = (name, value) => {
    if (JSON.stringify(state[name]) === JSON.stringify(value) && name !== "picture") return;
    state[name] = value;
    fire(`change:${name}`);
  };
  const model = {
    get: (name) => state[name],
    set: (name, value) => { changed[name] = value; put(name, value); },
    save_changes() { sent.push({ state: changed }); changed = {}; },
    send: (message) => sent.push({ message }),
    on: (event, listener) => (listeners[event] ??= new Set()).add(listener),
    off: (event, listener) => listeners[event]?.delete(listener),
  };
  state.picture = new DataView(new ArrayBuffer(0));
  window.take = () => sent.splice(0);
  window.give = ({ state: news, message, buffers }) => {
    if (message) fire("msg:custom", message, buffers.map(bytes));
    else for (const [name, value] of Object.entries(news))
      put(name, name === "picture" ? bytes(value) : value);
  };
  return import(URL.createObjectURL(new Blob([esm], { type: "text/javascript" })))
    .then(async (module) => {
      window.end = await module.default.render({ model, el: document.body });
    });
};
"""
"""A widget's model as notebooks have it: events of changes come at once, messages wait in a
list.
"""


class Notebook:
    """A viewer, and a page that shows it; messages go between them where the browser is waited
    for.
    """

    def __init__(self, page: Page, viewer: Any) -> None:
        self.page = page
        self.viewer = viewer
        self.moves = 0
        self.way: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.silent = False
        self.answered: list[str] = []
        viewer.observe(lambda change: self.silent or self.tell(change.name), list(viewer.keys))
        self.asked: dict[int, str] = {}
        viewer.send = lambda message, buffers=(): self.way.put(
            {"message": message, "buffers": [b64encode(each).decode() for each in buffers]}
        )
        page.evaluate(f"() => {{ {MODEL} }}")
        files = viewer.get_state(["_css", "_esm"])
        page.add_style_tag(content=files["_css"])
        state = {
            name: getattr(viewer, name)
            for name in viewer.keys
            if not name.startswith("_") and name != "picture"
        }
        page.evaluate("([state, esm]) => made(state, esm)", [plain(state), files["_esm"]])
        self.tell("picture"), self.tell("shown")

    def tell(self, name: str) -> None:
        """Have the page know of a part of the viewer's state."""
        value = getattr(self.viewer, name)
        self.way.put(
            {"state": {name: b64encode(value).decode() if isinstance(value, bytes) else value}}
        )

    def pump(self) -> None:
        """Carry what waits on both sides."""
        for each in self.page.evaluate("take()"):
            if "message" in each:
                self.asked[each["message"]["number"]] = each["message"]["path"]
                data = {"method": "custom", "content": each["message"]}
                self.viewer.comm.handle_msg({"content": {"data": data}, "buffers": []})
                continue
            self.moves += each["state"].get("moving", False)
            self.silent = True
            for name, value in each["state"].items():
                setattr(self.viewer, name, value)
            self.silent = False
        while not self.way.empty():
            self.page.evaluate("give", each := self.way.get())
            if "message" in each:
                self.answered += [self.asked[each["message"]["number"]]]

    def until(self, done: Callable[[], Any]) -> Any:
        """What ``done`` gives, once that is true."""
        end = time.monotonic() + SECONDS
        while not (found := done()):
            assert time.monotonic() < end
            self.pump()
            self.page.wait_for_timeout(10)
        return found

    def drag(self, right: int, down: int) -> None:
        """Drag the picture."""
        x, y = middle(self.page.locator(".stage"))
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + right, y + down, steps=4)
        self.page.wait_for_timeout(50)
        self.pump()
        self.page.mouse.up()

    def shot(self) -> np.ndarray:
        """What the stage shows, (h, w, 3) int."""
        picture = Image.open(io.BytesIO(self.page.locator(".stage").screenshot()))
        return np.asarray(picture.convert("RGB")).astype(int)


def plain(state: dict[str, Any]) -> dict[str, Any]:
    """The part of a state that JSON can hold."""
    return {
        name: value
        for name, value in state.items()
        if isinstance(value, str | float | int | list | dict | None)
    }


CARD = "document.querySelector('.isogi canvas')"
DRAWN = f"!{CARD}.hidden"


@pytest.fixture
def notebook(browser: Browser, small_scene: Path, tmp_path: Path) -> Iterator[Notebook]:
    """A viewer of the small scene whose card is a processor, with the server's final picture."""
    from isogi.widget import Viewer

    with (
        serving(small_scene, tmp_path) as url,
        Isogi(url) as isogi,
        lab_in(browser) as lab,
    ):
        viewer = Viewer(isogi, isogi.scenes()[0]["id"], width=160, height=120, draw="card")
        opened = Notebook(lab.page, viewer)
        opened.until(lambda: viewer.frame and not viewer.frame.facts.provisional)
        yield opened
        lab.page.evaluate("end()")
        viewer.close()


def test_the_card_draws_what_a_notebook_moves(notebook: Notebook) -> None:
    """Knobs reach the kernel, no picture is asked for meanwhile, and the server's takes the card's
    place at rest.
    """
    viewer = notebook.viewer
    page = notebook.page
    before = viewer.shown
    azimuth = viewer.azimuth
    notebook.until(lambda: any(path.startswith("card/light/") for path in notebook.answered))
    notebook.until(lambda: moved(notebook))
    assert viewer.azimuth != azimuth and notebook.moves > 0
    card = notebook.shot()
    notebook.until(lambda: page.evaluate(f"{CARD}.hasAttribute('data-faded')"))
    assert viewer.shown > before and viewer.seen[1] == viewer.azimuth
    page.wait_for_timeout(300)
    server = notebook.shot()
    surface = np.abs(server - server[0, 0]).max(axis=2) > 8
    apart = np.abs(card - server).max(axis=2)[surface]
    assert surface.sum() > 1000 and np.median(apart) <= 4 and (apart < 24).mean() > 0.9


def moved(notebook: Notebook) -> bool:
    """Drag, and whether the card has drawn that."""
    notebook.drag(30, 5)
    return bool(notebook.page.evaluate(f"{DRAWN} && !{CARD}.hasAttribute('data-faded')"))


def test_the_kernel_moves_the_view_of_the_page(notebook: Notebook) -> None:
    viewer = notebook.viewer
    shown = notebook.viewer.shown
    before = notebook.shot()
    viewer.azimuth = viewer.azimuth + 100.0
    notebook.until(lambda: viewer.shown > shown and viewer.seen[1] == viewer.azimuth)
    notebook.until(lambda: (np.abs(notebook.shot() - before).max(axis=2) > 8).mean() > 0.02)
