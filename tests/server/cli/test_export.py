"""``isogi export``: an isosurface or a volume with its light in files, and what it refuses."""

import json
from pathlib import Path

import pytest

from server.cli.command import run
from server.cli.export import size_of

pytestmark = pytest.mark.usefixtures("inline")


@pytest.mark.slow
def test_light_is_written_to_files_of_other_tools(
    small_scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "small.toml"
    text = small_scene.read_text().replace("small.nrrd", str(small_scene.parent / "small.nrrd"))
    scene.write_text(text.replace("lattice = 0.5", "lattice = 1"))
    for name, key in (("a.glb", "triangles"), ("a.usdz", "triangles"), ("a.vti", "texels"), ("a.zarr", "texels")):
        arguments = ["export", scene, "-o", tmp_path / name, "--store", tmp_path / "store", "--json"]
        assert run([str(each) for each in arguments]) == 0
        facts = json.loads(capsys.readouterr().out)
        assert facts[key] > 500 and facts["final"] == 1.0 and facts["bytes"] == size_of(tmp_path / name)


def test_turns_of_the_light_are_numbered_files(
    small_scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["export", small_scene, "--store", tmp_path / "store", "--json"]
    for name, yaw in (("a.ply", "0:180:90"), ("b.ply", "90")):
        assert run([str(each) for each in (*arguments, "-o", tmp_path / name, "--yaw", yaw)]) == 0
        facts = json.loads(capsys.readouterr().out)
    names = ["a-1.ply", "a-2.ply", "a-3.ply", "b.ply"]
    assert sorted(path.name for path in tmp_path.glob("*.ply")) == names and facts["files"] == [str(tmp_path / "b.ply")]
    first, turned, back, single = ((tmp_path / name).read_bytes() for name in names)
    assert turned == single and len({first, turned, back}) == 3


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-o", "a.stl"], "end it in .ply, .glb, .obj, .usdz, .vti, .nrrd, .nii.gz, .zarr"),
        (["-o", "no/a.ply"], "no folder no"),
        (["-o", "a.ply", "--isovalue", "0.3:0.5"], "a mesh is of one isovalue"),
        (["-o", "a.vti"], "set lattice = 1"),
        (["-o", "a.ply", "--yaw", "0:90"], "first:last:step"),
        (["-o", "a.ply", "--yaw", "0:360:0.1"], "1,000 at most"),
    ],
)
def test_what_cannot_be_exported_is_refused(
    small_scene: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    assert run(["export", str(small_scene), *arguments]) == 2
    assert sentence.lower() in capsys.readouterr().err.lower()
