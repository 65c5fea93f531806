"""Colours of scenes: where their values come from, what they change, and which mistakes are
told.
"""

from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.cache.scene_assets import receive_assets, receive_colours, send_assets
from isogi_core.errors import IsogiError, SceneError, ViewError, VolumeError
from isogi_core.model.colours import COLOUR_MAPS, SurfaceColours, table_of
from isogi_core.model.material import Shine
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import cut_open, under
from isogi_core.storage.store import Store
from tests.loaded import load_scene

BALL = np.linalg.norm(np.indices((12, 13, 14)).T - np.array([6.0, 6.0, 6.0]), axis=-1).T.astype(
    np.float32
)
OWN = 'use = "colour"\nfile = "c.nrrd"'


def save(path: Path, array: np.ndarray, affine: np.ndarray | None = None) -> None:
    """An array (z, y, x) as NRRD, in a patient's world where an affine (4, 4) says where it
    lies.
    """
    header: dict[str, Any] = {}
    if affine is not None:
        rows = {"space directions": affine[:3, :3].T, "space origin": affine[:3, 3]}
        header = {"space": "right-anterior-superior", **rows}
    nrrd.write(str(path), np.ascontiguousarray(array), header, index_order="C")


def scene_of(folder: Path, table: str = OWN, more: str = "") -> Scene:
    """The scene of v.nrrd in a folder with colours."""
    text = f'volume = "v.nrrd"\nsolid = "below"\nisovalue = 4\n{more}\n[[volumes]]\n{table}\n'
    (folder / "s.toml").write_text(text)
    return load_scene(folder / "s.toml")


def colours_of(scene: Scene) -> SurfaceColours:
    """The colours that it has."""
    assert scene.surfaces.colours is not None
    return scene.surfaces.colours


def values_of(scene: Scene) -> np.ndarray:
    """What the codes stand for; NaN where there is no value."""
    colours = colours_of(scene)
    low, high = colours.scale.span
    codes = colours.places.astype(float)
    return np.where(codes == 0, np.nan, low + (codes - 1) / 254 * (high - low))


@pytest.mark.parametrize("name", [name for name in COLOUR_MAPS if name != "grey"])
def test_maps_are_those_of_matplotlib(name: str) -> None:
    """Between the places that are kept they err by a few codes of 255. No albedo is so high that
    light hardly leaves a hollow.
    """
    maps = pytest.importorskip("matplotlib").colormaps
    whitest = table_of("grey").max()
    assert 0.9 < whitest < 0.98
    srgb = maps[name](np.linspace(0.0, 1.0, 255))[:, :3]
    expected = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).clip(
        0.0, whitest
    )
    np.testing.assert_allclose(table_of(name), expected, atol=0.03)


def test_a_turned_volume_is_read_in_the_world(tmp_path: Path) -> None:
    """A linear function of the world, sampled on a coarse grid that is turned, comes out as that
    function.
    """
    c, s = np.cos(0.4), np.sin(0.4)
    placed = np.array(
        [[2 * c, -1.5 * s, 0, 3.0], [2 * s, 1.5 * c, 0, -4.0], [0, 0, 3.0, -1.0], [0, 0, 0, 1.0]]
    )
    z, y, x = np.indices((8, 16, 12))
    world = np.stack([x, y, z], -1) @ placed[:3, :3].T + placed[:3, 3]
    save(tmp_path / "v.nrrd", BALL, np.diag([1.0, 1.0, 1.0, 1.0]))
    save(tmp_path / "c.nrrd", (world @ [1.0, -2.0, 0.5]).astype(np.float32), placed)
    scene = scene_of(tmp_path, f"{OWN}\nrange = [-40, 40]")
    z, y, x = np.indices(scene.volume.shape)
    points = scene.volume.orientation.to_world(
        np.stack([x, y, z], -1) * np.array(scene.volume.spacing)
    )
    found = values_of(scene)
    known = ~np.isnan(found)
    assert 0.4 < known.mean() < 1.0
    np.testing.assert_allclose(found[known], (points @ [1.0, -2.0, 0.5])[known], atol=80 / 254)


def test_the_gradient_is_in_units_of_the_file(tmp_path: Path) -> None:
    """A distance grows by 1 a unit; times 30, by 30."""
    save(tmp_path / "v.nrrd", BALL * 30.0)
    table = 'use = "colour"\nof = "gradient"\nrange = [0, 60]'
    (tmp_path / "s.toml").write_text(
        f'volume = "v.nrrd"\nsolid = "below"\nisovalue = 120\n[[volumes]]\n{table}\n'
    )
    found = values_of(load_scene(tmp_path / "s.toml"))
    near = (BALL > 3.0) & (BALL < 4.5)
    np.testing.assert_allclose(found[near], 30.0, rtol=0.1)


