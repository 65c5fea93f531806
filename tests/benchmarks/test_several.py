"""The benchmark of several surfaces: which texels a move lit anew, and slides that are kept."""

from pathlib import Path

import numpy as np

from benchmarks.accuracy.kept import Kept
from benchmarks.accuracy.surfaces import Found, Slide, baked


def test_new_texels_are_told_from_those_refined() -> None:
    own, other, fresh = Path("one/c/0"), Path("two/c/0"), Path("one/c/1")
    before = {own: np.array([0, 1, 2, 0], np.uint8), other: np.array([3, 0, 0, 0], np.uint8)}
    after = {own: np.array([1, 1, 3, 0], np.uint8), other: np.array([3, 0, 2, 2], np.uint8)}
    after[fresh] = np.array([0, 0, 4, 0], np.uint8)
    assert baked({"one"}, before, after) == (2, 2, 1)
    assert baked({"one"}, after, after) == (0, 0, 0)


def test_slides_are_read_back_as_they_were_kept(tmp_path: Path) -> None:
    view = Found("bone at 110", 0.01, 0.05, 0.012, True, 2, 3, 1, 4096, 640, 2.5)
    slide = Slide("skin", (view, view), view)
    Kept(tmp_path / "slides", Slide.of).put(slide)
    again = Kept(tmp_path / "slides", Slide.of)
    assert again.get("skin") == slide and again.get("bone") is None
