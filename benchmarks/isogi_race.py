"""isogi's side of a race to equal error: a set of pictures from nothing, and how wrong some of them are in all."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from tqdm import tqdm

from benchmarks.cost import Cost
from benchmarks.error_curve import relative_rmse, without
from benchmarks.picture_set import Pick, PictureSet
from benchmarks.plans import LONGEST, bake
from isogi_core.frame.frame import Frame
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from isogi_core.report.reference import Reference, trace_reference
from server.measure import make_renderer

SMALL = 8
"""Pixels a side of the pictures that kernels are compiled on."""


@dataclass(frozen=True, eq=False)
class Check:
    """A picture of the set as isogi has ``lit`` it, and as long paths from each pixel show it at ``best``."""

    lit: Frame
    best: Reference

    @property
    def error(self) -> float:
        """isogi's total error: relative RMSE over surface pixels, without the reference's own noise."""
        return without(relative_rmse(self.lit.radiance, self.best.mean, self.best.on), self.best.noise)


@dataclass(frozen=True)
class Costs:
    """What was spent from nothing: to the ``first`` picture, and on ``baking`` and ``rendering`` the whole set."""

    first: Cost
    baking: Cost
    rendering: Cost

    @property
    def whole(self) -> Cost:
        """What the whole set cost."""
        return self.baking + self.rendering


class Isogi:
    """A renderer over an empty ``store`` that bakes light until each texel has the relative error ``target``."""

    def __init__(self, scene: Scene, store: str, target: float) -> None:
        """Nothing is made yet: maps are made when the first view needs them, and that is counted."""
        self.renderer, self.target = make_renderer(scene, store), target
        self.baking, self.rendering = Cost(), Cost()

    def bake(self, view: View) -> None:
        """Bake what a view lacks, and keep it in the store."""
        with self.baking.counting():
            demands = self.renderer.render(view, self.target).demands
            loader = self.renderer.caches.of(view.shading)
            self.renderer.tiles.run(lambda a, b: bake(loader, demands[a:b], self.target), len(demands), 1)

    def frame(self, view: View) -> Frame:
        """The picture of a view."""
        with self.rendering.counting():
            return self.renderer.render(view, self.target)

    def frames(self, pictures: PictureSet, first: int) -> Iterator[tuple[Pick, Frame]]:
        """All pictures of a set, camera by camera, beginning with the ``first``."""
        cameras = sorted(range(pictures.views), key=lambda camera: camera != first)
        for camera in tqdm(cameras, desc="isogi", unit="view"):
            self.bake(pictures.view(camera))
            for turn in range(pictures.turns):
                yield (camera, turn), self.frame(pictures.view(camera, turn))


def run(pictures: PictureSet, target: float, picks: Sequence[Pick]) -> tuple[list[Frame], Costs]:
    """Render the whole set on an empty store, beginning with the first of ``picks``; the frames of these."""
    kept: dict[Pick, Frame] = {}
    first: Cost | None = None
    with tempfile.TemporaryDirectory() as store:
        isogi = Isogi(pictures.scene, store, target)
        for pick, frame in isogi.frames(pictures, picks[0][0]):
            first = first or isogi.baking + isogi.rendering
            if pick in picks:
                kept[pick] = frame
    return [kept[pick] for pick in picks], Costs(first or Cost(), isogi.baking, isogi.rendering)


def warm(pictures: PictureSet, target: float) -> None:
    """Compile the kernels, on pictures so small that they take no time."""
    tiny = replace(pictures, size=SMALL, views=1, turns=min(pictures.turns, 2))
    frames, _ = run(tiny, target, tiny.picks(1))
    check(tiny.scene, frames, 8)


def check(scene: Scene, frames: Sequence[Frame], paths: int) -> list[Check]:
    """The frames with their references: so many ``paths`` from each pixel, with more bounces than the scene has."""
    longer = replace(scene, plan=replace(scene.plan, bounces=max(scene.bounces, LONGEST), survival=1.0))
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(longer, store)
        bar = tqdm(frames, desc="references", unit="picture", disable=len(frames) < 2)
        return [Check(lit, trace_reference(renderer, lit.view, paths)) for lit in bar]
