"""A layer of light as a Zarr array: what it says of itself, who may read it, and what is done about
damage.
"""

import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import pytest
import zarr
from numcodecs.zstd import Zstd

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.texel_light import VOID, Light, Part
from isogi_core.cache.chunk_record import Chunk, facts_in
from isogi_core.cache.layer import LayerStore, merge_parts
from isogi_core.errors import DamagedChunkError, StoreError, StoreReadOnlyError
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoredObject, StoreUrl
from tests.bake.texels import same
from tests.cache.chunks import TEXELS, baked, file_of, spec_of
from tests.s3 import S3Server

INNER = (1, 1, 1)
EDGE = (2, 1, 2)
NOBODY = 65534
DIRECT = 0
INDIRECT = 1


@pytest.fixture
def layer(tmp_path: Path, spec: BakeSpec) -> LayerStore:
    """The store of indirect light: whose digest has all that any layer's has."""
    return layer_of(tmp_path, spec)


def layer_of(store: str | Path, spec: BakeSpec, number: int = INDIRECT) -> LayerStore:
    return LayerStore(store, spec.prepared, spec.plan.layers[number])


def save(layer: LayerStore, chunk: Chunk, number: int = INDIRECT) -> None:
    """Write one part of a chunk."""
    layer.save(chunk.index, chunk.offsets, chunk.light.parts[number])


def found(layer: LayerStore, chunk: Chunk, number: int = INDIRECT) -> bool:
    """Whether the store has the part of a chunk bit by bit."""
    offsets, part = layer.decode(chunk.index, layer.read(chunk.index) or b"")
    return np.array_equal(offsets, chunk.offsets) and same(
        Light((part,)), Light((chunk.light.parts[number],))
    )


# --- what it is
# --------------------------------------------------------------------------------------------------


def test_the_metadata_keeps_the_promises(layer: LayerStore, spec: BakeSpec) -> None:
    save(layer, baked(spec, INNER))
    facts = json.loads(Path(layer.path, "zarr.json").read_text())
    assert (facts["zarr_format"], facts["node_type"], facts["data_type"]) == (3, "array", "uint8")
    assert [codec["name"] for codec in facts["codecs"]] == ["bytes", "zstd", "crc32c"]
    assert facts["chunk_key_encoding"] == {"name": "default", "configuration": {"separator": "/"}}
    size = layer.size
    assert facts["shape"] == [3, 3, 3, size]
    assert facts["chunk_grid"]["configuration"]["chunk_shape"] == [1, 1, 1, size]


def test_a_layer_of_several_albedos_is_read_as_it_was_written(tmp_path: Path) -> None:
    spec = spec_of(albedo=0.3, albedos=(0.0, 0.9))
    layer = layer_of(tmp_path, spec)
    save(layer, baked(spec, INNER))
    metadata = Path(layer.path, "zarr.json").read_bytes()
    assert facts_in(metadata).layer == spec.plan.layers[INDIRECT] and spec.plan.nodes
    assert json.loads(metadata)["attributes"]["isogi"]["albedo"] == list(spec.plan.nodes)
    fixed = layer_of(tmp_path, spec, DIRECT)
    save(fixed, baked(spec, INNER), DIRECT)
    older = json.loads(Path(fixed.path, "zarr.json").read_bytes())
    del older["attributes"]["isogi"]["nodes"]
    assert facts_in(json.dumps(older).encode()).layer == spec.plan.layers[DIRECT], (
        "as it was before there were any"
    )


def test_a_chunk_is_one_object_under_its_own_key(layer: LayerStore, spec: BakeSpec) -> None:
    save(layer, baked(spec, EDGE))
    store = layer.store.url.folder
    digest = spec.prepared.scene.layer_digest(layer.layer)
    files = {path.relative_to(store).as_posix() for path in store.rglob("*") if path.is_file()}
    assert files == {"isogi.json", f"{digest}/zarr.json", f"{digest}/c/2/1/2/0"}
    assert sorted(layer.store.keys(digest)) == [f"{digest}/c/2/1/2/0", f"{digest}/zarr.json"]
    assert layer.store.layers() == [digest]


def test_the_attributes_say_whose_light_it_is(tmp_path: Path, spec: BakeSpec) -> None:
    scene = spec.prepared.scene
    facts = [
        layer_of(tmp_path, spec, number).array.attrs.asdict()["isogi"]
        for number in (DIRECT, INDIRECT)
    ]
    for own, layer in zip(facts, spec.plan.layers, strict=True):
        assert own["volume_digest"] == scene.volume.digest
        assert own["texels"] == [39, 39, 39] and own["step"] == spec.prepared.step.tolist()
        assert {name: own[name] for name in vars(layer)} == {**vars(layer), "nodes": []}
    assert [own["kind"] for own in facts] == ["direct", "indirect"]
    assert [own["albedo"] for own in facts] == [None, [0.7, 0.7, 0.7]]
    assert [own["bounces"] for own in facts] == [0, 1]


