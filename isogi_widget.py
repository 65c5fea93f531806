"""isogi in a notebook: a view that is dragged about, in JupyterLab, VS Code and Colab.

>>> from isogi_client import Isogi
>>> from isogi_widget import Viewer
>>> viewer = Viewer(Isogi("http://127.0.0.1:8000"), "casting", width=640, height=480)
>>> viewer

It needs `isogi_client.py` and anywidget: isogi's extra ``notebook``. The visitor's graphics card
draws what moves, by the modules of the server's page; without one, the server does. Modules,
voxels, light and pictures go by way of the kernel, so that the browser needs no way to the server.

The modules are programs that run in the notebook's page, with all that this page may do. Connect to
a server that you trust, and to one on another machine by https:// or a tunnel: whoever is on the
way of plain http:// can put programs of theirs in their place.
"""

from __future__ import annotations

import re
import threading
from concurrent.futures import ThreadPoolExecutor
from posixpath import dirname, join, normpath
from typing import Any

import anywidget
import traitlets

from isogi_client import Frame, Isogi, IsogiError, query, scene_path

MOVED_PARAMETERS = ("isovalue", "azimuth", "elevation", "distance", "yaw", "pitch", "roll")
"""Parameters of the view that the notebook moves, besides the target."""

REFINE_SECONDS = 1.0
"""Seconds of baking between two pictures of a view at rest."""

REST_SECONDS = 1.0
"""Seconds without a change after which a view rests, where the page does not say so: it may have
been closed.
"""

NOTEBOOK_MODULE = "notebook/notebook.js"
"""The page's module that shows a view in a notebook."""

IMPORT_STATEMENT = re.compile(r'^(?:import|export) [^;]*?from "(\.[^"]+)";$', re.MULTILINE)
"""What a module of the page imports."""

DEFAULT_SIDE_PIXELS = 512
"""Pixels of a picture's sides where they are not given."""

ESM = r"""
const made = new Map(); // addresses of modules, by their text: widgets of a page share them

function addressOf(modules, name) {
  const [folder] = name.split(/\/[^/]*$/);
  const imports = /(^(?:import|export) [^;]*?from )"(\.[^"]+)";$/gm;
  const text = modules[name].replace(imports, (_, head, path) => {
    const place = new URL(path, `http://web/${folder}/`).pathname.slice(1);
    return `${head}"${addressOf(modules, place)}";`;
  });
  if (!made.has(text)) {
    const blob = new Blob([text], { type: "text/javascript" });
    made.set(text, URL.createObjectURL(blob));
  }
  return made.get(text);
}

async function render({ model, el }) {
  const { show } = await import(addressOf(model.get("modules"), model.get("start")));
  return show(model, el);
}
export default { render };
"""

CSS = """
.isogi { display: inline-grid; gap: 0.3em; max-width: 100%; }
.isogi .stage {
  position: relative; max-width: 100%; cursor: grab; touch-action: none; user-select: none;
}
.isogi .stage > * { position: absolute; inset: 0; width: 100%; height: 100%; margin: 0; }
.isogi canvas { pointer-events: none; }
.isogi canvas[data-faded] { opacity: 0; transition: opacity 0.15s; }
.isogi [hidden] { display: none; }
.isogi output { font-size: smaller; opacity: 0.8; }
"""


