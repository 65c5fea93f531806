"""An isovalue that slides in a room: errors and jumps of made-up pictures against closed forms, and
the part itself.
"""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.accuracy.sliding import SURFACE, Shot, errors_of, jump, kinds, sliding
from tests.benchmarks.parts import figures

SHAPE = (10, 12)
ROOM = """
volume = "demo:orbital"
room = "cornell"
isovalues = [0.03, 0.04]
isovalue = 0.03
lattice = 0.5
bounces = 1
target_error = 0.1
"""


def seen(light: np.ndarray, error: float = 0.0, surface: int = 5) -> Any:
    """What a frame tells of grey ``light``: ``surface`` rows show the isosurface, and the others
    the wall number 2.
    """
    rows = np.arange(light.size).reshape(SHAPE)
    walls = SimpleNamespace(pixels=rows[surface:].ravel(), numbers=np.full(rows[surface:].size, 2))
    told = np.full(SHAPE, error)
    return SimpleNamespace(
        radiance=np.repeat(light[..., None], 3, axis=2),
        state=np.full(SHAPE, 3),
        error=told,
        gbuffer=SimpleNamespace(pixels=rows[:surface].ravel(), walls=walls),
        total=SimpleNamespace(likely=0.01),
        final=True,
    )


def shot(
    frame: np.ndarray, truth: np.ndarray, error: float = 0.0, surface: int = 5, half: float = 0.0
) -> Shot:
    """Pictures of these; that of ``half`` of the truth's paths is so much brighter."""
    return Shot(0.0, seen(frame), seen(truth), seen(truth, error, surface), seen(truth + half))


def test_pixels_are_told_apart_by_what_they_show() -> None:
    found = kinds(seen(np.ones(SHAPE)))
    assert (found[:5] == SURFACE).all() and (found[5:] == SURFACE + 3).all()


def test_errors_are_of_all_and_of_the_isosurface() -> None:
    light = np.full(SHAPE, 2.0)
    wrong = np.zeros(SHAPE)
    wrong[:5] = 0.1
    found = errors_of(shot(light + wrong, light))
    assert found.surface == pytest.approx(0.05) and found.rmse == pytest.approx(0.05 / np.sqrt(2.0))
    assert (found.fresh_rmse, found.noise) == (0.0, 0.0) and found.apart == pytest.approx(
        found.rmse
    )
    noisy = errors_of(shot(light + 0.1, light, 0.03))
    assert noisy.rmse == pytest.approx(np.sqrt(0.05**2 - 0.03**2)) and noisy.noise == pytest.approx(
        0.03
    )


def test_jumps_are_of_pixels_that_show_the_same_in_both() -> None:
    light = np.full(SHAPE, 1.0)
    step = np.zeros(SHAPE)
    step[5] = 50.0
    found = jump(shot(light, light), shot(light + step, light + step, surface=6))
    assert (found.frames, found.truth, found.unlike) == (0.0, 0.0, 0.0), (
        "this row was a wall before"
    )


def test_a_jump_of_the_truth_is_none_of_the_frames() -> None:
    rng = np.random.default_rng(2)
    light = np.full(SHAPE, 1.0)
    change = 0.2 * rng.standard_normal(SHAPE)
    flicker = 0.1 * rng.standard_normal(SHAPE)
    mean = (light + change / 2.0).mean()
    found = jump(shot(light, light), shot(light + change + flicker, light + change))
    assert found.truth == pytest.approx(np.sqrt((change**2).mean()) / mean)
    assert found.unlike == pytest.approx(np.sqrt((flicker**2).mean()) / mean)
    assert found.above == pytest.approx(
        np.sqrt(((change + flicker) ** 2).mean()) / mean - found.truth
    )
    calmer = jump(shot(light, light), shot(light, light + change))
    assert calmer.above == 0.0 and calmer.unlike == pytest.approx(calmer.truth)


def test_the_truths_jump_is_less_the_noise_of_its_change() -> None:
    light = np.full(SHAPE, 1.0)
    shared = jump(shot(light, light, half=0.2), shot(light, light + 0.05, half=0.2))
    assert shared.truth == pytest.approx(0.05 / 1.025)
    apart = jump(shot(light, light), shot(light, light + 0.05, half=0.03))
    assert apart.truth == pytest.approx(np.sqrt(0.05**2 - 0.03**2) / 1.025)


@pytest.mark.long
def test_a_slide_in_a_room(tmp_path: Path) -> None:
    scene = tmp_path / "orbital.toml"
    scene.write_text(ROOM)
    told = figures(sliding, str(scene), "--size", "16", "--frames", "2", "--paths", "64")
    found = {key.removeprefix("orbital: "): value for key, value in told.items()}
    assert found["frames"] == found["final"] == 2
    assert found["RMSE, largest, %"] < 10.0 and found["apart from a fresh bake, largest, %"] < 10.0
    assert found["told, largest, %"] <= 10.0 and found["the truth's jump, largest, %"] > 0.0