@pytest.mark.parametrize("chunk", [8, 32])
def test_light_in_chunks_of_another_size_lies_elsewhere(
    tmp_path: Path, spec: BakeSpec, chunk: int
) -> None:
    other = spec_of(chunk=chunk)
    layer = layer_of(tmp_path, other)
    baked_one = baked(other, (1, 0, 1))
    save(layer, baked_one)
    assert found(layer, baked_one) and layer.path != layer_of(tmp_path, spec).path
    assert layer.array.shape == (*[-(-39 // chunk)] * 3, layer.size)
    assert layer.array.attrs.asdict()["isogi"]["chunk"] == chunk


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"precision": "single", "albedo": [0.2, 0.5, 0.8]},
        {"precision": "bytes", "order": 4, "indirect_order": 3},
    ],
)
def test_plain_numpy_reads_what_the_attributes_describe(
    tmp_path: Path, settings: dict[str, Any]
) -> None:
    """A reader that has Zarr and NumPy and no isogi."""
    spec = spec_of(**settings)
    chunk = baked(spec, EDGE, samples=64)
    layer = layer_of(tmp_path, spec)
    save(layer, chunk)
    array = zarr.open_array(layer.path, mode="r")
    facts = array.attrs.asdict()["isogi"]
    kind = np.dtype([(name, code, tuple(shape)) for name, code, shape in facts["record"]])
    record = np.frombuffer(np.asarray(array[(*EDGE, slice(None))]).tobytes(), kind)[0]
    part = chunk.light.parts[INDIRECT]
    assert (record["bake"].decode(), record["index"].tolist()) == (layer.digest, list(EDGE))
    assert np.flatnonzero(record["rung"]).tolist() == chunk.offsets.tolist()
    codes = facts["codes"]
    rungs = record["rung"][chunk.offsets].astype(int)
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
    np.testing.assert_allclose(
        np.where(quiet == codes["silent"], 0.0, noise), part.noise, rtol=1e-6
    )


@pytest.mark.parametrize("index", [INNER, EDGE])
def test_empty_chunks_are_written_too(
    layer: LayerStore, spec: BakeSpec, index: tuple[int, int, int]
) -> None:
    for used in (layer, layer_of(layer.store.url, spec)):
        save(used, Chunk.empty(index, spec.plan))
        assert found(used, Chunk.empty(index, spec.plan))
        file_of(used, index).unlink()
        assert used.read(index) is None


# --- damage
# --------------------------------------------------------------------------------------------------

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
def test_damage_is_found_and_healed(
    layer: LayerStore, spec: BakeSpec, damage: Damage, index: tuple[int, int, int]
) -> None:
    save(layer, baked(spec, index))
    whole = file_of(layer, index).read_bytes()
    file_of(layer, index).write_bytes(damage(whole))
    with pytest.raises(DamagedChunkError, match=r"is damaged: .*baked again\.$"):
        layer.decode(index, layer.read(index) or b"")
    save(layer, baked(spec, index))
    assert file_of(layer, index).read_bytes() == whole


def test_an_object_under_another_chunks_key_is_refused(layer: LayerStore, spec: BakeSpec) -> None:
    for index in (INNER, EDGE):
        save(layer, baked(spec, index))
    a, b = (file_of(layer, index).read_bytes() for index in (INNER, EDGE))
    for index, stored in ((INNER, b), (EDGE, a)):
        file_of(layer, index).write_bytes(stored)
        with pytest.raises(DamagedChunkError, match="another place"):
            layer.decode(index, layer.read(index) or b"")


# --- many at once
# -------------------------------------------------------------------------------------------------

MANY: tuple[Index, ...] = (INNER, EDGE, (0, 0, 0), (0, 1, 2), (1, 0, 0))


def decoded(
    layer: LayerStore, stored: list[bytes | None]
) -> tuple[list[tuple[Index, np.ndarray, Part]], list[str]]:
    """What is found in objects of MANY together, chunk by chunk, and what is told of them."""
    raised: list[str] = []
    places, part = layer.decode_all(MANY, stored, lambda error: raised.append(str(error)))
    assert places.dtype == np.int32 and (np.diff(places) > 0).all()
    number, offset = np.divmod(places, TEXELS)
    return [
        (MANY[i], offset[number == i], part.rows(number == i)) for i in range(len(MANY))
    ], raised


