"""Masks of glows take the voxels of a scene's volume that are nearest to theirs, and travel with the scene."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.cache.scene_assets import receive_assets, receive_glow_bits, send_assets
from isogi_core.errors import IsogiError
from isogi_core.model.value_survey import no_progress
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import cut_open
from isogi_core.storage.store import Store
from tests.loaded import load_scene

FIELD = np.random.default_rng(6).integers(20, 90, (9, 7, 8)).astype(np.uint8)
LABELS = np.zeros(FIELD.shape, np.int16)
LABELS[2:5, 1:4, 3:7] = 4
LABELS[6:, 5:, :2] = 9


def scene_of(folder: Path, *glows: dict[str, Any], **settings: Any) -> Scene:
    """The scene of v.nrrd in a folder, in which ``glows`` have m.nrrd for a mask."""
    nrrd.write(str(folder / "v.nrrd"), FIELD, index_order="C")
    nrrd.write(str(folder / "m.nrrd"), LABELS, index_order="C")
    mask = str(folder / "m.nrrd")
    return load_scene(folder / "v.nrrd", glow=[{"mask": mask, **each} for each in glows], isovalue=50.0, **settings)


def test_masks_are_bits_of_voxels_and_their_boxes_regions(tmp_path: Path) -> None:
    glowing = scene_of(tmp_path, {}, {"labels": [4], "radiance": [3, 2, 1]}).lighting.glowing
    np.testing.assert_array_equal(glowing.bits, (LABELS != 0) * np.uint8(1) + (LABELS == 4) * np.uint8(2))
    lows, highs = glowing.middles - glowing.halves, glowing.middles + glowing.halves
    np.testing.assert_allclose(lows, [[0.0, 0.5, 1.5], [2.5, 0.5, 1.5]])
    np.testing.assert_allclose(highs, [[6.5, 6.0, 8.0], [6.5, 3.5, 4.5]])
    sphere = scene_of(tmp_path, {"sphere": [4, 3, 3, 2]}).lighting.glowing
    assert sphere.round.all() and sphere.masked.all() and sphere.halves[0, 0] == 2.0


def test_light_depends_on_a_mask_and_not_on_its_file(tmp_path: Path) -> None:
    one, other = (scene_of(tmp_path, {"labels": [label], "box": [[0, 0, 0], [7, 6, 8]]}) for label in (4, 9))
    assert one.lighting.glowing.halves.tolist() == other.lighting.glowing.halves.tolist()
    assert one.bake_digest != other.bake_digest
    nrrd.write(str(tmp_path / "same.nrrd"), (LABELS == 4).astype(np.uint8), index_order="C")
    same = load_scene(
        tmp_path / "v.nrrd",
        isovalue=50.0,
        glow=[{"mask": str(tmp_path / "same.nrrd"), "box": [[0, 0, 0], [7, 6, 8]], "radiance": 3}],
    )
    assert same.bake_digest == one.bake_digest and same.digest != one.digest


def test_other_machines_are_given_what_masks_take(tmp_path: Path) -> None:
    scene, store = scene_of(tmp_path, {"labels": [4]}), Store(tmp_path / "store")
    assets = send_assets(scene, store)
    (tmp_path / "m.nrrd").unlink()
    source, volume = receive_assets(replace(scene.source, base=Path("/nowhere")), assets, store)
    made = build_scene(source, no_progress, volume, None, receive_glow_bits(assets, store))
    assert made.bake_digest == scene.bake_digest
    cut = cut_open(scene, "z>6", "cut")
    np.testing.assert_array_equal(cut.lighting.glowing.bits, scene.lighting.glowing.bits)


@pytest.mark.parametrize(
    ("glow", "sentence"),
    [
        ({"labels": [7]}, "No voxel of the volume is in the glow's mask"),
        ({"labels": 4}, "A glow's labels are 4: give a list"),
        ({"mask": 3}, "A glow's mask is 3: give the file"),
        ({"mask": "nowhere.nrrd"}, "nowhere.nrrd"),
    ],
)
def test_a_bad_mask_is_refused_in_a_sentence(glow: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    with pytest.raises(IsogiError, match=sentence):
        scene_of(tmp_path, glow)


def test_labels_without_a_mask_are_refused() -> None:
    with pytest.raises(IsogiError, match="A glow has labels of no mask: add mask"):
        load_scene("demo:orbital", glow=[{"labels": [1], "sphere": [40, 50, 60, 5]}])
