"""Light that stands in where there is none yet: the whole volume's for what is cut open, another time's in a series."""

import hashlib
import weakref
from dataclasses import replace

import numpy as np

from isogi_core.bake.noise import Until
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.shading import light_sources
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL
from isogi_core.kernels.shading.lattice import BURIED_GRADE, PARTIAL_GRADE, UNBAKED_GRADE
from isogi_core.plan.volumes.cuts import Ranges, box_left, is_within


class StandIn:
    """The light of a whole volume for views of one that is cut: of those texels that are far from its faces.

    So of another step of a series in time, nothing of which is cut.
    """

    def __init__(self, whole: Caches, left: Ranges) -> None:
        """``whole`` are the caches of the whole volume, of which the voxels that are ``left`` are shown.

        They are not kept in memory for this alone.
        """
        self._whole, self._box = weakref.ref(whole), box_left(left, whole.prepared.scene.volume.size)

    def light(
        self, texels: ViewTexels, reading: Reading, lit: np.ndarray, light: RotatedLight, tiles: Tiles
    ) -> tuple[Reading, np.ndarray]:
        """The ``reading`` of a view and its texels' light ``lit``, with the whole's for those that have none: dark too,
        where the whole is closed.

        They are then partly lit: pixels that read them are provisional still. Raises Cancelled.
        """
        caches, waiting = self._whole(), reading.grade == UNBAKED_GRADE
        if caches is None or not waiting.any() or caches.spec(light.view.shading).plan != light.spec.plan:
            return reading, lit
        loader = caches.of(light.view.shading)
        loader.ensure(texels.chunks, tiles.check)
        with loader.pool.hold(texels.chunks) as held:
            other = read_texels(texels, held.slots, loader.pool, Until(reading.target, reading.enough), tiles)
            fit = waiting & np.isin(other.grade, (CONVERGING, FINAL, BURIED_GRADE)) & self._is_far(texels, caches)
            rows = np.where(fit, other.rows, -1).astype(np.int32)
            borrowed = light_sources(((rows, loader.pool),), light, tiles)
        version = hashlib.sha256(other.version + fit.tobytes()).digest()
        grade = np.where(fit, np.uint8(PARTIAL_GRADE), reading.grade)
        return replace(reading, grade=grade, version=reading.version + version), np.where(fit[:, None], borrowed, lit)

    def _is_far(self, texels: ViewTexels, caches: Caches) -> np.ndarray:
        """Which texels are far from the faces of the cut; (texels,) bool."""
        return is_within(texels.positions[:, ::-1] * caches.prepared.step, self._box)
