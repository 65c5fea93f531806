"""The state of the check of a picture, as frames hold it."""

import hashlib
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.frame.rays.control_pixels import ControlPixels
from isogi_core.frame.rays.own_light import PixelLight
from isogi_core.frame.rays.point_transfer import TransferredLight

LitBy = Literal["texels", "paths", "transfer"]
"""What lights the pixels of a picture: the texels around them, paths of their own alone, or the
transfer of their points (``ViewTransfer``).
"""


@dataclass(frozen=True, eq=False)
class PictureState:
    """All that the check of a picture knows besides the light of its texels. Each step of the check
    replaces the record as a whole, so that another thread reads the values of one step.

    - ``goal``: relative error that the picture is to reach, and samples that texels are to have,
      the present rung.
    - ``controls``: control pixels of the present attempt.
    - ``uncertainty`` (m,): uncertain luminance of each surface point; controls were drawn by it.
    - ``own``: light that pixels have from paths of their own.
    - ``carried`` (k,): rows of the surface points whose light was carried over from other views.
    - ``attempt``: number of times that pixels have got light of their own; each has new controls.
    - ``lit_by``: what lights the picture; None before that was decided.
    - ``base``: light of all points by their transfer, if that lights the picture.
    - ``ended``: True if the last step found nothing to do.
    - ``drawn``: the rung on which the controls were drawn.
    - ``paths``: number of paths in each half of a control.
    """

    goal: Goal
    controls: ControlPixels = field(default_factory=ControlPixels.none)
    uncertainty: np.ndarray = field(default_factory=lambda: np.empty(0))
    own: PixelLight = field(default_factory=PixelLight.none)
    carried: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    attempt: int = 0
    lit_by: LitBy | None = "texels"
    base: TransferredLight = field(default_factory=TransferredLight.none)
    ended: bool = False
    drawn: int = 0
    paths: int = 0

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        light = self.own.nbytes + self.base.nbytes
        return self.controls.nbytes + self.uncertainty.nbytes + light + self.carried.nbytes

    @property
    def goes_without_texels(self) -> bool:
        """True if the picture reads no texels."""
        return self.lit_by in ("paths", "transfer")

    @property
    def covers(self) -> bool:
        """True if each surface point of a picture by paths has light of its own."""
        return self.lit_by == "paths" and self.all_points

    @property
    def all_points(self) -> bool:
        """True if each surface point has light of its own."""
        return len(self.own.places) == len(self.own.expected) > 0

    @property
    def transferred(self) -> int:
        """The number of paths of each point whose transfer lights the picture."""
        return self.base.samples

    @property
    def outdated(self) -> bool:
        """True if the controls were drawn on a lower rung than the present one."""
        return self.drawn < self.goal.samples

    @property
    def version(self) -> bytes:
        """The name of the light that pixels have of their own and by their transfer, equal if and
        only if their light is; empty if no pixel has any.
        """
        own = self.own
        name = b""
        # The points of a picture and the number of their paths determine their transfer.
        if self.transferred:
            name += b"transfer" + repr(self.transferred).encode()
        if not len(own.places):
            return name
        name += repr(own.count).encode() + hashlib.sha256(own.places.data).digest()
        # Points may have different numbers of paths (``Growth.next``).
        if own.estimate.unequal:
            name += hashlib.sha256(np.ascontiguousarray(own.estimate.counts).data).digest()
        # The pixel of a point and the number of its paths determine the light traced for it.
        # Light that was carried over was traced for pixels of other views, so its values count.
        if len(self.carried):
            name += hashlib.sha256(np.ascontiguousarray(own.light).data).digest()
        return name
