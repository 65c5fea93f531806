"""isogi's side of a race to equal error: a set of pictures from nothing, and how wrong some of them
are in all.
"""

import math
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from benchmarks.accuracy.errors import relative_rmse, without
from benchmarks.common.timing import Seconds
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_core.reference import Reference, trace_reference, with_bounces
from isogi_report.speed import Offsets, bake_offsets, make_renderer

SMALL = 8
"""Pixels a side of the pictures that kernels are compiled on."""


Pick = tuple[int, int]
"""A camera and a turn of the light, by their numbers."""

GOLDEN = math.pi * (3.0 - math.sqrt(5.0))
"""The golden angle."""

STEPS = (5, 3, 2, 1)
"""Turns of the light between one picked picture and the next: the first that goes through all of
them.
"""


@dataclass(frozen=True, eq=False)
class PictureSet:
    """``views`` cameras spread evenly above the horizon, three radii away, 30 degrees wide, by
    ``turns`` of light.
    """

    scene: Scene
    size: int
    views: int
    turns: int

    def __len__(self) -> int:
        return self.views * self.turns

    def view(self, camera: int, turn: int = 0) -> View:
        """The picture of one of the cameras under one of the lights, turned about z by equal steps.

        Directions are those of a Fibonacci lattice on the upper half of the sphere.
        """
        elevation = math.degrees(math.asin(1.0 - (camera + 0.5) / self.views))
        azimuth = math.degrees(camera * GOLDEN) % 360.0
        light = quaternion_from_angles(360.0 * turn / self.turns, 0.0, 0.0)
        towards = self.scene.camera(azimuth, elevation, 3.0, 30.0)
        return View(self.scene.isovalue, towards, light, self.size, self.size)

    def picks(self, count: int) -> list[Pick]:
        """Cameras and turns of ``count`` pictures from all over the set, different in both as far
        as there are.
        """
        count = min(count, len(self))
        step = next(step for step in STEPS if math.gcd(step, self.turns) == 1)
        return [
            ((2 * i + 1) * self.views // (2 * count), step * i % self.turns) for i in range(count)
        ]


@dataclass(frozen=True, eq=False)
class Check:
    """A picture of the set as isogi has ``lit`` it, and as long paths from each pixel show it at
    ``best``.

    ``outside`` (h, w) bool are the pixels that show the surface's outer side.
    """

    lit: Frame
    best: Reference
    outside: np.ndarray

    def error(self, on: np.ndarray) -> float:
        """isogi's total error: relative RMSE over the pixels ``on``, without the reference's own
        noise there.
        """
        return without(
            relative_rmse(self.lit.radiance, self.best.mean, on), replace(self.best, on=on).noise
        )

    def noise(self, on: np.ndarray) -> float:
        """The part of it that is noise of samples, as the frame estimates it."""
        wrong = self.lit.error[..., None] * self.lit.radiance
        return relative_rmse(self.lit.radiance + wrong, self.lit.radiance, on)


@dataclass(frozen=True)
class Costs:
    """What was spent from nothing: on the ``first`` picture alone, and on ``baking`` and
    ``rendering`` the set.
    """

    first: Seconds
    baking: Seconds
    rendering: Seconds

    @property
    def whole(self) -> Seconds:
        """What the whole set cost."""
        return self.baking + self.rendering


class Isogi:
    """A renderer over an empty ``store`` whose texels take ``samples`` each; ``baking`` and
    ``rendering`` are timed.
    """

    def __init__(self, scene: Scene, store: str, samples: int) -> None:
        """Nothing is made yet: maps are made when the first view needs them, and that is
        counted.
        """
        self.renderer = make_renderer(scene, store)
        self.samples = samples
        self.baking = Seconds()
        self.rendering = Seconds()

    def bake(self, views: Sequence[View]) -> None:
        """Bake what the views read, each chunk once for all of them, and keep it in the store."""
        with self.baking.counting():
            wanted = self._read_by(views)
            bar = tqdm(desc="isogi bakes", unit="chunk", total=len(wanted), disable=len(views) < 2)
            bake_offsets(self.renderer, "gi", wanted, self.samples, bar)

    def frame(self, view: View) -> Frame:
        """The picture of a view."""
        with self.rendering.counting():
            return self.renderer.render(view)

    def _read_by(self, views: Sequence[View]) -> Offsets:
        """The texels that some of the views read: offsets, chunk by chunk."""
        found: defaultdict[Index, list[np.ndarray]] = defaultdict(list)
        for view in tqdm(views, desc="isogi looks", unit="view", disable=len(views) < 2):
            texels = self.renderer.surface.texels(view, self.renderer.gbuffer(view))
            for index, offsets in zip(texels.chunks, texels.offsets, strict=True):
                found[index].append(offsets)
        return {index: np.unique(np.concatenate(parts)) for index, parts in found.items()}


def run(pictures: PictureSet, samples: int, picks: Sequence[Pick]) -> tuple[list[Frame], Costs]:
    """Render the first of ``picks`` on an empty store, and the whole set on another; the frames of
    all picks.
    """
    with tempfile.TemporaryDirectory() as store:
        one = Isogi(pictures.scene, store, samples)
        one.bake([pictures.view(*picks[0])])
        one.frame(pictures.view(*picks[0]))
    with tempfile.TemporaryDirectory() as store:
        every = Isogi(pictures.scene, store, samples)
        every.bake([pictures.view(camera) for camera in range(pictures.views)])
        kept = {pick: frame for pick, frame in frames(every, pictures) if pick in picks}
    return [kept[pick] for pick in picks], Costs(
        one.baking + one.rendering, every.baking, every.rendering
    )


def frames(isogi: Isogi, pictures: PictureSet) -> Iterator[tuple[Pick, Frame]]:
    """All pictures of a set, camera by camera."""
    with tqdm(
        desc="isogi renders", unit="picture", total=len(pictures), disable=len(pictures) < 3
    ) as bar:
        for pick in np.ndindex(pictures.views, pictures.turns):
            yield (pick[0], pick[1]), isogi.frame(pictures.view(*pick))
            bar.update()


def warm(pictures: PictureSet, samples: int) -> None:
    """Compile the kernels, on pictures so small that they take no time."""
    tiny = replace(pictures, size=SMALL, views=1, turns=min(pictures.turns, 2))
    lit, _ = run(tiny, samples, tiny.picks(1))
    check(tiny.scene, lit, 8)


def check(scene: Scene, lit: Sequence[Frame], paths: int) -> list[Check]:
    """The frames with their references: so many ``paths`` from each pixel, with all the bounces
    that matter.
    """
    with tempfile.TemporaryDirectory() as store:
        renderer = make_renderer(with_bounces(scene), store)
        bar = tqdm(lit, desc="references", unit="picture", disable=len(lit) < 2)
        return [
            Check(each, trace_reference(renderer, each.view, paths), outside(each, renderer))
            for each in bar
        ]


def outside(frame: Frame, renderer: Renderer) -> np.ndarray:
    """Which pixels show the outer side of the surface: where its normal points towards the eye; (h,
    w) bool.
    """
    gbuffer = frame.gbuffer
    seen = np.zeros(frame.state.size, np.bool_)
    towards = frame.view.camera.eye - gbuffer.points * np.array(gbuffer.spacing)
    seen[gbuffer.pixels] = (gbuffer.normals(renderer.tiles) * towards).sum(axis=1) > 0.0
    return seen.reshape(gbuffer.shape)