def test_the_curvature_of_a_ball_is_one_over_its_radius(tmp_path: Path) -> None:
    """Whatever its values and its spacing are, and less than 0 where it is a hollow."""
    z, y, x = np.indices((24, 24, 24))
    distance = np.hypot(np.hypot((x - 11.5), (y - 11.5)), (z - 11.5) * 2.0)
    for solid, sign in (("below", 1.0), ("above", -1.0)):
        save(tmp_path / "v.nrrd", (7.0 * distance**2).astype(np.float32))
        table = 'use = "colour"\nof = "curvature"\nrange = [-1, 1]'
        known = f'volume = "v.nrrd"\nspacing = [0.5, 0.5, 1.0]\nsolid = "{solid}"\nisovalue = 400'
        text = f"{known}\n[[volumes]]\n{table}\n"
        (tmp_path / "s.toml").write_text(text)
        found = values_of(load_scene(tmp_path / "s.toml"))
        near = (distance > 5.0) & (distance < 8.0) & (z > 1) & (z < 22)
        np.testing.assert_allclose(
            found[near], sign / (0.5 * distance[near]), rtol=0.05, atol=1 / 127
        )


def test_curvature_has_its_zero_in_the_middle(tmp_path: Path) -> None:
    save(tmp_path / "v.nrrd", BALL)
    scale = colours_of(scene_of(tmp_path, 'use = "colour"\nof = "curvature"')).scale
    assert scale.map == "coolwarm" and scale.span[0] == -scale.span[1] < 0.0


def test_the_usual_range_is_of_the_surface_alone(tmp_path: Path) -> None:
    """Values far from the surface, however large, do not spread the colours."""
    save(tmp_path / "v.nrrd", BALL)
    marks = np.where(np.abs(BALL - 4.0) < 2.0, np.indices(BALL.shape)[2], 1e6)
    save(tmp_path / "c.nrrd", marks.astype(np.float32))
    low, high = colours_of(scene_of(tmp_path)).scale.span
    assert 1.0 <= low < 4.0 and 8.0 < high <= 11.0


def test_holes_have_the_colour_outside(tmp_path: Path) -> None:
    """NaN, infinities and what floats do not hold are no values, and do not spread the range."""
    save(tmp_path / "v.nrrd", BALL)
    marks = np.indices(BALL.shape)[2].astype(np.float64)
    marks[:, :4, 5] = np.nan
    marks[:, :4, 6] = np.inf
    marks[:, :4, 7] = 1e300
    save(tmp_path / "c.nrrd", marks)
    scene = scene_of(tmp_path)
    found = values_of(scene)
    assert np.isnan(found[:, :4, 5:8]).all() and not np.isnan(found[:, 5:]).any()
    assert colours_of(scene).scale.span[1] < 13.0 and colours_of(scene).table[0] == pytest.approx(
        0.5
    )


@pytest.mark.parametrize("spacing", [1e-12, 1e12])
def test_the_gradient_of_a_volume_of_any_size(tmp_path: Path, spacing: float) -> None:
    save(tmp_path / "v.nrrd", BALL)
    plain = scene_of(tmp_path, 'use = "colour"\nof = "gradient"')
    scene = scene_of(
        tmp_path, 'use = "colour"\nof = "gradient"', f"spacing = [{spacing}, {spacing}, {spacing}]"
    )
    np.testing.assert_array_equal(colours_of(scene).places, colours_of(plain).places)
    np.testing.assert_allclose(
        np.array(colours_of(scene).scale.span) * spacing, colours_of(plain).scale.span
    )


def test_values_that_are_all_the_same_have_a_range(tmp_path: Path) -> None:
    save(tmp_path / "v.nrrd", BALL)
    save(tmp_path / "c.nrrd", np.full_like(BALL, -8.0))
    colours = colours_of(scene_of(tmp_path))
    assert colours.scale.span == (-12.0, -4.0) and np.unique(colours.places).tolist() == [128]


def test_map_and_range_change_reflected_light_alone(tmp_path: Path) -> None:
    save(tmp_path / "v.nrrd", BALL)
    save(tmp_path / "c.nrrd", BALL)
    scene = scene_of(tmp_path)
    other = scene_of(tmp_path, f'{OWN}\nmap = "magma"\nrange = [0, 9]')
    direct = scene.plan.layers[0]
    reflected = scene.plan.layers[-1]
    assert (direct.kind, reflected.kind) == ("direct", "indirect")
    assert scene.layer_digest(direct) == other.layer_digest(direct) and scene.digest != other.digest
    assert scene.layer_digest(reflected) != other.layer_digest(reflected)
    left = {each.what for each in scene.left_out}
    assert "albedos that views choose" in left


