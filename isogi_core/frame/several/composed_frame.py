"""Add up the frames of the sides of several surfaces to one frame; combine their errors and
states.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.demand import Demand
from isogi_core.frame.frame import Frame, Layer, Quality
from isogi_core.frame.framing import paint_faces
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.several.mixed_reading import MixedReading
from isogi_core.frame.several.peels import Peels, SideLayers
from isogi_core.frame.texel_reading import Stage
from isogi_core.frame.tiles import Stopwatch
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import OUTER, WALLS_SIDE, Side

MIN_SHOWN_LUMINANCE = 1e-30
"""Luminance that stands for zero in a divisor."""


@dataclass(frozen=True, eq=False)
class Part:
    """The share of a picture that one ``side`` of a surface has, or all walls as WALLS_SIDE:
    its ``layers``, their ``frame`` as one tall picture, and the ``caches`` of its light.
    """

    side: Side
    layers: SideLayers
    frame: Frame
    caches: Caches

    @property
    def weight(self) -> float:
        """The sum of the squares of the weights of its points in their pixels."""
        return float((self.layers.weights.astype(np.float64) ** 2).sum())

    def seen(self, values: np.ndarray) -> np.ndarray:
        """Return the ``values`` of a tall picture at its points."""
        return np.asarray(values.reshape(-1, *values.shape[2:])[self.layers.gbuffer.pixels])

    @property
    def light(self) -> tuple[Caches | None, ...]:
        """The caches of all light that its texels read; None stands for those of the scene."""
        if self.side == OUTER:
            return (None,)
        lacking = self.frame.quality.lacking
        if lacking is not None and isinstance(lacking.reading, MixedReading):
            return tuple(caches for _, caches in lacking.reading.parts)
        return (self.caches,)

    @property
    def measured(self) -> TotalError | None:
        """The total error by control pixels; None if there are none. Walls have none, and
        report their noise.
        """
        noise = self.frame.noise
        if self.side == WALLS_SIDE:
            return TotalError(noise, noise, noise)
        return self.frame.measured

    @property
    def unmeasured(self) -> bool:
        """True if control pixels have not measured it with the samples that its texels have."""
        return self.measured is None or self.frame.outdated


@dataclass(frozen=True, eq=False)
class ComposedFrame(Frame):
    """A frame that is composed of ``parts``, one for each side of a surface that is seen.

    A pixel has the least state of all that it shows; errors add up by their weights. ``aim`` is
    stored for the property ``target``, which frames of one surface compute; None if the picture is
    not checked.
    """

    parts: tuple[Part, ...] = ()
    aim: float | None = None

    @property
    def target(self) -> float | None:
        """The total error that control pixels must show before the frame is final; None if they
        do not check it.
        """
        return self.aim

    @property
    def given_up(self) -> bool:
        """True if each part is final, or its check has ended."""
        return bool(self.parts) and all(
            part.frame.given_up or part.frame.final for part in self.parts
        )

    @property
    def outdated(self) -> bool:
        """True if controls of a part were drawn when its texels were to have fewer samples."""
        return any(part.frame.outdated for part in self.parts)

    @property
    def traced_pixels(self) -> int:
        """The number of pixels that have light from paths of their own, in all parts."""
        return sum(part.frame.traced_pixels for part in self.parts)

    @property
    def demands(self) -> tuple[Demand, ...]:
        """The light that is not final on the outer side of the surface that slides."""
        return next((part.frame.demands for part in self.parts if part.side == OUTER), ())

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All light that must be baked until the picture is final, the side with the largest
        error first.
        """
        stages = []
        for part in sorted(self.parts, key=error_of, reverse=True):
            for stage in part.frame.stages:
                # The light of the outer side is in the scene's caches, which None stands for.
                if part.side == OUTER:
                    caches = None
                else:
                    caches = stage.caches or part.caches
                stages.append(replace(stage, caches=caches))
        return tuple(stages)

    @property
    def layers(self) -> Iterator[Layer]:
        """The layers of all sides, and the faces of its window; see ``Frame.layers``."""
        for part in self.parts:
            for rows, pixels in part.layers.each:
                yield pixels, part.layers.gbuffer.points[rows], part.layers.weights[rows]
        yield self.gbuffer.faces.pixels, self.gbuffer.faces.points, 1.0

    @property
    def checkable(self) -> bool:
        """True if a step of a check can improve the frame: all surfaces have their light, and some
        part is not at its target.
        """
        lit = not any(part.frame.provisional for part in self.parts if part.side != WALLS_SIDE)
        return lit and not self.final and any(part.frame.checkable for part in self.parts)

    @cached_property
    def walls_lag(self) -> bool:
        """True if walls are coarse, or not final with a larger error than the side with the largest
        one.
        """
        walls = [
            part for part in self.parts if part.side == WALLS_SIDE and part.frame.quality.waiting
        ]
        worst = max((error_of(part) for part in self.parts if part.side != WALLS_SIDE), default=0.0)
        return any(part.frame.walls_coarse or error_of(part) > worst for part in walls)

    @cached_property
    def true_mean(self) -> float:
        """The mean luminance of the pixels that show something."""
        return float(
            (self.radiance[self.state > 0].astype(np.float64) @ LUMINANCE_WEIGHTS).sum()
        ) / max(self.surface, 1)

    @cached_property
    def measured(self) -> TotalError | None:
        """The total relative RMSE by the control pixels of all sides; None before each side has
        some.

        The errors of different sides count as independent, but the ends of their intervals do not:
        the total is at an end if all sides are, so its interval is rather too wide.
        """
        # All sides must be measured: the error of one says nothing about the others.
        found = [part.measured for part in self.parts]
        if not found or self.view.shading != "gi" or self.view.moving or not all(found):
            return None
        errors = [each for each in found if each is not None]
        total = TotalError(
            self._sum([each.likely for each in errors]),
            self._sum([each.low for each in errors]),
            self._sum([each.high for each in errors]),
            sum(each.controls for each in errors),
        )
        return total.at_least(self.noise)

    @cached_property
    def tail(self) -> None:
        """None: control pixels of one side do not tell how errors of two in one pixel add up."""

    @cached_property
    def total_error(self) -> np.ndarray:
        """The relative error of each pixel, whatever its causes; (h, w) float32."""
        return summed_errors([(part, part.frame.total_error) for part in self.parts], self.radiance)

    def _sum(self, errors: Sequence[float]) -> float:
        """Return the relative RMSE from the relative ``errors`` of the parts, which are
        independent.
        """
        parts = zip(errors, self.parts, strict=True)
        squares = sum((error * part.frame.true_mean) ** 2 * part.weight for error, part in parts)
        error = math.sqrt(squares / max(self.surface, 1))
        return min(error / max(self.true_mean, MIN_SHOWN_LUMINANCE), 1.0)


