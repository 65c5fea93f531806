"""Plans: ways to bring a picture to its target error, and the cost of each in paths.

There are three ways: more samples for its texels, finer texels, and light of pixels' own. Their
costs are predicted from the errors that control pixels show.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isogi_core.bake.texel_light import FIRST_LEVEL, next_level
from isogi_core.cache.costs import TASK_OVERHEAD_SECONDS
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.control_pixels import MAX_CONTROLS, TotalError
from isogi_core.frame.rays.own_light import Choice, choose_points
from isogi_core.model.scene_plan import most_samples
from isogi_core.plan.variants import FINER_FACTOR

QUIETER = 0.5
"""Share of the variance of a filtered picture that one rung leaves: 0.35 to 0.7 on the engine,
the bonsai and the chest.
"""

CLOSER = FINER_FACTOR**-2
"""Share of a picture's squared error besides noise that finer texels leave: 0.11 to 0.44."""

COUNTED_TEXEL_SHARE = 0.25
"""Share of a texel's paths that counts, as other views and other lights read the texel, too."""

HEAVIER = 3.0
"""Time of a path of a texel over that of a path of a pixel: 2.5 to 4.5, as it branches, and is
saved and read.
"""

LIGHTER = 0.4
"""Time of a path whose end is projected over that of a path that gathers light: 0.37 to 0.5, as it
casts no shadow rays (engine, CT head, carp, heptane).
"""

PATHS_PER_SECOND = float(1 << 21)
"""Paths of pixels that a thread traces in a second, by which seconds of workers are priced. It is
a constant, as a picture's samples must not depend on the speed of the machine.
"""

TASK = PATHS_PER_SECOND * TASK_OVERHEAD_SECONDS
"""Cost of baking one chunk by one rung besides its paths, in paths of pixels."""

FINER_TEXELS_COST = PATHS_PER_SECOND * 2.0
"""Cost of starting with finer texels, in paths of pixels: each worker opens them, which takes 1
to 2 s.
"""


class Prices(NamedTuple):
    """Costs in paths of pixels: of each ``path`` of a texel, of each ``task``, and of ``opening``
    finer texels; ``alone`` is the factor on paths of a picture that reads no texels. By default
    those for a picture that somebody waits for.

    If ``carries``, light that was traced for other views may take the place of texels. A picture
    that stands for others goes without it: texels are to serve all of them.
    """

    path: float = COUNTED_TEXEL_SHARE * HEAVIER
    task: float = TASK
    opening: float = FINER_TEXELS_COST
    alone: float = 1.0
    carries: bool = True

    @property
    def of_present(self) -> "Prices":
        """The prices without finer texels, whose price is infinite."""
        return self._replace(opening=math.inf)

    @property
    def of_transfer(self) -> "Prices":
        """The prices of a picture that the transfer of its points lights, in place of texels."""
        return self._replace(path=self.path / HEAVIER * LIGHTER)

    @property
    def of_texels(self) -> "Prices":
        """The prices of a picture whose texels are to be baked in any case."""
        return self._replace(alone=math.inf)


AWAITED = Prices()
"""Prices for a picture that somebody waits for."""

PRESENT: Prices = AWAITED.of_present
"""Prices for a picture that somebody waits for, without finer texels."""

SHARED_PRICES = Prices(COUNTED_TEXEL_SHARE, 0.0, carries=False).of_present.of_texels
"""Prices for a picture that stands for others, of any size: all of these read its texels, and
none the light of its pixels.
"""

FINER_TEXELS_FACTOR = FINER_FACTOR**2
"""Factor on the number of texels of a surface if the lattice is twice as fine: 4, an upper
estimate; measured are 2.2 to 4.
"""


@dataclass(frozen=True, eq=False)
class Plan:
    """A way to bring a picture to its target: first ``rungs`` for its texels, or for ``finer``
    ones, then light of their own for the pixels of a ``choice``.

    ``texel_paths`` is the number of paths of all rungs, ``next`` that of the first of them,
    ``tasks`` the number of tasks for workers.
    """

    choice: Choice
    rungs: int = 0
    texel_paths: float = 0.0
    next: float = 0.0
    tasks: float = 0.0
    finer: bool = False

    def cost(self, prices: Prices) -> float:
        """Return the cost of the plan at these ``prices``, in paths of pixels."""
        work = prices.task * self.tasks + prices.path * self.texel_paths + self.choice.paths
        if self.finer:
            return work + prices.opening
        return work

    def ahead(self, first: float, last: float) -> "Ahead":
        """Return the work that is left after the next step of the plan: after its first rung, or
        after the light of its pixels if it has no rungs.

        ``first`` is the number of paths of the controls on each rung, ``last`` that of all controls
        at the end.
        """
        if not self.rungs:
            return Ahead(last, times=1)
        # Each rung is drawn and measured, and the picture with the light of pixels once more.
        pixels = self.choice.paths + self.rungs * first + last
        return Ahead(pixels, self.texel_paths - self.next, self.rungs + 1)


class Ahead(NamedTuple):
    """Work that a picture is expected to need after the step that is under way: numbers of paths of
    ``pixels``, controls among them, and of ``texels``. The picture is drawn ``times`` times on the
    way.
    """

    pixels: float = 0.0
    texels: float = 0.0
    times: int = 0


def until_decided(controls: float, climbs: Sequence[float], prices: Prices, first: float) -> Ahead:
    """Return the work that decides if a picture is at its target: paths of more ``controls``, or
    a rung and its ``first`` controls if that costs less. ``climbs`` is as from ``climbs_of``.
    """
    if len(climbs) > 1 and prices.path * climbs[1] + first < controls:
        return Ahead(first, climbs[1], times=2)
    return Ahead(controls, times=1)


