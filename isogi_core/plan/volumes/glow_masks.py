"""Masks of glows: which voxels of the scene's volume each of them takes, by the nearest voxel of its file."""

from collections.abc import Sequence

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.mappings import budget
from isogi_core.files.scene_file import Settings
from isogi_core.model.glow import NO_BITS, Glow
from isogi_core.model.volume import Volume
from isogi_core.plan.volumes.colours import volume_grids
from isogi_core.plan.volumes.masks import MaskTable, place
from isogi_core.plan.volumes.opening import AXES_CHOICES, open_grid


def read_glow_masks(glows: Sequence[Glow], settings: Settings, volume: Volume) -> np.ndarray:
    """Of each voxel of a ``volume`` the numbers of the ``glows`` whose masks take it, a bit each; as ``Glowing.bits``.

    Raises SceneError and VolumeError where a mask cannot be used.
    """
    if not any(glow.mask for glow in glows):
        return NO_BITS
    if volume.voxels.size > budget():
        need = f"Masks of glows take a byte a voxel, {volume.voxels.size / 1e6:.0f} MB of memory"
        raise VolumeError(f"{need}: leave them out, or give more by ISOGI_VOLUME_MB.")
    base, raw = settings.source.base, settings.choice("axes", AXES_CHOICES) == "raw"
    whole, straight = volume_grids(settings, base, volume, raw)
    bits = np.zeros(volume.shape, np.uint8)
    for number, glow in enumerate(glows):
        if glow.mask:
            mask = place(MaskTable(glow.mask, glow.labels), open_grid(base, glow.mask, {}, raw)[0], whole, straight)
            for z in range(len(bits)):
                bits[z] |= mask.layer(z, volume.shape).astype(np.uint8) << np.uint8(number)
    return bits