class Viewer(anywidget.AnyWidget):
    """A view of a scene on a server, which is dragged (with Shift the light), zoomed by the wheel,
    and slid.

    Its knobs can be read, set and observed: ``isovalue``, ``azimuth``, ``elevation``, ``distance``,
    ``yaw``, ``pitch``, ``roll``, and the ``target`` that the camera turns about, None for the
    volume's centre. The other parameters of the HTTP interface are given once. The visitor's
    graphics card draws while the view moves, and the server's picture becomes better while it
    rests. ``draw="server"`` leaves all to the server, and ``draw="card"`` draws by the processor
    where the browser has no card.
    """

    _esm = ESM
    _css = CSS
    isovalue = traitlets.Float().tag(sync=True)
    azimuth = traitlets.Float().tag(sync=True)
    elevation = traitlets.Float().tag(sync=True)
    distance = traitlets.Float().tag(sync=True)
    yaw = traitlets.Float().tag(sync=True)
    pitch = traitlets.Float().tag(sync=True)
    roll = traitlets.Float().tag(sync=True)
    target: traitlets.List[Any] = traitlets.List(None, allow_none=True).tag(sync=True)
    moving = traitlets.Bool().tag(sync=True)
    picture = traitlets.Bytes().tag(sync=True)
    shown = traitlets.Int().tag(sync=True)
    seen: traitlets.List[Any] = traitlets.List().tag(sync=True)
    provisional = traitlets.Float().tag(sync=True)
    told = traitlets.Unicode().tag(sync=True)
    span: traitlets.List[Any] = traitlets.List().tag(sync=True)
    scene = traitlets.Dict().tag(sync=True)
    given = traitlets.Dict().tag(sync=True)
    size: traitlets.List[Any] = traitlets.List().tag(sync=True)
    modules = traitlets.Dict().tag(sync=True)
    start = traitlets.Unicode(NOTEBOOK_MODULE).tag(sync=True)

    def __init__(self, isogi: Isogi, scene: str, **view: Any) -> None:
        """Show the view, which takes what is not given from the scene's defaults. Raises
        IsogiError.
        """
        facts = isogi.scene(scene)
        modules = modules_of(isogi)
        knobs = {
            name: float(view.pop(name, facts["defaults"].get(name, 0.0)))
            for name in MOVED_PARAMETERS
        }
        target = view.pop("target", None)
        given = query(view)
        view.pop("draw", None)
        self._isogi = isogi
        self._scene = scene
        self._more = view
        self._moved = threading.Event()
        self._closed = False
        self._answers = ThreadPoolExecutor(2, "isogi-viewer")
        self.frame: Frame | None = None
        super().__init__(
            **knobs,
            target=None if target is None else [float(each) for each in target],
            span=list(facts["ranges"]["isovalue"].values()),
            scene=facts,
            given=given,
            size=[int(view.get(name) or DEFAULT_SIDE_PIXELS) for name in ("width", "height")],
            modules=modules,
        )
        self.on_msg(lambda _, asked, __: self._answers.submit(self._answer, asked))
        self.observe(lambda _: self._moved.set(), (*MOVED_PARAMETERS, "target", "moving"))
        self._moved.set()
        self._thread = threading.Thread(target=self._follow, name="isogi-viewer", daemon=True)
        self._thread.start()

    @property
    def view(self) -> dict[str, Any]:
        """The parameters of what is shown, such as for ``isogi.frame(scene, wait="final",
        **viewer.view)``.
        """
        if self.target is None:
            target = {}
        else:
            target = {"target": self.target}
        return {**self._more, **{name: getattr(self, name) for name in MOVED_PARAMETERS}, **target}

    def close(self) -> None:
        """Show nothing more, once the picture that is under way has come."""
        self._closed = True
        self._moved.set()
        self._answers.shutdown(wait=False, cancel_futures=True)
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
            if self.moving and self._moved.wait(REST_SECONDS):
                continue
            try:
                frame = self._show("now")
                while frame.facts.provisional and not self._moved.is_set():
                    frame = self._show(REFINE_SECONDS)
            except (
                IsogiError,
                RuntimeError,
            ) as error:  # a RuntimeError where the connections were closed
                self.told = str(error)

    def _show(self, wait: Any) -> Frame:
        view = self.view
        seen = [*(view[name] for name in MOVED_PARAMETERS), view.get("target")]
        self.frame = frame = self._isogi.frame(self._scene, wait=wait, f="jpeg", **view)
        if not self._closed:
            with self.hold_sync():
                self.told = str(frame.facts)
                self.picture = frame.content
                self.seen = seen
                self.provisional = frame.facts.coverage.get("provisional", 0.0)
                self.shown = self.shown + 1
        return frame

    def _answer(self, asked: dict[str, Any]) -> None:
        """Hand the page what it asks the server for."""
        number = asked["number"]
        path = asked["path"]
        if path.startswith("web/"):
            place = path
        else:
            place = f"{scene_path(self._scene)}/{path}"
        try:
            self.send({"number": number}, [self._isogi.read(place)])
        except (IsogiError, RuntimeError) as error:
            self.send(
                {
                    "number": number,
                    "status": getattr(error, "status", None) or 503,
                    "detail": str(error),
                }
            )


def modules_of(isogi: Isogi) -> dict[str, str]:
    """The modules of a server's page that show a view in a notebook, by their places. Raises
    IsogiError.
    """
    found = {}
    waiting = [NOTEBOOK_MODULE]
    while waiting:
        name = waiting.pop()
        found[name] = isogi.read(f"web/{name}").decode()
        paths = {
            normpath(join(dirname(name), path)) for path in IMPORT_STATEMENT.findall(found[name])
        }
        waiting += sorted(paths - found.keys() - set(waiting))
    return found
