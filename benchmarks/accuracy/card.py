"""The card's pictures beside the server's: 20 views of six shared volumes, lobes, several surfaces,
shine, and texels that just became visible.

    python -m benchmarks.accuracy card -o FOLDER [--size 128] [--only engine]

Chromium draws WebGL 2 by its processor in a card's place, from the bytes that the server sends.
Light is baked for each view alone, to a tenth: the same light is in both pictures. What was
measured is kept in FOLDER; a view that is there is not measured again. Needs the shared data.
"""

import gzip
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from playwright.sync_api import sync_playwright

from benchmarks.accuracy.benches import wanted
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import LIGHTS, shared_data
from benchmarks.common.suite import part
from benchmarks.service.browser import CHROMIUM
from isogi_core.bake.noise import Goal
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.edges import smooth_edges
from isogi_core.frame.film import develop, ground_of
from isogi_core.frame.known_blocks import LEVEL
from isogi_core.model.view import IDENTITY, View, orthographic, quaternion_from_angles, read_window
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_core.storage.atomic_file import write_whole
from tests.frame.conftest import Workbench
from tests.frame.several.drawing import bake
from tests.web.card.lab import (
    CARD_FLAGS,
    CardScene,
    Lab,
    difference,
    lab_in,
    orthographic_camera,
    plain_light,
)

VOLUMES = {
    "engine": "engine_256x256x128_uint8.nhdr",
    "head": "ct_head_208x256x225_uint8.nhdr",
    "brain": "brain_t1_124x160x140_uint8.nhdr",
    "bonsai": "bonsai_256x256x256_uint8.nhdr",
    "heptane": "heptane_302x302x302_uint8.nhdr",
    "isabel": "isabel_t30_wind_125x125x25_float32.nhdr",
}
TARGET = 0.1
"""The error that light is baked to."""

SHOW = """card.drawing.show(card.last.view, card.last.size);
  const { gl, canvas: { width, height } } = { gl: card.device.gl, canvas: card.canvas };
  const found = new Uint8Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, found);
  return bench.packed(new Float32Array(found));"""
"""What is on the card's canvas, rows from the bottom."""


@dataclass(frozen=True)
class Case:
    """A view of a ``volume`` under a ``light``, by a name; ``kind`` says what is compared.

    Its light has a ``turn`` of angles in degrees; its ``shine`` has a ``roughness``; ``after`` are
    the azimuth and the isovalue of the view that is drawn with the light of this one alone.
    ``pinned`` are the isovalue of another surface and the share of rays that pass it.
    """

    volume: str
    isovalue: float
    light: str
    azimuth: float = 40.0
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    window: str = ""
    parallel: bool = False
    kind: str = "texels"
    after: tuple[float, float] | None = None
    pinned: tuple[float, float] | None = None
    shine: str = ""
    roughness: float = 0.3

    @property
    def name(self) -> str:
        """What a person calls it."""
        more = (
            ["turned"] * any(self.turn)
            + ["window"] * bool(self.window)
            + ["orthographic"] * self.parallel
            + [f"{self.shine} {self.roughness:g}"] * bool(self.shine)
        )
        if self.pinned:
            more += [f"in {self.pinned[0]:g} of {self.pinned[1]:.0%} clear"]
        if self.after:
            more += [f"then {self.after[0]:g}° at {self.after[1]:g}"]
        return ", ".join(
            [
                f"{self.kind}: {self.volume} {self.isovalue:g}",
                f"{self.light} {self.azimuth:g}°",
                *more,
            ]
        )


