"""Light of a whole volume that its cut keeps: found in the store, and put into the chunks of the cut."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.keeping import Remains, find_kept, keeps
from isogi_core.bake.texel_light import Light
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.scene_assets import SceneAssets
from isogi_core.files.scene_file import SceneSource
from isogi_core.kernels._jit import load
from isogi_core.kernels.transport.strays import find_strays
from isogi_core.plan.volumes.cuts import cut_digest, voxels_left
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.store import Store


@dataclass(frozen=True)
class Whole:
    """The scene that one was cut from: its ``source``, and its ``assets`` where workers lack its files."""

    source: SceneSource
    assets: SceneAssets | None = None

    def planes(self, cut: SceneSource) -> str:
        """What a ``cut`` of it takes away, as its document has that besides what the whole is cut by itself."""
        own, both = (str(each.document.get("cut", "")) for each in (self.source, cut))
        return both.removeprefix(f"{own};") if own else both


@dataclass(frozen=True, eq=False)
class WholeLight:
    """The light of a whole volume in a store, ``chunks``, and what ``remains`` of it where it is cut."""

    chunks: ChunkStore
    remains: Remains

    def lend(
        self, light: Light, waiting: np.ndarray, places: Sequence[tuple[Index, np.ndarray]], walks: bool
    ) -> np.ndarray:
        """Give texels that are ``waiting`` (m,) bool the light that they keep; which have it now, (m,) bool.

        Without ``walks`` those alone of which this is known without walking paths. ``places`` are chunks and offsets
        in them, whose texels have the rows of ``light``, in place, one chunk's after the other's.
        """
        lattice, kept = self.chunks.spec.prepared.lattice, np.zeros(len(light), np.bool_)
        bounds = np.cumsum([0, *(len(offsets) for _, offsets in places)]).tolist()
        rows, texels, found = list[np.ndarray](), list[np.ndarray](), list[Light]()
        for (index, offsets), (first, last) in zip(places, pairwise(bounds), strict=True):
            chunk = self.chunks.read(index) if waiting[first:last].any() else None
            if chunk is None:
                continue
            own = np.flatnonzero(waiting[first:last] & np.isin(offsets, chunk.offsets))
            rows.append(first + own)
            texels.append(lattice.positions(index, offsets[own]))
            found.append(chunk.light.rows(chunk.rows_of(offsets[own])))
        if not any(map(len, rows)):
            return kept
        whole, every = Light.joined(found), np.concatenate(rows)
        whole.agree_on_void()
        ahead = np.flatnonzero(whole.samples > light.samples[every])
        own = np.concatenate(texels)[ahead]
        stays = ahead[find_kept(whole.rows(ahead), own, self.chunks.spec, self.remains, walks)]
        light.put(every[stays], whole.rows(stays))
        kept[every[stays]] = True
        return kept


def light_of_whole(spec: BakeSpec, planes: str, cut: BakeSpec, store: Store) -> WholeLight | None:
    """The light by a ``spec`` of a whole volume, of which a ``cut`` by some ``planes`` may keep some; None where none
    can.
    """
    whole, left = spec.prepared.scene.volume, cut.prepared.scene.volume
    if not keeps(spec) or cut_digest(whole, planes) != left.digest:
        return None
    load((find_strays,))
    return WholeLight(ChunkStore(store, spec), Remains.of(whole, voxels_left(whole, planes)))
