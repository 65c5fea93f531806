"""isogi in a notebook: a view that the mouse moves, in JupyterLab, VS Code and Colab.

>>> from isogi.client import Isogi
>>> from isogi.widget import Viewer
>>> viewer = Viewer(Isogi("http://127.0.0.1:8000"), "casting", width=640, height=480)
>>> viewer

It needs `isogi/client.py` and anywidget: isogi's extra ``notebook``. The visitor's graphics card
draws while the view moves, by the modules of the server's page; if there is no card, the server
draws. Modules, voxels, light and pictures go through the kernel, so the browser needs no way to the
server.

The modules are programs that run in the notebook's page, with all rights of this page. So connect
only to a server that you trust, and to one on another machine by https:// or a tunnel: over plain
http://, anyone on the way can replace the programs.
"""

from __future__ import annotations

import re
import threading
from concurrent.futures import ThreadPoolExecutor
from posixpath import dirname, join, normpath
from typing import Any

import anywidget
import traitlets

from isogi.client import Frame, Isogi, IsogiError, query, scene_path

MOVED_PARAMETERS = ("isovalue", "azimuth", "elevation", "distance", "yaw", "pitch", "roll")
"""Parameters of the view that the notebook moves, besides the target."""

REFINE_SECONDS = 1.0
"""Seconds of baking between two pictures of a view at rest."""

REST_SECONDS = 1.0
"""Seconds without a change after which a view is taken to be at rest,
even if the page has not reported it: it may have been closed.
"""

NOTEBOOK_MODULE = "notebook/notebook.js"
"""The page's module that shows a view in a notebook."""

IMPORT_STATEMENT = re.compile(r'^(?:import|export) [^;]*?from "(\.[^"]+)";$', re.MULTILINE)
"""An import of another module in a module of the page, as the page's modules write it: a statement
that begins its line, with a path that begins with a dot. ESM looks for the same.
"""

DEFAULT_SIDE_PIXELS = 512
"""Pixels of a picture's sides if they are not given."""

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
    """A view of a scene on a server. Dragging turns the camera, with Shift the light; the wheel
    zooms, and a slider sets the isovalue.

    Its knobs can be read, set and observed: ``isovalue``, ``azimuth``, ``elevation``, ``distance``,
    ``yaw``, ``pitch``, ``roll``, and the ``target`` that the camera turns about, None for the
    volume's centre. Other parameters of the HTTP interface are given once, to the constructor.

    The visitor's graphics card draws while the view moves, and the server's picture is refined
    while it rests. ``draw="server"`` leaves all drawing to the server; ``draw="card"`` draws by the
    processor if the browser has no card.
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
        """Show a view; parameters that are not given are the scene's defaults.

        Raises IsogiError.
        """
        facts = isogi.scene(scene)
        modules = modules_of(isogi)
        # Split the parameters: knobs that move, the target, those that the page sends itself, and
        # the rest.
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
        # Requests of the page are answered by threads; a change of a knob wakes the thread that
        # draws.
        self.on_msg(lambda _, asked, __: self._answers.submit(self._answer, asked))
        self.observe(lambda _: self._moved.set(), (*MOVED_PARAMETERS, "target", "moving"))
        self._moved.set()
        self._thread = threading.Thread(target=self._follow, name="isogi-viewer", daemon=True)
        self._thread.start()

    @property
    def view(self) -> dict[str, Any]:
        """The parameters of the present view,
        such as for ``isogi.frame(scene, wait="final", **viewer.view)``.
        """
        view = {**self._more, **{name: getattr(self, name) for name in MOVED_PARAMETERS}}
        if self.target is not None:
            view["target"] = self.target
        return view

    def close(self) -> None:
        """Show nothing more, once the picture that is under way has come."""
        self._closed = True
        self._moved.set()
        self._answers.shutdown(wait=False, cancel_futures=True)
        if threading.current_thread() is not self._thread:
            self._thread.join()
        super().close()

    def _follow(self) -> None:
        """Show the newest view as it is, and then refine it until it moves on. Runs in a thread."""
        while True:
            self._moved.wait()
            self._moved.clear()
            if self._closed:
                return
            # While the view moves, the card draws it: wait for rest.
            if self.moving and self._moved.wait(REST_SECONDS):
                continue
            try:
                # Show the light that is there, then better pictures until the view is final or
                # moves.
                frame = self._show("now")
                while frame.facts.provisional and not self._moved.is_set():
                    frame = self._show(REFINE_SECONDS)
            except (IsogiError, RuntimeError) as error:
                # A closed client raises RuntimeError.
                self.told = str(error)

    def _show(self, wait: Any) -> Frame:
        """Ask for a frame, show it, and return it."""
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
        """Answer a request of the page with the server's bytes, or with its error.

        A request is ``asked`` by a ``path`` and a ``number``, which the answer repeats, so that the
        page finds the request that it belongs to.
        """
        number = asked["number"]
        path = asked["path"]
        # Files of the server's page have addresses under web/; all other paths are relative to the
        # scene's address.
        if path.startswith("web/"):
            address = path
        else:
            address = f"{scene_path(self._scene)}/{path}"
        try:
            self.send({"number": number}, [self._isogi.read(address)])
        except (IsogiError, RuntimeError) as error:
            status = getattr(error, "status", None) or 503
            self.send({"number": number, "status": status, "detail": str(error)})


def modules_of(isogi: Isogi) -> dict[str, str]:
    """Return the modules of a server's page that show a view in a notebook, by their paths.

    Raises IsogiError.
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
