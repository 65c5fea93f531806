"""``import isogi``: the same pictures and files as the command line's, from Python."""

import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import isogi
from isogi.scenes import kept_array, open_scene, plain, spacing_of, text_of, toml_of
from isogi_core.errors import SceneError, ViewError, VolumeError
from isogi_core.files.scene_file import SceneSource
from isogi_server.cli.command import cli

SIZE = {"width": 40, "height": 30}
EASY = {"error": 0.3, **SIZE}
"""A picture that takes a second."""

SCRIPT = """\
import sys
import isogi

print("begun")
scene = isogi.open(sys.argv[1], store=sys.argv[2], workers=1, lattice=0.5)
print(scene.render(width=40, height=30, error=0.3))
"""


def ball(n: int = 20) -> np.ndarray:
    """Values that fall from the middle, (n, n, n) uint8."""
    z, y, x = np.mgrid[:n, :n, :n] - (n - 1) / 2
    return np.clip(200.0 - 16.0 * np.sqrt(x * x + y * y + z * z), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("isogi")
    np.save(made / "ball.npy", ball())
    return made


@pytest.fixture(scope="module")
def scene(folder: Path) -> Iterator[isogi.Scene]:
    keys = {"isovalue": 100, "lattice": 0.5}
    with isogi.open(ball(), store=folder / "light", workers=1, light="studio", **keys) as opened:
        yield opened


def test_importing_isogi_loads_no_library() -> None:
    code = "import sys, isogi; print([m for m in ('numpy', 'numba', 'zarr') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    with pytest.raises(AttributeError, match="isogi has no shut"):
        _ = isogi.shut


def test_a_scene_tells_what_it_is(scene: isogi.Scene) -> None:
    assert scene.shape == (20, 20, 20) and scene.spacing == (1.0, 1.0, 1.0)
    assert (
        scene.isovalue == 100.0 and repr(scene) == "Scene(array, 20 × 20 × 20 voxels, isovalue 100)"
    )


def test_a_picture_has_light_places_and_its_error(scene: isogi.Scene, tmp_path: Path) -> None:
    picture = scene.render(azimuth=40, **EASY)
    assert picture.final and 0.0 < picture.error <= 0.3
    assert picture.radiance.shape == picture.positions.shape == (30, 40, 3)
    away = np.linalg.norm(picture.positions[picture.mask] - 9.5, axis=1)
    assert picture.mask.any() and np.abs(away - 100.0 / 16.0).max() < 0.1
    assert np.isnan(picture.positions[~picture.mask]).all()
    assert picture.errors.shape == (30, 40) and picture.radiance[picture.mask].min() >= 0.0
    assert picture._repr_png_()[:4] == b"\x89PNG" and np.asarray(picture).shape == (30, 40, 3)
    assert "final" in repr(picture) and picture.facts["width"] == 40
    saved = picture.save(tmp_path / "ball.npy")
    assert np.load(saved).shape == (30, 40, 9) and (np.load(saved)[..., 3][picture.mask] > 0).all()
    with pytest.raises(ViewError, match="names no picture format"):
        picture.save(tmp_path / "ball.bmp")


def test_the_command_line_draws_the_same(scene: isogi.Scene, folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "scene.toml"
    volume = json.dumps(str(folder / "ball.npy"))
    place.write_text(f"volume = {volume}\nisovalue = 100\nlattice = 0.5\n")
    output = tmp_path / "picture.png"
    options = ["--environment", "studio", "--azimuth", "40", "--width", "40", "--height", "30"]
    work = ["--target-error", "0.3", "--workers", "1", "--store", str(folder / "light")]
    done = CliRunner().invoke(cli, ["render", str(place), "-o", str(output), *options, *work])
    assert done.exit_code == 0, done.output
    assert output.read_bytes() == scene.render(azimuth=40, **EASY)._repr_png_()


def test_a_surface_is_written_with_its_light(scene: isogi.Scene, tmp_path: Path) -> None:
    path = scene.export(tmp_path / "ball.ply", isovalue=100, error=0.3)
    assert path.read_bytes().startswith(b"ply")


def test_what_is_wrong_is_said_in_a_sentence(scene: isogi.Scene, folder: Path) -> None:
    with pytest.raises(ViewError, match="azimut"):
        scene.render(azimut=40, **SIZE)
    with pytest.raises(VolumeError, match=r"three dimensions .* \(3, 3\)"):
        isogi.open(np.zeros((3, 3)))
    with pytest.raises(SceneError, match="isovalu"):
        isogi.open(folder / "ball.npy", isovalu=70)
    with pytest.raises(isogi.IsogiError):
        isogi.open(folder / "nothing.nrrd")


def test_a_script_without_a_guard_runs_once(folder: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, str(script), str(folder / "ball.npy"), str(tmp_path / "light")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("begun") == 1 and "final" in done.stdout


class Labelled:
    """What an xarray.DataArray is to isogi."""

    def __init__(self, **coordinates: list[float]) -> None:
        self.dims = tuple(coordinates)
        self.coords = coordinates
        self.sizes = {name: len(places) for name, places in coordinates.items()}

    def __array__(self, dtype: object = None, copy: bool | None = None) -> np.ndarray:
        shape = [self.sizes[name] for name in self.dims]
        return np.arange(float(np.prod(shape))).reshape(shape)


def test_coordinates_give_the_spacing() -> None:
    assert spacing_of(Labelled(z=[0, 2], y=[0, -1, -2], x=[3, 3.5, 4])) == [0.5, 1.0, 2.0]
    with pytest.raises(VolumeError, match="'y' are not evenly spaced"):
        open_scene(Labelled(z=[0, 2], y=[0, 1, 5], x=[0, 1]), None, None, None, None, {})


def test_labelled_arrays_are_no_mirror_images() -> None:
    labelled = Labelled(x=[0, 1, 2], z=[5, 3], y=[0, 2, 4, 6])
    folder, path, spacing = kept_array(labelled)
    written = np.load(path)
    shutil.rmtree(folder)
    assert spacing == [1.0, 2.0, 2.0] and written.shape == (2, 4, 3)
    assert np.array_equal(written, np.asarray(labelled).transpose(1, 2, 0)[::-1])


def test_values_become_text_and_toml(tmp_path: Path) -> None:
    assert text_of(0.1) == "0.1" and text_of((1, 2)) == "1,2" and text_of("a") == "a"
    assert plain((np.float64(1.5), {"a": np.array([1, 2])})) == [1.5, {"a": [1, 2]}]
    (tmp_path / "probe.hdr").touch()
    lights = [{"type": "probe", "file": "probe.hdr"}]
    document = {"lights": lights, "name": 'a "b"', "on": True, "order": 3}
    text = toml_of(SceneSource("a", document, tmp_path))
    assert f'"file" = "{tmp_path / "probe.hdr"}"' in text and r'name = "a \"b\""' in text
    assert "on = true" in text and '\nresearch = { "order" = 3 }' in text


def test_any_text_survives_toml(tmp_path: Path) -> None:
    """Files whose names have a #, odd keys, and characters that TOML does not take as they are."""
    (tmp_path / "a#b.h5").touch()
    odd = {"two words": "bell \x07, delete \x7f, é", "volume": "a#b.h5#time=3"}
    read = tomllib.loads(toml_of(SceneSource("a", {"meta": odd}, tmp_path)))["meta"]
    assert read["two words"] == odd["two words"]
    assert read["volume"] == f"{tmp_path / 'a#b.h5'}#time=3"
