"""Progress bars: the time left that they show, and the bar of a large volume that is opened."""

import os
import re
from pathlib import Path
from types import SimpleNamespace

import nrrd
import numpy as np
import pytest

from isogi_core.files.mappings import budget
from isogi_core.files.volume_copies import copies_folder, most_bytes
from isogi_server import clocks, progress
from isogi_server.progress import Progress, open_scene
from isogi_server.settings import Settings
from isogi_worker.progress import TimeLeft
from tests.server.sockets import wait_for


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands at its one number; of this module alone, as servers of other tests live
    by the true one.
    """
    now = [100.0]
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_a_clock_runs_where_nothing_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(clocks, "REDRAW_SECONDS", 0.2)
    with Progress() as bar:
        bar.begin("compiling")
        assert "compiling, 00:00" in capsys.readouterr().err, "drawn at once"
        assert wait_for(lambda: "compiling, 00:01" in capsys.readouterr().err, 20)
        bar.name("looking", "view")
        bar.show(1, 2)
        assert "1/2 views, 00:00" in capsys.readouterr().err
        assert wait_for(lambda: "1/2 views, 00:01" in capsys.readouterr().err, 20)


def test_long_work_has_a_clock_before_its_first_progress(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(clocks, "REDRAW_SECONDS", 0.1)
    monkeypatch.setattr(clocks, "watched", lambda: True)
    with Progress("reading", "slab", soon="opening the file") as bar:
        assert capsys.readouterr().err == "", "it may be over sooner"
        assert wait_for(lambda: "opening the file, 00:00" in capsys.readouterr().err, 20)
        bar.show(1, 2)
        assert "1/2 slabs" in capsys.readouterr().err
    with clocks.waiting("starting"):
        assert wait_for(lambda: "starting, 00:00" in capsys.readouterr().err, 20)


def test_a_time_left_that_is_over_is_said_to_be_longer(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with Progress("baking", "chunk") as bar:
        bar.show(1, 9, TimeLeft(5.0, 10.0, 20.0))
        assert "about 10 s left (5 s to 20 s)" in capsys.readouterr().err
        clock[0] += 6.0
        bar.show(1, 9, TimeLeft(5.0, 10.0, 20.0))
        assert "about 4 s left" in capsys.readouterr().err, "the estimate stands, time passes"
        clock[0] += 5.0
        bar.show(1, 9)
        assert "longer than expected, about 19 s left" in capsys.readouterr().err


def test_each_name_has_a_bar_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress() as bar:
        for what, done in (("looking", 1), ("looking", 2), ("baking", 1)):
            bar.name(what, "view")
            bar.show(done, 2, TimeLeft(61.0, 200.0, 7300.0), "still at it")
    error = capsys.readouterr().err
    assert "looking: 100%" in error and "2/2 views" in error
    assert "baking:  50%" in error and "still at it about 3.3 min left (1 min to 2 h)" in error
    assert error.count("\n") == 2


def test_the_pace_so_far_says_how_much_time_is_left(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with Progress("checking", "object") as bar:
        clock[0] += 30.0
        bar.count(1, 3)
    assert "1/3 objects" in (error := capsys.readouterr().err) and "about 1 min left" in error


def test_nothing_is_drawn_without_progress(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("checking", "object"):
        pass
    assert capsys.readouterr().err == ""


@pytest.fixture
def volume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of half a megabyte of voxels; the environment is as it was once the test ends."""
    for name in ("ISOGI_VOLUME_MB", "ISOGI_VOLUME_CACHE", "ISOGI_VOLUME_CACHE_MB"):
        monkeypatch.setenv(name, os.environ.get(name, ""))
        monkeypatch.delenv(name)
    nrrd.write(
        str(tmp_path / "v.nrrd"), np.random.default_rng(1).random((50, 52, 54)), index_order="C"
    )
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


def test_a_small_volume_has_neither_bar_nor_copy(
    volume: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    open_scene(volume, Settings(volume_cache=str(volume.parent / "copies")))
    assert capsys.readouterr().err == "" and not (volume.parent / "copies").exists()
