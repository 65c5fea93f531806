"""Extreme values and boxes: digits are kept, holes stay where they are, and pictures depend on no
unit or axis.
"""

import math
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import permutations, product

import numpy as np
import pytest

from isogi_core.bake.bake_spec import SPECS
from isogi_core.errors import VolumeError
from isogi_core.frame.film import develop
from isogi_core.model.view import Camera, View
from isogi_core.model.volume import make_volume
from isogi_core.plan.scene import Scene
from isogi_core.prepared.active_cell_maps import ActiveCellMaps
from tests.stability.scenes import frame_of, grey_levels, picture_of, renderer_of, scene_of, view_of
from tests.stability.volumes import RANGES, REFUSED, SIDE, grid, soft, spoiled

HOT = (SIDE // 2 - 2, SIDE // 2, SIDE - 8)
"""A voxel (z, y, x) at the body's skin, in sight."""

REACH = 2.0
"""Voxels from a spoiled one within which the cells lie that have it as a corner."""

RADIUS = 8.0
"""Of spheres, in voxels of the coarse axes."""

CHORDS = RADIUS - math.sqrt(RADIUS**2 - 0.75)
"""How far a cube's trilinear field may lie within the sphere: of r² it lacks 1/4 for each axis at
most.
"""

SHADED = ("lambert", "phong_shadow", "gi")
EYE = np.array([50.0, 33.0, 21.0])
"""The eye, from the volume's middle, in voxels; that of the mirrored and permuted field is mirrored
and permuted.
"""

SUN = np.array([0.5, 0.7, 0.6])
"""Towards the lamp of all shadings but global illumination, which has the same light from
everywhere.
"""

PLAIN = (0, 1, 2), (1, 1, 1)
"""The axes as they are: their order, and their signs."""

Axes = tuple[tuple[int, ...], tuple[int, ...]]


@pytest.mark.parametrize("name", RANGES)
def test_values_keep_24_bits_of_their_range(name: str) -> None:
    """Whatever offset and outliers; in exact fractions."""
    array = RANGES[name].make()
    volume = make_volume(array)
    few = np.random.default_rng(1).choice(volume.voxels.size, 100)
    values = array.ravel()[few]
    voxels = volume.voxels.ravel()[few]
    offset = Fraction(volume.offset)
    scale = Fraction(volume.scale)
    span = Fraction(volume.core[1]) - Fraction(volume.core[0]) or Fraction(1)
    # Outliers are a hundred times as large as the core, which is from 0 to 1.
    inner = np.isfinite(voxels) & (np.abs(voxels) <= 10.0)
    assert inner.any()
    for value, voxel in zip(values[inner].tolist(), voxels[inner].tolist(), strict=True):
        assert abs(offset + scale * Fraction(voxel) - Fraction(value)) / span <= Fraction(1, 2**24)


@pytest.mark.parametrize("dtype", ["float32", "float64", "int64"])
def test_a_volume_knows_how_many_steps_its_type_has(dtype: str) -> None:
    """Of a range of 256 at 1e9; single floats have four."""
    array = (1e9 + 256 * soft()).astype(dtype)
    bits = array.view({"float32": np.int32, "float64": np.int64, "int64": np.int64}[dtype])
    assert make_volume(array).steps == pytest.approx(float(np.ptp(bits)), abs=0.5)


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_volume_is_refused_in_a_sentence(name: str) -> None:
    poor = REFUSED[name]
    with pytest.raises(VolumeError, match=rf"{poor.refused}[\s\S]*\.\Z"):
        make_volume(poor.make(), poor.spacing)


def hits_of(scene: Scene, view: View) -> np.ndarray:
    """Where pixels meet the surface, in index space, (h, w, 3) float32; -1 where they do not."""
    hits = np.full((view.height * view.width, 3), -1.0, np.float32)
    with renderer_of(scene) as renderer:
        found = renderer.gbuffer(view)
    hits[found.pixels] = found.points
    return hits.reshape(view.height, view.width, 3)


@pytest.mark.parametrize("value", [1e30, -1e30, 1e300, -9999.0, np.nan, np.inf, -np.inf])
def test_a_voxel_changes_no_hit_outside_its_eight_cells(value: float) -> None:
    plain = scene_of(make_volume(soft()), 0.5)
    field = soft()
    field[HOT] = value
    view = view_of(plain, 128, azimuth=0.0, elevation=0.0)
    before, after = (hits_of(scene, view) for scene in (plain, scene_of(make_volume(field), 0.5)))
    near = [np.abs(hits - HOT[::-1]).max(axis=2) <= REACH for hits in (before, after)]
    other = (before != after).any(axis=2)
    assert other.any()
    assert not (other & ~near[0] & ~near[1]).any()


@pytest.mark.parametrize("mark", [-9999.0, -1e34, 1e30, 0.25])
def test_a_value_that_a_scene_calls_missing_is_a_hole(mark: float) -> None:
    """To the bit the volume with NaN in those places."""
    marked = make_volume(spoiled(0.3, mark), missing=[mark]).voxels
    holes = make_volume(spoiled(0.3, np.nan)).voxels
    np.testing.assert_array_equal(marked.view(np.uint32), holes.view(np.uint32))


@pytest.mark.parametrize("value", [100.0, 1000.0, 1e6, 1e30])
def test_a_hot_voxel_at_most_doubles_the_cells_of_a_map(value: float) -> None:
    field = soft()
    cells = marked_cells(field)
    field[0, 0, 0] = value
    assert 0 < marked_cells(field) <= 2 * cells


def marked_cells(field: np.ndarray) -> int:
    """Cells that the map of isovalue 0.5 marks."""
    volume = make_volume(field)
    level = volume.normalise_isovalue(0.5)
    words = ActiveCellMaps(volume.voxels).at(level).cells & 0xFFFF
    return int(np.bitwise_count(words).sum())


@pytest.mark.parametrize("ratio", [1, 10, 100, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_sphere_in_thin_voxels_is_as_round_as_in_cubes(ratio: int) -> None:
    """In voxels that are so many times thinner along x than along y and z."""
    side = round(2 * RADIUS) + 6
    x, y, z = grid((side - 1) * ratio + 1, side, side)
    field = RADIUS**2 - (x / ratio) ** 2 - y**2 - z**2
    scene = scene_of(make_volume(field.astype(np.float32), (1.0 / ratio, 1.0, 1.0)), 0.0)
    with renderer_of(scene) as renderer:
        gbuffer = renderer.gbuffer(view_of(scene, 64, shading="lambert"))
        points = gbuffer.points
        normals = gbuffer.normals(renderer.tiles)
    out = points.astype(np.float64) * scene.volume.spacing - scene.volume.centre
    radii = np.linalg.norm(out, axis=1)
    angles = np.arccos(np.clip((out * normals).sum(axis=1) / radii, -1.0, 1.0))
    assert np.abs(radii - RADIUS).max() <= CHORDS
    assert np.degrees(angles.max()) < 0.1


@pytest.mark.parametrize("shading", ["lambert", "phong_shadow", "lambert_fog", "gi"])
def test_the_picture_does_not_depend_on_the_unit_of_length(shading: str) -> None:
    """Bit by bit for powers of two; others round the paths' hits, so that a few of them go another
    way.
    """
    one, *others = (spaced(step, shading) for step in (1.0, 2.0**-99, 2.0**99, 1e-30, 1e30))
    assert one.any()
    levels = [grey_levels(one, other) for other in others]
    assert levels[:2] == [0, 0] and max(levels[2:]) <= 4, levels


def spaced(step: float, shading: str) -> np.ndarray:
    """The picture of the body with cubes of ``step`` for voxels."""
    scene = scene_of(make_volume(soft(), (step, step, step)), 0.5)
    return picture_of(scene, view_of(scene, 14, shading=shading), 256)


def test_where_the_box_ends_nothing_but_the_surface_ends() -> None:
    """Hits of the upper half of the body, and those of the whole body that lie there, by the same
    rays.
    """
    whole = scene_of(make_volume(soft()), 0.5)
    half = scene_of(make_volume(soft()[16:]), 0.5)
    view = view_of(whole, 96, elevation=50.0)
    (x, y, z) = view.camera.eye
    (u, v, w) = view.camera.target
    camera = Camera((x, y, z - 16.0), (u, v, w - 16.0), view.camera.up, view.camera.fov)
    found = hits_of(half, replace(view, camera=camera))
    expected = hits_of(whole, view)
    kept = expected[..., 2] >= 16.0
    assert kept.sum() > 500
    assert np.abs(found[kept] - (expected[kept] - np.array([0, 0, 16], np.float32))).max() < 1e-4


@cache
def plain_picture(shading: str) -> np.ndarray:
    """The picture of ``soft``."""
    scene = scene_of(make_volume(soft()), 0.5)
    return picture_of(scene, view_of(scene, 20, shading=shading), 256)


@pytest.mark.parametrize("shading", SHADED)
@pytest.mark.parametrize(
    ("offset", "factor"),
    [(1e9, 1.0), (-1e9, 1.0), (0.0, 1e-300), (0.0, 1e300), (0.0, 3.7)],
    ids=str,
)
def test_the_picture_does_not_depend_on_the_unit_of_value(
    offset: float, factor: float, shading: str
) -> None:
    """But for a few paths, in 22 of 1,220 texels, that go another way as values are rounded."""
    scene = scene_of(make_volume(offset + factor * soft()), offset + factor * 0.5)
    picture = picture_of(scene, view_of(scene, 20, shading=shading), 256)
    assert grey_levels(plain_picture(shading), picture) <= (2 if shading in SPECS else 1)


@pytest.mark.parametrize("shading", SHADED)
@pytest.mark.parametrize(
    "signs", [each for each in product((1, -1), repeat=3) if -1 in each], ids=str
)
def test_a_mirrored_volume_has_the_mirrored_picture(signs: tuple[int, ...], shading: str) -> None:
    assert grey_levels(turned(PLAIN, shading), turned(((0, 1, 2), signs), shading)) <= 1


@pytest.mark.parametrize("shading", SHADED)
@pytest.mark.parametrize("order", list(permutations(range(3)))[1:], ids=str)
def test_a_volume_with_permuted_axes_has_the_permuted_picture(
    order: tuple[int, ...], shading: str
) -> None:
    assert grey_levels(turned(PLAIN, shading), turned((order, (1, 1, 1)), shading)) <= 1


@cache
def turned(axes: Axes, shading: str) -> np.ndarray:
    """The picture of the field with its axes (x, y, z) permuted and then mirrored, from an eye that
    went along.

    The lamp went along too. The picture is itself mirrored back where the axes changed their hand.
    """
    order, signs = axes
    field = soft(24).transpose([2 - order[2 - axis] for axis in range(3)])
    field = field[tuple(slice(None, None, signs[2 - axis]) for axis in range(3))]
    move = np.eye(3)[list(order)] * np.array(signs)[:, None]
    x, y, z = move @ SUN
    angles = {
        "azimuth": math.degrees(math.atan2(y, x)),
        "elevation": math.degrees(math.atan2(z, math.hypot(x, y))),
    }
    lamp = {"type": "directional", **angles}
    scene = scene_of(make_volume(field), 0.5, **({} if shading == "gi" else {"lights": [lamp]}))
    eye = np.array(scene.volume.centre) + move @ EYE
    camera = Camera(tuple(eye), scene.volume.centre, tuple(move @ (0.1, 0.2, 1.0)), 26.0)
    frame = frame_of(scene, View(0.5, camera, width=10, height=10, shading=shading), 2048)
    picture = develop(
        frame, 1.0
    )  # a scene's exposure is found from its front, which is mirrored here
    if np.linalg.det(move) > 0.0:
        return picture
    return picture[:, ::-1]
