import json
import multiprocessing
import os
import shutil
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import google_crc32c
import nrrd
import numpy as np
import pytest
import zarr
from numcodecs.zstd import Zstd

from isogi_core.bake.light import SAMPLES, VOID
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.bake.refine import refine
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.record import TEXELS
from isogi_core.cache.origin import values_at
from isogi_core.cache.store import ChunkStore, default_store
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.kernels.field import value
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.scene import load_scene

INNER, EDGE = (1, 1, 1), (2, 1, 2)
NOBODY = 65534


def recipe_of(target: str | Path = "demo:orbital", **overrides: Any) -> Recipe:
    settings = {"order": 2, "lattice": 0.4, "bounces": 1, "target_error": 0.5}
    return Recipe(load_scene(target, **{**settings, **overrides}))


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    """39³ texels in 3³ chunks: the last along each axis is 7 texels wide, and texels lie between voxels."""
    return recipe_of()


@pytest.fixture
def store(tmp_path: Path, recipe: Recipe) -> ChunkStore:
    return ChunkStore(tmp_path, recipe)


def baked(recipe: Recipe, index: Index, texels: int = 40, seed: int = 0) -> Chunk:
    """A chunk with real light in some of its texels."""
    inside = np.stack(np.unravel_index(np.arange(TEXELS), (CHUNK,) * 3), axis=-1) + np.array(index) * CHUNK
    offsets = np.flatnonzero((inside < recipe.shape).all(axis=1))
    chosen = np.sort(np.random.default_rng(seed).choice(offsets, texels, replace=False))
    chunk = Chunk.empty(index, recipe.scene.plan).with_texels(chosen)
    refine(chunk.light, chunk.positions(chunk.offsets), recipe, 16, 1e-3)
    return chunk


def file_of(store: ChunkStore, index: Index) -> Path:
    return Path(store.path, "c", *map(str, index), "0")


def assert_equal(a: Chunk, b: Chunk) -> None:
    assert a.index == b.index
    np.testing.assert_array_equal(a.offsets, b.offsets)
    np.testing.assert_array_equal(a.light.planes, b.light.planes)


def test_the_metadata_keeps_the_promises(store: ChunkStore, recipe: Recipe) -> None:
    store.save(baked(recipe, INNER))
    facts = json.loads(Path(store.path, "zarr.json").read_text())
    assert (facts["zarr_format"], facts["node_type"], facts["data_type"]) == (3, "array", "float32")
    assert facts["fill_value"] == "NaN"
    assert [codec["name"] for codec in facts["codecs"]] == ["bytes", "zstd", "crc32c"]
    assert facts["chunk_key_encoding"] == {"name": "default", "configuration": {"separator": "/"}}
    planes = recipe.scene.plan.planes
    assert facts["shape"] == [39, 39, 39, len(planes)]
    assert facts["chunk_grid"]["configuration"]["chunk_shape"] == [16, 16, 16, len(planes)]


def test_the_attributes_say_what_the_planes_are(store: ChunkStore, recipe: Recipe) -> None:
    store.save(baked(recipe, INNER))
    facts = json.loads(Path(store.path, "zarr.json").read_text())["attributes"]["isogi"]
    assert facts["planes"] == list(recipe.scene.plan.planes)
    assert facts["planes"][:3] == ["samples", "isovalue", "error"]
    assert facts["volume_digest"] == recipe.scene.volume.digest
    assert facts["step"] == recipe.step.tolist()
    assert (facts["albedo"], facts["bounces"], facts["order"]) == ([0.7, 0.7, 0.7], 1, 2)


def test_a_chunk_is_one_object_under_its_own_key(store: ChunkStore, recipe: Recipe) -> None:
    store.save(baked(recipe, EDGE))
    files = {path.relative_to(store.root).as_posix() for path in Path(store.root).rglob("*") if path.is_file()}
    digest = recipe.scene.bake_digest
    assert files == {f"{digest}/zarr.json", f"{digest}/c/2/1/2/0"}


def test_plain_zarr_reads_what_the_fast_reader_reads(store: ChunkStore, recipe: Recipe) -> None:
    for index in product(range(3), repeat=3):
        store.save(baked(recipe, index, seed=sum(index)))
    whole = np.asarray(zarr.open_array(store.path, mode="r")[...])
    assert whole.shape == (*recipe.shape, len(recipe.scene.plan.planes))
    for index in product(range(3), repeat=3):
        z, y, x = (slice(i * CHUNK, min((i + 1) * CHUNK, n)) for i, n in zip(index, recipe.shape, strict=True))
        block = store.load(index).block()[: z.stop - z.start, : y.stop - y.start, : x.stop - x.start]
        np.testing.assert_array_equal(whole[z, y, x], block)
    assert (~np.isnan(whole[..., SAMPLES])).sum() == 27 * 40


