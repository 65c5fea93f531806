"""The store of a look: its layers side by side, each whole or absent, wherever Zarr can keep
them.
"""

import shutil
import uuid
from collections.abc import Callable
from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.refine import climb, locate
from isogi_core.bake.texel_light import VOID, Light
from isogi_core.cache.chunk_record import Chunk
from isogi_core.cache.chunk_store import ChunkStore, default_store
from isogi_core.errors import StoreAwayError
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage import store as store_module
from tests.bake.texels import same
from tests.cache.chunks import TEXELS, assert_equal, baked, file_of, spec_of

INNER = (1, 1, 1)
EDGE = (2, 1, 2)
DIRECT = 0
INDIRECT = 1


@pytest.fixture
def chunk_store(tmp_path: Path, spec: BakeSpec) -> ChunkStore:
    return ChunkStore(tmp_path, spec)


def test_default_store_is_in_the_users_cache(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_store() == tmp_path / "isogi" / "light"


def test_opening_makes_the_layers_before_there_is_any_light(
    chunk_store: ChunkStore, tmp_path: Path
) -> None:
    assert not list(tmp_path.iterdir())
    chunk_store.open()
    assert {path.parent.name for path in tmp_path.glob("*/zarr.json")} == {
        layer.digest for layer in chunk_store.layers
    }
    assert chunk_store.read(INNER) is None


# --- stores
# --------------------------------------------------------------------------------------------------


@pytest.fixture(params=["folder", "file://", "memory://"])
def anywhere(request: pytest.FixtureRequest, tmp_path: Path, spec: BakeSpec) -> ChunkStore:
    roots = {"folder": str(tmp_path), "file://": f"file://{tmp_path}/light/"}
    return ChunkStore(roots.get(request.param, f"memory://{uuid.uuid4().hex}"), spec)


def objects(chunk_store: ChunkStore, index: Index) -> list[bytes | None]:
    """The objects of a chunk, one for each layer."""
    return [layer.read(index) for layer in chunk_store.layers]


def test_every_store_keeps_chunks(anywhere: ChunkStore, spec: BakeSpec) -> None:
    assert anywhere.read(EDGE) is None
    assert anywhere.load(EDGE).offsets.size == 0
    chunk = baked(spec, EDGE)
    anywhere.save(chunk)
    for found in (anywhere, ChunkStore(anywhere.store.url, spec)):
        assert_equal(found.load(EDGE), chunk)
    assert anywhere.read(INNER) is None
    stored = objects(anywhere, EDGE)
    assert all(stored)
    anywhere.save(chunk)
    assert objects(anywhere, EDGE) == stored
    anywhere.save(baked(spec, EDGE, seed=1))
    assert all(one != other for one, other in zip(objects(anywhere, EDGE), stored, strict=True))


# --- layers apart
# -------------------------------------------------------------------------------------------------


def test_only_parts_that_changed_are_written(chunk_store: ChunkStore, spec: BakeSpec) -> None:
    first = baked(spec, EDGE)
    chunk_store.save(first)
    before = objects(chunk_store, EDGE)
    second = baked(spec, EDGE, seed=1)
    chunk_store.save(second, [False, True])
    after = objects(chunk_store, EDGE)
    assert after[DIRECT] == before[DIRECT] and after[INDIRECT] != before[INDIRECT]
    chunk_store.save(second, [False, False])
    assert objects(chunk_store, EDGE) == after


@pytest.mark.parametrize("lost", [DIRECT, INDIRECT])
@pytest.mark.parametrize(
    "damage", [lambda path: path.unlink(), lambda path: path.write_bytes(path.read_bytes()[:-1])]
)
def test_what_is_lost_of_one_layer_is_dark_and_the_other_stays(
    chunk_store: ChunkStore, spec: BakeSpec, damage: Callable[[Path], None], lost: int
) -> None:
    chunk = baked(spec, INNER)
    chunk_store.save(chunk)
    damage(file_of(chunk_store.layers[lost], INNER))
    found = chunk_store.load(INNER)
    assert np.array_equal(found.offsets, chunk.offsets)
    kept = 1 - lost
    assert same(Light((found.light.parts[kept],)), Light((chunk.light.parts[kept],)))
    assert (
        not found.light.parts[lost].samples.any() and not found.light.parts[lost].coefficients.any()
    )
    texels = spec.prepared.lattice.positions(INNER, found.offsets)
    climb([found.light.parts[lost]], np.arange(40), locate(texels, spec.prepared, spec.shown), spec)
    chunk_store.save(found, [lost == DIRECT, lost == INDIRECT])
    assert_equal(chunk_store.load(INNER), chunk)


def test_layers_that_scenes_share_are_baked_once(tmp_path: Path, spec: BakeSpec) -> None:
    """Another albedo, and vicinity shading, have the same direct light; other lights have all of
    it.
    """
    chunk = baked(spec, INNER)
    ChunkStore(tmp_path, spec).save(chunk)
    bright = ChunkStore(tmp_path, spec_of(albedo=0.9)).load(INNER)
    assert same(Light(bright.light.parts[:1]), Light(chunk.light.parts[:1]))
    assert not bright.light.parts[INDIRECT].samples.any()
    vicinity = ChunkStore(tmp_path, spec_of(shading="vicinity")).load(INNER)
    assert same(vicinity.light, Light(chunk.light.parts[:1]))
    other = ChunkStore(tmp_path, spec_of(lights=[{"type": "sky", "sun_elevation": 10.0}]))
    assert_equal(other.load(INNER), chunk)


def test_void_texels_in_holes_are_at_home(tmp_path: Path) -> None:
    voxels = np.random.default_rng(0).random((20, 20, 20)).astype(np.float32)
    voxels[5:12, 5:12, 5:12] = np.nan
    nrrd.write(str(tmp_path / "holes.nrrd"), voxels, index_order="C")
    spec = spec_of(tmp_path / "holes.nrrd", lattice=1.0)
    chunk_store = ChunkStore(tmp_path / "light", spec)
    chunk = baked(spec, (0, 0, 0), texels=TEXELS)
    assert 0 < chunk.light.void.sum() < TEXELS
    assert any((part.samples == VOID).any() for part in chunk.light.parts)
    chunk_store.save(chunk)
    assert_equal(chunk_store.load((0, 0, 0)), chunk)


def test_a_deleted_store_is_away_until_a_new_start_makes_it(
    chunk_store: ChunkStore, spec: BakeSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_module, "CHECKED", 0.0)
    chunk = baked(spec, INNER)
    chunk_store.save(chunk)
    shutil.rmtree(chunk_store.store.url.folder)
    for use in (
        lambda: chunk_store.read(INNER),
        lambda: chunk_store.load(INNER),
        lambda: chunk_store.save(chunk),
    ):
        with pytest.raises(StoreAwayError, match="is gone"):
            use()
    assert not chunk_store.store.url.folder.exists()
    anew = ChunkStore(chunk_store.store.url, spec)
    assert anew.read(INNER) is None
    anew.save(chunk)
    assert_equal(anew.load(INNER), chunk)


# --- many writers
# -------------------------------------------------------------------------------------------------


def test_a_chunk_that_was_never_lit_is_no_chunk(chunk_store: ChunkStore, spec: BakeSpec) -> None:
    """What tells is the texels in it: a task that found nothing to do leaves none."""
    chunk_store.save(Chunk.empty(INNER, spec.plan).with_texels(np.arange(10, dtype=np.int32)))
    assert chunk_store.read(INNER) is None
