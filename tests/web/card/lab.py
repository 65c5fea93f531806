"""A page with a card to test: WebGL 2 in software, a server of files and of data, and scenes as a
card gets them.
"""

import gzip
import http.server
import json
import threading
from base64 import b64decode, b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from playwright.sync_api import Browser, Page

from isogi_core.bake.noise import Goal
from isogi_core.frame.card.blocks import fold_chunks, transfer_chunks
from isogi_core.frame.card.blurred_surroundings import blurred_surroundings
from isogi_core.frame.card.colour_codes import ColourCodes
from isogi_core.frame.card.sides import known_light_of_sides, look_at_sides
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import Camera, Quaternion, View, quaternion_from_angles
from isogi_server.answers import card_scene
from isogi_server.exports.page_files import SHADERS, shaders
from tests.frame.conftest import shading_of

WEB = Path(__file__).resolve().parents[3] / "web" / "isogi_web"
HERE = Path(__file__).resolve().parent
CARD_FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SECONDS = 300


class Lab:
    """A page whose scripts are those of ``web``, and files of ``data`` that it may fetch as
    ``/data/NAME``.
    """

    def __init__(self, page: Page, address: str, data: dict[str, bytes]) -> None:
        self.page = page
        self.data = data
        page.set_default_timeout(1000 * SECONDS)
        page.goto(address)
        page.evaluate("import('/bench/bench.js').then((bench) => { window.bench = bench; })")

    def ask(self, script: str, argument: Any = None) -> Any:
        """What an expression in the page is; it may wait, and has ``bench``."""
        return self.page.evaluate(f"async (given) => {{ {script} }}", argument)

    def floats(self, script: str, argument: Any = None) -> np.ndarray:
        """Float32 numbers that a script returns as text."""
        return np.frombuffer(b64decode(self.ask(script, argument)), np.float32)

    def put(self, name: str, content: bytes | dict[str, Any]) -> str:
        """Let the page fetch a file of this name."""
        if isinstance(content, bytes):
            self.data[name] = content
        else:
            self.data[name] = json.dumps(content).encode()
        return name


def packed(numbers: np.ndarray) -> str:
    """Float32 numbers as text, on their way to the page."""
    return b64encode(np.ascontiguousarray(numbers, np.float32).tobytes()).decode()


@contextmanager
def served(data: dict[str, bytes]) -> Iterator[str]:
    """The address of a server of the page's files, of this folder's, and of ``data``."""

    class Handler(http.server.BaseHTTPRequestHandler):
        KINDS: ClassVar[dict[str, str]] = {
            ".js": "text/javascript",
            ".html": "text/html",
            ".glsl": "text/plain",
        }

        def do_GET(self) -> None:
            room, _, name = self.path.split("?")[0].lstrip("/").partition("/")
            if room == "data":
                content = data.get(name)
            else:
                content = self.file(room, name)
            self.send_response(200 if content is not None else 404)
            self.send_header(
                "Content-Type", self.KINDS.get(Path(self.path).suffix, "application/octet-stream")
            )
            self.end_headers()
            self.wfile.write(content or b"")

        def file(self, room: str, name: str) -> bytes | None:
            if room in ("x.html", "favicon.ico"):
                return b""
            if f"{room}/{name}" == f"web/{SHADERS}":
                return json.dumps(shaders()).encode()
            path = {"web": WEB, "bench": HERE}[room] / name
            if path.is_file():
                return path.read_bytes()
            return None

        def log_message(self, *_: Any) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/x.html"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@contextmanager
def lab_in(browser: Browser) -> Iterator[Lab]:
    """A lab in a page of its own, whose console must stay free of errors."""
    complaints: list[str] = []
    data: dict[str, bytes] = {}
    with served(data) as address:
        page = browser.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "console", lambda line: complaints.append(line.text) if line.type == "error" else None
        )
        yield Lab(page, address, data)
        page.close()
    assert complaints == []


IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
TURN = quaternion_from_angles(70.0, -20.0, 15.0)


def view_of(view: View, exposure: float = 1.0, **more: Any) -> dict[str, Any]:
    """A view as a card takes it: camera and light in the world."""
    camera = {
        "eye": view.camera.eye,
        "target": view.camera.target,
        "up": view.camera.up,
        "fov": view.camera.fov,
    }
    shown = {
        "isovalue": view.isovalue,
        "camera": camera,
        "light": view.light,
        "ground": [0.01, 0.01, 0.02],
    }
    planes = view.window.planes if view.window else ()
    shown["window"] = [{"normal": [-x, -y, -z], "limit": w} for x, y, z, w in planes]
    return {**shown, "exposure": exposure, "shading": view.shading, **more}


@dataclass(frozen=True)
class Shown:
    """A card's picture: linear ``light`` (h, w, 3), and how much of each pixel the surface
    ``covers`` (h, w).
    """

    light: np.ndarray
    covers: np.ndarray


