"""A layer of light as a Zarr array: what it says of itself, who may read it, and what is done about damage."""

import json
import os
import shutil
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pytest
import zarr
from numcodecs.zstd import Zstd

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.layer import LayerStore
from isogi_core.cache.record import TEXELS
from isogi_core.errors import DamagedChunkError, StoreError
from tests.bake.texels import same
from tests.cache.chunks import CONSTANT, baked, file_of, look_of

INNER, EDGE = (1, 1, 1), (2, 1, 2)
NOBODY = 65534
DIRECT, INDIRECT = 0, 1


@pytest.fixture
def layer(tmp_path: Path, look: Look) -> LayerStore:
    """The store of indirect light: whose digest has all that any layer's has."""
    return layer_of(tmp_path, look)


def layer_of(root: str | Path, look: Look, number: int = INDIRECT) -> LayerStore:
    return LayerStore(root, look.recipe, look.plan.layers[number])


def save(layer: LayerStore, chunk: Chunk, number: int = INDIRECT) -> None:
    """Write one part of a chunk."""
    layer.save(chunk.index, chunk.offsets, chunk.light.parts[number])


def found(layer: LayerStore, chunk: Chunk, number: int = INDIRECT) -> bool:
    """Whether the store has the part of a chunk bit by bit."""
    offsets, part = layer.decode(chunk.index, layer.read(chunk.index) or b"")
    return np.array_equal(offsets, chunk.offsets) and same(Light((part,)), Light((chunk.light.parts[number],)))


# --- what it is ---------------------------------------------------------------------------------------------------


def test_the_metadata_keeps_the_promises(layer: LayerStore, look: Look) -> None:
    save(layer, baked(look, INNER))
    facts = json.loads(Path(layer.path, "zarr.json").read_text())
    assert (facts["zarr_format"], facts["node_type"], facts["data_type"]) == (3, "array", "uint8")
    assert [codec["name"] for codec in facts["codecs"]] == ["bytes", "zstd", "crc32c"]
    assert facts["chunk_key_encoding"] == {"name": "default", "configuration": {"separator": "/"}}
    size = layer.size
    assert facts["shape"] == [3, 3, 3, size]
    assert facts["chunk_grid"]["configuration"]["chunk_shape"] == [1, 1, 1, size]


def test_a_chunk_is_one_object_under_its_own_key(layer: LayerStore, look: Look) -> None:
    save(layer, baked(look, EDGE))
    files = {path.relative_to(layer.root).as_posix() for path in Path(layer.root).rglob("*") if path.is_file()}
    digest = look.recipe.scene.layer_digest(layer.layer)
    assert files == {f"{digest}/zarr.json", f"{digest}/c/2/1/2/0"}


def test_the_attributes_say_whose_light_it_is(tmp_path: Path, look: Look) -> None:
    scene = look.recipe.scene
    facts = [layer_of(tmp_path, look, number).array.attrs.asdict()["isogi"] for number in (DIRECT, INDIRECT)]
    for own, layer in zip(facts, look.plan.layers, strict=True):
        assert own["volume_digest"] == scene.volume.digest
        assert own["texels"] == [39, 39, 39] and own["step"] == look.recipe.step.tolist()
        assert {name: own[name] for name in vars(layer)} == vars(layer)
    assert [own["kind"] for own in facts] == ["direct", "indirect"]
    assert [own["albedo"] for own in facts] == [None, [0.7, 0.7, 0.7]]
    assert [own["bounces"] for own in facts] == [0, 1]


@pytest.mark.parametrize(
    "settings",
    [{}, {"precision": "single", "albedo": [0.2, 0.5, 0.8]}, {"precision": "bytes", "order": 4, "indirect_order": 3}],
)
def test_plain_numpy_reads_what_the_attributes_describe(tmp_path: Path, settings: dict[str, Any]) -> None:
    """A reader that has Zarr and NumPy and no isogi."""
    look = look_of(**settings)
    chunk = baked(look, EDGE, samples=64)
    layer = layer_of(tmp_path, look)
    save(layer, chunk)
    array = zarr.open_array(layer.path, mode="r")
    facts = array.attrs.asdict()["isogi"]
    kind = np.dtype([(name, code, tuple(shape)) for name, code, shape in facts["record"]])
    record = np.frombuffer(np.asarray(array[(*EDGE, slice(None))]).tobytes(), kind)[0]
    part = chunk.light.parts[INDIRECT]
    assert (record["bake"].decode(), record["index"].tolist()) == (layer.digest, list(EDGE))
    assert np.flatnonzero(record["rung"]).tolist() == chunk.offsets.tolist()
    codes, rungs = facts["codes"], record["rung"][chunk.offsets].astype(int)
    assert (rungs != codes["void"]).all()
    assert np.array_equal(codes["first_rung"] << (rungs - 1), part.samples)
    low, high = (record[name][:, :, chunk.offsets] for name in ("light", "high"))
    steps = (high & ~np.uint8(codes["negative"])).astype(np.float32) - 1.0
    size = np.where(high == 0, 0.0, 2.0 ** (-steps / codes["steps"]))
    signed = np.where(high & codes["negative"], -size, size)
    light = np.concatenate([low, signed], axis=1).astype(np.float32) * record["scale"]
    assert light.shape == (facts["channels"], facts["order"] ** 2, 40)
    np.testing.assert_allclose(np.moveaxis(light, -1, 0), part.coefficients, rtol=1e-6)
    assert high.any() == (facts["coarse"] is not None)
    quiet = record["noise"][:, chunk.offsets].T
    noise = codes["noisiest"] * record["scale"] * 2.0 ** (quiet / -codes["steps"])
    np.testing.assert_allclose(np.where(quiet == codes["silent"], 0.0, noise), part.noise, rtol=1e-6)