TURN = (70.0, -20.0, 15.0)
TEXELS = (
    Case("engine", 70, "constant light"),
    Case("engine", 70, "uffizi", 130),
    Case("engine", 70, "uffizi", turn=TURN),
    Case("engine", 70, "uffizi", window="x>150"),
    Case("engine", 170, "uffizi", parallel=True),
    Case("head", 110, "constant light"),
    Case("head", 110, "uffizi", turn=TURN),
    Case("head", 110, "uffizi", window="z>150"),
    Case("head", 50, "constant light", 130, parallel=True),
    Case("brain", 60, "constant light"),
    Case("brain", 60, "uffizi", 220),
    Case("brain", 100, "uffizi", turn=TURN),
    Case("bonsai", 40, "constant light"),
    Case("bonsai", 40, "uffizi", 130),
    Case("bonsai", 80, "uffizi", turn=TURN, parallel=True),
    Case("heptane", 30, "constant light"),
    Case("heptane", 30, "uffizi", turn=TURN),
    Case("heptane", 100, "uffizi", window="x>150"),
    Case("isabel", 35, "constant light"),
    Case("isabel", 35, "uffizi", turn=TURN),
)
LOBES = tuple(
    Case(*place, light, kind=kind)
    for place in (("engine", 70), ("head", 110), ("bonsai", 40))
    for light in ("grace", "noon_grass")
    for kind in ("moving", "rest")
)
NEW = (
    Case("engine", 70, "uffizi", kind="new", after=(55.0, 70.0)),
    Case("head", 110, "uffizi", kind="new", after=(55.0, 110.0)),
    Case("engine", 70, "uffizi", kind="new", after=(40.0, 80.0)),
)
SEVERAL = (
    Case("head", 110, "uffizi", kind="several", pinned=(50.0, 0.6)),
    Case("head", 115, "uffizi", 130, window="z>150", kind="several", pinned=(50.0, 0.6)),
    Case("engine", 170, "uffizi", kind="several", pinned=(70.0, 0.6)),
)
SHINE = tuple(
    Case(*place, kind=kind, shine=shine, roughness=roughness)
    for place in (("engine", 70, "uffizi"), ("head", 110, "noon_grass"))
    for shine, roughness in (("plastic", 0.3), ("metal", 0.1), ("metal", 0.5))
    for kind in ("moving shine", "shine at rest")
)
CASES = (*TEXELS, *LOBES, *SEVERAL, *NEW, *SHINE)
GOALS = {
    "texels": (0.999, 0.002),
    "moving": (0.98, 0.02),
    "rest": (0.992, 0.005),
    "several": (0.999, 0.002),
    "new": (0.94, 0.03),
    "moving shine": (0.5, 0.2),
    "shine at rest": (0.7, 0.15),
}
"""The share of surface pixels within 2/255 that is asked for at least, and the relative RMSE at
most, by kind.
"""

KINDS = {
    "texels": "light of texels, before pixels get light of their own",
    "moving": "lobes while the view moves, beside the server at rest",
    "rest": "lobes at rest, beside the server at rest, away from edges",
    "several": "several surfaces, before pixels get light of their own",
    "new": "texels that just became visible, before any was sent",
    "moving shine": "shine while the view moves, beside the server's final picture",
    "shine at rest": "shine at rest, beside the server's final picture, away from edges",
}


@dataclass(frozen=True)
class Found:
    """How far a card's picture is from the server's, as ``Difference`` has it, and the ``bytes`` of
    a first view.
    """

    within: float
    rmse: float
    surface: int
    torn: int
    bytes: int


@part(size=128)
@click.option(
    "-o",
    "--output",
    default="card",
    type=click.Path(path_type=Path, file_okay=False),
    show_default=True,
)
@click.option("--only", multiple=True, help="Part of a view's name, such as 'engine'; repeatable.")
def card(output: Path, size: int, only: tuple[str, ...]) -> Measurement:
    """The card's pictures beside the server's, in Chromium that draws by its processor."""
    cases = [case for case in CASES if wanted(case.name, only)]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", *CARD_FLAGS]
        )
        for case in (each for each in cases if not place_of(output, each, size).exists()):
            with lab_in(browser) as lab, TemporaryDirectory() as folder:
                found = measure(case, lab, Path(folder), size)
            click.echo(f"{case.name}: {found.within:.3%}, RMSE {found.rmse:.3%}", err=True)
            write_whole(place_of(output, case, size), json.dumps(asdict(found)).encode())
        browser.close()
    known = {case: place_of(output, case, size) for case in CASES}
    read = {
        case: Found(**json.loads(place.read_text()))
        for case, place in known.items()
        if place.exists()
    }
    return Measurement(
        f"The card's pictures beside the server's, {size} × {size}", figures_of(read), body(read)
    )


def place_of(output: Path, case: Case, size: int) -> Path:
    """The file of what was found of a view."""
    output.mkdir(parents=True, exist_ok=True)
    return output / f"{case.name.translate(str.maketrans(' :,°>', '-----'))}-{size}.json"