class CardScene:
    """A scene in a lab: the voxels, and what light the ``renderer`` has for views; with its
    ``lobes`` or without.
    """

    def __init__(
        self, lab: Lab, renderer: Renderer, view: View, size: tuple[int, int], lobes: bool = False
    ) -> None:
        self.lab = lab
        self.renderer = renderer
        self.size = size
        codes = renderer.prepared.voxel_codes
        slabs = [
            codes.code(renderer.prepared.scene.volume.voxels[a:b]).tobytes() for a, b in codes.slabs
        ]
        if colours := ColourCodes.of(renderer.prepared.scene):
            slabs += [colours.layers(a, b).tobytes() for a, b in colours.slabs]
        around = blurred_surroundings(renderer.prepared.scene.lighting.environment)
        scene = card_scene(renderer, view, ()).model_dump(mode="json")
        if not lobes:
            scene["light"]["lobes"] = []
        slabs += [around.tobytes()] * bool(scene["shine"])
        document = lab.put("document", scene)
        names = [lab.put(f"slab{i}", slab) for i, slab in enumerate(slabs)]
        given = {"files": {"document": document, "slabs": names}, "size": size}
        lab.ask("window.card = await bench.loaded(given.files, given.size);", given)

    def light(
        self, view: View, target: float, raw: bool = False, turn: Quaternion | None = None
    ) -> int:
        """Give the card the folded light, and the ``raw`` transfer, of all chunks of a view, whose
        light is turned by ``turn`` in the world if that is not the turn in the box.

        Returns the bytes, as a server compresses them.
        """
        tiles = self.renderer.tiles
        sent = 0
        goal = Goal.checked(target)
        seen = [each.at for each in look_at_sides(self.renderer, view, goal, tiles).seen]
        for first in range(0, len(seen), 64):
            some = seen[first : first + 64]
            if self.renderer.peeling:
                answers = [known_light_of_sides(self.renderer, view, some, goal, tiles)]
            else:
                answers = [fold_chunks(self.renderer, view, some, goal, tiles)]
            if raw:
                answers += [transfer_chunks(self.renderer, some, Goal.checked(target), tiles)]
            for answer in answers:
                name = self.lab.put("answer", b"".join(each.data for each in answer.blocks))
                sent += len(gzip.compress(self.lab.data[name], 1))
                self.lab.ask("card.take(await bench.bytes('answer'), given);", turn or view.light)
        return sent

    def picture(self, view: View, rest: bool = False, **more: Any) -> Shown:
        """What the card draws of a view; at ``rest`` with all its samples."""
        given = {"view": view_of(view, **more), "rest": {"rest": rest}}
        found = self.lab.floats("return bench.pictureOf(card, given.view, given.rest);", given)
        found = found.reshape(self.size[1], self.size[0], 4)
        return Shown(found[..., :3], found[..., 3])


def plain_light(renderer: Renderer, view: View, target: float) -> tuple[np.ndarray, np.ndarray]:
    """What isogi's frame has before lobes and own light: radiance (h, w, 3), and where the surface
    is seen (h, w).
    """
    gbuffer = renderer.gbuffer(view)
    texels = renderer.surface.texels(view, gbuffer)
    shot = renderer.surface.shot(view, gbuffer, Goal(target), renderer.tiles)
    _, framebuffer = shading_of(renderer.caches).picture(texels, shot)
    size = (view.height, view.width)
    return framebuffer.radiance.reshape(*size, 3), framebuffer.state.reshape(size) > 0


def light_of(renderer: Renderer, view: View) -> RotatedLight:
    """The light of a view."""
    return RotatedLight(renderer.caches.spec(view.shading), view)


def orthographic_camera(camera: Camera) -> dict[str, Any]:
    """A camera of parallel rays as a card takes it."""
    return {
        "eye": camera.eye,
        "target": camera.target,
        "up": camera.up,
        "fov": camera.fov,
        "parallel": True,
    }


def toned(light: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Linear light through isogi's curve, without a table; (h, w, 3) float64."""
    light = light.astype(np.float64) * exposure
    peak = light.max(axis=-1, keepdims=True)
    y = 1.7 * peak * (peak / (peak + 0.16))
    y = np.where(y <= 0.6, y, 1.0 - 0.4 * np.exp((0.6 - y) / 0.4))
    return np.asarray(np.where(peak > 0.0, light * y / np.maximum(peak, 1e-30), 0.0))


def developed(light: np.ndarray, covers: np.ndarray, exposure: float) -> np.ndarray:
    """sRGB codes of linear light through isogi's curve, without a table; (h, w, 3) float64."""
    shown = np.where(covers[..., None], toned(light, exposure), 0.0)
    return np.rint(
        255.0
        * np.where(
            shown <= 0.0031308, 12.92 * shown, 1.055 * np.maximum(shown, 1e-12) ** (1 / 2.4) - 0.055
        )
    )


@dataclass(frozen=True)
class Difference:
    """How far a card's picture is from isogi's: the share of surface pixels ``within`` 2/255, and
    the relative RMSE of the radiance; pixels of the ``surface``, and those that show it in one of
    both pictures alone (``torn``).
    """

    within: float
    rmse: float
    surface: int
    torn: int


def difference(
    shown: Shown, light: np.ndarray, on: np.ndarray, exposure: float = 1.0
) -> Difference:
    """How far the card's picture is from the ``light`` (h, w, 3) of isogi's, which shows the
    surface where ``on``.
    """
    covers = shown.covers > 0.5
    apart = np.abs(developed(shown.light, covers, exposure) - developed(light, on, exposure)).max(
        axis=-1
    )
    either = covers | on
    both = covers & on
    wrong = (shown.light - light)[both]
    rmse = float(np.sqrt((wrong**2).mean()) / light[on].mean())
    return Difference(
        float((apart[either] <= 2).mean()), rmse, int(on.sum()), int((covers != on).sum())
    )
