"""Total errors told and true, on one small view; and the volumes by formula that they are looked at on."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.accuracy.filtering import filtering
from benchmarks.accuracy.formulas import KINDS, made
from benchmarks.accuracy.furnace import furnace
from benchmarks.accuracy.totals import totals
from tests.benchmarks.parts import figures


def test_a_picture_is_as_wrong_as_it_says_and_reaches_its_target(tmp_path: Path) -> None:
    """Views that are kept are not measured again."""
    kept = tmp_path / "kept.jsonl"
    asked = "--size", "24", "--paths", "256", "--only", "nested shells 1 under constant light", "--kept", str(kept)
    found = figures(totals, *asked)
    lines = kept.read_text()
    assert figures(totals, *asked) == found and kept.read_text() == lines and len(lines.splitlines()) == 2
    assert (found["views"], found["final"]) == (2, 1.0)
    assert 0.5 < found["told / true, median"] < 2.0
    assert 0.0 < found["worst true error told as final"] <= 0.025


def test_filtered_light_is_nearer_to_the_truth() -> None:
    case = "nested shells 1 under constant light"
    found = figures(filtering, "--size", "24", "--paths", "256", "--only", case)
    assert len(found) == 4
    assert found[f"{case}, 16 samples: filtered / alone"] < 0.95
    assert found[f"{case}, 16 samples in a quarter: provisional"] < 0.02


def test_a_white_furnace_is_white() -> None:
    found = figures(furnace, "--size", "24", "--paths", "32", "--only", "coarse shell 1")
    assert found["volumes"] == 1 and found["worst mean, off by"] < 0.005 and found["worst pixel, off by"] < 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_volumes_by_formula_have_a_surface(kind: str) -> None:
    volume, isovalue = made(kind, 1)
    low, high = volume.value_range
    assert low < isovalue < high and np.isfinite(volume.voxels).all()
    inside = float((volume.voxels > volume.normalise_isovalue(isovalue)).mean())
    assert 0.002 < inside < 0.998


def test_a_seed_makes_the_same_volume_and_another_another() -> None:
    one, same, other = (made("coarse shell", seed)[0].voxels for seed in (1, 1, 2))
    assert np.array_equal(one, same) and not np.array_equal(one, other)
