"""What the command line tells of large volumes: a bar while a copy is made, and settings that reach the core."""

import os
import re
from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.files.copies import copies_folder, most_bytes
from isogi_core.files.resident import budget
from server.opening import open_scene
from server.settings import Settings


@pytest.fixture
def volume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of half a megabyte of voxels; the environment is as it was once the test ends."""
    for name in ("ISOGI_VOLUME_MB", "ISOGI_VOLUME_CACHE", "ISOGI_VOLUME_CACHE_MB"):
        monkeypatch.setenv(name, os.environ.get(name, ""))
        monkeypatch.delenv(name)
    nrrd.write(str(tmp_path / "v.nrrd"), np.random.default_rng(1).random((50, 52, 54)), index_order="C")
    return tmp_path / "v.nrrd"


def test_settings_reach_the_core_and_a_bar_tells_the_time_left(
    volume: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = volume.parent / "copies"
    settings = Settings(volume_mb=1, volume_cache=str(folder), volume_cache_mb=7)
    first = open_scene(volume, settings)
    assert (budget(), copies_folder(), most_bytes()) == (1 << 20, folder, 7 << 20)
    told = capsys.readouterr().err
    assert re.search(r"reading the volume: 100%.*150/150 steps.*about \S+ \S+ left", told), told
    again = open_scene(volume, settings)
    assert capsys.readouterr().err == ""
    assert again.volume.digest == first.volume.digest and len(list(folder.glob("*.voxels"))) == 2


def test_a_small_volume_has_neither_bar_nor_copy(volume: Path, capsys: pytest.CaptureFixture[str]) -> None:
    open_scene(volume, Settings(volume_cache=str(volume.parent / "copies")))
    assert capsys.readouterr().err == "" and not (volume.parent / "copies").exists()
