"""``isogi convert``: what it writes opens as what it was made of, and what it says."""

import json
from pathlib import Path

import numpy as np
import pytest

from isogi_core.plan.assembly import load_scene
from server.cli.command import run
from tests.files.formats.phantom import letter


def test_a_converted_volume_opens_as_it_was(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "a #1.npy", letter())
    out = tmp_path / "a.ome.zarr"
    assert run(["convert", str(tmp_path / "a #1.npy"), "-o", str(out)]) == 0
    assert "16 × 20 × 12 voxels of int16" in capsys.readouterr().out
    assert load_scene(out).volume.digest == load_scene(tmp_path / "a #1.npy").volume.digest
    assert run(["convert", str(tmp_path / "a #1.npy"), "-o", str(out)]) == 2
    assert "already: remove it" in capsys.readouterr().err


def test_bare_voxels_and_a_step_in_time_are_converted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "v.raw").write_bytes(letter().astype(">i2").tobytes())
    raw = [
        "convert",
        str(tmp_path / "v.raw"),
        "--raw",
        "16x20x12,int16,big",
        "-o",
        str(tmp_path / "v.ome.zarr"),
        "--json",
    ]
    assert run(raw) == 0
    assert json.loads(capsys.readouterr().out)["read_as"].startswith("bare voxels of int16, big-endian")
    np.save(tmp_path / "t.npy", np.stack([letter(), letter() + 1]))
    assert run(["convert", f"{tmp_path / 't.npy'}#time=1", "-o", str(tmp_path / "t.ome.zarr")]) == 0
    assert load_scene(tmp_path / "t.ome.zarr").volume.value_range[0] == 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["demo:casting", "-o", "v.ome.zarr"], "is no volume of a file"),
        (["v.npy", "-o", "v.nrrd"], "ends in .ome.zarr"),
        (["absent.npy", "-o", "v.ome.zarr"], "There is no file"),
    ],
)
def test_what_cannot_be_converted_is_told(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["convert", *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_options_follow_a_file_with_any_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a#1.npy", "a %41.npy", "æ.npy"):
        np.save(tmp_path / name, letter())
        assert run(["inspect", str(tmp_path / name), "--axes", "raw", "--solid", "below", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["solid"] == "below"