def parts_of(frame: Frame) -> tuple[Part, ...]:
    """Return the parts that a frame is composed of; none for a frame of one surface."""
    if isinstance(frame, ComposedFrame):
        return frame.parts
    return ()


def error_of(part: Part) -> float:
    """Return the absolute error of a part in the picture, as far as it is known."""
    return in_picture(part, part.frame.total.likely)


def in_picture(part: Part, error: float) -> float:
    """Return the absolute error in the picture of a part with this relative ``error``."""
    return error * part.frame.true_mean * part.weight**0.5


def step_key(part: Part) -> tuple[bool, bool, float]:
    """Return a key by which parts are sorted, in reverse, for the next step of a picture: walls
    that are coarse, as their first fine texels are cheap; those that are not measured; and then
    those of the largest error.
    """
    return part.frame.walls_coarse, part.unmeasured, error_of(part)


def to_refine(frame: ComposedFrame, errors: Mapping[Side, float], target: float) -> list[Part]:
    """Return the parts of a ``frame`` that take steps until it reaches a ``target``, after all were
    measured; ``errors`` are the relative errors of all parts, as far as they are known.

    Walls are always brought to the target. Of the sides, the one with the largest error is brought
    to the target by itself. Steps end once the squares of all errors add up to the allowed one.
    """
    allowed = (target * frame.true_mean) ** 2 * frame.surface
    # Walls alone wait by themselves.
    found = [part for part in frame.parts if part.frame.quality.waiting]
    left = {part.side: in_picture(part, errors[part.side]) for part in frame.parts}
    left |= {part.side: in_picture(part, target) for part in found}
    improving = [part for part in frame.parts if part.frame.improving]
    while improving and sum(error**2 for error in left.values()) > allowed:
        part = max(improving, key=lambda each: left[each.side])
        improving.remove(part)
        # A part that is at the target by itself takes no steps.
        if errors[part.side] > target:
            found.append(part)
            left[part.side] = in_picture(part, target)
    return found


