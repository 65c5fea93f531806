import asyncio
import pickle
import shutil
import threading
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec, spec_for
from isogi_core.bake.noise import Effort, Goal, finished, relative_error, standard_error
from isogi_core.bake.refine import locate
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.scene_assets import send_assets
from isogi_core.errors import SceneError, StoreAwayError, VolumeError
from isogi_core.kernels.transport.transfer import bake_irradiance, bake_texels, locate_texels
from isogi_core.model.scene_plan import most_samples
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared import prepared_scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.prepared.shared_scenes import SharedScenes
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from isogi_worker import tasks
from isogi_worker.tasks import (
    BAKED_ELSEWHERE,
    OPEN,
    BakeResult,
    BakeTask,
    bake,
    bake_all,
    bake_kernels,
    claims_of,
    dask_setup,
    open_spec,
    opened,
    sample_texels,
)

INDEX = (1, 1, 2)
UNTIL = most_samples(0.05)
TEXELS = np.arange(5, 3000, 41, dtype=np.int32)
TEXELS = TEXELS[TEXELS % 16 < 7]  # the last chunk along x is 7 texels wide
SEEN = np.ones(len(TEXELS), np.float32)
SCENE = load_scene("demo:orbital", order=2, lattice=0.4, bounces=2, target_error=0.05)
SPEC = spec_for(PreparedScene(SCENE), "gi")
VICINITY = spec_for(PreparedScene(SCENE), "vicinity")


def made(root: Path) -> StoreUrl:
    """The place of a store that a server has made."""
    Store(root).open()
    return StoreUrl(str(root))


def task(
    root: Path,
    texels: np.ndarray = TEXELS,
    until: int = UNTIL,
    target: float = 0.05,
    spec: BakeSpec = SPEC,
    **more: Any,
) -> BakeTask:
    """A task for a chunk, all of whose texels are seen alike."""
    seen = np.ones(len(texels), np.float32)
    what = SCENE.source, spec.plan, spec.digest, made(root), INDEX, texels, seen
    return BakeTask(*what, until, Goal(target), **more)


def do(root: Path, texels: np.ndarray = TEXELS, **more: Any) -> BakeResult:
    return bake(task(root, texels, **more))


def store_of(root: Path) -> ChunkStore:
    return open_spec(SCENE.source, SPEC.plan, SPEC.digest, made(root))[1]


def stored(root: Path) -> list[bytes | None]:
    """The chunk's object in each layer."""
    return [layer.read(INDEX) for layer in store_of(root).layers]


def test_a_worker_keeps_specs_of_several_scenes_open(tmp_path: Path) -> None:
    first = store_of(tmp_path / "0")
    for number in range(1, 16):
        store_of(tmp_path / str(number))
    assert store_of(tmp_path / "0") is first


def test_a_spec_that_was_prepared_is_that_of_tasks(tmp_path: Path) -> None:
    """Whether or not a caller says that there are no assets."""
    place = (SCENE.source, SPEC.plan, SPEC.digest, made(tmp_path))
    first = open_spec(*place)
    assert open_spec(*place, None) is first
    assert open_spec(*place, None, None) is first
    assert open_spec(*place, shown=None) is first


def test_a_task_leaves_light_of_just_its_texels(tmp_path: Path) -> None:
    result = do(tmp_path, until=16)
    chunk = store_of(tmp_path).load(INDEX)
    np.testing.assert_array_equal(chunk.offsets, TEXELS)
    assert [set(part.samples.tolist()) for part in chunk.light.parts] == [{16}, {16}]
    waiting = ~finished(chunk.light, store_of(tmp_path).spec, Goal(0.05))
    error = relative_error(chunk.light, store_of(tmp_path).spec)[waiting]
    assert result.unfinished == waiting.sum() > 0
    noise = standard_error(chunk.light, store_of(tmp_path).spec)[waiting]
    assert result.priority == pytest.approx((noise**2).mean() / 16)
    assert result.effort == Effort.of(error, np.full(len(error), 16), Goal(0.05))
    assert (result.cost.paths, result.cost.texels) == (16 * len(TEXELS), len(TEXELS))
    assert result.cost.seconds == result.cost.first > 0.0


def test_a_finished_task_says_so(tmp_path: Path) -> None:
    target = 0.03
    result = do(tmp_path, target=target)
    assert (result.unfinished, result.priority, result.effort) == (0, 0.0, Effort(0, 0.0, 0.0))
    chunk = store_of(tmp_path).load(INDEX)
    assert result.cost.paths == chunk.light.samples[~chunk.light.void].sum()
    assert do(tmp_path, target=target).cost[1:] == (0, 0, 0.0)
    assert finished(chunk.light, store_of(tmp_path).spec, Goal(target)).all()
    assert all(len(set(part.samples.tolist())) > 1 for part in chunk.light.parts)


