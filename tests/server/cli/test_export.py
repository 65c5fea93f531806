"""``isogi export`` and ``isogi convert``: light in files of other tools, and volumes in files of
isogi.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from isogi_core.plan.assembly import load_scene
from isogi_server.cli.export import size_of
from tests.files.formats.phantom import letter
from tests.server.asking import Told

pytestmark = pytest.mark.usefixtures("inline")


@pytest.mark.slow
def test_light_is_written_to_files_of_other_tools(
    small_scene: Path, tmp_path: Path, told: Told
) -> None:
    scene = tmp_path / "small.toml"
    text = small_scene.read_text().replace("small.nrrd", str(small_scene.parent / "small.nrrd"))
    scene.write_text(text.replace("lattice = 0.5", "lattice = 1"))
    for name, key in (
        ("a.glb", "triangles"),
        ("a.usdz", "triangles"),
        ("a.vti", "texels"),
        ("a.zarr", "texels"),
    ):
        facts = json.loads(
            told("export", scene, "-o", tmp_path / name, "--store", tmp_path / "store", "--json")
        )
        assert (
            facts[key] > 500
            and facts["final"] == 1.0
            and facts["bytes"] == size_of(tmp_path / name)
        )


def test_turns_of_the_light_are_numbered_files(
    small_scene: Path, tmp_path: Path, told: Told
) -> None:
    arguments = ["export", small_scene, "--store", tmp_path / "store", "--json"]
    for name, yaw in (("a.ply", "0:180:90"), ("b.ply", "90")):
        facts = json.loads(told(*arguments, "-o", tmp_path / name, "--yaw", yaw))
    names = ["a-1.ply", "a-2.ply", "a-3.ply", "b.ply"]
    assert sorted(path.name for path in tmp_path.glob("*.ply")) == names and facts["files"] == [
        str(tmp_path / "b.ply")
    ]
    first, turned, back, single = ((tmp_path / name).read_bytes() for name in names)
    assert turned == single and len({first, turned, back}) == 3


def test_a_converted_volume_opens_as_it_was(tmp_path: Path, told: Told) -> None:
    np.save(tmp_path / "a #1.npy", letter())
    command = ["convert", tmp_path / "a #1.npy", "-o", tmp_path / "a.ome.zarr"]
    assert "16 × 20 × 12 voxels of int16" in told(*command)
    assert (
        load_scene(tmp_path / "a.ome.zarr").volume.digest
        == load_scene(tmp_path / "a #1.npy").volume.digest
    )
    assert "already: remove it" in told(*command, status=2)


def test_bare_voxels_and_a_step_in_time_are_converted(tmp_path: Path, told: Told) -> None:
    (tmp_path / "v.raw").write_bytes(letter().astype(">i2").tobytes())
    raw = told(
        "convert",
        tmp_path / "v.raw",
        "--raw",
        "16x20x12,int16,big",
        "-o",
        tmp_path / "v.ome.zarr",
        "--json",
    )
    assert json.loads(raw)["read_as"].startswith("bare voxels of int16, big-endian")
    np.save(tmp_path / "t.npy", np.stack([letter(), letter() + 1]))
    told("convert", f"{tmp_path / 't.npy'}#time=1", "-o", tmp_path / "t.ome.zarr")
    assert load_scene(tmp_path / "t.ome.zarr").volume.value_range[0] == 1.0


@pytest.mark.parametrize("name", ["a#1.npy", "a %41.npy", "æ.npy"])
def test_options_follow_a_file_with_any_name(tmp_path: Path, told: Told, name: str) -> None:
    np.save(tmp_path / name, letter())
    assert (
        json.loads(told("inspect", tmp_path / name, "--axes", "raw", "--solid", "below", "--json"))[
            "solid"
        ]
        == "below"
    )
