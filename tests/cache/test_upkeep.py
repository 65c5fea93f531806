"""Looking after a store: audits, repair, census and pruning, what bakes cost, and claims of
bakers.
"""

import errno
import json
import logging
import os
import shutil
import threading
import time
import uuid
from collections.abc import Callable
from pathlib import Path

import google_crc32c
import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.texel_light import FIRST_LEVEL, VOID
from isogi_core.cache.chunk_record import Chunk, record_type
from isogi_core.cache.chunk_store import ChunkStore, UseStamps
from isogi_core.cache.costs import Cost, Costs
from isogi_core.cache.inventory import Claims
from isogi_core.cache.upkeep import (
    Audit,
    PruneRule,
    audit_store,
    census_of,
    delete_layers,
    plan_prune,
    repair_store,
)
from isogi_core.errors import StoreError
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoredObject
from isogi_core.storage.folder import Folder
from isogi_core.storage.store import Store, unwrap, wrap
from tests.cache.chunks import CONSTANT, TEXELS, assert_equal, baked, file_of, shown, spec_of
from tests.s3 import Call, Fault, S3Server
from tests.worker.clock import Clock

PLACES: tuple[Index, ...] = ((0, 1, 1), (1, 1, 1), (1, 2, 0), (2, 1, 2))
DIRECT = 0
INDIRECT = 1
DAY = 86400.0


@pytest.fixture(scope="module")
def chunks(spec: BakeSpec) -> list[Chunk]:
    return [baked(spec, index) for index in PLACES]


@pytest.fixture
def chunk_store(tmp_path: Path, spec: BakeSpec, chunks: list[Chunk]) -> ChunkStore:
    chunk_store = ChunkStore(tmp_path / "light", spec)
    for chunk in chunks:
        chunk_store.save(chunk)
    return chunk_store


def audit_of(chunk_store: ChunkStore) -> Audit:
    return audit_store(chunk_store.store)


def key_of(chunk_store: ChunkStore, index: Index, layer: int = DIRECT) -> str:
    return (
        file_of(chunk_store.layers[layer], index)
        .relative_to(chunk_store.store.url.folder)
        .as_posix()
    )


def contents(chunk_store: ChunkStore) -> dict[str, bytes]:
    """All files by their keys."""
    files = [path for path in chunk_store.store.url.folder.rglob("*") if path.is_file()]
    return {
        path.relative_to(chunk_store.store.url.folder).as_posix(): path.read_bytes()
        for path in files
    }


def put(chunk_store: ChunkStore, index: Index, field: str, value: float) -> None:
    """Fill a field of a record of direct light, and wrap it as if that was what was baked."""
    own = chunk_store.layers[DIRECT]
    record = unwrap(own.read(index) or b"", own.size).copy().view(record_type(own.layer, TEXELS))
    record[field] = value
    file_of(own, index).write_bytes(wrap(record.view(np.uint8)))


def age(path: Path, seconds: float) -> None:
    """Have a file written so long ago."""
    os.utime(path, (time.time() - seconds,) * 2)


# --- audit
# --------------------------------------------------------------------------------------------------


def test_a_sound_store_is_sound_and_is_left_as_it_is(chunk_store: ChunkStore) -> None:
    before = contents(chunk_store)
    heard: list[tuple[int, int]] = []
    found = audit_store(chunk_store.store, progress=lambda done, total: heard.append((done, total)))
    assert found.sound and (found.whole, found.unread, len(found.inventory.layers)) == (8, 0, 2)
    assert heard[0] == (0, 8) and heard[-1] == (8, 8)
    assert contents(chunk_store) == before


Damage = Callable[[ChunkStore, Path], object]
TEXT = b"light" + google_crc32c.value(b"light").to_bytes(4, "little")


def copy_of(index: Index, layer: int) -> Damage:
    """Another object in the place of one."""
    return lambda chunk_store, path: shutil.copy(file_of(chunk_store.layers[layer], index), path)


