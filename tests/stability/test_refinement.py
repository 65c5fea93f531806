"""Refinement: each step of each kind of picture has the same bits on any number of threads, and
after a restart.

``python -m tests.stability.test_refinement`` prints a digest of each step, to compare before and
after a change.
"""

import hashlib
import sys
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import read_window
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import refine_chunk
from tests.loaded import load_scene
from tests.stability.scenes import view_of

SIZE = 16
STEPS = 8
"""Pixels along each side of a picture, and steps that are compared at most."""

SKY = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
FLOOR = {"corner": [-20, -20, -5], "edges": [[135, 0, 0], [0, 135, 0]], "sides": 1}
HALO = {"isovalue": 0.012, "clear": 0.6, "albedo": [0.4, 0.6, 0.9]}
GRADIENT = {"use": "colour", "of": "gradient", "map": "coolwarm"}
PLASTIC = {"kind": "plastic", "roughness": 0.3}
BALL = {"sphere": [60.0, 60.0, 40.0, 5.0], "radiance": [4.0, 2.0, 0.5]}


@dataclass(frozen=True)
class Kind:
    """A kind of picture, by the settings of its scene, and of its view, and the isovalue ``shown``
    if it is another.
    """

    scene: Mapping[str, Any] = field(default_factory=dict)
    view: Mapping[str, Any] = field(default_factory=dict)
    shown: float | None = None

    def load(self) -> Scene:
        """The orbital, coarse, under a sky, with these settings."""
        plain = {
            "lattice": 0.4,
            "bounces": 1,
            "lights": [SKY],
            "target_error": 0.1,
            "projected": False,
        }
        return load_scene("demo:orbital", **{**plain, **self.scene})


KINDS: Mapping[str, Kind] = {
    "plain": Kind(),
    "strict": Kind({"target_error": 0.02}),
    "projected": Kind({"projected": True}, shown=0.05),
    "walls": Kind(
        {"room": "cornell", "lights": [{"type": "constant"}]}, {"azimuth": 90.0, "elevation": 0.0}
    ),
    "glass": Kind(
        {"material": "glass", "walls": [FLOOR], "target_error": 0.03}, {"elevation": 20.0}
    ),
    "shine": Kind({"shine": PLASTIC}),
    "shine among walls": Kind({"shine": PLASTIC, "walls": [FLOOR]}),
    "several": Kind({"isovalue": 0.06, "surfaces": [HALO]}),
    "several among walls": Kind({"isovalue": 0.06, "surfaces": [HALO], "walls": [FLOOR]}),
    "glow": Kind({"glow": [BALL]}),
    "glow among walls": Kind({"glow": [BALL], "walls": [FLOOR]}),
    "window": Kind({}, {"window": read_window("x>48")}),
    "orthographic": Kind({"projection": "orthographic"}),
    "colours": Kind({"volumes": [GRADIENT]}),
    "smooth": Kind({}, {"smooth": True}),
    "albedo": Kind({"albedos": [0.2, 0.9]}, {"albedo": (0.3, 0.5, 0.4)}),
    "moving": Kind({"shine": PLASTIC}, {"moving": True}),
    "vicinity": Kind({}, {"shading": "vicinity"}),
    "path traced": Kind({"walls": [FLOOR]}, {"shading": "path_traced", "samples": 16}),
    "local": Kind({"walls": [FLOOR]}, {"shading": "phong_shadow"}),
}


@dataclass(frozen=True, eq=False)
class Site:
    """A ``renderer`` of a ``kind`` of picture, its light in a store of its own."""

    kind: Kind
    renderer: Renderer

    def bake(self, frame: Frame, rung: int) -> None:
        """Bake all light that a frame wants to a ``rung`` of samples."""
        for stage in frame.stages:
            caches = stage.caches or self.renderer.caches
            if stage.shown is None:
                light = caches.of(frame.view.shading)
            else:
                light = caches.projected(stage.shown)
            for demand in stage.demands:
                refine_chunk(light, rung, stage.goal.error, demand)

    def steps(self) -> Iterator[Frame]:
        """The first frame of its view, and the frame after each step towards a final one."""
        scene = self.renderer.prepared.scene
        rung = FIRST_LEVEL
        view = replace(
            view_of(scene, SIZE, **self.kind.view), isovalue=self.kind.shown or scene.isovalue
        )
        for _ in range(STEPS):
            yield (frame := self.renderer.render(view))
            if frame.stages:
                self.bake(frame, rung)
                rung *= 2
            elif not self.renderer.refine(view):
                return


def digest_of(frame: Frame) -> str:
    """Names all that a frame shows, and what it says of its quality."""
    said = (
        frame.version,
        frame.counts,
        frame.total,
        frame.tail,
        frame.final,
        frame.checkable,
        frame.refinable,
    )
    whole = hashlib.blake2b(repr(said).encode(), digest_size=8)
    for values in (
        frame.radiance,
        frame.state,
        frame.error,
        frame.total_error,
        frame.reported_state,
        frame.position,
    ):
        whole.update(np.ascontiguousarray(values).tobytes())
    return whole.hexdigest()


def digests(name: str, threads: int) -> list[str]:
    """What names each step of a kind of picture, drawn by so many ``threads``, and at last the
    objects of its store.
    """
    kind = KINDS[name]
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder, closing(Tiles(threads)) as tiles:
        site = Site(
            kind, Renderer(Caches(PreparedScene(kind.load()), Path(folder), 1 << 28), tiles)
        )
        found = [digest_of(frame) for frame in site.steps()]
        files = sorted(
            path for path in Path(folder).rglob("*") if path.is_file() and "/c/" in path.as_posix()
        )
        objects = [(str(path.relative_to(folder)), path.read_bytes()) for path in files]
        return [*found, hashlib.blake2b(repr(objects).encode(), digest_size=8).hexdigest()]


LONG = {"several", "several among walls", "glass", "shine", "shine among walls", "walls"}
"""Kinds of pictures that take more than a dozen seconds of a processor each."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=[pytest.mark.long] * (each in LONG)) for each in KINDS]
)
def test_steps_of_refinement_do_not_depend_on_threads(name: str) -> None:
    assert digests(name, 1) == digests(name, 3)


if __name__ == "__main__":
    for kind in sys.argv[1:] or KINDS:
        sys.stdout.write(f"{kind}: {' '.join(digests(kind, 2))}\n")
        sys.stdout.flush()
