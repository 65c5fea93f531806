"""isogi in a notebook: a view that is dragged about, in JupyterLab, VS Code and Colab.

>>> from isogi_client import Isogi
>>> from isogi_widget import Viewer
>>> viewer = Viewer(Isogi("http://127.0.0.1:8000"), "casting", width=640, height=480)
>>> viewer

It needs `isogi_client.py` and anywidget: isogi's extra ``notebook``. Pictures go by way of the kernel, so that the
browser needs no way to the server.
"""

from __future__ import annotations

import threading
from typing import Any

import anywidget
import traitlets

from isogi_client import Frame, Isogi, IsogiError

KNOBS = ("isovalue", "azimuth", "elevation", "distance", "yaw")
"""Parameters of the view that the notebook moves."""

REFINED = 1.0
"""Seconds of baking between two pictures of a view at rest."""

ESM = """
const DRAG = 0.4, STEP = 5, ZOOM = 1.001;
const KEYS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};

function render({ model, el }) {
  const picture = Object.assign(document.createElement("img"), { tabIndex: 0, draggable: false });
  const slider = Object.assign(document.createElement("input"), { type: "range", step: "any", ariaLabel: "Isovalue" });
  const told = document.createElement("output");
  el.classList.add("isogi");
  el.append(picture, slider, told);

  const set = (values) => {
    for (const [name, value] of Object.entries(values)) model.set(name, value);
    model.save_changes();
  };
  const turn = (dx, dy, light) => {
    if (light) return set({ yaw: (model.get("yaw") + dx) % 360 });
    const elevation = Math.min(90, Math.max(-90, model.get("elevation") + dy));
    set({ azimuth: (model.get("azimuth") - dx) % 360, elevation });
  };
  const show = () => {
    URL.revokeObjectURL(picture.src);
    picture.src = URL.createObjectURL(new Blob([model.get("picture")], { type: "image/jpeg" }));
    picture.alt = `Isosurface at ${model.get("isovalue")}: ${model.get("told")}`;
  };
  const mirror = () => {
    [slider.min, slider.max] = model.get("span");
    slider.value = model.get("isovalue");
    slider.hidden = slider.min === slider.max;
    told.textContent = model.get("told");
  };

  picture.addEventListener("pointerdown", (event) => picture.setPointerCapture(event.pointerId));
  picture.addEventListener("pointermove", (event) => {
    if (event.buttons) turn(DRAG * event.movementX, DRAG * event.movementY, event.shiftKey);
  });
  picture.addEventListener("wheel", (event) => {
    event.preventDefault();
    set({ distance: Math.min(1e6, Math.max(0.02, model.get("distance") * ZOOM ** event.deltaY)) });
  }, { passive: false });
  picture.addEventListener("keydown", (event) => {
    if (!(event.key in KEYS)) return;
    event.preventDefault();
    event.stopPropagation();
    const [dx, dy] = KEYS[event.key];
    turn(STEP * dx, STEP * dy, event.shiftKey);
  });
  slider.addEventListener("input", () => set({ isovalue: Number(slider.value) }));
  model.on("change:picture", show);
  model.on("change", mirror);
  show();
  mirror();
  return () => URL.revokeObjectURL(picture.src);
}
export default { render };
"""

CSS = """
.isogi { display: inline-grid; gap: 0.3em; max-width: 100%; }
.isogi img { max-width: 100%; cursor: grab; touch-action: none; user-select: none; }
.isogi output { font-size: smaller; opacity: 0.8; }
"""


class Viewer(anywidget.AnyWidget):
    """A view of a scene on a server, which is dragged (with Shift the light), zoomed by the wheel, and slid.

    Its knobs can be read, set and observed: ``isovalue``, ``azimuth``, ``elevation``, ``distance``, ``yaw``. The
    other parameters of the HTTP interface are given once. The picture becomes better while the view rests.
    """

    _esm = ESM
    _css = CSS
    isovalue = traitlets.Float().tag(sync=True)
    azimuth = traitlets.Float().tag(sync=True)
    elevation = traitlets.Float().tag(sync=True)
    distance = traitlets.Float().tag(sync=True)
    yaw = traitlets.Float().tag(sync=True)
    picture = traitlets.Bytes().tag(sync=True)
    told = traitlets.Unicode().tag(sync=True)
    span = traitlets.List().tag(sync=True)

    def __init__(self, isogi: Isogi, scene: str, **view: Any) -> None:
        """Show the view, which takes what is not given from the scene's defaults. Raises IsogiError."""
        facts = isogi.scene(scene)
        start = {name: float(view.pop(name, facts["defaults"][name])) for name in KNOBS}
        self._isogi, self._scene, self._more = isogi, scene, view
        self._moved, self._closed = threading.Event(), False
        self.frame: Frame | None = None
        super().__init__(**start, span=list(facts["ranges"]["isovalue"].values()))
        self.observe(lambda _: self._moved.set(), KNOBS)
        self._moved.set()
        self._thread = threading.Thread(target=self._follow, name="isogi-viewer", daemon=True)
        self._thread.start()

    @property
    def view(self) -> dict[str, Any]:
        """The parameters of what is shown, such as for ``isogi.frame(scene, wait="final", **viewer.view)``."""
        return {**self._more, **{name: getattr(self, name) for name in KNOBS}}

    def close(self) -> None:
        """Show nothing more, once the picture that is under way has come."""
        self._closed = True
        self._moved.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()
        super().close()

    def _follow(self) -> None:
        """Show the newest view as it is, and then ever better, until it moves on."""
        while True:
            self._moved.wait()
            self._moved.clear()
            if self._closed:
                return
            try:
                frame = self._show("now")
                while frame.facts.provisional and not self._moved.is_set():
                    frame = self._show(REFINED)
            except (IsogiError, RuntimeError) as error:  # a RuntimeError where the connections were closed
                self.told = str(error)

    def _show(self, wait: Any) -> Frame:
        self.frame = self._isogi.frame(self._scene, wait=wait, f="jpeg", **self.view)
        if not self._closed:
            self.told, self.picture = str(self.frame.facts), self.frame.content
        return self.frame