def test_the_isovalue_plane_is_the_field(store: ChunkStore, recipe: Recipe) -> None:
    chunk = baked(recipe, EDGE)
    places = chunk.positions(chunk.offsets) * recipe.step[::-1]
    twin = [value(recipe.scene.volume.voxels, (float(x), float(y), float(z))) for z, y, x in places]
    np.testing.assert_allclose(values_at(recipe.scene.volume.voxels, places), twin, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(chunk.light.isovalue, np.float32(twin))


@pytest.mark.parametrize("index", [INNER, EDGE])
def test_dark_chunks_and_empty_ones_are_written_too(store: ChunkStore, recipe: Recipe, index: Index) -> None:
    for used in (store, ChunkStore(store.root, recipe)):
        used.save(Chunk.empty(index, recipe.scene.plan))
        assert used.read(index) is not None
        assert used.load(index).offsets.size == 0
        file_of(used, index).unlink()


def test_default_store_is_in_the_users_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_store() == tmp_path / "isogi" / "light"


@pytest.fixture(params=["folder", "file://", "memory://"])
def anywhere(request: pytest.FixtureRequest, tmp_path: Path, recipe: Recipe) -> ChunkStore:
    roots = {"folder": str(tmp_path), "file://": f"file://{tmp_path}/light/"}
    return ChunkStore(roots.get(request.param, f"memory://{uuid.uuid4().hex}"), recipe)


def test_every_store_keeps_chunks(anywhere: ChunkStore, recipe: Recipe) -> None:
    assert anywhere.read(EDGE) is None
    assert anywhere.load(EDGE).offsets.size == 0
    chunk = baked(recipe, EDGE)
    anywhere.save(chunk)
    assert_equal(anywhere.load(EDGE), chunk)
    assert anywhere.read(INNER) is None
    stored = anywhere.read(EDGE)
    assert stored is not None
    anywhere.save(chunk)
    assert anywhere.read(EDGE) == stored
    anywhere.save(baked(recipe, EDGE, seed=1))
    assert (anywhere.read(EDGE) or b"")[-4:] != stored[-4:]


def test_every_store_is_found_again(anywhere: ChunkStore, recipe: Recipe) -> None:
    chunk = baked(recipe, INNER)
    anywhere.save(chunk)
    assert_equal(ChunkStore(anywhere.root, recipe).load(INNER), chunk)


Damage = Callable[[bytes], bytes]
DAMAGES: dict[str, Damage] = {
    "empty": lambda b: b"",
    "three bytes": lambda b: b[:3],
    "four bytes": lambda b: b[:4],
    "cut in half": lambda b: b[: len(b) // 2],
    "cut by one byte": lambda b: b[:-1],
    "first byte lost": lambda b: b[1:],
    "zeros": lambda b: bytes(len(b)),
    "one sector of zeros": lambda b: b[:64] + bytes(512) + b[576:],
    "one byte more": lambda b: b + b"\0",
    "four bytes more": lambda b: b + b"abcd",
    "twice": lambda b: b + b,
    "another checksum": lambda b: b[:-4] + b"\0\0\0\0",
    "whole, but no chunk": lambda b: b[:-9] + google_crc32c.value(b[:-9]).to_bytes(4, "little"),
    "whole, but text": lambda b: b"light" + google_crc32c.value(b"light").to_bytes(4, "little"),
}


@pytest.mark.parametrize("index", [INNER, EDGE])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damage_is_found_taken_as_absent_and_healed(
    store: ChunkStore, recipe: Recipe, damage: Damage, index: Index
) -> None:
    store.save(baked(recipe, index))
    whole = file_of(store, index).read_bytes()
    file_of(store, index).write_bytes(damage(whole))
    with pytest.raises(DamagedChunkError, match=r"is damaged: .*baked again\.$"):
        store.decode(index, store.read(index) or b"")
    assert store.load(index).offsets.size == 0
    store.save(baked(recipe, index))
    assert file_of(store, index).read_bytes() == whole


def test_every_single_flipped_bit_is_found(store: ChunkStore, recipe: Recipe) -> None:
    store.save(baked(recipe, INNER, texels=4))
    whole = store.read(INNER) or b""
    for bit in range(8 * len(whole)):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << (bit % 8)
        with pytest.raises(DamagedChunkError):
            store.decode(INNER, bytes(flipped))


@pytest.mark.parametrize("lattice", [0.4, 1.0])
def test_a_chunk_under_another_name_is_found(tmp_path: Path, lattice: float) -> None:
    recipe = recipe_of(lattice=lattice)
    store = ChunkStore(tmp_path, recipe)
    for index in (INNER, EDGE):
        store.save(baked(recipe, index))
    a, b = (file_of(store, index).read_bytes() for index in (INNER, EDGE))
    for index, stored in ((INNER, b), (EDGE, a)):
        file_of(store, index).write_bytes(stored)
        with pytest.raises(DamagedChunkError, match="another place"):
            store.decode(index, store.read(index) or b"")
    assert store.load(INNER).offsets.size == 0


@pytest.mark.parametrize(
    "other", [{"target": "demo:casting"}, {"lattice": 0.8}, {"order": 3}, {"albedo": [0.2, 0.3, 0.4]}]
)
def test_a_chunk_of_another_scene_is_found(store: ChunkStore, tmp_path: Path, other: dict[str, Any]) -> None:
    strange = recipe_of(**other)
    stranger = ChunkStore(tmp_path / "other", strange)
    stranger.save(baked(strange, INNER, texels=500))
    with pytest.raises(DamagedChunkError):
        store.decode(INNER, stranger.read(INNER) or b"")


def test_texels_beyond_the_lattice_are_found(store: ChunkStore, recipe: Recipe) -> None:
    chunk = baked(recipe, EDGE)
    outside = Chunk(EDGE, np.array([TEXELS - 1], np.int32), chunk.light.rows(np.array([0])))
    store.save(Chunk.empty(EDGE, recipe.scene.plan))
    stored = np.ascontiguousarray(outside.block())
    with pytest.raises(DamagedChunkError, match="another place"):
        store.decode(EDGE, packed(stored))


def packed(block: np.ndarray) -> bytes:
    body = bytes(Zstd(1).encode(block))
    return body + google_crc32c.value(body).to_bytes(4, "little")


def test_an_object_that_unpacks_to_too_much_is_refused(store: ChunkStore) -> None:
    with pytest.raises(DamagedChunkError, match="unpack"):
        store.decode(INNER, packed(np.zeros(1 << 24, np.uint8)))


def test_void_texels_in_holes_are_at_home(tmp_path: Path) -> None:
    voxels = np.random.default_rng(0).random((20, 20, 20)).astype(np.float32)
    voxels[5:12, 5:12, 5:12] = np.nan
    nrrd.write(str(tmp_path / "holes.nrrd"), voxels, index_order="C")
    recipe = recipe_of(tmp_path / "holes.nrrd", lattice=1.0)
    store = ChunkStore(tmp_path / "light", recipe)
    chunk = baked(recipe, (0, 0, 0), texels=TEXELS)
    assert 0 < (chunk.light.samples == VOID).sum() < TEXELS
    store.save(chunk)
    assert_equal(store.load((0, 0, 0)), chunk)


def test_left_over_partial_files_are_ignored(store: ChunkStore, recipe: Recipe) -> None:
    chunk = baked(recipe, INNER)
    store.save(chunk)
    for index in (INNER, EDGE):
        file_of(store, index).parent.mkdir(parents=True, exist_ok=True)
        file_of(store, index).with_suffix(f".{uuid.uuid4().hex}.partial").write_bytes(b"half a chunk")
    assert store.read(EDGE) is None
    assert_equal(store.load(INNER), chunk)
    assert np.isnan(np.asarray(zarr.open_array(store.path, mode="r")[32:, 16:32, 32:])).all()


def test_a_deleted_folder_reads_as_absent_and_is_made_again(store: ChunkStore, recipe: Recipe) -> None:
    chunk = baked(recipe, INNER)
    store.save(chunk)
    shutil.rmtree(store.root)
    assert store.read(INNER) is None
    assert store.load(INNER).offsets.size == 0
    store.save(chunk)
    assert_equal(ChunkStore(store.root, recipe).load(INNER), chunk)
    assert not np.isnan(zarr.open_array(store.path, mode="r")[16:32, 16:32, 16:32]).all()


@pytest.mark.parametrize("text", ["", "{", '{"zarr_format": 3, "node_ty', "[]", "null", "\0\0\0", '{"zarr_format": 3}'])
def test_cut_metadata_is_told_in_one_sentence(store: ChunkStore, recipe: Recipe, text: str) -> None:
    store.save(baked(recipe, INNER))
    Path(store.path, "zarr.json").write_text(text)
    again = ChunkStore(store.root, recipe)
    for use in (lambda: again.array, lambda: again.read(INNER), lambda: again.save(baked(recipe, INNER))):
        with pytest.raises(StoreError) as caught:
            use()
        assert store.path in str(caught.value)
        assert str(caught.value).endswith("move that folder away, and the light is baked again.")
        assert "\n" not in str(caught.value)


def change(path: Path, *keys: str, to: Any) -> None:
    facts = json.loads(path.read_text())
    part = facts
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = to
    path.write_text(json.dumps(facts))


@pytest.mark.parametrize(
    ("keys", "to"),
    [
        (("shape",), [39, 39, 40, 15]),
        (("data_type",), "float64"),
        (("chunk_grid", "configuration", "chunk_shape"), [8, 16, 16, 15]),
        (("codecs",), [{"name": "bytes", "configuration": {"endian": "little"}}]),
        (("attributes",), {}),
        (("attributes", "isogi", "volume_digest"), "00"),
        (("node_type",), "group"),
    ],
)
def test_metadata_of_something_else_is_refused(
    store: ChunkStore, recipe: Recipe, keys: tuple[str, ...], to: Any
) -> None:
    store.save(baked(recipe, INNER))
    change(Path(store.path, "zarr.json"), *keys, to=to)
    with pytest.raises(StoreError, match="move that folder away"):
        ChunkStore(store.root, recipe).read(INNER)


@pytest.fixture
def sealed(recipe: Recipe) -> Iterator[Path]:
    """A store that this process may read and not write, with one chunk in it."""
    root = Path(tempfile.mkdtemp())
    ChunkStore(root, recipe).save(baked(recipe, INNER))
    folders = [path for path in (root, *root.rglob("*")) if path.is_dir()]
    for folder in folders:
        folder.chmod(0o555)
    was_root = os.geteuid() == 0
    if was_root:
        os.seteuid(NOBODY)
    yield root
    if was_root:
        os.seteuid(0)
    for folder in folders:
        folder.chmod(0o755)
    shutil.rmtree(root)


def test_a_store_that_cannot_be_written_is_read(sealed: Path, recipe: Recipe) -> None:
    store = ChunkStore(sealed, recipe)
    chunk = store.load(INNER)
    assert chunk.offsets.size == 40
    with pytest.raises(StoreError, match=r"Cannot write chunk \(2, 1, 2\) .*Permission denied"):
        store.save(Chunk.empty(EDGE, recipe.scene.plan))
    assert_equal(store.load(INNER), chunk)
    with pytest.raises(StoreError, match=r"Cannot make a place for light at .*Permission denied"):
        ChunkStore(sealed / "more", recipe).read(INNER)


def test_one_chunk_written_from_two_threads_is_always_whole(store: ChunkStore, recipe: Recipe) -> None:
    versions = [baked(recipe, EDGE, texels=300, seed=seed) for seed in (1, 2)]
    store.save(versions[0])

    def write(chunk: Chunk) -> None:
        for _ in range(60):
            store.save(chunk)

    writers = [threading.Thread(target=write, args=(chunk,)) for chunk in versions]
    for writer in writers:
        writer.start()
    seen = 0
    while any(writer.is_alive() for writer in writers):
        found = store.decode(EDGE, store.read(EDGE) or b"")
        assert any(np.array_equal(found.light.planes, chunk.light.planes) for chunk in versions)
        seen += 1
    assert seen > 1


def save_chunks(root: Path, indices: list[Index]) -> None:
    recipe = recipe_of()
    store = ChunkStore(root, recipe)
    for index in indices:
        store.save(baked(recipe, index, seed=sum(index)))


def test_two_processes_with_different_chunks_lose_none(tmp_path: Path, recipe: Recipe) -> None:
    indices = list(product(range(3), repeat=3))
    spawn = multiprocessing.get_context("spawn")
    writers = [spawn.Process(target=save_chunks, args=(tmp_path, indices[i::2])) for i in range(2)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
        assert writer.exitcode == 0
    store = ChunkStore(tmp_path, recipe)
    for index in indices:
        assert_equal(store.load(index), baked(recipe, index, seed=sum(index)))
    assert not list(tmp_path.rglob("*.partial"))