def test_a_layer_that_takes_no_samples_is_not_written_again(tmp_path: Path) -> None:
    do(tmp_path, until=64)
    before = stored(tmp_path)
    do(tmp_path, until=256, target=1e-4, spec=VICINITY)
    ahead = stored(tmp_path)
    assert [now == old for now, old in zip(ahead, before, strict=True)] == [False, True]
    do(tmp_path, until=256, target=1e-4)
    assert [now == old for now, old in zip(stored(tmp_path), ahead, strict=True)] == [True, False]
    do(tmp_path / "together", until=256, target=1e-4)
    assert stored(tmp_path) == stored(tmp_path / "together")


def test_the_same_task_leaves_the_same_bytes(tmp_path: Path) -> None:
    do(tmp_path / "a")
    assert not do(tmp_path / "b").duplicate
    assert stored(tmp_path / "a") == stored(tmp_path / "b")
    again = do(tmp_path / "b")
    assert (again.healed, again.duplicate) == (False, True)
    assert stored(tmp_path / "a") == stored(tmp_path / "b")


def test_chunks_baked_together_have_the_bytes_of_single_ones(tmp_path: Path) -> None:
    """Texels of one chunk are far more visible than those of the other, and one of them has light
    already.
    """
    for root, together in ((tmp_path / "a", False), (tmp_path / "b", True)):
        do(root, TEXELS[::2], until=32)
        what = SCENE.source, SPEC.plan, SPEC.digest, made(root)
        wanted = [(INDEX, TEXELS, SEEN), ((1, 1, 1), TEXELS[::3], 100.0 * SEEN[::3])]
        tasks = [BakeTask(*what, *each, 256, Goal(0.01)) for each in wanted]
        if together:
            results = bake_all(tasks)
        else:
            results = [bake(task) for task in tasks]
        assert all(isinstance(result, BakeResult) and result.cost.paths for result in results)
    paths = [path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("c/*/*/*/0")]
    assert len(paths) == 2 * len(SPEC.plan.layers)
    assert all(
        (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()
        for path in paths
    )


def test_a_chunk_that_fails_harms_none_beside_it(tmp_path: Path) -> None:
    whole = task(tmp_path, until=16)
    sound, broken = bake_all([whole, replace(whole, index=(1, 1))])
    assert isinstance(sound, BakeResult) and sound.cost.paths == 16 * len(TEXELS)
    assert isinstance(broken, ValueError)


def test_a_baker_claims_chunks_after_contention(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two bake the same at the same time; afterwards each claims its chunks."""
    one, other = (task(tmp_path, until=16, owner=owner) for owner in ("one", "other"))
    seen: list[list[bytes]] = []

    def meanwhile(*arguments: Any) -> None:
        sample_texels(*arguments)
        seen.append([path.read_bytes() for path in (tmp_path / "claims").glob("*")])
        if len(seen) == 1:
            bake(other)

    monkeypatch.setattr("isogi_worker.tasks.sample_texels", meanwhile)
    assert not bake(one).elsewhere
    bake(replace(one, until=64))
    assert seen[:2] == [[], []]
    assert seen[2] == [b"one"]
    assert not list((tmp_path / "claims").glob("*"))


def test_a_chunk_that_another_baker_claimed_is_left(tmp_path: Path) -> None:
    one = task(tmp_path, until=16, owner="one")
    claims_of(one.store_url).note_contention()
    claim = tmp_path / "claims" / ".".join(map(str, (store_of(tmp_path).layers[0].digest, *INDEX)))
    claim.parent.mkdir()
    claim.write_bytes(b"other")
    assert bake(one) == BAKED_ELSEWHERE and stored(tmp_path) == [None, None]
    assert bake(replace(one, insists=True)).cost.paths == 16 * len(TEXELS)
    assert not claim.exists()


def test_in_one_go_or_in_many_is_the_same(tmp_path: Path) -> None:
    do(tmp_path / "a")
    until = 16
    while do(tmp_path / "b", until=until).unfinished:
        until *= 2
    assert until > 32
    assert stored(tmp_path / "a") == stored(tmp_path / "b")


def test_the_order_of_views_does_not_matter(tmp_path: Path) -> None:
    parts = TEXELS[:20], TEXELS[10:40], TEXELS[35:]
    for part in parts:
        do(tmp_path / "a", part)
    for part in reversed(parts):
        do(tmp_path / "b", part, until=64)
    for part in parts:
        do(tmp_path / "b", part)
    do(tmp_path / "c")
    assert stored(tmp_path / "a") == stored(tmp_path / "b") == stored(tmp_path / "c")


def test_texels_that_are_not_asked_for_stay_as_they_are(tmp_path: Path) -> None:
    do(tmp_path, TEXELS[:10], until=16)
    before = store_of(tmp_path).load(INDEX)
    do(tmp_path, TEXELS[10:20])
    after = store_of(tmp_path).load(INDEX)
    for old, new in zip(before.light.parts, after.light.parts, strict=True):
        np.testing.assert_array_equal(new.samples[:10], old.samples)
        np.testing.assert_array_equal(new.noise[:10], old.noise)
        np.testing.assert_array_equal(new.coefficients[:10], old.coefficients)
        assert (new.samples[10:] >= 16).all()


def test_vicinity_shading_reads_the_layer_that_is_there(tmp_path: Path) -> None:
    do(tmp_path)
    before = stored(tmp_path)
    assert do(tmp_path, until=64, target=0.5, spec=VICINITY).unfinished == 0
    assert stored(tmp_path) == before
    light = (
        open_spec(SCENE.source, VICINITY.plan, VICINITY.digest, made(tmp_path))[1].load(INDEX).light
    )
    assert [part.layer for part in light.parts] == [SCENE.plan.layers[0]]
    assert (light.samples >= 64).all()


DAMAGES: list[Callable[[bytes], bytes]] = [
    *(
        lambda b: b"",
        lambda b: b[: len(b) // 2],
        lambda b: b[:-1],
        lambda b: bytes(len(b)),
        lambda b: b + b"more",
    ),
    lambda b: b[:40] + bytes([b[40] ^ 1]) + b[41:],
]


@pytest.mark.parametrize("layer", [0, 1])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_chunk_heals_to_the_same_bytes(
    tmp_path: Path, damage: Callable[[bytes], bytes], layer: int
) -> None:
    do(tmp_path)
    path = Path(store_of(tmp_path).layers[layer].path, "c", *map(str, INDEX), "0")
    whole = stored(tmp_path)
    path.write_bytes(damage(whole[layer] or b""))
    result = do(tmp_path)
    assert (result.healed, result.duplicate) == (True, False)
    assert stored(tmp_path) == whole


@pytest.mark.parametrize("layer", [0, 1])
@pytest.mark.parametrize("rest", [0, 1], ids=["of all texels", "of others"])
def test_what_is_void_in_one_layer_is_so_in_all(tmp_path: Path, layer: int, rest: int) -> None:
    """A layer may be lost, or read while another writes it: whoever bakes of the chunk then marks
    void texels anew.
    """
    texels = np.arange(16**3, dtype=np.int32)[:1024]
    do(tmp_path, texels)
    store = store_of(tmp_path)
    path = Path(store.layers[layer].path, "c", *map(str, INDEX), "0")
    whole = stored(tmp_path)
    void = texels[store.load(INDEX).light.void]
    assert len(void) > 0
    path.unlink()
    do(tmp_path, np.setdiff1d(texels, void) if rest else texels)
    assert stored(tmp_path) == whole


def test_a_scene_whose_files_changed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        SceneError, match=r"'orbital' have changed since the server began: restart it\.$"
    ):
        bake(replace(task(tmp_path, until=16), digest="0" * 20))
    assert [path.name for path in tmp_path.iterdir()] == ["isogi.json"]


def test_a_store_that_no_server_has_made_is_away(tmp_path: Path) -> None:
    """An empty mount point, say: what is baked there would be lost when the disk is back."""
    (tmp_path / "empty").mkdir()
    with pytest.raises(StoreAwayError, match="is gone") as reported:
        bake(
            replace(task(tmp_path / "made", until=16), store_url=StoreUrl(str(tmp_path / "empty")))
        )
    assert not list((tmp_path / "empty").iterdir())
    assert str(pickle.loads(pickle.dumps(reported.value))) == str(reported.value)


async def test_a_worker_answers_while_it_loads_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    answered = threading.Event()
    loaded = list[bool]()

    def load(kinds: Collection[str]) -> None:
        loaded.append({*kinds} >= {"direct", "indirect"} and answered.wait(5))

    monkeypatch.setattr("isogi_worker.tasks.load_kernels", load)
    asyncio.get_running_loop().call_soon(answered.set)
    await dask_setup(None)
    assert loaded == [True]


def test_layers_need_the_kernels_of_their_kinds_alone() -> None:
    assert set(bake_kernels(["direct", "indirect"])) == {bake_texels, locate_texels}
    assert set(bake_kernels(["whole"])) == {bake_texels, locate_texels}
    assert set(bake_kernels(["irradiance"])) == {bake_irradiance, locate_texels}
    assert set(bake_kernels(["direct", "indirect", "irradiance"])) == {
        bake_texels,
        bake_irradiance,
        locate_texels,
    }


def test_a_worker_without_the_files_leaves_the_same_bytes(
    small_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the scene's folder away, as on another machine: the volume comes from the store, by its
    digest.
    """
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    shutil.copytree(small_scene.parent, tmp_path / "away")
    scene = load_scene(tmp_path / "away" / small_scene.name)
    spec = spec_for(PreparedScene(scene), "gi")
    what = scene.source, spec.plan, spec.digest, made(tmp_path / "own")
    here = BakeTask(*what, (0, 0, 0), TEXELS[:40], SEEN[:40], 64, Goal(0.5))
    bake(here)
    assets = send_assets(scene, Store(tmp_path / "other"))
    (tmp_path / "away").rename(tmp_path / "gone")
    there = replace(here, store_url=made(tmp_path / "other"), assets=assets)
    assert bake(there).cost.paths > 0
    own, other = (
        open_spec(each.source, each.plan, each.digest, each.store_url, each.assets)[1]
        for each in (here, there)
    )
    assert [layer.read((0, 0, 0)) for layer in other.layers] == [
        layer.read((0, 0, 0)) for layer in own.layers
    ]
    assert all(layer.read((0, 0, 0)) for layer in own.layers)
    OPEN.clear()  # as in a process that has not had them
    with pytest.raises(VolumeError, match="There is no file"):
        bake(replace(here, store_url=made(tmp_path / "third")))


def test_projected_texels_have_the_same_bytes_in_any_order(tmp_path: Path) -> None:
    places = SPEC.prepared.lattice.positions(INDEX, TEXELS)
    spec = replace(SPEC, shown=float(np.median(locate(places, SPEC.prepared)[0][3])))
    assert spec.digest not in (SPEC.digest, replace(spec, shown=0.123).digest)

    def stored_after(name: str, *untils: int) -> list[bytes | None]:
        results = [
            do(tmp_path / name, until=until, spec=spec, shown=spec.shown) for until in untils
        ]
        assert results[-1].unfinished == 0
        return [layer.read(INDEX) for layer in ChunkStore(made(tmp_path / name), spec).layers]

    at_once = stored_after("a", UNTIL)
    assert at_once == stored_after("b", 16, 64, UNTIL) and None not in at_once
    assert store_of(tmp_path / "a").read(INDEX) is None, "what serves every isovalue is kept apart"
    chunk = ChunkStore(made(tmp_path / "a"), spec).load(INDEX)
    void = locate(places, spec.prepared, spec.shown)[1]
    np.testing.assert_array_equal(chunk.light.void, void)
    assert 0 < void.sum() < len(void)


def test_a_shared_scene_is_neither_read_nor_surveyed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Where the server has let go of it, the scene's files are read again."""
    shared = SharedScenes().share(SPEC.prepared)
    assert shared is not None
    with monkeypatch.context() as patch:
        patch.setattr(tasks, "build_scene", lambda *_: pytest.fail("it is read again"))
        patch.setattr(prepared_scene, "survey_of", lambda _: pytest.fail("it is surveyed again"))
        do(tmp_path / "shared", assets=shared)
    do(tmp_path / "own")
    assert stored(tmp_path / "shared") == stored(tmp_path / "own")
    gone = replace(shared, volume=replace(shared.volume, key=bytes(16)))
    do(tmp_path / "gone", assets=gone)
    assert stored(tmp_path / "gone") == stored(tmp_path / "own")


def test_scenes_in_other_light_share_what_is_open(small_scene: Path) -> None:
    own = load_scene(small_scene)
    first = opened(own.source)
    lit = opened(replace(own.source, document={**own.source.document, "environment": "studio"}))
    assert lit.scene.volume is first.scene.volume and lit.field is first.field
    assert (
        lit.scene.digest
        == load_scene(small_scene, environment="studio").digest
        != first.scene.digest
    )
    raw = opened(replace(own.source, document={**own.source.document, "spacing": [1.0, 1.0, 2.0]}))
    assert raw.scene.volume is not first.scene.volume, "it lies otherwise"
