"""A chi-square test of samples against the density they claim to follow, after Mitsuba's
`ChiSquareTest`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

LEVEL = 0.01
FEWEST = 5.0

Bounds = tuple[tuple[float, float], tuple[float, float]]
Density = Callable[[np.ndarray, np.ndarray], np.ndarray]


def uniform(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The density of the unit square."""
    return np.ones(np.broadcast(s, t).shape)


@dataclass(frozen=True)
class ChiSquare:
    """Counts of samples in the cells of a grid over a rectangle, and what the density makes them
    expect.

    ``points`` (n, 2) lie in ``bounds``; ``density(s, t)`` is per unit area of that rectangle and is
    integrated over every cell by Gauss quadrature, so it may bend within a cell, but not break.
    """

    points: np.ndarray
    density: Density = uniform
    bounds: Bounds = ((0.0, 1.0), (0.0, 1.0))
    cells: tuple[int, int] = (32, 32)

    def observed(self) -> np.ndarray:
        """Samples per cell; a sample outside the bounds is an error."""
        counts, _, _ = np.histogram2d(*self.points.T, bins=self.cells, range=self.bounds)
        if counts.sum() != len(self.points):
            raise AssertionError(
                f"{len(self.points) - counts.sum():.0f} samples lie outside {self.bounds}"
            )
        return counts.ravel()

    def expected(self) -> np.ndarray:
        """Samples per cell that the density promises; their sum is n when it integrates to 1."""
        (s, s_weight), (t, t_weight) = map(self._nodes, self.bounds, self.cells)
        mass = self.density(s[:, None], t[None, :]) * s_weight[:, None] * t_weight
        rows, columns = self.cells
        return (
            len(self.points)
            * mass.reshape(rows, -1, columns, len(t) // columns).sum(axis=(1, 3)).ravel()
        )

    @staticmethod
    def _nodes(
        bounds: tuple[float, float], cells: int, count: int = 8
    ) -> tuple[np.ndarray, np.ndarray]:
        nodes, weights = np.polynomial.legendre.leggauss(count)
        width = (bounds[1] - bounds[0]) / cells
        starts = bounds[0] + width * np.arange(cells)
        return (starts[:, None] + width * (nodes + 1) / 2).ravel(), np.tile(
            weights * width / 2, cells
        )

    def p_value(self) -> float:
        """Chance of counts at least this far from the expected ones; cells that expect < 5 are
        pooled.
        """
        observed = self.observed()
        expected = self.expected()
        np.testing.assert_allclose(
            expected.sum(), len(self.points), rtol=1e-6, err_msg="no density: its integral"
        )
        if observed[expected < 1e-9].any():
            return 0.0
        order = np.argsort(-expected)
        kept = int((expected >= FEWEST).sum())
        if expected[order[kept:]].sum() < FEWEST:
            kept -= 1
        counts = np.append(observed[order[:kept]], observed[order[kept:]].sum())
        means = np.append(expected[order[:kept]], expected[order[kept:]].sum())
        return float(chi2.sf(((counts - means) ** 2 / means).sum(), kept))

    def check(self, tests: int = 1) -> None:
        """Fail where the p-value is below the level 0.01, shared by Šidák's rule among ``tests``
        tests.
        """
        p = self.p_value()
        level = 1.0 - (1.0 - LEVEL) ** (1.0 / tests)
        assert p >= level, f"samples do not follow their density: p = {p:.2e} < {level:.2e}"
