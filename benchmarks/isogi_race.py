"""isogi's side of a race to equal error: a set of pictures from nothing, and how wrong some of them are in all."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tqdm import tqdm

from benchmarks.error_curve import relative_rmse, without
from benchmarks.picture_set import Pick, PictureSet
from benchmarks.plans import LONGEST, SMALL, bake
from isogi_core.frame.frame import Frame
from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from server.measure import make_renderer, seconds


@dataclass(frozen=True, eq=False)
class Check:
    """A picture of the set as isogi has ``lit`` it, and as paths from each pixel show it at ``best``."""

    lit: Frame
    best: Frame

    @property
    def error(self) -> float:
        """isogi's total error: relative RMSE over surface pixels, without the reference's own noise."""
        measured = relative_rmse(self.lit.radiance, self.best.radiance, self.best.state > 0)
        return without(measured, self.best.estimated_error)


@dataclass(frozen=True)
class Times:
    """Seconds of the wall: of the ``first`` view from nothing, of ``baking`` and of ``rendering`` the whole set."""

    first: float
    baking: float
    rendering: float

    @property
    def whole(self) -> float:
        """Seconds of the whole set, from nothing."""
        return self.baking + self.rendering


class Isogi:
    """A renderer over an empty ``store`` that bakes its light to a relative error, the ``target`` of each texel."""

    def __init__(self, scene: Scene, store: str, target: float) -> None:
        """Nothing is made yet: maps are when the first view needs them, and so are timed."""
        self.renderer, self.target = make_renderer(scene, store), target

    def bake(self, view: View) -> None:
        """Bake what a view lacks, and keep it in the store."""
        demands = self.frame(view).demands
        loader = self.renderer.caches.of(view.shading)
        self.renderer.tiles.run(lambda a, b: bake(loader, demands[a:b], self.target), len(demands), 1)

    def frame(self, view: View) -> Frame:
        """The picture of a view."""
        return self.renderer.render(view, self.target)


def run(pictures: PictureSet, target: float, picks: Sequence[Pick]) -> tuple[list[Frame], Times]:
    """Render the whole set on an empty store, beginning with the first of ``picks``; the frames of these."""
    kept: dict[Pick, Frame] = {}
    first, *others = sorted(range(pictures.views), key=lambda camera: camera != picks[0][0])
    with tempfile.TemporaryDirectory() as store:
        isogi, baking, rendering = Isogi(pictures.scene, store, target), 0.0, 0.0

        def _render(camera: int, turn: int) -> None:
            frame = isogi.frame(pictures.view(camera, turn))
            if (camera, turn) in picks:
                kept[camera, turn] = frame

        alone = seconds(lambda: isogi.bake(pictures.view(first))) + seconds(lambda: _render(first, 0))
        for camera in tqdm([first, *others], desc="isogi", unit="view"):
            baking += seconds(lambda camera=camera: isogi.bake(pictures.view(camera)))
            for turn in range(pictures.turns):
                rendering += seconds(lambda camera=camera, turn=turn: _render(camera, turn))
    return [kept[pick] for pick in picks], Times(alone, baking, rendering)
