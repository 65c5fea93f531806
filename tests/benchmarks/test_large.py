"""The benchmark of large volumes on a small one that counts as large: real processes render and serve it."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.large import main
from isogi_core.files.voxels import read_voxels


@pytest.mark.slow
def test_a_volume_beyond_the_budget_is_rendered_and_served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    small = ("--size", "80", "--pixels", "24", "--seconds", "2", "--folder", str(tmp_path), "--json")
    done = CliRunner().invoke(main, small, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["disk: copies, MiB"] == pytest.approx(80**3 * 4 / 2**20, rel=0.01)
    assert found["serve: first frame after, s"] >= found["serve: ready after, s"] > 0
    for process in ("render: main", "serve: main", "serve: worker"):
        assert found[f"{process}: RssAnon, MiB"] > 0 < found[f"{process}: RssFile, MiB"]
        assert found[f"{process}: processor, s"] > 0
    assert (tmp_path / "gyroid-80.png").read_bytes().startswith(b"\x89PNG")
    (copy,) = {path.stat().st_ino: path for path in (tmp_path / "copies").glob("*.voxels")}.values()
    voxels, facts = read_voxels(copy) or pytest.fail("the copy cannot be read")
    assert voxels.shape == (80, 80, 80) and facts["dtype"] == "uint16"