@pytest.mark.parametrize("index", [INNER, EDGE])
def test_empty_chunks_are_written_too(layer: LayerStore, look: Look, index: tuple[int, int, int]) -> None:
    for used in (layer, layer_of(layer.root, look)):
        save(used, Chunk.empty(index, look.plan))
        assert found(used, Chunk.empty(index, look.plan))
        file_of(used, index).unlink()
        assert used.read(index) is None


# --- damage -------------------------------------------------------------------------------------------------------

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
def test_damage_is_found_and_healed(layer: LayerStore, look: Look, damage: Damage, index: tuple[int, int, int]) -> None:
    save(layer, baked(look, index))
    whole = file_of(layer, index).read_bytes()
    file_of(layer, index).write_bytes(damage(whole))
    with pytest.raises(DamagedChunkError, match=r"is damaged: .*baked again\.$"):
        layer.decode(index, layer.read(index) or b"")
    save(layer, baked(look, index))
    assert file_of(layer, index).read_bytes() == whole


def test_every_single_flipped_bit_is_found(layer: LayerStore, look: Look) -> None:
    save(layer, baked(look, INNER, texels=4))
    whole = layer.read(INNER) or b""
    assert len(whole) > 100
    for bit in range(8 * len(whole)):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << (bit % 8)
        with pytest.raises(DamagedChunkError):
            layer.decode(INNER, bytes(flipped))


def test_an_object_under_another_chunks_key_is_refused(layer: LayerStore, look: Look) -> None:
    for index in (INNER, EDGE):
        save(layer, baked(look, index))
    a, b = (file_of(layer, index).read_bytes() for index in (INNER, EDGE))
    for index, stored in ((INNER, b), (EDGE, a)):
        file_of(layer, index).write_bytes(stored)
        with pytest.raises(DamagedChunkError, match="another place"):
            layer.decode(index, layer.read(index) or b"")


@pytest.mark.parametrize(
    "other",
    [
        {"target": "demo:casting"},
        {"lattice": 0.8},
        {"order": 3, "indirect_order": 3},
        {"albedo": 0.5},
        {"albedo": [0.2, 0.3, 0.4]},
        {"bounces": 2},
        {"precision": "single"},
        {"lights": [CONSTANT]},
    ],
)
def test_an_object_of_another_scene_is_refused(layer: LayerStore, tmp_path: Path, other: dict[str, Any]) -> None:
    strange = look_of(**other)
    stranger = layer_of(tmp_path / "other", strange, -1)
    save(stranger, baked(strange, INNER, texels=500), -1)
    with pytest.raises(DamagedChunkError):
        layer.decode(INNER, stranger.read(INNER) or b"")


def test_an_object_in_another_layers_folder_is_refused(layer: LayerStore, look: Look) -> None:
    """Direct and indirect light of the same scene, the same order and so the same number of bytes."""
    direct, chunk = layer_of(layer.root, look, DIRECT), baked(look, INNER)
    assert direct.size == layer.size
    save(direct, chunk, DIRECT)
    save(layer, chunk)
    shutil.copyfile(file_of(direct, INNER), file_of(layer, INNER))
    with pytest.raises(DamagedChunkError, match="another place"):
        layer.decode(INNER, layer.read(INNER) or b"")
    assert found(direct, chunk, DIRECT)


def packed(record: np.ndarray) -> bytes:
    """An object with a whole checksum."""
    body = bytes(Zstd(1).encode(record))
    return body + google_crc32c.value(body).to_bytes(4, "little")