def scene_for(case: Case) -> Scene:
    """The scene of a view. ClickException where the shared data are not at hand."""
    if (data := shared_data()) is None:
        raise click.ClickException(
            "There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them."
        )
    given = {
        "volume": VOLUMES[case.volume],
        "isovalue": case.isovalue,
        "lights": [dict(LIGHTS[case.light])],
    }
    if case.pinned:
        isovalue, clear = case.pinned
        given["surfaces"] = [{"isovalue": isovalue, "clear": clear}]
    if case.shine:
        given["shine"] = {"kind": case.shine, "roughness": case.roughness}
    return build_scene(
        SceneSource(case.volume, {**given, "target_error": TARGET, "projected": False}, data)
    )


def measure(case: Case, lab: Lab, folder: Path, size: int) -> Found:
    """Bake a view, draw it by the card and by the server, and compare."""
    bench = Workbench(scene_for(case), folder)
    if case.pinned:
        return among_several(case, bench, lab, size)
    size = size * (FINE if case.kind == "new" else 1)
    view = view_of(case, bench, size)
    first = view_of(replace(case, after=None), bench, size)
    bench.bake(first)
    plain = replace(first, light=IDENTITY)
    shown = CardScene(lab, bench.renderer, plain, (size, size), LOBES_OF[case.kind])
    codes = bench.prepared.voxel_codes.code(bench.scene.volume.voxels)
    sent = len(gzip.compress(codes.tobytes(), LEVEL)) + shown.light(first, TARGET)
    if any(case.turn):
        shown.light(plain, TARGET, raw=True)
    bench.bake(view)
    parallel = orthographic_camera(bench.scene.camera(case.azimuth, 30.0, 3.0, 30.0))
    given: dict[str, Any] = {"camera": parallel} if case.parallel else {}
    exposure = bench.scene.default_exposure
    if case.kind == "rest":
        return at_rest(bench, shown, view, exposure, sent)
    if case.shine:
        return beside_final(bench, shown, view, exposure, sent, case.kind == "shine at rest")
    light, on = plain_light(bench.renderer, view, TARGET)
    if case.kind == "moving":
        light = bench.renderer.render(view, Goal.checked(TARGET)).radiance
    drawn = shown.picture(view, exposure=exposure, **given)
    covers = drawn.covers.copy()
    covers.reshape(-1)[bench.renderer.gbuffer(view).faces.pixels] = 0.0
    drawn = replace(drawn, covers=covers)
    found = difference(drawn, light, on, exposure)
    return Found(found.within, found.rmse, found.surface, found.torn, sent)


def among_several(case: Case, bench: Workbench, lab: Lab, size: int) -> Found:
    """Bake a view of several surfaces, draw it by the card and by the server, and compare."""
    view = replace(view_of(case, bench, size), smooth=False)
    bake(bench, view)
    shown = CardScene(lab, bench.renderer, view, (size, size))
    codes = bench.prepared.voxel_codes.code(bench.scene.volume.voxels)
    sent = len(gzip.compress(codes.tobytes(), LEVEL)) + shown.light(view, TARGET)
    exposure = bench.scene.default_exposure
    frame = bench.renderer.render(view, Goal.checked(TARGET))
    drawn = shown.picture(view, exposure=exposure)
    # Clear surfaces cover a part of a pixel, and are seen all the same.
    seen = replace(drawn, covers=(drawn.covers > 0.0).astype(np.float32))
    found = difference(seen, frame.radiance, frame.state > 0, exposure)
    return Found(found.within, found.rmse, found.surface, found.torn, sent)


FINE = 3
"""By how much pictures of new texels are larger: where pixels are larger than texels, many texels
are seen by none.
"""

LOBES_OF = {kind: kind not in ("texels", "several", "new") for kind in KINDS}
"""Whether lobes are drawn, by kind; light of several surfaces has none."""


