"""The light of a set of texels, as a table with one row each: the planes that a chunk keeps."""

from dataclasses import dataclass

import numpy as np

from isogi_core.model.plan import ScenePlan

SAMPLES, ISOVALUE, ERROR, COEFFICIENTS = 0, 1, 2, 3
VOID = -1.0
"""Number of samples that marks a texel which can hold no light."""


@dataclass(frozen=True, eq=False)
class Light:
    """``planes`` (texels, planes) float32, in the order of ``ScenePlan.planes``; the properties are views into it."""

    plan: ScenePlan
    planes: np.ndarray

    @classmethod
    def dark(cls, plan: ScenePlan, texels: int) -> "Light":
        """Texels that no path has been sent from yet."""
        return cls(plan, np.zeros((texels, len(plan.planes)), np.float32))

    def rows(self, which: np.ndarray) -> "Light":
        """A copy of some rows."""
        return Light(self.plan, self.planes[which])

    @property
    def samples(self) -> np.ndarray:
        """Paths taken, both randomisations together; VOID where there is no surface."""
        return self.planes[:, SAMPLES]

    @property
    def isovalue(self) -> np.ndarray:
        """The isovalue (normalised) of the surface that each texel was lit on."""
        return self.planes[:, ISOVALUE]

    @property
    def direct(self) -> np.ndarray:
        """τ of paths that leave at once; (texels, n²)."""
        return self.planes[:, COEFFICIENTS : COEFFICIENTS + self.plan.order**2]

    @property
    def indirect(self) -> np.ndarray:
        """τ of paths that were reflected, times R^k; (texels, channels, n²)."""
        return self._coloured(0)

    @property
    def spread(self) -> np.ndarray:
        """Half the difference of the two randomisations of direct + indirect; squared, the variance of their mean."""
        return self._coloured(1)

    @property
    def transfer(self) -> np.ndarray:
        """τ = direct + indirect; (texels, channels, n²)."""
        return self.direct[:, None, :] + self.indirect

    def _coloured(self, which: int) -> np.ndarray:
        n, channels = self.plan.order**2, self.plan.channels
        start = COEFFICIENTS + n + which * channels * n
        return self.planes[:, start : start + channels * n].reshape(-1, channels, n)
