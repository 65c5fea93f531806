"""Effort: the samples that texels have taken, and those that they will take until they are final."""

from typing import NamedTuple, Self

import numpy as np

from isogi_core.bake.noise import good_enough
from isogi_core.model.plan import FEWEST, most_samples

RATE = 1.5
"""How samples grow as the error falls: with 1 / error^RATE, since stratified points' error falls about as n^-2/3."""


class Effort(NamedTuple):
    """What texels that are not final want: ``unlit`` of them hold no light yet.

    The others have ``taken`` so many samples together, and are predicted to take ``left`` more.
    """

    unlit: int
    taken: float
    left: float

    @classmethod
    def of(cls, error: np.ndarray, samples: np.ndarray, target: float) -> Self:
        """The effort of texels by their relative ``error`` and their ``samples``, void ones left out."""
        unlit, taken, left = efforts(np.zeros(len(error), np.intp), 1, error, samples, target)[0].tolist()
        return cls(int(unlit), taken, left)


def samples_left(error: np.ndarray, samples: np.ndarray, target: float) -> np.ndarray:
    """The samples that texels will still take to bring their relative ``error`` to ``target``; (texels,) float64.

    They must be lit and not final: each takes one more rung of the ladder at least.
    """
    worth = np.clip(samples * (error / target) ** RATE, FEWEST, most_samples(target))
    goal = 2.0 ** np.ceil(np.log2(worth))
    return np.asarray(np.maximum(goal, 2.0 * samples) - samples)


def efforts(chunks: np.ndarray, count: int, error: np.ndarray, samples: np.ndarray, target: float) -> np.ndarray:
    """``Effort.of`` the texels of each of ``count`` chunks, (count, 3) float64; ``chunks`` is where each texel is."""
    unlit, waiting = samples == 0, (samples > 0) & ~good_enough(error, samples, target)
    left = samples_left(error[waiting], samples[waiting], target)
    columns = ((unlit, None), (waiting, samples[waiting]), (waiting, left))
    sums = [np.bincount(chunks[rows], weights=weights, minlength=count) for rows, weights in columns]
    return np.stack(sums, axis=1).astype(np.float64)