def at_rest(bench: Workbench, shown: CardScene, view: View, exposure: float, sent: int) -> Found:
    """The card's picture with all its samples beside the server's, both as they are on a screen.

    Pixels at edges are left out, which both smooth by samples at places of their own.
    """
    frame = smooth_edges(
        bench.renderer.render(view, Goal.checked(TARGET)), bench.prepared, bench.renderer.tiles
    )
    picture = shown.picture(view, rest=True, exposure=exposure, ground=ground_of("dark"))
    codes = shown.lab.floats(SHOW).reshape(view.height, view.width, 4)[::-1, :, :3]
    server = develop(frame, exposure, background="dark").astype(np.float64)
    on = frame.state > 0
    flat = (frame.state > 0) | (picture.covers > 0.5)
    flat.reshape(-1)[frame.edges.pixels if frame.edges else []] = False
    within = float((np.abs(codes - server).max(axis=-1)[flat] <= 2).mean())
    rmse = float(
        np.sqrt(((picture.light - frame.radiance)[flat & on] ** 2).mean())
        / frame.radiance[on].mean()
    )
    return Found(
        within, rmse, int(flat.sum()), int((on != (picture.covers > 0.5))[flat].sum()), sent
    )


def beside_final(
    bench: Workbench, shown: CardScene, view: View, exposure: float, sent: int, rest: bool
) -> Found:
    """The card's picture beside the server's final one, whose noise is half of the target.

    Pixels at edges are left out, as in ``at_rest``.
    """
    frame = bench.settled(view, TARGET)
    drawn = shown.picture(view, rest=rest, exposure=exposure)
    on = frame.state > 0
    edges = smooth_edges(frame, bench.prepared, bench.renderer.tiles).edges
    flat = on & (drawn.covers == 1.0)
    flat.reshape(-1)[edges.pixels if edges else []] = False
    found = difference(
        replace(drawn, covers=flat), np.where(flat[..., None], frame.radiance, 0.0), flat, exposure
    )
    torn = int((on != (drawn.covers > 0.5)).sum())
    return Found(found.within, found.rmse, found.surface, torn, sent)


def view_of(case: Case, bench: Workbench, size: int) -> View:
    """The view that a case is about: where it goes on, the one after."""
    azimuth, isovalue = case.after or (case.azimuth, case.isovalue)
    view = bench.view(
        azimuth, size=size, isovalue=isovalue, light=quaternion_from_angles(*case.turn)
    )
    if case.parallel:
        view = replace(view, camera=orthographic(view.camera, bench.scene.volume.radius))
    if case.window:
        return replace(view, window=read_window(case.window))
    return view


def figures_of(read: Mapping[Case, Found]) -> dict[str, Any]:
    """The worst and the mean of each kind of view, and the bytes of a first view of the engine."""
    figures: dict[str, Any] = {}
    for kind, (within, rmse) in GOALS.items():
        if some := [found for case, found in read.items() if case.kind == kind]:
            figures |= {
                f"{kind}, views": len(some),
                f"{kind}, within 2/255, all pixels": share(some),
                f"{kind}, within 2/255, least": min(each.within for each in some),
                f"{kind}, RMSE, most": max(each.rmse for each in some),
                f"{kind}, views as asked": sum(
                    each.within >= within and each.rmse <= rmse for each in some
                ),
            }
    engine = [
        found.bytes
        for case, found in read.items()
        if case.volume == "engine" and case.kind == "moving"
    ]
    return figures | ({"bytes of a first view of the engine": engine[0]} if engine else {})


def share(some: Iterable[Found]) -> float:
    """The share of surface pixels of some views that are within 2/255."""
    pairs = [(each.within * each.surface, each.surface) for each in some]
    return sum(good for good, _ in pairs) / max(sum(surface for _, surface in pairs), 1)


def body(read: Mapping[Case, Found]) -> str:
    """The tables, one of each kind, and the views that were not measured."""
    parts = []
    for kind, (within, rmse) in GOALS.items():
        rows = [
            (
                case.name.partition(": ")[2],
                f"{each.within:.3%}",
                f"{each.rmse:.3%}",
                str(each.surface),
                str(each.torn),
            )
            for case, each in read.items()
            if case.kind == kind
        ]
        asked = f"asked: {within:.1%} of surface pixels within 2/255, relative RMSE {rmse:.1%}"
        head = ("view", "within 2/255", "relative RMSE", "surface pixels", "shown by one alone")
        if rows:
            parts += [f"## {KINDS[kind].capitalize()}\n\n{asked}\n\n{markdown(head, rows)}"]
    missing = [case.name for case in CASES if case not in read]
    if missing:
        parts += ["## Not measured\n\n" + "\n".join(f"- {name}" for name in missing)]
    return "\n\n".join(parts)
