"""The race to equal error: its errors and laws against closed forms, and one small run without and
with Mitsuba.
"""

import importlib.util
import tempfile
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from click import ClickException

from benchmarks.accuracy import mitsuba_race
from benchmarks.accuracy.equal_error import SURFACE, equal_error, likeness, scenes
from benchmarks.accuracy.errors import PowerLaw, relative_rmse, without
from benchmarks.accuracy.isogi_race import PictureSet, check
from benchmarks.common import mitsuba
from isogi_core.model.view import quaternion_from_angles
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_report.speed import make_renderer
from tests.benchmarks.parts import figures

TINY = (
    "demo:casting",
    "--size",
    "24",
    "--views",
    "2",
    "--turns",
    "2",
    "--checks",
    "2",
    "--samples",
    "64",
)


@pytest.fixture(autouse=True)
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    """There are no shared data."""
    monkeypatch.setenv("ISOGI_SHARED_DATA", str(tmp_path / "none"))


def casting() -> Scene:
    """The demo's casting, as it is raced."""
    return load_scene("demo:casting", **SURFACE)


def test_relative_rmse_is_of_the_luminance_of_counted_pixels() -> None:
    best = np.full((2, 2, 3), 2.0)
    picture = best + np.array([[0.2, -0.2], [9.0, 0.2]])[..., None]
    on = np.array([[True, True], [False, True]])
    assert relative_rmse(picture, best, on) == pytest.approx(0.1)


def test_noise_of_the_reference_is_taken_off() -> None:
    assert without(0.05, 0.03) == pytest.approx(0.04)
    assert without(0.03, 0.05) == 0.0


def test_a_power_law_is_found_and_turned_round() -> None:
    counts = (4, 16, 64)
    law = PowerLaw.fit(counts, [0.8 * n**-0.6 for n in counts])
    assert (law.scale, law.power) == pytest.approx((0.8, 0.6))
    assert law.count_for(0.8 * 300**-0.6) == 300
    assert law.count_for(5.0) == 1
    assert law.through(100, 0.1).count_for(0.1) == 100


def test_an_error_below_the_converged_noise_is_refused() -> None:
    best = mitsuba_race.Converged(np.ones((2, 2, 4)), 0.1, np.ones((2, 2), np.bool_))
    with pytest.raises(ClickException, match="below the noise"):
        mitsuba_race.measured(best, best.picture)


def test_a_closed_surface_is_seen_from_outside() -> None:
    scene = casting()
    with tempfile.TemporaryDirectory() as store:
        each = check(
            scene, [make_renderer(scene, store).render(PictureSet(scene, 24, 3, 3).view(1))], 8
        )[0]
    assert each.outside[each.best.on].mean() > 0.97
    assert not each.outside[~each.best.on].any()


def test_views_are_spread_evenly_and_picks_differ() -> None:
    pictures = PictureSet(casting(), 8, 36, 12)
    scene = pictures.scene
    towards = np.array([pictures.view(i).camera.eye for i in range(36)]) - np.array(
        scene.volume.centre
    )
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    cosines = towards @ towards.T - 2.0 * np.eye(36)
    assert np.degrees(np.arccos(cosines.max(axis=1))).min() > 17.0
    assert towards[:, 2].min() > 0.0
    assert towards.mean(axis=0) == pytest.approx([0.0, 0.0, 0.5], abs=0.03)
    for views, turns, count in ((36, 12, 6), (36, 5, 5), (3, 10, 3), (30, 30, 5)):
        picks = PictureSet(scene, 8, views, turns).picks(count)
        assert len({camera for camera, _ in picks}) == len({turn for _, turn in picks}) == count
    assert len(PictureSet(scene, 8, 2, 2).picks(9)) == 4


def test_without_mitsuba_our_side_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name == "mitsuba" else find(name, *a)
    )
    told = figures(equal_error, *TINY, "--paths", "32")
    found = {key.removeprefix("demo:casting: "): value for key, value in told.items()}
    assert found.pop("mitsuba") == "not installed"
    assert all(value >= 0.0 for value in found.values())
    assert {"isogi: one view, s", "isogi: whole set, s"} <= set(found)
    assert 0.01 < found["isogi: total error, all pixels"] < 0.4


def test_mitsuba_sees_the_light_turned_as_ours_does(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mitsuba")
    pytest.importorskip("skimage")
    if not mitsuba.usable(mitsuba_race.VARIANT):
        pytest.skip("Mitsuba's llvm variant finds no LLVM")
    monkeypatch.setattr(mitsuba_race, "CONVERGED", 64)
    scene = casting()
    view = replace(
        PictureSet(scene, 48, 3, 3).view(1), light=quaternion_from_angles(30.0, 60.0, 20.0)
    )
    with tempfile.TemporaryDirectory() as store:
        each = check(scene, [make_renderer(scene, store).render(view)], 64)[0]
    peer = mitsuba_race.Mitsuba(scene, PictureSet(scene, 48, 3, 3).view(0))
    best = peer.converge(view, each.best.on)
    other = peer.converge(
        replace(view, light=quaternion_from_angles(30.0, -60.0, 20.0)), each.best.on
    )
    assert likeness([each], [best])["picture 1: likeness, difference"] < 0.1
    assert likeness([each], [other])["picture 1: likeness, difference"] > 0.15
    peer.converge(view, each.best.on)
    reached = peer.reach("multijitter", best, 0.05)
    assert reached.error == pytest.approx(0.05, rel=0.25)


def test_without_shared_volumes_a_person_hears_it() -> None:
    with pytest.raises(ClickException, match="ISOGI_SHARED_DATA"):
        next(scenes(None, ()))