@pytest.mark.parametrize("size", [0, 36, -1, 1 << 24])
def test_an_object_that_unpacks_to_another_size_is_refused(layer: LayerStore, look: Look, size: int) -> None:
    save(layer, baked(look, INNER))
    record = np.asarray(layer.array[(*INNER, slice(None))])
    assert layer.decode(INNER, packed(record))[0].size == 40
    with pytest.raises(DamagedChunkError, match="unpack"):
        layer.decode(INNER, packed(np.resize(record, size if size >= 0 else len(record) + size)))


def test_left_over_partial_files_are_ignored(layer: LayerStore, look: Look) -> None:
    chunk = baked(look, INNER)
    save(layer, chunk)
    for index in (INNER, EDGE):
        file_of(layer, index).parent.mkdir(parents=True, exist_ok=True)
        file_of(layer, index).with_suffix(f".{uuid.uuid4().hex}.partial").write_bytes(b"half a chunk")
    assert layer.read(EDGE) is None
    assert found(layer, chunk)


# --- metadata -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["", "{", '{"zarr_format": 3, "node_ty', "[]", "null", "\0\0\0", '{"zarr_format": 3}'])
def test_cut_metadata_is_told_in_one_sentence(layer: LayerStore, look: Look, text: str) -> None:
    save(layer, baked(look, INNER))
    Path(layer.path, "zarr.json").write_text(text)
    again = layer_of(layer.root, look)
    for use in (lambda: again.array, lambda: again.read(INNER), lambda: save(again, baked(look, INNER))):
        with pytest.raises(StoreError) as caught:
            use()
        assert layer.path in str(caught.value)
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
        (("data_type",), "int8"),
        (("chunk_grid", "configuration", "chunk_shape"), [1, 1, 1, 15]),
        (("codecs",), [{"name": "bytes", "configuration": {"endian": "little"}}]),
        (("attributes",), {}),
        (("attributes", "isogi", "volume_digest"), "00"),
        (("node_type",), "group"),
    ],
)
def test_metadata_of_something_else_is_refused(layer: LayerStore, look: Look, keys: tuple[str, ...], to: Any) -> None:
    save(layer, baked(look, INNER))
    change(Path(layer.path, "zarr.json"), *keys, to=to)
    with pytest.raises(StoreError, match="move that folder away"):
        layer_of(layer.root, look).read(INNER)


def test_a_deleted_folder_reads_as_absent_and_is_made_again(layer: LayerStore, look: Look) -> None:
    chunk = baked(look, INNER)
    save(layer, chunk)
    shutil.rmtree(layer.root)
    assert layer.read(INNER) is None
    save(layer, chunk)
    assert found(layer_of(layer.root, look), chunk)


# --- who may write, and who writes at once ------------------------------------------------------------------------


@pytest.fixture
def sealed(look: Look) -> Iterator[Path]:
    """A store that this process may read and not write, with one chunk in it."""
    root = Path(tempfile.mkdtemp())
    save(layer_of(root, look), baked(look, INNER))
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


def test_a_store_that_cannot_be_written_is_read(sealed: Path, look: Look) -> None:
    layer, chunk = layer_of(sealed, look), baked(look, INNER)
    assert found(layer, chunk)
    with pytest.raises(StoreError, match=r"Cannot write chunk \(2, 1, 2\) .*Permission denied"):
        save(layer, Chunk.empty(EDGE, look.plan))
    assert found(layer, chunk)
    with pytest.raises(StoreError, match=r"Cannot make a place for light at .*Permission denied"):
        layer_of(sealed / "more", look).read(INNER)


def test_one_chunk_written_from_two_threads_is_always_whole(layer: LayerStore, look: Look) -> None:
    versions = [baked(look, EDGE, texels=300, seed=seed) for seed in (1, 2)]
    save(layer, versions[0])

    def write(chunk: Chunk) -> None:
        for _ in range(60):
            save(layer, chunk)

    writers = [threading.Thread(target=write, args=(chunk,)) for chunk in versions]
    for writer in writers:
        writer.start()
    seen = 0
    while any(writer.is_alive() for writer in writers):
        _, part = layer.decode(EDGE, layer.read(EDGE) or b"")
        assert any(same(Light((part,)), Light((chunk.light.parts[INDIRECT],))) for chunk in versions)
        seen += 1
    assert seen > 1


def test_one_record_holds_a_whole_chunk(layer: LayerStore, look: Look) -> None:
    part = Part.dark(look.plan.layers[INDIRECT], TEXELS)
    part.samples[:] = 1 << 20
    part.coefficients[:] = np.random.default_rng(1).random(part.coefficients.shape, np.float32).astype(np.float16)
    layer.save(INNER, np.arange(TEXELS, dtype=np.int32), part)
    offsets, again = layer.decode(INNER, layer.read(INNER) or b"")
    assert len(offsets) == TEXELS and same(Light((again,)), Light((part,)))