def packed(field: str, value: float) -> Damage:
    """A record with a field that is not as it was packed."""
    return lambda chunk_store, _: put(chunk_store, PLACES[0], field, value)


DAMAGES: dict[str, tuple[Damage, str]] = {
    "cut": (lambda _, path: path.write_bytes(path.read_bytes()[:-1]), "checksum"),
    "empty": (lambda _, path: path.write_bytes(b""), "checksum"),
    "whole, but text": (lambda _, path: path.write_bytes(TEXT), "unpack"),
    "of another place": (copy_of(PLACES[1], DIRECT), "another place"),
    "of another layer": (copy_of(PLACES[0], INDIRECT), "another place"),
    "to another scale": (packed("scale", 3.0), "scale"),
    "a rung too high": (packed("rung", 40), "number of samples"),
    "not finite": (packed("light", np.inf), "not finite"),
    "light from nowhere": (packed("light", 1.0), "without samples"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_each_damage_is_found_reported_and_moved(
    chunk_store: ChunkStore, chunks: list[Chunk], damage: str
) -> None:
    do, why = DAMAGES[damage]
    key = key_of(chunk_store, PLACES[0])
    path = file_of(chunk_store.layers[DIRECT], PLACES[0])
    do(chunk_store, path)
    content = path.read_bytes()
    audit = audit_of(chunk_store)
    assert [found.key for found in audit.damages] == [key] and why in audit.damages[0].why
    assert audit.whole == 7 and not audit.sound
    repair = repair_store(chunk_store.store)
    to = repair.moved[key]
    assert not path.exists() and to is not None and to.startswith(f"quarantine/{key}.")
    assert Path(chunk_store.store.url.folder, to).read_bytes() == content
    after = audit_of(chunk_store)
    assert after.sound and after.whole == 7 and len(after.inventory.quarantined) == 1
    chunk_store.save(chunks[0], [True, False])
    assert_equal(chunk_store.load(PLACES[0]), chunks[0])


@pytest.mark.parametrize("part", ["/c/", "/zarr.json"])
def test_a_damaged_answer_of_a_bucket_moves_nothing(
    s3: S3Server, spec: BakeSpec, chunks: list[Chunk], part: str
) -> None:
    chunk_store = ChunkStore(s3.url, spec)
    for chunk in chunks:
        chunk_store.save(chunk)
    before = dict(s3.objects)
    flipped: set[str] = set()

    def once(call: Call) -> Fault | None:
        """Flip a bit in the first answer with each object."""
        if part not in call.key or call.method != "GET" or call.key in flipped:
            return None
        flipped.add(call.key)
        return "flip"

    s3.fault = once
    repair = repair_store(Store(s3.url))
    assert flipped and repair.audit.sound and not repair.moved
    assert s3.objects == before


def test_layers_that_disagree_on_void_texels_are_both_moved(
    chunk_store: ChunkStore, chunks: list[Chunk]
) -> None:
    wrong = chunks[1].light.parts[INDIRECT].rows(np.arange(40))
    wrong.samples[7] = VOID
    wrong.coefficients[7] = 0.0
    wrong.noise[7] = 0.0
    chunk_store.layers[INDIRECT].save(PLACES[1], chunks[1].offsets, wrong)
    keys = {key_of(chunk_store, PLACES[1], layer) for layer in (DIRECT, INDIRECT)}
    assert {damage.key for damage in audit_of(chunk_store).damages} == keys
    assert set(repair_store(chunk_store.store, delete=True).moved.items()) == {
        (key, None) for key in keys
    }
    assert chunk_store.read(PLACES[1]) is None
    assert audit_of(chunk_store).sound and not list(chunk_store.store.url.folder.glob("quarantine"))


def test_a_part_that_was_not_written_yet_is_no_quarrel(
    chunk_store: ChunkStore, chunks: list[Chunk]
) -> None:
    """A kill between two layers: one has void texels, the other nothing of them yet."""
    void = chunks[2].light.parts[DIRECT].rows(np.arange(40))
    void.samples[:] = VOID
    void.coefficients[:] = 0.0
    void.noise[:] = 0.0
    chunk_store.layers[DIRECT].save(PLACES[2], chunks[2].offsets, void)
    file_of(chunk_store.layers[INDIRECT], PLACES[2]).unlink()
    assert audit_of(chunk_store).sound


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"zarr_format": 3}', "missing", "shape"])
def test_damaged_metadata_is_reported_and_its_light_is_kept(
    chunk_store: ChunkStore, chunks: list[Chunk], text: str
) -> None:
    file = Path(chunk_store.layers[INDIRECT].path, "zarr.json")
    facts = json.loads(file.read_text())
    file.write_text(json.dumps({**facts, "shape": [9, 9, 9, 9]}) if text == "shape" else text)
    if text == "missing":
        file.unlink()
    audit = audit_of(chunk_store)
    assert [damage.key for damage in audit.damages] == [
        f"{chunk_store.layers[INDIRECT].digest}/zarr.json"
    ]
    assert (audit.unread, audit.whole) == (4, 4)
    repair_store(chunk_store.store)
    again = ChunkStore(chunk_store.store, chunk_store.spec)
    again.open()
    for chunk in chunks:
        assert_equal(again.load(chunk.index), chunk)
    assert audit_of(chunk_store).sound


def test_an_object_outside_of_the_lattice_is_damage(chunk_store: ChunkStore) -> None:
    path = file_of(chunk_store.layers[DIRECT], (3, 1, 1))
    path.parent.mkdir(parents=True)
    shutil.copy(file_of(chunk_store.layers[DIRECT], PLACES[0]), path)
    assert [
        (found.key, "no such place" in found.why) for found in audit_of(chunk_store).damages
    ] == [(key_of(chunk_store, (3, 1, 1)), True)]


def test_old_leftovers_go_and_foreign_objects_stay(chunk_store: ChunkStore) -> None:
    folder = file_of(chunk_store.layers[DIRECT], PLACES[0]).parent
    store = chunk_store.store.url.folder
    old = folder / "0.12ab.partial"
    fresh = folder / "0.34cd.partial"
    probe = store / "probe.12ab.partial"
    claim = store / "claims" / f"{chunk_store.layers[DIRECT].digest}.1.1.1"
    claim.parent.mkdir()
    for path in (old, fresh, probe, claim, store / "notes.txt"):
        path.write_bytes(b"half")
    for path in (old, probe, claim):
        age(path, 70.0)
    age(fresh, 50.0)
    audit = audit_of(chunk_store)
    assert audit.sound and len(audit.inventory.leftovers) == 4
    assert [found.key for found in audit.inventory.foreign] == ["notes.txt"]
    removed = {found.key for found in repair_store(chunk_store.store).removed}
    assert removed == {path.relative_to(store).as_posix() for path in (old, probe, claim)}
    assert (
        not any(path.exists() for path in (old, probe, claim))
        and fresh.exists()
        and (store / "notes.txt").exists()
    )


# --- census and pruning
# -------------------------------------------------------------------------------------------


@pytest.fixture
def two(chunk_store: ChunkStore) -> ChunkStore:
    """The store, with light of another albedo besides, which shares the direct layer, and the costs
    of both.
    """
    other = ChunkStore(chunk_store.store, spec_of(albedo=0.5))
    other.save(baked(other.spec, PLACES[0]))
    for number, each in enumerate((chunk_store, other), 1):
        costs = Costs(chunk_store.store, each.spec.digest)
        costs.add(PLACES[0], Cost(float(number), 640, 40, 0.5))
        costs.save()
    for path in chunk_store.store.url.folder.rglob("*"):
        if path.is_file():
            age(path, (10 if other.layers[INDIRECT].digest in path.parts else 2) * DAY)
    return other


def test_the_census_tells_texels_and_costs(two: ChunkStore, chunk_store: ChunkStore) -> None:
    census = census_of(chunk_store.store)
    shared = chunk_store.layers[DIRECT].digest
    own = chunk_store.layers[INDIRECT].digest
    other = two.layers[INDIRECT].digest
    assert {digest: len(count.files.chunks) for digest, count in census.counts.items()} == {
        shared: 4,
        own: 4,
        other: 1,
    }
    assert [census.counts[own].lit, census.counts[own].paths, census.counts[other].lit] == [
        160,
        2560,
        40,
    ]
    assert {layers: cost.seconds for layers, cost in census.costs.items()} == {
        (shared, own): 1.0,
        (shared, other): 2.0,
    }
    assert not census_of(chunk_store.store, texels=False).counts[own].samples


def test_the_census_counts_void_texels_apart(tmp_path: Path) -> None:
    store = ChunkStore(tmp_path, spec_of())
    chunk = baked(store.spec, PLACES[0])
    for part in chunk.light.parts:
        part.samples[:7] = VOID
    store.save(chunk)
    counts = census_of(store.store).counts.values()
    assert [(count.lit, count.void) for count in counts] == [(33, 7), (33, 7)]


def test_the_census_tells_the_cost_of_a_single_layer(tmp_path: Path) -> None:
    store = ChunkStore(tmp_path, spec_of(lights=[CONSTANT]))
    store.save(baked(store.spec, PLACES[0]))
    costs = Costs(store.store, store.spec.digest)
    costs.add(PLACES[0], Cost(3.0, 640, 40, 0.5))
    costs.save()
    (layer,) = store.layers
    assert census_of(store.store).costs == {(layer.digest,): Cost(3.0, 640, 40, 0.5)}


def wanted(chunk_store: ChunkStore, rule: PruneRule) -> set[str]:
    """Digests of the layers that go."""
    return {
        count.files.digest
        for count in plan_prune(
            census_of(chunk_store.store, False), rule, chunk_store.store.now()
        ).going
    }


def test_what_is_pruned_is_what_was_asked_for(two: ChunkStore, chunk_store: ChunkStore) -> None:
    every = {layer.digest for layer in (*chunk_store.layers, *two.layers)}
    old = {two.layers[INDIRECT].digest}
    assert wanted(chunk_store, PruneRule(older_than=5 * DAY)) == old
    assert wanted(chunk_store, PruneRule(older_than=1 * DAY)) == every
    assert (
        wanted(chunk_store, PruneRule(older_than=20 * DAY))
        == wanted(chunk_store, PruneRule(scene="nobody"))
        == set()
    )
    assert wanted(chunk_store, PruneRule(scene="orbital")) == every
    size = sum(
        len(content)
        for key, content in contents(chunk_store).items()
        if not key.startswith(("costs", "isogi.json"))
    )
    assert wanted(chunk_store, PruneRule(keep=size)) == set()
    assert wanted(chunk_store, PruneRule(keep=size - 1)) == old
    assert wanted(chunk_store, PruneRule(keep=0)) == every
    assert wanted(chunk_store, PruneRule(empty=True)) == set()
    shutil.rmtree(Path(chunk_store.layers[INDIRECT].path, "c"))
    assert wanted(chunk_store, PruneRule(empty=True)) == {chunk_store.layers[INDIRECT].digest}


def test_pruning_deletes_layers_with_their_costs_alone(
    two: ChunkStore, chunk_store: ChunkStore
) -> None:
    census = census_of(chunk_store.store, False)
    before = contents(chunk_store)
    delete_layers(
        chunk_store.store,
        census,
        plan_prune(census, PruneRule(older_than=5 * DAY), chunk_store.store.now()),
    )
    gone = (two.layers[INDIRECT].digest, f"costs/{two.spec.digest}")
    assert contents(chunk_store) == {
        key: content for key, content in before.items() if not key.startswith(gone)
    }
    assert not Path(two.layers[INDIRECT].path).exists()
    assert audit_of(chunk_store).sound


def stamps_written(store: Store) -> int:
    """The writes to a store so far, once no stamp is under way."""
    for thread in threading.enumerate():
        if thread.name == "stamp":
            thread.join()
    return store.calls.count["put"]


def test_light_written_or_read_just_now_stays(two: ChunkStore, chunk_store: ChunkStore) -> None:
    old = two.layers[INDIRECT]
    age(file_of(old, PLACES[0]), 50.0)
    plan = plan_prune(
        census_of(chunk_store.store, False), PruneRule(scene="orbital"), chunk_store.store.now()
    )
    assert [count.files.digest for count in plan.busy] == [old.digest] and len(plan.going) == 2
    age(file_of(old, PLACES[0]), 70.0)
    plan = plan_prune(
        census_of(chunk_store.store, False), PruneRule(scene="orbital"), chunk_store.store.now()
    )
    assert not plan.busy and len(plan.going) == 3
    age(file_of(old, PLACES[0]), 10 * DAY)
    UseStamps(chunk_store.store, [old.digest]).touch()
    stamps_written(chunk_store.store)
    assert wanted(chunk_store, PruneRule(older_than=5 * DAY)) == set()


def test_light_is_stamped_when_it_is_shown_and_seldom_again(chunk_store: ChunkStore) -> None:
    now = [0.0]
    use = UseStamps(chunk_store.store, ["0" * 20], lambda: now[0])
    before = stamps_written(chunk_store.store)
    stamps = []
    for now[0] in (0.0, 60.0, 1700.0, 7300.0, 7360.0):
        use.touch()
        stamps.append(stamps_written(chunk_store.store) - before)
    assert stamps == [1, 1, 1, 2, 2]
    shown(chunk_store, PLACES[0])
    digests = {layer.digest for layer in chunk_store.layers}
    deadline = time.monotonic() + 60.0
    used = chunk_store.store.url.folder / "used"
    while not {path.name for path in used.iterdir()} >= digests:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_store_that_tells_no_ages_is_pruned_of_nothing(
    two: ChunkStore, chunk_store: ChunkStore
) -> None:
    census = census_of(chunk_store.store, False)
    for count in census.counts.values():
        count.files.chunks = {
            index: found._replace(written=float("nan"))
            for index, found in count.files.chunks.items()
        }
        count.files.metadata = None
    with pytest.raises(StoreError, match="does not know when"):
        plan_prune(census, PruneRule(older_than=DAY), 0.0)


# --- claims
# --------------------------------------------------------------------------------------------------


NAME = "0123456789abcdef0123.1.2.3"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path)
    store.open()
    return store


