"""Pictures of segmentations: one label is a plain volume of its field, two are told apart, hidden ones let light in."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import nrrd
import numpy as np

from isogi_core.model.view import read_window
from isogi_core.plan.scene import Scene
from isogi_core.plan.volumes.labels import smooth
from tests.frame.conftest import CONSTANT, SKY, Workbench, chunks_of, rmse_of_colours
from tests.loaded import load_scene

Z, Y, X = np.indices((18, 18, 18)) - 8.5
BALL = np.sqrt(X**2 + Y**2 + Z**2) < 6.3
CUP = (np.abs(X) < 6) & (np.abs(Y) < 6) & (np.abs(Z) < 6) & ~((np.abs(X) < 3) & (np.abs(Y) < 3) & (Z > -3))
RED, GREEN = [0.8, 0.2, 0.2], [0.2, 0.7, 0.2]
KEPT = {"bounces": 3, "target_error": 0.03, "isovalues": [0.4, 0.6]}


def scene_of(folder: Path, volume: np.ndarray, **settings: Any) -> Scene:
    """The scene of a volume in a folder."""
    path = folder / "v.nrrd"
    nrrd.write(str(path), np.ascontiguousarray(volume), index_order="C")
    return load_scene(path, **{**KEPT, "lights": [CONSTANT], **settings})


def label(value: int, colour: list[float], hidden: bool = False) -> dict[str, Any]:
    """An entry of [[labels]]."""
    return {"value": value, "colour": colour, "hidden": hidden}


def test_one_label_is_a_plain_volume_of_its_albedo(tmp_path: Path) -> None:
    """The closed form: the same voxels, direct light under the same key and of the same bytes, the same picture."""
    own = scene_of(tmp_path, CUP.astype(np.uint8), labels=[label(1, RED)], lights=[SKY])
    plain = scene_of(tmp_path, np.concatenate(list(smooth(CUP))), isovalue=0.5, albedo=RED, lights=[SKY])
    direct = own.plan.layers[0]
    assert own.surfaces.albedo == plain.surfaces.albedo and own.layer_digest(direct) == plain.layer_digest(direct)
    one, other = Workbench(own, tmp_path / "a"), Workbench(plain, tmp_path / "b")
    frame, expected = (bench.bake(bench.view(size=24)) for bench in (one, other))
    assert rmse_of_colours(frame, expected) < 0.002
    found, others = (chunks_of(bench.folder, own.layer_digest(direct)) for bench in (one, other))
    assert found and found == others


def test_two_halves_part_at_their_plane(tmp_path: Path, workbench: Callable[..., Workbench]) -> None:
    """Pixels that hit the surface more than half a voxel away from the plane are of one colour."""
    halves = np.where(BALL, np.where(X < 0, 2, 9), 0).astype(np.uint8)
    bench = workbench(scene_of(tmp_path, halves, labels=[label(2, RED), label(9, GREEN)]))
    frame = bench.renderer.render(bench.view(size=48, shading="lambert", azimuth=90.0))
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    away = frame.gbuffer.points[:, 0] - 8.5
    left, right = own[away < -0.51], own[away > 0.51]
    assert len(left) > 100 and len(right) > 100
    np.testing.assert_allclose(left, np.tile(RED, (len(left), 1)), atol=0.01)
    np.testing.assert_allclose(right, np.tile(GREEN, (len(right), 1)), atol=0.01)


def test_faces_of_a_window_are_in_the_colours_of_labels(tmp_path: Path, workbench: Callable[..., Workbench]) -> None:
    halves = np.where(BALL, np.where(X < 0, 2, 9), 0).astype(np.uint8)
    bench = workbench(scene_of(tmp_path, halves, labels=[label(2, RED), label(9, GREEN)]))
    view = bench.view(size=48, shading="lambert", elevation=70.0, window=read_window("z>8.5"))
    frame = bench.renderer.render(view)
    faces = frame.gbuffer.faces
    shown, away = frame.radiance.reshape(-1, 3)[faces.pixels], faces.points[:, 0] - 8.5
    for side, colour in ((away < -0.51, RED), (away > 0.51, GREEN)):
        assert side.sum() > 100
        np.testing.assert_allclose(
            shown[side] / shown[side].sum(axis=1)[:, None], [colour / np.sum(colour)] * side.sum(), atol=0.01
        )


def test_a_hidden_lid_lets_light_into_its_cup(tmp_path: Path, workbench: Callable[..., Workbench]) -> None:
    """By paths of the volume without it: what it hid is lit, under another key."""
    lid = (np.abs(X) < 6) & (np.abs(Y) < 6) & (Z > 5) & (Z < 8)
    both = np.where(CUP, 1, np.where(lid, 2, 0)).astype(np.uint8)
    closed = scene_of(tmp_path, both, labels=[label(1, RED), label(2, GREEN)])
    opened = workbench(scene_of(tmp_path, both, labels=[label(1, RED), label(2, GREEN, hidden=True)]))
    alone = workbench(scene_of(tmp_path, CUP.astype(np.uint8), labels=[label(1, RED)]))
    assert closed.bake_digest != opened.scene.bake_digest == alone.scene.bake_digest
    frame = opened.bake(opened.view(size=24, elevation=60.0))
    traced = opened.renderer.render(opened.view(size=24, elevation=60.0, shading="path_traced", samples=256))
    assert rmse_of_colours(frame, traced) < 0.05
    inner = np.argwhere((frame.position[..., 2] < 8.0) & (np.abs(frame.position[..., :2] - 8.5) < 2.5).all(axis=-1))
    assert len(inner) and all(frame.radiance[row, column, 0] > 0.05 for row, column in inner)
