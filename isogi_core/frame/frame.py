"""A frame: the answer to a view, with what is known of its own quality."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.frame.texels import Demand
from isogi_core.kernels.lattice import CONVERGING, FINAL, PROVISIONAL
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import View

STATES = {"final": FINAL, "converging": CONVERGING, "provisional": PROVISIONAL}


@dataclass(frozen=True, eq=False)
class Frame:
    """A rendered view. Planes are zero off the surface.

    ``radiance`` (h, w, 3) float32 linear RGB; ``state`` (h, w) uint8, 0 none, 1 provisional,
    2 converging, 3 final; ``error`` (h, w) float32 relative standard error; ``position`` (h, w, 3)
    float32 world. ``version`` is equal for equal pictures, also after a restart. ``demands`` is the
    light that was not final, ``seconds`` the time of each stage.
    """

    view: View
    radiance: np.ndarray
    state: np.ndarray
    error: np.ndarray
    position: np.ndarray
    chunks_needed: int
    chunks_final: int
    demands: tuple[Demand, ...]
    version: str
    seconds: Mapping[str, float]

    @cached_property
    def counts(self) -> dict[str, int]:
        """Surface pixels in each state."""
        return {name: int((self.state == value).sum()) for name, value in STATES.items()}

    @property
    def surface(self) -> int:
        """Pixels that show the surface."""
        return sum(self.counts.values())

    @property
    def coverage(self) -> dict[str, float]:
        """Share of the surface pixels in each state; all final where no surface is in the picture."""
        if not self.surface:
            return {"final": 1.0, "converging": 0.0, "provisional": 0.0}
        return {name: count / self.surface for name, count in self.counts.items()}

    @property
    def provisional(self) -> bool:
        """Whether any surface pixel is not final."""
        return self.counts["final"] < self.surface

    @cached_property
    def estimated_error(self) -> float:
        """Estimated relative RMSE of the frame: root mean square of the pixels' errors over the mean, in luminance.

        A provisional pixel counts as wrong by all of its light; the whole is at most 1.
        """
        if not self.surface:
            return 0.0
        light = self.radiance[self.state > 0] @ LUMINANCE
        wrong = light * self.error[self.state > 0]
        mean = float(light.mean())
        rms = float(np.sqrt((wrong.astype(np.float64) ** 2).mean()))
        return min(rms / mean, 1.0) if mean > 0.0 else 0.0
