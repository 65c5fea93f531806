"""Ways to bring a picture to its target: more samples of its texels, finer texels, and light of its
pixels' own.

Each way is weighed by the paths that it is expected to take, from the picture's errors as control
pixels show them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isogi_core.bake.texel_light import FIRST_LEVEL, next_level
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.control_pixels import MAX_CONTROLS, TotalError
from isogi_core.frame.rays.own_light import Choice, choose_points
from isogi_core.model.scene_plan import most_samples
from isogi_core.plan.variants import FINER_FACTOR

QUIETER = 0.5
"""What one rung leaves of the variance of a filtered picture: 0.35 to 0.7 on the engine, the bonsai
and the chest.
"""

CLOSER = FINER_FACTOR**-2
"""What finer texels leave of a picture's squared error besides its noise: 0.11 to 0.44."""

COUNTED_TEXEL_SHARE = 0.25
"""The share of a texel's paths that counts: other views, and other lights, read the texel too."""

HEAVIER = 3.0
"""What a path of a texel takes over one of a pixel, in time: 2.5 to 4.5, as it branches, and is
saved and read.
"""

TASK = float(1 << 14)
"""What a chunk's rung counts beside its paths, in paths of pixels: 8 ms of a worker, see
``worker.progress``.
"""

FINER_TEXELS_COST = float(1 << 22)
"""What it counts to begin with finer texels, in paths of pixels: each worker opens them, for 1 to 2
s.
"""


class Prices(NamedTuple):
    """What texels count, in paths of pixels: each ``path``, each ``task``, and ``opening`` finer
    ones.

    By default those of a picture somebody waits for.
    """

    path: float = COUNTED_TEXEL_SHARE * HEAVIER
    task: float = TASK
    opening: float = FINER_TEXELS_COST

    @property
    def of_present(self) -> "Prices":
        """The prices where only present texels serve: finer ones have none that is finite."""
        return self._replace(opening=math.inf)


AWAITED = Prices()
"""Prices of a picture that somebody waits for."""

PRESENT: Prices = AWAITED.of_present
"""Prices of such a picture where there are no finer texels."""

SHARED_PRICES = Prices(COUNTED_TEXEL_SHARE, 0.0).of_present
"""Prices of a picture that stands for others, of any size: they all read its texels, and none its
pixels' light.
"""

FINER_TEXELS_FACTOR = FINER_FACTOR**2
"""How many times as many texels of a surface there are where the lattice is twice as fine, about:
2.2 to 4.
"""


@dataclass(frozen=True, eq=False)
class Plan:
    """A way to bring a picture to its target: so many ``rungs`` of its texels, or of ``finer``
    ones, and then light of their own for the pixels of a ``choice``. The rungs take so many
    ``texel_paths``, of that the ``next`` one, in so many ``tasks``.
    """

    choice: Choice
    rungs: int = 0
    texel_paths: float = 0.0
    next: float = 0.0
    tasks: float = 0.0
    finer: bool = False

    def cost(self, prices: Prices) -> float:
        """What it takes at these ``prices``, in paths of pixels."""
        work = prices.task * self.tasks + prices.path * self.texel_paths + self.choice.paths
        if self.finer:
            return work + prices.opening
        return work

    def ahead(self, first: float, last: float) -> "Ahead":
        """What is ahead beside the next rung, and beside pixels that begin to have light now.

        A rung's ``first`` controls, and the ``last`` of all, take so many paths.
        """
        if not self.rungs:
            return Ahead(last, times=1)
        return Ahead(
            self.choice.paths + self.rungs * first + last,
            self.texel_paths - self.next,
            self.rungs + 1,
        )


class Ahead(NamedTuple):
    """The paths that a picture is expected to take besides the samples that its texels are to have
    now.

    Paths of ``pixels``, controls among them, and of ``texels``; it is drawn so many ``times``
    meanwhile.
    """

    pixels: float = 0.0
    texels: float = 0.0
    times: int = 0


@dataclass(frozen=True, eq=False)
class OwnLight:
    """What light of their own costs pixels: so many ``paths`` leave the ``variance`` (m,) of each,
    those in ``own`` have some, and the picture's mean squared error is to be ``allowed``.
    """

    variance: np.ndarray
    paths: int
    own: np.ndarray
    allowed: float

    def beside(self, errors: np.ndarray) -> Choice:
        """The pixels that are to have it where texels leave these squared ``errors`` (m,)."""
        return choose_points(errors, self.variance, self.paths, self.own, self.allowed)


def noise_of_climbers(frame: Frame) -> float:
    """The share of a picture's noise variance that comes from noisy texels, which alone take more
    samples; from 0 to 1.

    It is 0 for a picture of no texels.
    """
    if (lacking := frame.quality.lacking) is None:
        return 0.0
    reading = lacking.reading
    variance = np.where(reading.samples > 0, reading.error.astype(np.float64) ** 2, 0.0)
    return float(variance[reading.noisy].sum() / max(variance.sum(), 1e-300))


def climbs_of(frame: Frame, rung: int, target: float) -> list[float]:
    """The paths that it takes the texels of a ``frame`` to climb no rung, one, two, and so on, from
    this ``rung``.
    """
    paths = [0.0]
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
    """How many of so many ``rungs`` texels climb before the picture is checked: one, or as far as
    that takes no more paths than a ``check``.
    """
    return max(1, sum(paths <= check for paths in climbs[1 : rungs + 1]))


def rungs_above(rung: int, target: float) -> Iterator[int]:
    """The samples of the rungs above one, as far as a ``target`` lets texels climb."""
    while (rung := next_level(rung)) <= most_samples(target):
        yield rung


def by_rungs(
    own: OwnLight, errors: np.ndarray, noise: np.ndarray, climbs: Sequence[float], chunks: int
) -> list[Plan]:
    """The plans by a picture's present texels, from its squared ``errors`` (m,), of which ``noise``
    (m,) falls.

    Each rung is a task of each of so many ``chunks``.
    """
    left = [errors - (1.0 - QUIETER**rungs) * noise for rungs in range(len(climbs))]
    return [
        Plan(own.beside(each), rungs, climbs[rungs], climbs[min(rungs, 1)], rungs * chunks)
        for rungs, each in enumerate(left)
    ]


def by_finer(
    own: OwnLight,
    errors: np.ndarray,
    noise: np.ndarray,
    texels: int,
    chunks: int,
    rung: int,
    target: float,
) -> list[Plan]:
    """The plans by finer texels in the place of so many, in ``chunks``, on a ``rung``; they begin
    with the first one.

    Of a picture's squared ``errors`` (m,) ``noise`` (m,) becomes less with each doubling of
    samples, the rest at once.
    """
    apart = CLOSER * np.maximum(errors - noise, 0.0)
    paths = FINER_TEXELS_FACTOR * texels
    plans = []
    for rungs, level in enumerate([FIRST_LEVEL, *rungs_above(FIRST_LEVEL, target)], start=1):
        left = apart + QUIETER ** math.log2(level / rung) * np.minimum(noise, errors)
        plans.append(
            Plan(
                own.beside(left),
                rungs,
                paths * level,
                paths * FIRST_LEVEL,
                FINER_TEXELS_FACTOR * rungs * chunks,
                True,
            )
        )
    return plans


def controls_to(measured: TotalError, likely: float, target: float) -> int:
    """How many controls it takes to say that a picture is at its ``target``, once its error is as
    ``likely``.

    The logarithm of the interval's width falls with the root of their number.
    """
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
