"""First isovalues of fields whose histogram has no two classes: orbitals, densities, maps."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.files.formats.chemistry.levels import level_in
from isogi_core.files.scene_file import find_source
from isogi_core.model.volume import make_volume
from isogi_core.plan.assembly import build_scene, load_scene, otsu
from isogi_core.plan.starts import Start, find_start
from isogi_core.plan.variants import at_both_signs, cut_open, smoothed_by

X, Y, Z = np.mgrid[-1:1:32j, -1:1:32j, -1:1:32j].transpose(0, 3, 2, 1)
R = np.sqrt(X**2 + Y**2 + Z**2)
ORBITAL = (X * np.exp(-8.0 * R)).astype(np.float32)
DENSITY = (np.exp(-12.0 * R) * 80.0 + np.exp(-3.0 * R) * 0.5).astype(np.float32)


def start_of(field: np.ndarray) -> Start | None:
    volume = make_volume(field)
    return find_start(volume, otsu(*volume.histogram()))


def test_an_orbital_starts_with_both_lobes(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", ORBITAL)
    scene = load_scene(tmp_path / "p.npy")
    squares = ORBITAL.astype(float) ** 2
    inside = squares[np.abs(ORBITAL) > scene.isovalue].sum() / squares.sum()
    assert abs(inside - 0.85) < 0.02
    assert [each.isovalue for each in scene.surfaces.pinned] == [-scene.isovalue]
    assert scene.surfaces.albedo[2] > scene.surfaces.albedo[0]
    assert scene.surfaces.pinned[0].albedo[0] > scene.surfaces.pinned[0].albedo[2]
    assert "both signs" in scene.volume.orientation.notes[-1]


def test_the_negative_lobe_has_its_own_colour(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", ORBITAL)
    scene = load_scene(tmp_path / "p.npy", isovalue=-0.01)
    assert scene.surfaces.pinned[0].isovalue == 0.01
    assert scene.surfaces.albedo[0] > scene.surfaces.albedo[2]


@pytest.mark.parametrize(
    "setting",
    [{"albedo": 0.5}, {"isovalue": 0}, {"rotating": True}, {"isovalues": [-0.01, 0.01]}],
)
def test_a_scene_that_says_its_surface_keeps_it(tmp_path: Path, setting: dict[str, Any]) -> None:
    np.save(tmp_path / "p.npy", ORBITAL)
    scene = load_scene(tmp_path / "p.npy", **setting)
    assert not scene.surfaces.pinned
    if setting.keys() & {"albedo", "rotating"}:
        assert (
            f"isovalue = {-scene.isovalue:g} pins the other" in scene.volume.orientation.notes[-1]
        )


def test_a_peaked_density_starts_by_its_mass() -> None:
    start = start_of(DENSITY)
    assert start is not None
    assert not start.signed
    share = DENSITY[start.isovalue < DENSITY].sum(dtype=float) / DENSITY.sum(dtype=float)
    assert abs(share - 0.85) < 0.02


def test_a_given_isovalue_replaces_the_chosen_one(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", DENSITY)
    source = load_scene(tmp_path / "d.npy").source
    assert source.found and find_source(source, {"target_error": 0.1}).found
    given = build_scene(find_source(source, {"isovalue": 0.4}))
    assert (given.isovalue, given.source.found) == (0.4, False)


@pytest.mark.parametrize(
    "field",
    [
        np.sin(6 * X) * np.cos(6 * Y) + np.sin(6 * Y) * np.cos(6 * Z) + np.sin(6 * Z),  # a gyroid
        R - 0.6,  # distances to a ball
        np.where(R < 0.3, 5.0, 0.0),  # a pocket in an empty grid
        np.clip(0.7 - R, 0.0, 0.2),  # a ball with a soft edge
        (127 * ORBITAL / ORBITAL.max()).astype(np.int8),
    ],
)
def test_other_fields_start_at_the_threshold(field: np.ndarray) -> None:
    assert start_of(field) is None


def test_a_map_starts_by_its_deviations(tmp_path: Path) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    noise = np.random.default_rng(3).normal(0.0, 0.1, R.shape)
    density = (np.exp(-(R**2) / 0.1) + noise).astype(np.float32)
    with mrcfile.new(tmp_path / "map.mrc") as made:
        made.set_data(density)
        made.header.ispg = 1
    scene = load_scene(tmp_path / "map.mrc")
    assert scene.isovalue == pytest.approx(density.mean() + 3.0 * density.std(), rel=0.01)
    assert "3 σ above the mean" in scene.volume.orientation.notes[-1]


def test_a_map_of_differences_starts_with_both_signs(tmp_path: Path) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    rng = np.random.default_rng(3)
    noise = rng.normal(0.0, 0.1, R.shape)
    blobs = np.exp(-((X - 0.4) ** 2 + Y**2 + Z**2) / 0.02)
    for name, other in (("difference", -blobs[..., ::-1]), ("density", 0.0 * blobs)):
        with mrcfile.new(tmp_path / f"{name}.mrc") as made:
            made.set_data((blobs + other + noise).astype(np.float32))
            made.header.ispg = 19
    difference = load_scene(tmp_path / "difference.mrc")
    assert [each.isovalue for each in difference.surfaces.pinned] == [-difference.isovalue]
    assert "3 σ" in difference.volume.orientation.notes[-1]
    density = load_scene(tmp_path / "density.mrc")
    assert not density.surfaces.pinned
    assert "1.5 σ" in density.volume.orientation.notes[-1]


def test_the_isovalue_of_a_file_comes_first(tmp_path: Path) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.new(tmp_path / "map.mrc") as made:
        made.set_data(DENSITY)
        made.add_label("contour level: 0.25")
    assert load_scene(tmp_path / "map.mrc").isovalue == 0.25


def test_comments_name_isovalues() -> None:
    psi4 = "Property: Psi_a. Isocontour range for 85% of the density: (0.0300541,-0.030054)"
    assert level_in(psi4) == 0.0300541
    assert level_in("a level of theory, 6-31G") is None
    assert level_in("Isovalue = 2.5e-3") == 2.5e-3


def test_another_isovalue_moves_both_lobes(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", ORBITAL)
    scene = load_scene(tmp_path / "p.npy")
    moved = at_both_signs(scene, 0.5 * scene.isovalue)
    assert moved.isovalue == 0.5 * scene.isovalue
    assert [each.isovalue for each in moved.surfaces.pinned] == [-moved.isovalue]
    assert moved.volume is scene.volume
    named = load_scene(tmp_path / "p.npy", surfaces=[{"isovalue": -0.02}])
    assert at_both_signs(named, 0.01) is named


def test_a_start_gives_way_to_values_that_are_gone(tmp_path: Path) -> None:
    lobes = np.where(R < 0.2, np.sign(X), 0.0) * (1.0 - 5.0 * R)
    np.save(tmp_path / "p.npy", lobes.astype(np.float32))
    scene = load_scene(tmp_path / "p.npy")
    assert scene.surfaces.pinned
    smooth = smoothed_by(scene, 6.0, "smooth")
    assert smooth.volume.value_range[1] < scene.isovalue
    assert smooth.isovalues == scene.isovalues
    slight = smoothed_by(scene, 0.3, "slight")
    assert slight.source.document["surfaces"] == scene.source.document["surfaces"]


@pytest.mark.parametrize(("sigma", "signs"), [(2.0, 1), (6.0, 0)])
def test_a_smoothed_scene_is_built_by_its_document(
    tmp_path: Path, sigma: float, signs: int
) -> None:
    """By other processes, and for its cuts: the document has the start of the smoothed values."""
    lobes = np.where(R < 0.2, np.sign(X), 0.0) * (1.0 - 5.0 * R)
    np.save(tmp_path / "p.npy", lobes.astype(np.float32))
    scene = load_scene(tmp_path / "p.npy")
    smooth = smoothed_by(scene, sigma, "smooth")
    assert smooth.volume.value_range[1] < scene.isovalue
    assert len(smooth.surfaces.pinned) == signs
    received = {key: value for key, value in smooth.source.document.items() if key != "smooth"}
    for again in (
        build_scene(smooth.source),
        build_scene(replace(smooth.source, document=received), volume=smooth.volume),
        smoothed_by(scene, sigma, "smooth", smooth.volume),
    ):
        assert again.bake_digest == smooth.bake_digest
    assert again.source == smooth.source
    assert len(cut_open(smooth, "x<20", "cut").surfaces.pinned) == signs
