"""Parcels: a scene from the store alone is the scene that its files make, fetched once, and never a
damaged one.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest
import zarr

from isogi_core.cache import scene_assets as room
from isogi_core.cache.scene_assets import SceneAssets, receive_assets, send_assets
from isogi_core.errors import StoreError
from isogi_core.files.radiance import write_hdr
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene
from isogi_core.storage.backend import StoredObject
from isogi_core.storage.store import Store

SCENE = """\
volume = "v.nrrd"
spacing = [1, 2, 3]
solid = "below"
missing = -9
isovalue = 0.4
[[lights]]
type = "probe"
file = "sky.hdr"
[[lights]]
type = "constant"
"""


@pytest.fixture(autouse=True)
def copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    monkeypatch.setattr(room, "VOLUME_OBJECT_VOXELS", (4, 8, 8))
    return tmp_path / "copies"


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    """A scene with a volume that has a hole, and a probe."""
    (tmp_path / "base").mkdir()
    field = np.random.default_rng(3).random((9, 12, 17)).astype(np.float32)
    field[3, 3, 3] = -9
    nrrd.write(str(tmp_path / "base" / "v.nrrd"), field, index_order="C")
    write_hdr(tmp_path / "base" / "sky.hdr", np.random.default_rng(4).random((8, 16, 3)))
    (tmp_path / "base" / "s.toml").write_text(SCENE)
    return load_scene(tmp_path / "base" / "s.toml")


def received(scene: Scene, assets: SceneAssets, store: Path) -> Scene:
    """The scene as another machine opens it."""
    store = Store(store, make=False)
    source, volume = receive_assets(replace(scene.source, base=Path("/nowhere")), assets, store)
    return build_scene(source, volume=volume)


def test_a_scene_from_the_store_is_the_scene(scene: Scene, tmp_path: Path) -> None:
    assets = send_assets(scene, Store(tmp_path / "store"))
    shutil.rmtree(tmp_path / "base")
    other = received(scene, assets, tmp_path / "store")
    assert (other.digest, other.bake_digest, other.id) == (
        scene.digest,
        scene.bake_digest,
        scene.id,
    )
    np.testing.assert_array_equal(other.volume.voxels, scene.volume.voxels)
    facts = [
        {k: v for k, v in vars(each.volume.counted()).items() if k != "voxels"}
        for each in (scene, other)
    ]
    assert facts[0] == facts[1]
    assert (other.isovalue, other.isovalues) == (scene.isovalue, scene.isovalues)
    assert [light.name for light in other.lighting.lights] == [
        light.name for light in scene.lighting.lights
    ]


def test_what_was_fetched_is_not_asked_for_again(scene: Scene, tmp_path: Path) -> None:
    assets = send_assets(scene, Store(tmp_path / "store"))
    first = received(scene, assets, tmp_path / "store")
    shutil.rmtree(tmp_path / "store")
    assert received(scene, assets, tmp_path / "store").digest == first.digest


def test_what_is_there_is_not_written_again(scene: Scene, tmp_path: Path) -> None:
    first = send_assets(scene, Store(tmp_path / "store"))
    before = {
        path: path.stat().st_mtime_ns for path in (tmp_path / "store").rglob("*") if path.is_file()
    }
    assert len(before) == 1 + 2 + 3 * 2 * 3 + 1
    assert send_assets(scene, Store(tmp_path / "store")) == first
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_half_written_assets_are_written_again(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "store")
    written = []
    put = Store.put

    def fails_late(self: Store, key: str, data: bytes, former: StoredObject | None) -> None:
        written.append(key)
        if len(written) == 9:
            raise StoreError("gone")
        put(self, key, data, former)

    with monkeypatch.context() as patch:
        patch.setattr(Store, "put", fails_late)
        with pytest.raises(StoreError, match="gone"):
            send_assets(scene, store)
    with pytest.raises(
        StoreError, match=r"The workers need volumes/.* which is missing in .*: restart the server"
    ):
        room.fetch_volume(scene.volume.digest, store)
    (tmp_path / "store" / written[4]).write_bytes(b"of a server that was killed")
    assets = send_assets(scene, store)
    assert received(scene, assets, tmp_path / "store").digest == scene.digest


def test_it_is_a_plain_zarr_array(scene: Scene, tmp_path: Path) -> None:
    send_assets(scene, Store(tmp_path / "store"))
    array = zarr.open_array(tmp_path / "store" / "volumes" / scene.volume.digest, mode="r")
    np.testing.assert_array_equal(array[:], scene.volume.voxels)


def test_a_damaged_asset_is_refused_and_never_copied(
    scene: Scene, tmp_path: Path, copies: Path
) -> None:
    assets = send_assets(scene, Store(tmp_path / "store"))
    chunk = next((tmp_path / "store" / "volumes").rglob("c/1/0/1"))
    whole = chunk.read_bytes()
    other = (chunk.parent / "0").read_bytes()
    for data, raised in (
        (whole[:-1], "checksum"),
        (b"", "checksum"),
        (other, "another volume"),
        (None, "is missing"),
    ):
        chunk.unlink() if data is None else chunk.write_bytes(data)
        with pytest.raises(
            StoreError, match=rf"is damaged \(.*{raised}.*\): delete it, and restart the server"
        ):
            received(scene, assets, tmp_path / "store")
    assert not list(copies.glob("*.voxels")) and not list(copies.glob("*.partial"))
    chunk.write_bytes(whole)
    assert received(scene, assets, tmp_path / "store").digest == scene.digest


def without_spacing(found: dict[str, Any]) -> None:
    del found["attributes"]["isogi"]["spacing"]


def without_name(found: dict[str, Any]) -> None:
    del found["attributes"]["isogi"]["name"]


def with_more(found: dict[str, Any]) -> None:
    found["attributes"]["isogi"]["colour"] = "red"


def of_two_axes(found: dict[str, Any]) -> None:
    found["shape"] = [9 * 12, 17]
    found["chunk_grid"]["configuration"]["chunk_shape"] = [4, 8]


def of_another_digest(found: dict[str, Any]) -> None:
    found["attributes"]["isogi"]["digest"] = "0" * 32


CHANGES = [without_spacing, without_name, with_more, of_two_axes, of_another_digest]


@pytest.mark.parametrize("change", CHANGES)
def test_facts_of_another_kind_are_refused(
    scene: Scene, tmp_path: Path, copies: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    """As another version may write them, of a volume."""
    assets = send_assets(scene, Store(tmp_path / "store"))
    path = next((tmp_path / "store" / "volumes").glob("*/zarr.json"))
    found = json.loads(path.read_text())
    change(found)
    path.write_text(json.dumps(found))
    with pytest.raises(StoreError, match="is damaged"):
        received(scene, assets, tmp_path / "store")
    assert not list(copies.glob("*.voxels"))


def test_a_demo_needs_no_volume_asset(tmp_path: Path) -> None:
    scene = load_scene("demo:orbital")
    store = Store(tmp_path)
    assets = send_assets(scene, store)
    assert assets == SceneAssets("", ()) and not list(tmp_path.iterdir())
    assert receive_assets(scene.source, assets, store) == (scene.source, None)
