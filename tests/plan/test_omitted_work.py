"""Rays, kernels and texels that plans leave out are not missed; where they would be, they are kept."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake import refine
from isogi_core.frame import lighting as surroundings
from isogi_core.frame.gbuffer import trace
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import find_texels
from isogi_core.kernels.shading.lattice import DEFAULT_CHUNK_SIDE
from isogi_core.model import environment as lamps
from isogi_core.model.view import IDENTITY
from isogi_core.plan.reachable_texels import surface_cells, void_texels
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.plan.conftest import (
    SUN,
    TARGET,
    TURN,
    WIDE,
    Frames,
    Lobe,
    apart,
    bowl,
    in_bowl,
    plated_ball,
    scene_of,
    view_of,
)
from tests.plan.shown import shown_texels

KERNELS = {"bake_texels": refine, "bake_irradiance": refine, "rotate": surroundings, "project_lamps": lamps}
"""Kernels that some scenes do without, and the module that calls them."""


@pytest.mark.parametrize("light", ["constant", "fixed", "rotating", "lamp"])
def test_kernels_are_called_but_for_those_left_out(
    light: str, frame_of: Frames, lobe: Lobe, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: set[str] = set()
    for name, module in KERNELS.items():
        monkeypatch.setattr(module, name, recorded(name, getattr(module, name), called))
    lights = {"constant": [{"type": "constant"}], "lamp": [{"type": "directional"}]}.get(light, [lobe(WIDE)])
    scene = in_bowl(lights=lights, rotating=light in ("constant", "rotating"))
    frame_of(scene, light=TURN if light == "rotating" else IDENTITY)
    (idle,) = [each.what for each in scene.left_out if each.what.startswith("kernels")]
    assert called == {name for name in KERNELS if name not in idle}


def recorded(name: str, kernel: Callable[..., None], called: set[str]) -> Callable[..., None]:
    """The kernel, which notes that it was ``called``."""

    def call(*arguments: Any) -> None:
        called.add(name)
        kernel(*arguments)

    return call


def aimed(scene: Scene, sharp: bool) -> Scene:
    """The scene with shadow rays towards the bright parts of its environment, or without."""
    around = replace(scene.lighting.environment)
    vars(around)["sharp"] = sharp
    return replace(scene, lighting=replace(scene.lighting, environment=around))


@pytest.mark.slow
def test_soft_light_leaves_out_shadow_rays_and_their_table(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(1.0)], rotating=False)
    assert not scene.lighting.environment.table[0].size
    kept = aimed(scene, True)
    assert kept.lighting.environment.table[0].size
    assert apart(frame_of(scene, 256), frame_of(kept, 256)) < TARGET / 3


@pytest.mark.slow
def test_shadow_rays_and_their_table_are_kept_under_the_sun(frame_of: Frames) -> None:
    scene = in_bowl(lights=[SUN], rotating=False)
    assert scene.lighting.environment.table[0].size
    best = frame_of(scene, 1024)
    assert apart(frame_of(scene, 256), best) < TARGET < apart(frame_of(aimed(scene, False), 256), best)


def read_by(scene: Scene, isovalue: float, azimuth: float) -> np.ndarray:
    """Which texels of the lattice a view reads; bool."""
    prepared, tiles = PreparedScene(scene), Tiles()
    gbuffer = trace(view_of(scene, azimuth, isovalue=isovalue), prepared.surface(isovalue), tiles)
    marks = np.zeros(prepared.shape, np.bool_)
    texels = find_texels(gbuffer, prepared, tiles)
    for index, offsets in zip(texels.chunks, texels.offsets, strict=True):
        inside = np.unravel_index(offsets, (DEFAULT_CHUNK_SIDE,) * 3)
        marks[tuple(at + DEFAULT_CHUNK_SIDE * chunk for at, chunk in zip(inside, index, strict=True))] = True
    return marks


def test_texels_are_left_out_that_no_allowed_isovalue_shows() -> None:
    scene = scene_of(bowl(), (-0.45, 0.45))
    low, high = map(scene.volume.normalise_isovalue, scene.isovalues)
    shown = shown_texels(surface_cells(scene.volume.voxels, low, high), scene.lattice_shape)
    assert shown.sum() == scene.texels.shown < scene.texels.total / 2
    for isovalue, azimuth in [(-0.45, 0.0), (-0.2, 100.0), (0.0, 200.0), (0.45, 300.0)]:
        assert not (read_by(scene, isovalue, azimuth) & ~shown).any()


def test_texels_are_kept_that_some_allowed_isovalue_shows() -> None:
    one, more = scene_of(bowl(), (0.0, 0.0)), scene_of(bowl(), (0.0, 3.0))
    at_zero = surface_cells(one.volume.voxels, *[one.volume.normalise_isovalue(0.0)] * 2)
    assert (read_by(more, 3.0, 40.0) & ~shown_texels(at_zero, one.lattice_shape)).any()
    assert more.texels.shown > one.texels.shown


def test_texels_without_a_gradient_are_left_out_and_not_missed(frame_of: Frames) -> None:
    """A ball lit from all sides is R everywhere; texels counted as black would show."""
    scene = scene_of(plated_ball(), (-0.4, 0.4), lattice=0.5, bounces=0)
    assert scene.texels.void > scene.texels.shown / 4
    frame = frame_of(scene)
    assert frame.coverage["provisional"] == 0.0
    assert apart(frame, replace(frame, radiance=np.full_like(frame.radiance, scene.surfaces.albedo[0]))) < TARGET


def test_texels_with_a_gradient_are_kept() -> None:
    """But a few: at the crest within the bowl's wall, and in the gap between bowl and ball, a voxel wide."""
    scene = scene_of(bowl(), (-0.4, 0.4))
    low, high, deep = map(scene.volume.normalise_isovalue, (*scene.isovalues, 1.5))
    voxels, shape = scene.volume.voxels, scene.lattice_shape
    shown = shown_texels(surface_cells(voxels, low, high), shape)
    void = void_texels(PreparedScene(scene).field, shape, np.flatnonzero(shown))
    gap = [(np.roll(voxels, 1, axis) > voxels) & (np.roll(voxels, -1, axis) > voxels) for axis in range(3)]
    assert void.sum() == scene.texels.void < 0.03 * scene.texels.shown
    assert ((voxels > deep) | np.any(gap, axis=0))[shown][void].all()