def test_grey_colours_need_one_channel(tmp_path: Path) -> None:
    save(tmp_path / "v.nrrd", BALL)
    save(tmp_path / "c.nrrd", BALL)
    assert scene_of(tmp_path, f'{OWN}\nmap = "grey"').plan.layers[-1].channels == 1
    assert scene_of(tmp_path).plan.layers[-1].channels == 3


def test_cuts_and_other_light_keep_the_colours(tmp_path: Path) -> None:
    save(tmp_path / "v.nrrd", BALL)
    save(tmp_path / "c.nrrd", BALL)
    scene = scene_of(tmp_path)
    written = scene_of(tmp_path, more='cut = "z>7"')
    assert cut_open(scene, "z>7", "cut").bake_digest == written.bake_digest
    assert under(scene, "studio", "lit").surfaces.colours is scene.surfaces.colours


def test_workers_elsewhere_get_the_colours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    save(tmp_path / "v.nrrd", BALL)
    save(tmp_path / "c.nrrd", BALL)
    scene = scene_of(tmp_path)
    store = Store(tmp_path / "store")
    assets = send_assets(scene, store)
    source, volume = receive_assets(scene.source, assets, store)
    made = build_scene(source, volume=volume, colours=receive_colours(assets, store))
    assert (
        made.bake_digest == scene.bake_digest
        and colours_of(made).scale.anchors == colours_of(scene).scale.anchors
    )


MISTAKES = [
    ({}, "", SceneError, "need a file, or of = 'gradient'"),
    ({}, 'file = "c.nrrd"\nof = "gradient"', SceneError, "need a file, or of = 'gradient'"),
    ({}, 'of = "height"', SceneError, "is not one of gradient, curvature"),
    (
        {},
        'file = "c.nrrd"\nmap = "jet"',
        SceneError,
        "one of viridis, magma, cividis, coolwarm, grey",
    ),
    ({}, 'file = "c.nrrd"\nrange = [9, 3]', SceneError, r"two ascending numbers\.$"),
    ({}, 'file = "c.nrrd"\ncolours = [[1, 0, 0]]', SceneError, "is not a list of 2 to 255 albedos"),
    (
        {},
        'file = "c.nrrd"\ncolours = [[1, 0, 0], [2, 0, 0]]',
        SceneError,
        "is not a list of 2 to 255 albedos",
    ),
    (
        {},
        'file = "c.nrrd"\nmap = "grey"\ncolours = [[0, 0, 0], [1, 0, 0]]',
        SceneError,
        "leave one out",
    ),
    ({}, 'file = "c.nrrd"\ntint = 3', SceneError, "sets tint, unknown here"),
    (
        {},
        'file = "c.nrrd"\n[[volumes]]\nuse = "colour"\nof = "gradient"',
        SceneError,
        "2 volumes of colour: give one",
    ),
    ({}, 'file = "n.nrrd"', VolumeError, "n.nrrd"),
    ({"c": BALL[:5]}, 'file = "c.nrrd"\nrange = [0, 1]', None, ""),
    (
        {"v": (BALL, np.eye(4)), "c": BALL[:5]},
        'file = "c.nrrd"',
        SceneError,
        "one does not say where it lies",
    ),
]


@pytest.mark.parametrize(("files", "table", "error", "message"), MISTAKES)
def test_mistakes_with_colours_are_told(
    tmp_path: Path, files: dict[str, Any], table: str, error: type[IsogiError] | None, message: str
) -> None:
    for name, given in {"v": BALL, "c": BALL, **files}.items():
        save(tmp_path / f"{name}.nrrd", *(given if isinstance(given, tuple) else (given,)))
    if error is None:
        assert np.isnan(values_of(scene_of(tmp_path, f'use = "colour"\n{table}'))).any(), (
            "it is smaller"
        )
        return
    with pytest.raises(error, match=message):
        scene_of(tmp_path, f'use = "colour"\n{table}')


@pytest.mark.parametrize("more", ["albedo = 0.5", "albedos = [0, 0.9]"])
def test_an_albedo_beside_colours_is_refused(tmp_path: Path, more: str) -> None:
    save(tmp_path / "v.nrrd", BALL)
    with pytest.raises(SceneError, match="has its albedo from 'gradient': leave out albedo"):
        scene_of(tmp_path, 'use = "colour"\nof = "gradient"', more)


def test_metal_cannot_have_colours(tmp_path: Path) -> None:
    save(tmp_path / "v.nrrd", BALL)
    table = 'use = "colour"\nof = "gradient"\n[shine]\nkind = "{}"'
    with pytest.raises(SceneError, match="choose plastic"):
        scene_of(tmp_path, table.format("metal"))
    with pytest.raises(ViewError, match="choose plastic"):
        scene_of(tmp_path, table.format("plastic")).surfaces.shine_for(Shine("metal"))
