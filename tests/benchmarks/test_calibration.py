"""The calibration of frames' errors, on one small scene."""

import numpy as np

from benchmarks.accuracy.calibration import Told, frames_of, table
from benchmarks.accuracy.scenes import load_calibrated
from tests.scale import COMPILED


@COMPILED
def test_frames_are_as_wrong_as_they_say() -> None:
    name = "orbital, sky, coloured"
    ((_, scene),) = load_calibrated([name])
    frames = list(frames_of(name, scene, 12, 64))
    assert len(frames) == 2 * 2 * 4, "two views, two turns, 16 and 64 samples and two targets"
    ratios = np.array([told.ratio for told in frames])
    assert 0.75 < np.median(ratios) < 1.33 and ((ratios > 0.5) & (ratios < 2.0)).all()
    assert np.mean([told.covered for told in frames]) > 0.8


def test_the_table_has_a_line_for_each_and_one_for_all() -> None:
    frames = [Told("box", 0, 0, light, 0.02, 0.02 / ratio, ratio, 0.95) for light, ratio in (("16", 1.0), ("64", 2.0))]
    lines = table(frames).splitlines()[2:]
    assert [line.split(" | ")[0] for line in lines] == ["| box", "| all, 16", "| all, 64", "| all"]
    assert lines[-1] == "| all | 2 | 1.50 | 50% | 1.00 … 2.00 | 95.0% |"