@pytest.mark.parametrize("number", [DIRECT, INDIRECT])
@pytest.mark.parametrize("absent", [(), (0,), (4,), (1, 2), range(5)])
def test_many_chunks_are_decoded_as_each_alone(
    tmp_path: Path, spec: BakeSpec, absent: Sequence[int], number: int
) -> None:
    layer = layer_of(tmp_path, spec, number)
    for i, index in enumerate(MANY):
        save(layer, baked(spec, index, texels=30 + i, seed=i), number)
    found, raised = decoded(
        layer, [None if i in absent else layer.read(index) for i, index in enumerate(MANY)]
    )
    assert not raised
    for i, (index, offsets, part) in enumerate(found):
        alone, own = layer.decode(index, layer.read(index) or b"")
        assert np.array_equal(offsets, [] if i in absent else alone)
        assert same(Light((part,)), Light((own.rows(np.arange(0 if i in absent else len(alone))),)))


@pytest.mark.parametrize("damaged", [(0,), (4,), (1, 3), range(5)])
@pytest.mark.parametrize(
    "damage", [*DAMAGES.values(), "shorter", "another's"], ids=[*DAMAGES, "shorter", "another's"]
)
def test_damaged_chunks_among_many_are_reported_and_left_out(
    layer: LayerStore, spec: BakeSpec, damage: Damage | str, damaged: Sequence[int]
) -> None:
    for i, index in enumerate(MANY):
        save(layer, baked(spec, index, texels=30 + i, seed=i))
    whole = [layer.read(index) or b"" for index in MANY]
    stored: list[bytes | None] = [*whole]
    for i in damaged:
        if damage == "shorter":
            stored[i] = packed(
                np.asarray(zarr.open_array(layer.path, mode="r")[(*MANY[i], slice(None))])[:-10]
            )
        elif isinstance(damage, str):
            stored[i] = whole[i - 1]
        else:
            stored[i] = damage(whole[i])
    found, raised = decoded(layer, stored)
    assert [str(MANY[i]) in why for i, why in zip(damaged, raised, strict=True)]
    for i, (index, offsets, part) in enumerate(found):
        alone, own = layer.decode(index, whole[i])
        assert np.array_equal(offsets, [] if i in damaged else alone)
        assert same(
            Light((part,)), Light((own.rows(np.arange(0 if i in damaged else len(alone))),))
        )


def packed(record: np.ndarray) -> bytes:
    """An object with a whole checksum."""
    body = bytes(Zstd(1).encode(record))
    return body + google_crc32c.value(body).to_bytes(4, "little")


def test_left_over_partial_files_are_ignored(layer: LayerStore, spec: BakeSpec) -> None:
    chunk = baked(spec, INNER)
    save(layer, chunk)
    for index in (INNER, EDGE):
        file_of(layer, index).parent.mkdir(parents=True, exist_ok=True)
        file_of(layer, index).with_suffix(f".{uuid.uuid4().hex}.partial").write_bytes(
            b"half a chunk"
        )
    assert layer.read(EDGE) is None
    assert found(layer, chunk)


# --- metadata
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["", "{", '{"zarr_format": 3, "node_ty', "[]", "null", "\0\0\0", '{"zarr_format": 3}']
)
def test_cut_metadata_is_refused_in_one_sentence(
    layer: LayerStore, spec: BakeSpec, text: str
) -> None:
    save(layer, baked(spec, INNER))
    Path(layer.path, "zarr.json").write_text(text)
    again = layer_of(layer.store.url, spec)
    for use in (
        lambda: again.array,
        lambda: again.read(INNER),
        lambda: save(again, baked(spec, INNER)),
    ):
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
def test_metadata_of_something_else_is_refused(
    layer: LayerStore, spec: BakeSpec, keys: tuple[str, ...], to: Any
) -> None:
    save(layer, baked(spec, INNER))
    change(Path(layer.path, "zarr.json"), *keys, to=to)
    with pytest.raises(StoreError, match="move that folder away"):
        layer_of(layer.store.url, spec).read(INNER)


# --- who may write, and who writes at once
# ------------------------------------------------------------------------


@pytest.fixture
def sealed(spec: BakeSpec) -> Iterator[Path]:
    """A store that this process may read and not write, with one chunk in it."""
    store = Path(tempfile.mkdtemp())
    save(layer_of(store, spec), baked(spec, INNER))
    folders = [path for path in (store, *store.rglob("*")) if path.is_dir()]
    for folder in folders:
        folder.chmod(0o555)
    was_root = os.geteuid() == 0
    if was_root:
        os.seteuid(NOBODY)
    yield store
    if was_root:
        os.seteuid(0)
    for folder in folders:
        folder.chmod(0o755)
    shutil.rmtree(store)


