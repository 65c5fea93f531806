"""Chunks of light for the tests of the cache, and what is compared of them."""

from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, spec_for
from isogi_core.bake.noise import Goal
from isogi_core.bake.refine import refine
from isogi_core.cache.chunk_record import Chunk, Chunks
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.layer import LayerStore
from isogi_core.kernels.shading.lattice import DEFAULT_CHUNK_SIDE
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from tests.bake.texels import same
from tests.loaded import load_scene

SKY = {"type": "sky"}
CONSTANT = {"type": "constant", "radiance": 1.0}
SETTINGS: dict[str, Any] = {
    "lattice": 0.4,
    "bounces": 1,
    "target_error": 0.5,
    "lights": [SKY],
    "lobes": 0,
}
"""39³ texels in 3³ chunks: the last along each axis is 7 texels wide, and texels lie between
voxels.
"""

TEXELS = DEFAULT_CHUNK_SIDE**3
"""Texels of each of these chunks."""

ORDERS = {"order": 2, "indirect_order": 2}
"""What makes layers of as many bytes of direct and indirect light; of no use to constant light."""

PLAN = ScenePlan(
    "transfer", (Layer("direct", 3), Layer("indirect", 2, 3, half=False)), 3, 2, 1.0, 4096
)
"""A plan of two layers that differ in all that they can."""


def spec_of(target: str | Path = "demo:orbital", shading: str = "gi", **settings: Any) -> BakeSpec:
    """A look at a small scene of two layers, direct and indirect light of order 2, unless told
    otherwise.
    """
    if settings.get("lights") == [CONSTANT]:
        orders = {}
    else:
        orders = ORDERS
    return spec_for(
        PreparedScene(load_scene(target, **{**SETTINGS, **orders, **settings})), shading
    )


def baked(
    spec: BakeSpec, index: Index, texels: int = 40, seed: int = 0, samples: int = 16
) -> Chunk:
    """A chunk with real light in some of its texels."""
    lattice = spec.prepared.lattice
    inside = lattice.positions(index, np.arange(lattice.texels))
    offsets = np.flatnonzero((inside < lattice.shape).all(axis=1))
    chosen = np.sort(np.random.default_rng(seed).choice(offsets, texels, replace=False))
    chunk = Chunk.empty(index, spec.plan).with_texels(chosen)
    refine(chunk.light, inside[chosen], spec, samples, Goal(1e-3))
    return chunk


def shown(store: ChunkStore, index: Index) -> Chunks:
    """What frames are shown of a chunk."""
    return store.show([index], [store.objects(index)])


def file_of(layer: LayerStore, index: Index) -> Path:
    """Where the object of a chunk is."""
    return Path(layer.path, "c", *map(str, index), "0")


def assert_equal(a: Chunk, b: Chunk) -> None:
    """Two chunks are the same, bit by bit."""
    assert a.index == b.index
    np.testing.assert_array_equal(a.offsets, b.offsets)
    assert same(a.light, b.light)
