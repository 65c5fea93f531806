"""The light of a set of texels: for each layer of a plan a table with one row per texel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isogi_core.bake.bake_spec import Term
from isogi_core.bake.precision import VOID
from isogi_core.model.scene_plan import Layer, ScenePlan


@dataclass(frozen=True, eq=False)
class Part:
    """What texels keep of one ``layer``, one row each.

    ``samples`` (m,) int32 are the paths taken, both randomisations together, or VOID; ``noise`` (m, noises) float32
    is the standard error of a coefficient in band 0, and above it; ``coefficients`` (m, channels, n²) float32.
    """

    layer: Layer
    samples: np.ndarray
    noise: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def dark(cls, layer: Layer, texels: int) -> "Part":
        """Texels that no path has been sent from yet."""
        coefficients = np.zeros((texels, layer.channels, layer.order**2), np.float32)
        return cls(layer, np.zeros(texels, np.int32), np.zeros((texels, layer.noises), np.float32), coefficients)

    @classmethod
    def undefined(cls, layer: Layer, texels: int) -> "Part":
        """Texels that are to be filled: what they hold as yet is anything."""
        coefficients = np.empty((texels, layer.channels, layer.order**2), np.float32)
        return cls(layer, np.empty(texels, np.int32), np.empty((texels, layer.noises), np.float32), coefficients)

    @classmethod
    def joined(cls, parts: Sequence["Part"]) -> "Part":
        """The texels of several parts of one layer, one part's after the other's."""
        columns = zip(*((part.samples, part.noise, part.coefficients) for part in parts), strict=True)
        return cls(parts[0].layer, *map(np.concatenate, columns))

    def rows(self, which: np.ndarray) -> "Part":
        """A copy of some rows."""
        return Part(self.layer, self.samples[which], self.noise[which], self.coefficients[which])

    def channel(self, number: int) -> "Part":
        """The texels with channel ``number`` of their coefficients alone."""
        own = np.ascontiguousarray(self.coefficients[:, number : number + 1])
        return Part(self.layer, self.samples, self.noise, own)

    def put(self, which: np.ndarray, part: "Part") -> None:
        """Write the rows of ``part`` to some rows of this."""
        self.samples[which] = part.samples
        self.noise[which] = part.noise
        self.coefficients[which] = part.coefficients


@dataclass(frozen=True, eq=False)
class Light:
    """The ``parts`` of texels' light, in the order of the plan's layers."""

    parts: tuple[Part, ...]

    @classmethod
    def dark(cls, plan: ScenePlan, texels: int) -> "Light":
        """Texels that no path has been sent from yet."""
        return cls(tuple(Part.dark(layer, texels) for layer in plan.layers))

    @classmethod
    def joined(cls, lights: Sequence["Light"]) -> "Light":
        """The texels of several lights of one plan, one light's after the other's."""
        return cls(tuple(Part.joined(parts) for parts in zip(*(light.parts for light in lights), strict=True)))

    def __len__(self) -> int:
        return len(self.parts[0].samples)

    def rows(self, which: np.ndarray) -> "Light":
        """A copy of some rows."""
        return Light(tuple(part.rows(which) for part in self.parts))

    def put(self, which: np.ndarray, light: "Light") -> None:
        """Write the rows of ``light`` to some rows of this."""
        for mine, part in zip(self.parts, light.parts, strict=True):
            mine.put(which, part)

    @property
    def samples(self) -> np.ndarray:
        """The fewest samples of any part, VOID where a texel can hold no light; (m,) int32."""
        return np.min([part.samples for part in self.parts], axis=0)

    @property
    def void(self) -> np.ndarray:
        """Whether each texel can hold no light; (m,) bool."""
        return np.any([part.samples == VOID for part in self.parts], axis=0)

    def agree_on_void(self) -> None:
        """Make void in all parts what is so in one: a part may have been lost, or read while another is written."""
        void = self.void
        for part in self.parts:
            part.samples[void] = VOID

    @property
    def transfer(self) -> np.ndarray:
        """The parts' sum; (m, channels, n²) float32 with the most channels and the highest order of any."""
        return sum_of(self.parts, max(part.layer.channels for part in self.parts))

    def columns(self, terms: Sequence[Term]) -> np.ndarray:
        """The sums of the parts of each of the ``terms``, side by side; (m, channels, Σ n²) float32."""
        channels = max(part.layer.colours for part in self.parts)
        sums = [sum_of(self._of(term), channels)[:, :, : term.order**2] for term in terms]
        return sums[0] if len(sums) == 1 else np.concatenate(sums, axis=2)

    def _of(self, term: Term) -> list["Part"]:
        """The parts that are of a ``term``, or the one channel of its part that is."""
        parts = [self.parts[i] for i in term.layers]
        return parts if term.node is None else [part.channel(term.node) for part in parts]


def sum_of(parts: Sequence[Part], channels: int) -> np.ndarray:
    """The sum of some parts' coefficients; (m, channels, n²) float32 with the highest order of any."""
    n = max(part.coefficients.shape[2] for part in parts)
    total = np.zeros((len(parts[0].samples), channels, n), np.float32)
    for part in parts:
        total[:, :, : part.coefficients.shape[2]] += part.coefficients
    return total