def test_a_store_that_cannot_be_written_is_read(sealed: Path, spec: BakeSpec) -> None:
    layer = layer_of(sealed, spec)
    chunk = baked(spec, INNER)
    assert found(layer, chunk)
    with pytest.raises(StoreError, match=r"Cannot write .*/c/2/1/2/0 .*Permission denied"):
        save(layer, Chunk.empty(EDGE, spec.plan))
    assert found(layer, chunk)
    more = layer_of(sealed / "more", spec)
    assert more.read(INNER) is None and more.store.read_only
    with pytest.raises(StoreReadOnlyError, match="can only be read"):
        save(more, chunk)


@pytest.fixture(params=["folder", "s3"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> StoreUrl:
    """Where many write: on the disk and in a bucket."""
    if request.param == "folder":
        return StoreUrl(str(tmp_path))
    return StoreUrl(request.getfixturevalue("s3").url, seconds=2.0, retries=1)


@pytest.mark.parametrize("stale", [16, 64])
def test_two_writers_do_not_undo_each_other(place: StoreUrl, spec: BakeSpec, stale: int) -> None:
    """One reads, the other writes more samples and other texels, and the first writes after
    that.
    """
    mine = baked(spec, EDGE, samples=stale)
    theirs = baked(spec, EDGE, texels=60, seed=1, samples=32)
    slow, quick = (LayerStore(place, spec.prepared, spec.plan.layers[INDIRECT]) for _ in range(2))
    save(slow, baked(spec, EDGE))
    get = slow.store.get
    late = [theirs]

    def get_and_wait(key: str) -> StoredObject | None:
        read = get(key)
        if late and "/c/" in key:
            save(quick, late.pop())
        return read

    slow.store.get = get_and_wait  # type: ignore[method-assign]
    save(slow, mine)
    offsets, part = slow.decode(EDGE, slow.read(EDGE) or b"")
    assert np.array_equal(offsets, np.union1d(mine.offsets, theirs.offsets))
    for chunk in (mine, theirs):
        own = chunk.light.parts[INDIRECT]
        rows = np.searchsorted(offsets, chunk.offsets)
        assert (part.samples[rows] >= own.samples).all()
        kept = part.samples[rows] == own.samples
        assert same(Light((part.rows(rows[kept]),)), Light((own.rows(kept),))) and kept.any()


def test_light_that_is_there_already_is_not_written(
    place: StoreUrl, spec: BakeSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    layer = LayerStore(place, spec.prepared, spec.plan.layers[INDIRECT])
    save(layer, baked(spec, EDGE, samples=64))
    monkeypatch.setattr(layer.store, "put", lambda *_: pytest.fail("the store was written"))
    save(layer, baked(spec, EDGE, samples=16))


def test_a_write_whose_answer_was_lost_has_been_done(s3: S3Server, spec: BakeSpec) -> None:
    layer = layer_of(s3.url, spec)
    chunk = baked(spec, EDGE)
    layer.open()
    faults = iter(["lost"])
    s3.fault = lambda call: next(faults, None) if call.method == "PUT" else None  # type: ignore[return-value]
    save(layer, chunk)
    assert found(layer, chunk)


def test_void_texels_stay_void_whoever_comes_last(spec: BakeSpec) -> None:
    part, other = (Part.dark(spec.plan.layers[INDIRECT], 3) for _ in range(2))
    part.samples[:] = (VOID, 16, 16)
    other.samples[:] = (32, VOID, 8)
    ours = np.array([1, 2, 3], np.int32)
    theirs = np.array([1, 2, 4], np.int32)
    for first, second in (((ours, part), (theirs, other)), ((theirs, other), (ours, part))):
        offsets, both = merge_parts(*first, *second)
        assert (offsets.tolist(), both.samples.tolist()) == ([1, 2, 3, 4], [VOID, VOID, 16, 8])


def test_a_writer_keeps_light_whose_answer_was_damaged(s3: S3Server, spec: BakeSpec) -> None:
    """It reads the former light again, and does not write its few samples in the place of many."""
    layer = layer_of(s3.url, spec)
    better = baked(spec, EDGE, samples=64)
    save(layer, better)
    left = iter(["flip"])
    s3.fault = lambda call: next(left, None) if "/c/" in call.key else None  # type: ignore[return-value]
    save(layer, baked(spec, EDGE, samples=16))
    s3.fault = lambda _: None
    assert found(layer, better)
