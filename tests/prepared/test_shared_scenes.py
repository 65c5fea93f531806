"""Scenes that another process has opened, mapped from its memory."""

import gc
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from pickle import dumps

import numpy as np
import pytest

from isogi_core.bake.bake_spec import spec_for
from isogi_core.errors import SharedMemoryError
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared import prepared_scene, shared_scenes
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.prepared.shared_scenes import SharedScenes, receive_scene

pytestmark = pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="Linux shares so")
ROOT = Path(__file__).parent.parent.parent
LEVELS = np.array([0.2, 0.4])
MOST_BYTES = 1 << 30


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:orbital", lattice=0.5, lights=[{"type": "sky"}])


def test_what_is_received_is_what_was_shared(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of the voxels is measured again."""
    own = PreparedScene(scene)
    shared = SharedScenes().share(own)
    assert shared is not None
    for name in ("fill_macrocells", "survey_of"):
        monkeypatch.setattr(prepared_scene, name, lambda *_: pytest.fail("it is measured again"))
    other = receive_scene(shared, MOST_BYTES)
    assert other.scene.source == scene.source
    np.testing.assert_array_equal(other.scene.volume.voxels, scene.volume.voxels)
    np.testing.assert_array_equal(other.field.low, own.field.low)
    np.testing.assert_array_equal(other.field.high, own.field.high)
    np.testing.assert_array_equal(other.maps.levels, own.maps.levels)
    for mine, its in zip(own.maps.covering(LEVELS), other.maps.covering(LEVELS), strict=True):
        np.testing.assert_array_equal(its, mine)
    assert spec_for(other, "gi").digest == spec_for(own, "gi").digest
    np.testing.assert_array_equal(spec_for(other, "gi").light, spec_for(own, "gi").light)


def test_scenes_of_one_volume_share_its_file(scene: Scene) -> None:
    shares = SharedScenes()
    own = PreparedScene(scene)
    other = load_scene("demo:orbital", lattice=0.25)
    finer = own.beside(scene.__class__(**{**vars(other), "volume": scene.volume}))
    one, two = shares.share(own), shares.share(finer)
    assert one is not None and two is not None
    assert shares.share(own) == one
    assert one.volume == two.volume and one.scene != two.scene
    received = receive_scene(one, MOST_BYTES), receive_scene(two, MOST_BYTES)
    assert received[0].field is received[1].field and received[0].maps is received[1].maps


RECEIVE = """
import pickle, sys
from isogi_core.prepared.shared_scenes import receive_scene
received = receive_scene(pickle.loads(bytes.fromhex(sys.argv[1])), 1 << 30)
print(received.scene.volume.digest, float(received.scene.volume.voxels.sum()))
"""


def test_another_process_maps_a_shared_scene(scene: Scene) -> None:
    shares = SharedScenes()
    shared = shares.share(PreparedScene(scene))
    told = subprocess.run(
        [sys.executable, "-c", RECEIVE, dumps(shared).hex()],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    digest, total = told.stdout.split()
    assert digest == scene.volume.digest
    assert float(total) == float(scene.volume.voxels.sum())


def test_a_scene_that_is_let_go_can_no_longer_be_had() -> None:
    scene = load_scene("demo:casting", lattice=0.5)
    shared = SharedScenes().share(PreparedScene(scene))
    assert shared is not None
    del scene
    gc.collect()
    with pytest.raises(SharedMemoryError):
        receive_scene(shared, MOST_BYTES)


def test_another_file_of_the_same_number_is_not_taken(scene: Scene) -> None:
    shared = SharedScenes().share(PreparedScene(scene))
    assert shared is not None
    wrong = replace(shared, volume=replace(shared.volume, key=bytes(16)))
    with pytest.raises(SharedMemoryError, match="another file"):
        receive_scene(wrong, MOST_BYTES)


def test_a_share_that_fails_keeps_no_file(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    own = PreparedScene(scene)
    shares = SharedScenes()
    before = len(os.listdir("/proc/self/fd"))
    with monkeypatch.context() as patch:
        patch.setattr(shared_scenes, "ScenePickler", None)
        for _ in range(3):
            assert shares.share(own) is None
    assert len(os.listdir("/proc/self/fd")) == before
    assert shares.share(own) is not None


def test_large_volumes_are_left_to_their_copies(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They lie in files, which other processes map by themselves."""
    megabytes = scene.volume.voxels.nbytes >> 20
    assert megabytes >= 1
    monkeypatch.setenv("ISOGI_VOLUME_MB", str(4 * megabytes))
    assert SharedScenes().share(PreparedScene(scene)) is None
    monkeypatch.setenv("ISOGI_VOLUME_MB", str(20 * megabytes))
    assert SharedScenes().share(PreparedScene(scene)) is not None