@dataclass(frozen=True, eq=False)
class PixelLightCost:
    """What is known about the cost of light of pixels' own: ``paths`` paths leave the
    ``variance`` (m,) of each point's luminance, the points in rows ``own`` have such light, and
    ``allowed`` is the mean squared error that the picture may have.
    """

    variance: np.ndarray
    paths: int
    own: np.ndarray
    allowed: float

    def choose(self, errors: np.ndarray) -> Choice:
        """Choose the pixels that are to have such light if texels leave the squared ``errors``
        (m,).
        """
        return choose_points(errors, self.variance, self.paths, self.own, self.allowed)


def noise_of_climbers(frame: Frame) -> float:
    """Return the share of a picture's noise variance that falls if its texels, or the transfer of
    its points, climb a rung; from 0 to 1.

    Of texels, only those climb that would take more samples. Of a picture by transfer, all noise
    falls but that of lobes. If neither lights the picture, the share is 0.
    """
    if frame.transferred:
        shown = float((frame.pixel_noise**2).sum())
        return min(frame.variance_of_transfer / max(shown, 1e-300), 1.0)
    if (lacking := frame.quality.lacking) is None:
        return 0.0
    reading = lacking.reading
    variance = np.where(reading.samples > 0, reading.error.astype(np.float64) ** 2, 0.0)
    return float(variance[reading.noisy].sum() / max(variance.sum(), 1e-300))


def climbs_of(frame: Frame, rung: int, target: float) -> list[float]:
    """Return the number of paths that the texels of a ``frame``, or the transfer of its points,
    take to climb no rung, one, two, and so on, from ``rung`` as far as ``target`` allows.
    """
    paths = [0.0]
    if frame.transferred:
        points = len(frame.gbuffer.pixels)
        paths += [float(points * (each - rung)) for each in rungs_above(rung, target)]
    if (lacking := frame.quality.lacking) is not None:
        reading = lacking.reading
        samples = reading.samples[reading.noisy].astype(np.float64)
        paths += [
            float(np.maximum(each - samples, 0.0).sum())
            for each in rungs_above(rung, target)
            if len(samples)
        ]
    return paths


def rungs_at_once(rungs: int, climbs: Sequence[float], check: float) -> int:
    """Return how many of the ``rungs`` texels climb before control pixels measure the picture
    again: one, or as many as take no more paths than that ``check``. ``climbs`` is as from
    ``climbs_of``.
    """
    return max(1, sum(paths <= check for paths in climbs[1 : rungs + 1]))


def rungs_above(rung: int, target: float) -> Iterator[int]:
    """Yield the sample counts of the rungs above ``rung``, as far as texels climb for a
    ``target`` error.
    """
    while (rung := next_level(rung)) <= most_samples(target):
        yield rung


def by_rungs(
    pixels: PixelLightCost,
    errors: np.ndarray,
    noise: np.ndarray,
    climbs: Sequence[float],
    chunks: int,
) -> list[Plan]:
    """Return the plans that use the present texels of a picture, one for each number of rungs.

    ``errors`` (m,) are the squared errors of its points, of which ``noise`` (m,) falls with each
    rung. Each rung is a task for each of ``chunks`` chunks.
    """
    # Each rung leaves the share QUIETER of the noise, and all of the other errors.
    plans = []
    for rungs, paths in enumerate(climbs):
        left = errors - (1.0 - QUIETER**rungs) * noise
        first = climbs[min(rungs, 1)]
        plans.append(Plan(pixels.choose(left), rungs, paths, first, rungs * chunks))
    return plans


def by_finer(
    pixels: PixelLightCost,
    errors: np.ndarray,
    noise: np.ndarray,
    texels: int,
    chunks: int,
    rung: int,
    target: float,
) -> list[Plan]:
    """Return the plans that replace the ``texels`` of a picture, in ``chunks`` chunks, by finer
    ones, twice as many along each axis: a plan for each rung that these may climb to, as far as the
    ``target`` error allows.

    ``errors`` (m,) are the squared errors of points at the present ``rung``; ``noise`` (m,) is the
    part of them that samples reduce; if it is larger than the error, all of the error counts as
    noise. The other part falls to the share CLOSER at once.
    """
    interpolation = CLOSER * np.maximum(errors - noise, 0.0)
    count = FINER_TEXELS_FACTOR * texels
    plans = []
    # Finer texels begin without light, at the first rung.
    for rungs, level in enumerate([FIRST_LEVEL, *rungs_above(FIRST_LEVEL, target)], start=1):
        # The noise is that of ``rung`` samples. Each doubling from there to ``level`` multiplies it
        # by QUIETER; if ``level`` is lower, each halving divides it by QUIETER.
        left = interpolation + QUIETER ** math.log2(level / rung) * np.minimum(noise, errors)
        tasks = FINER_TEXELS_FACTOR * rungs * chunks
        choice = pixels.choose(left)
        plans.append(Plan(choice, rungs, count * level, count * FIRST_LEVEL, tasks, finer=True))
    return plans


def controls_to(measured: TotalError, likely: float, target: float) -> int:
    """Return the number of control pixels that shows a picture to be at its ``target``, if its
    error is ``likely``.

    The width of the logarithm of an interval falls with the root of their number.
    """
    # The interval must fit between the likely error and the target; ``wide`` is its present half
    # width.
    if 0.0 < likely < target:
        room = math.log(target / likely)
    else:
        room = 0.0
    if measured.likely > 0.0:
        wide = math.log(max(measured.high / measured.likely, 1.0))
    else:
        wide = 0.0
    if room > 0.0:
        return min(math.ceil(measured.controls * (wide / room) ** 2), MAX_CONTROLS)
    return MAX_CONTROLS
