"""Projection: at which isovalues a view's texels are to lie on the isosurface that it shows."""

from dataclasses import dataclass

import numpy as np

from isogi_core.kernels.tracing.field import Field
from isogi_core.model.volume import Isovalue
from isogi_core.plan.stiffness import measure_stiffness

INTERPOLATION = 0.5
"""Share of the target error that interpolation between texels may take: a quarter of its variance.

The survey may expect a third of the true error, see ``plan.stiffness``, and projecting in vain costs half a bake.
"""

LEVELS = 33
"""Isovalues that a volume is surveyed at, evenly spaced."""

SURVEYED = 1 << 20
"""Cells that the survey looks at, at most."""

Span = tuple[Isovalue, Isovalue]
"""Isovalues from one to another, both included."""


@dataclass(frozen=True, eq=False)
class ProjectionPlan:
    """Where texels are projected: at isovalues where the expected error of interpolation is above ``allowed``.

    ``levels`` (m,) are the isovalues that were surveyed, ascending, and ``errors`` (m,) what interpolation between
    texels on their own isosurfaces errs by there, relative; that of the nearest level counts.
    """

    levels: np.ndarray
    errors: np.ndarray
    allowed: float

    @classmethod
    def settled(cls, span: Span, projects: bool) -> "ProjectionPlan":
        """At every isovalue of a ``span``, or at none: what a scene settles itself."""
        return cls(np.array(span, float), np.full(2, np.inf if projects else 0.0), 0.0)

    @property
    def any(self) -> bool:
        """Whether texels are projected at any isovalue."""
        return bool((self.errors > self.allowed).any())

    def error(self, isovalue: Isovalue) -> float:
        """The expected error of interpolation at an isovalue; relative."""
        return float(self.errors[np.searchsorted(self._between, isovalue)])

    def projects(self, isovalue: Isovalue) -> bool:
        """Whether texels are projected onto the isosurface at an isovalue."""
        return self.error(isovalue) > self.allowed

    def spans(self) -> list[tuple[float, float]]:
        """The isovalues at which texels are projected, normalised, as ascending spans."""
        above = np.concatenate([[False], self.errors > self.allowed, [False]])
        edges = np.concatenate([self.levels[:1], self._between, self.levels[-1:]])[above[1:] != above[:-1]]
        return [(low, high) for low, high in edges.reshape(-1, 2).tolist()]

    @property
    def _between(self) -> np.ndarray:
        """Half-way between each two levels; (m - 1,)."""
        return np.asarray((self.levels[1:] + self.levels[:-1]) / 2)


def plan_projection(field: Field, span: Span, start: Isovalue, target: float) -> ProjectionPlan:
    """Survey how stiff isosurfaces of a ``field`` are: over a ``span`` of isovalues, and at that where views ``start``.

    ``target`` is the relative error of the scene; macrocells are not asked for. What stiff surfaces err by is of
    ``plan.stiffness``.
    """
    levels = np.append(np.linspace(*span, LEVELS), start)
    found = measure_stiffness(field, levels, most=SURVEYED)
    errors = np.array([found.expectation(place).likely for place in range(len(found.levels))])
    return ProjectionPlan(found.levels.astype(float), errors, INTERPOLATION * target)
