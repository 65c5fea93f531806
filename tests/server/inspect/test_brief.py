"""``isogi inspect`` in brief: the lines that a person needs first."""

from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.plan.assembly import load_scene
from server.cli.command import run
from server.inspect.inspection import inspection_schema
from server.inspect.text import LEAD_COLUMNS


def brief_of(capsys: pytest.CaptureFixture[str], target: Path) -> dict[str, str]:
    """The lines of a brief inspection, by their names."""
    assert run(["inspect", str(target)]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert last.startswith("--plan shows") and len(lines) <= 12 and max(map(len, lines)) <= 100
    return {line[:LEAD_COLUMNS].strip(): line[LEAD_COLUMNS:] for line in lines}


def test_ten_lines_say_what_matters(capsys: pytest.CaptureFixture[str], small_scene: Path) -> None:
    told = brief_of(capsys, small_scene)
    scene = load_scene(small_scene)
    own = next(each for each in inspection_schema(scene).stiffness.surfaces if each.isovalue == 0.5)
    light = 2 * own.cells * 0.5**2 * scene.plan.bytes_per_texel / 1e6
    assert told["volume"] == "small, 24 × 20 × 16 voxels of float32, spacing 1 × 1 × 1"
    assert told["values"].endswith(", no holes")
    assert told["isovalue"].startswith("0.5, as the scene says") and told["isovalue"].endswith("solid above")
    assert told["surface"].startswith(f"{own.cells:,} cells at 0.5")
    assert told["light"].startswith("constant, sky;")
    assert told["cost"].startswith(f"about {light:.2g} MB of light for this surface")


def test_ten_lines_tell_of_holes_and_marks(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    array = np.random.default_rng(3).random((12,) * 3).astype(np.float32)
    array[:2], array[5:7, 5:7, 5:7] = -9999.0, np.nan
    nrrd.write(str(tmp_path / "a.nrrd"), array, index_order="C")
    told = brief_of(capsys, tmp_path / "a.nrrd")
    assert told["values"].endswith("8 voxels are no numbers: holes")
    assert "proposed from the values" in told["isovalue"]
    assert told["missing"].startswith("Many voxels have the value -9999")


def test_ten_lines_tell_of_no_surface(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "a.nrrd"), np.ones((4, 5, 6), np.float32), index_order="C")
    told = brief_of(capsys, tmp_path / "a.nrrd")
    assert told["surface"] == "0 cells at 1"
    assert told["nothing"].startswith("No surface passes any cell at 1")
    assert "0 MB of light for this surface" in told["cost"]


def test_series_and_segmentations_have_no_more_lines(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    z, y, x = np.indices((12,) * 3)
    series = np.stack([np.hypot(z - 5, y - 5) + x, z + y + 0.0]).astype(np.float32)
    np.save(tmp_path / "a.npy", series)
    (tmp_path / "a.toml").write_text('volume = "a.npy#time=0"\n')
    assert brief_of(capsys, tmp_path / "a.toml")["volume"].endswith(", step 0 of 0 to 1")
    parts = np.zeros((12,) * 3, np.uint8)
    parts[2:10, 2:10, 2:10] = np.arange(1, 9)[:, None, None]
    named = {f"Segment{n}_LabelValue": str(n + 1) for n in range(8)}
    named |= {f"Segment{n}_Name": f"a part with a long name, number {n}" for n in range(8)}
    nrrd.write(str(tmp_path / "parts.seg.nrrd"), parts, named, index_order="C")
    assert "number 0" in brief_of(capsys, tmp_path / "parts.seg.nrrd")["light"]