def summed_errors(errors: Sequence[tuple[Part, np.ndarray]], radiance: np.ndarray) -> np.ndarray:
    """Return the relative errors (h, w) of a picture with this ``radiance``, from those of the
    tall pictures of its parts; float32.
    """
    squares = np.zeros(radiance.shape[0] * radiance.shape[1])
    # Sum the squares of weight · luminance · relative error over all layers of a pixel.
    for part, error in errors:
        light = part.seen(part.frame.radiance).astype(np.float64) @ LUMINANCE_WEIGHTS
        added = (part.layers.weights * light * part.seen(error)) ** 2
        for rows, pixels in part.layers.each:
            squares[pixels] += added[rows]
    light = radiance.reshape(-1, 3).astype(np.float64) @ LUMINANCE_WEIGHTS
    errors_of_pixels = np.minimum(np.sqrt(squares) / np.maximum(light, MIN_SHOWN_LUMINANCE), 1.0)
    return errors_of_pixels.astype(np.float32).reshape(radiance.shape[:2])


def summed(view: View, parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Add up the light of the ``parts`` of a view, by the weights of their layers; return
    linear light (h, w, 3) float32, and the least state of each pixel, (h, w) uint8.
    """
    count = view.width * view.height
    # States begin above all real ones, so that the least of a pixel's layers remains.
    radiance = np.zeros((count, 3))
    state = np.full(count, FINAL + 1, np.uint8)
    for part in parts:
        light = part.layers.weights[:, None] * part.seen(part.frame.radiance)
        states = part.seen(part.frame.state)
        for rows, pixels in part.layers.each:
            radiance[pixels] += light[rows]
            state[pixels] = np.minimum(state[pixels], states[rows])
    # Pixels that no layer has touched show nothing.
    state[state > FINAL] = 0
    shape = view.height, view.width
    return radiance.astype(np.float32).reshape(*shape, 3), state.reshape(shape)


def compose(
    view: View, peels: Peels, parts: Sequence[Part], watch: Stopwatch, target: float, scene: Scene
) -> ComposedFrame:
    """Compose the frame of a ``view`` of a ``scene`` from the frames of its sides, and paint
    the faces of its window.
    """
    # Add up light and errors of all layers of each pixel.
    lit, state = summed(view, parts)
    error = summed_errors([(part, part.frame.error) for part in parts], lit)
    # Faces of a window hide all that is behind them: paint them over light, state and error, which
    # the framebuffer views.
    if len(peels.first.faces.pixels):
        paint_faces(
            peels.first,
            scene,
            Framebuffer(lit.reshape(-1, 3), state.reshape(-1), error.reshape(-1)),
        )
    # Control pixels check only pictures of this shading at rest; others have no target.
    checked = view.shading == "gi" and not view.moving
    # Name the picture by the versions of its parts.
    versions = repr([(part.side, part.frame.version) for part in parts]) + repr(view)
    # Counts of the parts add up; the worst of the expected errors stands for all.
    frames = [part.frame for part in parts]
    chunks = sum(each.chunks_needed for each in frames), sum(each.chunks_final for each in frames)
    quality = Quality(
        chunks=chunks,
        waiting=sum(each.quality.waiting for each in frames),
        expected=max((each.quality.expected for each in frames), default=0.0),
    )
    version = hashlib.blake2b(versions.encode(), digest_size=16).hexdigest()
    return ComposedFrame(
        view,
        lit,
        state,
        error,
        gbuffer=peels.first,
        version=version,
        seconds=watch.seconds,
        quality=quality,
        left=peels.left,
        parts=tuple(parts),
        aim=target if checked else None,
    )