def someone(store: Store, clock: Clock | None = None) -> Claims:
    """Claims of a process that has met another."""
    claims = Claims(store, clock or Clock())
    claims.note_contention()
    return claims


def left(store: Store) -> list[str]:
    """The keys of all claims in the store."""
    return [found.key for found in store.entries() if found.key.startswith("claims/")]


def test_a_claim_stands_while_the_work_lasts_and_no_longer(store: Store) -> None:
    one, other = someone(store), someone(store)
    with one.on(NAME, "one") as ours:
        assert ours and left(store) == [f"claims/{NAME}"]
        with other.on(NAME, "other") as theirs:
            assert not theirs
        assert left(store) == [f"claims/{NAME}"]
        with other.on("another", "other") as theirs:
            assert theirs
    assert not left(store)
    with other.on(NAME, "other") as theirs:
        assert theirs


def test_a_claim_ends_with_work_that_fails(store: Store) -> None:
    with pytest.raises(ZeroDivisionError), someone(store).on(NAME, "one"):
        raise ZeroDivisionError
    assert not left(store)


def test_claims_end_a_while_after_the_last_contention(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    lonely = Claims(store, clock)
    met = someone(store, clock)
    clock.now += 70.0
    for asked in ("get", "put", "delete"):
        monkeypatch.setattr(Folder, asked, lambda *_: pytest.fail("the store was asked"))
    for claims in (lonely, met):
        with claims.on(NAME, "one") as ours:
            assert ours


def test_a_claim_that_stands_is_company(store: Store) -> None:
    clock = Clock()
    one, other = someone(store, clock), someone(store, clock)
    clock.now += 50.0
    with one.on(NAME, "one"), other.on(NAME, "other") as theirs:
        assert not theirs
    clock.now += 50.0
    with other.on(NAME, "other"):
        assert left(store)
    with one.on(NAME, "one"):
        assert not left(store)


def test_a_killed_bakers_claim_counts_until_another_insists(store: Store) -> None:
    killed = someone(store).on(NAME, "killed")
    killed.__enter__()
    other = someone(store)
    for insist in (False, True):
        with other.on(NAME, "other", insist) as theirs:
            assert theirs is insist
    assert not left(store)


def test_an_owner_takes_its_own_claim_over(store: Store) -> None:
    """The worker that had it died, and another of the same baker goes on at once."""
    dead = someone(store).on(NAME, "one")
    dead.__enter__()
    with someone(store).on(NAME, "one") as ours:
        assert ours
    assert not left(store)


def test_an_empty_owner_claims_nothing(store: Store) -> None:
    with someone(store).on(NAME, "") as ours:
        assert ours and not left(store)


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EIO])
def test_where_no_claim_can_be_made_the_work_goes_on(
    store: Store, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def fail(*_: object) -> None:
        raise OSError(number, "so it is")

    claims = someone(store)
    for asked in ("put", "delete"):
        monkeypatch.setattr(Folder, asked, fail)
    with claims.on(NAME, "one") as ours:
        assert ours


def test_of_two_that_insist_one_has_it(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody takes a claim over between another's look at it and that other's write."""
    killed = someone(store).on(NAME, "killed")
    killed.__enter__()

    def late(key: str) -> StoredObject | None:
        found = Store.get(store, key)
        store.put(key, b"third", found)
        return found

    monkeypatch.setattr(store, "get", late)
    with someone(store).on(NAME, "other", insist=True) as theirs:
        assert not theirs


def test_a_claim_that_ends_at_this_moment_is_free(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    killed = someone(store).on(NAME, "killed")
    killed.__enter__()
    monkeypatch.setattr(store, "get", store.delete)
    with someone(store).on(NAME, "other") as theirs:
        assert theirs


# --- costs
# --------------------------------------------------------------------------------------------------


GROUP = '{"zarr_format": 3, "node_type": "group", "attributes": %s}'


@pytest.fixture(params=["folder", "file://", "memory://"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    roots = {"folder": str(tmp_path / "light"), "file://": f"file://{tmp_path}/light"}
    return roots.get(request.param, f"memory://{uuid.uuid4().hex}")


def read(place: str | Path, digest: str = "digest") -> Costs:
    costs = Costs(place, digest)
    costs.read()
    return costs


def test_a_path_costs_its_chunks_rate_or_the_common_one(place: str) -> None:
    costs = read(place)
    assert costs.rate((0, 0, 0)) is None
    costs.add((0, 0, 1), Cost(8.0, 80, 5, 8.0))
    costs.add((0, 0, 2), Cost(4.0, 80, 5, 4.0))
    assert costs.rate((0, 0, 1)) == costs.rate((9, 9, 9)) == 0.05
    costs.add((0, 0, 1), Cost(3.0, 300, 0))
    assert costs.rate((0, 0, 1)) == costs.rate((0, 0, 2)) == pytest.approx(0.01)
    costs.add((0, 0, 2), Cost(40.0, 1000, 0))
    costs.add((0, 0, 3), Cost(98.0, 1016, 1, 8.0))
    costs.add((0, 0, 4), Cost(0.5, 0, 0))
    assert costs.rate((0, 0, 4)) == costs.rate((9, 9, 9)) == pytest.approx(0.04)
    assert costs.total == Cost(153.5, 2476, 11, 20.0)


def test_further_paths_cost_as_those_after_first_light() -> None:
    """Of 160 paths, 80 were the first light of 5 texels and took 2.5 of 4 seconds."""
    cost = Cost(4.0, 160, 5, 2.5)
    assert cost.ahead(160.0) == pytest.approx(3.0)
    assert cost.ahead(160.0 + 2 * FIRST_LEVEL, unlit=2) == pytest.approx(4.0)
    assert Cost(2.5, 80, 5, 2.5).ahead(160.0) == pytest.approx(5.0), "nothing else is known"
    assert Cost(2.0, 80).ahead(160.0 + 2 * FIRST_LEVEL, unlit=2) == pytest.approx(4.8)
    assert Cost().ahead(160.0) == 0.0
    assert Cost(9.0, 200, 5, 2.5).minus(cost) == Cost(5.0, 40, 0, 0.0)


def test_costs_are_known_after_a_restart(place: str) -> None:
    costs = read(place)
    costs.add((1, 20, 3), Cost(1.5, 100, 5, 0.1))
    costs.save()
    again = read(place)
    assert (again.rate((1, 20, 3)), again.total) == (pytest.approx(0.07), Cost(1.5, 100, 5, 0.1))
    assert read(place, "other").total == Cost()


def test_they_are_written_now_and_then(tmp_path: Path) -> None:
    now = 0.0
    costs = Costs(tmp_path, "digest", lambda: now)
    costs.save()
    costs.add((0, 0, 1), Cost(1.0, 100, 5, 0.5))
    costs.save(at_once=False)
    now = 15.0
    costs.save(at_once=False)
    assert not list(tmp_path.iterdir())
    now = 60.0
    costs.save(at_once=False)
    group = json.loads((tmp_path / "costs" / "digest" / "zarr.json").read_text())
    assert group["attributes"] == {"chunks": {"0/0/1": [1.0, 100, 5, 0.5]}}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        GROUP % "{}",
        *(
            GROUP % f'{{"chunks": {chunks}}}'
            for chunks in ("[]", '{"0/0": [1, 2, 3, 4]}', '{"0/0/1": [1]}')
        ),
    ],
)
def test_what_is_damaged_counts_as_unknown(tmp_path: Path, text: str) -> None:
    (tmp_path / "costs" / "digest").mkdir(parents=True)
    (tmp_path / "costs" / "digest" / "zarr.json").write_text(text)
    assert read(tmp_path).total == Cost()


def test_what_could_not_be_kept_is_logged_and_kept_later(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    now = 0.0
    place = tmp_path / "light"
    place.write_text("not a folder")
    costs = Costs(Store(place, clock=lambda: now), "digest", lambda: now)
    costs.read()
    costs.add((0, 0, 1), Cost(1.0, 100, 5, 0.5))
    with caplog.at_level(logging.WARNING, "isogi.cache"):
        costs.save()
    assert "The costs of baking cannot be stored" in caplog.text
    place.unlink()
    costs.save(at_once=False)
    assert not place.exists()
    now = 60.0
    costs.save(at_once=False)
    assert read(place).total == Cost(1.0, 100, 5, 0.5)


def test_the_common_rate_is_the_median_however_chunks_change() -> None:
    rng = np.random.default_rng(4)
    costs = Costs("memory://median", "digest")
    kept = {}
    for index in rng.integers(0, 9, 40):
        cost = Cost(float(rng.random()), int(rng.integers(1, 100)))
        costs.add((0, 0, int(index)), cost)
        kept[int(index)] = kept.get(int(index), Cost()).plus(cost)
        assert costs.rate((9, 9, 9)) == pytest.approx(
            np.median([each.rate for each in kept.values()])
        )
