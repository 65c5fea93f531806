"""Colours of a surface by data: the albedo of each value, and the value at each place of a
volume.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.files.grid import srgb_bytes
from isogi_core.files.vector import triple
from isogi_core.model.lights import Colour

COLOUR_MAPS = {
    "viridis": "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c"
    " 1fa088 28ae80 3fbc73 5ec962 84d44b addc30 d8e219 fde725",
    "magma": "000004 0a0822 1d1147 36106b 51127c 6a1c81 832681 9c2e7f b73779"
    " d0416f e75263 f56b5c fc8961 fea772 fec488 fde2a3 fcfdbf",
    "cividis": "00224e 002e6a 1a386f 32436d 434e6c 535a6d 61656f 6f7073 7d7c78"
    " 8c8878 9b9476 aba072 bcae6c cdbb63 dec958 f0d846 fee838",
    "coolwarm": "3b4cc0 4e68d8 6282ea 779af7 8db0fe a3c2fe b9d0f9 ccd9ed dddcdc"
    " ecd3c5 f5c4ac f7b093 f4987a eb7d62 dd5f4b ca3b37 b40426",
    "grey": "000000 ffffff",
}
"""Colour maps by name: sRGB at equal steps from the lowest value to the highest. Sources: viridis
and magma (Smith and van der Walt 2015), cividis (Nuñez, Anderton and Renslow 2018), coolwarm
(Moreland 2009).
"""

MAX_ALBEDO = 0.95
"""Highest albedo that colours may have: with more, light would hardly leave a hollow."""

VALUES = 255
"""Number of codes for values, from 1 on."""


def linear_of(code: float) -> float:
    """Return the linear light of an sRGB ``code`` from 0 to 1 (IEC 61966-2-1)."""
    if code <= 0.04045:
        return code / 12.92
    return ((code + 0.055) / 1.055) ** 2.4


def table_of(name: str) -> np.ndarray:
    """Return the albedos of all codes by the colour map ``name``, (255, 3) float64, linear RGB,
    at most MAX_ALBEDO.
    """
    anchors = (
        np.array([list(bytes.fromhex(colour)) for colour in COLOUR_MAPS[name].split()]) / 255.0
    )
    return np.vectorize(linear_of)(spread_colours(anchors)).clip(0.0, MAX_ALBEDO)


def spread_colours(colours: np.ndarray) -> np.ndarray:
    """Interpolate ``colours`` (n, 3) at equal steps linearly to all codes; (255, 3)."""
    place = np.linspace(0.0, 1.0, VALUES)
    at = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(place, at, channel) for channel in colours.T], axis=1)


@dataclass(frozen=True)
class Label:
    """A part of a segmentation: its ``value`` in the volume, its ``name``, its albedo
    ``colour``; ``shown`` is False for a hidden one.
    """

    value: int
    name: str
    colour: Colour
    shown: bool


@dataclass(frozen=True, eq=False)
class Scale:
    """The meaning and the colours of values.

    - ``name``: of the quantity; ``span``: values of the first and the last colour.
    - ``map``: name of the colours, one of COLOUR_MAPS, "own" or "labels"; ``table`` (255, 3): their
      albedos, linear RGB; ``outside``: albedo of places without a value.
    - ``labels``: of a segmentation, empty for other data; the shown ones have the codes from 1 on.
    """

    name: str
    span: tuple[float, float]
    map: str
    table: np.ndarray
    outside: Colour
    labels: tuple[Label, ...] = ()

    @property
    def anchors(self) -> list[str]:
        """Colours for a legend, as ``#rrggbb``: those of the shown labels, or 17 at equal steps."""
        if self.labels:
            return [hex_of(label.colour) for label in self.labels if label.shown]
        return [hex_of(self.table[round(place)]) for place in np.linspace(0, VALUES - 1, 17)]


def hex_of(albedo: np.ndarray | Colour) -> str:
    """Return an albedo, linear RGB, as sRGB ``#rrggbb``."""
    return "#" + srgb_bytes(np.asarray(albedo)).tobytes().hex()


@dataclass(frozen=True, eq=False)
class SurfaceColours:
    """The albedo of isosurfaces by data.

    ``places`` are ``step`` voxels of the scene's volume apart, along x, y, z. For values they are
    codes, (nz, ny, nx) uint8: 0 for none, else 1 to 255 along the ``scale``. For labels they are
    (nz, ny, nx, 3): two codes, and the share of the second (``kernels.transport.colours``).
    """

    places: np.ndarray
    step: tuple[float, float, float]
    scale: Scale

    @cached_property
    def table(self) -> np.ndarray:
        """The albedo of each code, linear RGB; (256, 3) float64."""
        return np.vstack([self.scale.outside, self.scale.table])

    @cached_property
    def brightest(self) -> Colour:
        """The highest albedo of any place, in each channel."""
        if self.places.ndim == 3:
            codes = self.places
        else:
            codes = self.places[..., :2]
        there = np.any(
            [np.bincount(layer.ravel(), minlength=VALUES + 1) > 0 for layer in codes], axis=0
        )
        return triple(self.table[there].max(axis=0))

    @property
    def grey(self) -> bool:
        """True if no place changes the colour of light."""
        return bool((self.table[:, 1:] == self.table[:, :1]).all())

    @cached_property
    def digest(self) -> str:
        """Hex digest of everything that light depends on."""
        found = hashlib.blake2b(f"{self.places.shape} {self.step}".encode(), digest_size=16)
        found.update(np.ascontiguousarray(self.places).data)
        found.update(np.ascontiguousarray(self.table).data)
        return found.hexdigest()
