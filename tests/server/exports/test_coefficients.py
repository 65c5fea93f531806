"""Coefficients in exported volumes: with the turned environment they are the light beside them."""

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.special import sph_harm_y

from isogi_core.model.environment import pixel_directions
from isogi_core.plan.assembly import load_scene
from isogi_server.cli.command import run
from tests.server.jobs import baking, until_over

SCENE = """\
volume = "small.nrrd"
isovalue = 0.5
isovalues = [0.2, 0.8]
bounces = 1
target_error = 0.1
albedo = [0.7, 0.5, 0.3]
lights = [{ type = "sky", sun_azimuth = 30, sun_elevation = 50 }]
"""
ARRAY = re.compile(
    r'<DataArray type="(\w+)" Name="(\w+)" NumberOfComponents="(\d+)"(?: NumberOfTuples="\d+")?'
    r' format="appended" offset="(\d+)"/>'
)
COLOURS = ("red", "green", "blue")


def arrays_in(file: Path) -> dict[str, np.ndarray]:
    """The arrays of a VTI file with raw data at its end, (points, components) each; read without
    VTK.
    """
    head, _, data = file.read_bytes().partition(b'<AppendedData encoding="raw">_')
    found = {}
    for kind, name, parts, offset in ARRAY.findall(head.decode()):
        start = int(offset)
        (size,) = struct.unpack_from("<Q", data, start)
        dtype = np.dtype("u1" if kind == "UInt8" else "<f4")
        values = np.frombuffer(data, dtype, size // dtype.itemsize, start + 8)
        found[name] = values.reshape(-1, int(parts))
    return found


def radiance_of(found: dict[str, np.ndarray]) -> np.ndarray:
    """The light that coefficients and environments make, as docs/export.md says it; (points, 3)."""
    if "lobes" in found:
        total = found["lobes"].astype(np.float64)
    else:
        total = np.zeros((len(found["value"]), 3))
    for name in [each for each in found if each.startswith("environment_")]:
        kind = name.removeprefix("environment_")
        bands = math.isqrt(found[name].shape[1])
        for colour, own in enumerate(COLOURS):
            for band in range(bands):
                array = found.get(f"{kind}_band{band}", found.get(f"{kind}_band{band}_{own}"))
                assert array is not None and array.shape[1] == 2 * band + 1
                total[:, colour] += array @ found[name][colour, band**2 : (band + 1) ** 2]
    return total


def real_harmonics(order: int, directions: np.ndarray) -> np.ndarray:
    """Real harmonics without the Condon-Shortley phase by SciPy's complex ones; (n², m)."""
    theta = np.arccos(np.clip(directions[:, 2], -1, 1))
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    rows = []
    for band in range(order):
        for m in range(-band, band + 1):
            value = (-1) ** m * sph_harm_y(band, abs(m), theta, phi)
            rows.append(
                value.real if m == 0 else math.sqrt(2) * (value.imag if m < 0 else value.real)
            )
    return np.array(rows)


def turned_environment(scene: Path, yaw: float, order: int) -> np.ndarray:
    """The scene's sky, turned about z, projected onto harmonics by a sum over its pixels; (3,
    n²).
    """
    environment = load_scene(scene).lighting.environment
    height, width = environment.image.shape[:2]
    towards = pixel_directions(height, width).reshape(-1, 3)
    (c, s) = (math.cos(yaw), math.sin(yaw))
    turned = towards @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    steradians = np.sqrt(1.0 - towards[:, 2] ** 2) * 2.0 * math.pi**2 / (height * width)
    light = environment.image.reshape(-1, 3) + environment.constant
    return (light * steradians[:, None]).T @ real_harmonics(order, turned).T


@pytest.fixture(scope="module")
def scene(small_scene: Path) -> Path:
    path = small_scene.with_name("coefficients.toml")
    path.write_text(SCENE)
    return path


def test_coefficients_make_the_light_beside_them(scene: Path, tmp_path: Path, inline: None) -> None:
    output = tmp_path / "a.vti"
    options = ["--store", str(tmp_path / "store"), "--yaw", "40", "--exposure", "2"]
    assert run(["export", str(scene), "-o", str(output), "--coefficients", *options]) == 0
    found = arrays_in(output)
    light = found["light"].astype(np.float64)
    made = radiance_of(found)
    lit = light.any(axis=1)
    assert lit.sum() > 500
    error = np.sqrt(((made - light)[lit] ** 2).mean()) / light[lit].mean()
    assert error < 0.01, error
    reflected = found["environment_reflected"]
    turned = turned_environment(scene, math.radians(40), math.isqrt(reflected.shape[1]))
    own = 2.0 * np.array([[0.7], [0.5], [0.3]]) * turned
    assert np.abs(reflected - own).max() < 0.01 * np.abs(own).max()


def test_a_servers_coefficients_are_those_of_the_command(
    scene: Path, tmp_path: Path, inline: None
) -> None:
    with baking(scene, tmp_path / "store") as client:
        wrong = client.post(
            "/v1/scenes/coefficients/export", params={"f": "ply", "coefficients": "on"}
        )
        assert wrong.status_code == 422 and ".vti alone" in wrong.json()["detail"]
        begun = client.post(
            "/v1/scenes/coefficients/export", params={"f": "vti", "yaw": "70", "coefficients": "on"}
        )
        over = until_over(client, begun.headers["location"])
        (link,) = [each for each in over["links"] if each["rel"].endswith("/results")]
        fetched = client.get(link["href"]).content
    options = ["--store", str(tmp_path / "store"), "--yaw", "70", "--coefficients"]
    assert run(["export", str(scene), "-o", str(tmp_path / "a.vti"), *options]) == 0
    assert (tmp_path / "a.vti").read_bytes() == fetched


def test_vtk_reads_coefficients_and_environments(scene: Path, tmp_path: Path, inline: None) -> None:
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    output = tmp_path / "a.vti"
    assert (
        run(
            [
                "export",
                str(scene),
                "-o",
                str(output),
                "--coefficients",
                "--store",
                str(tmp_path / "store"),
            ]
        )
        == 0
    )
    reader = vtk.vtkXMLImageDataReader()
    reader.SetFileName(str(output))
    reader.Update()
    image = reader.GetOutput()
    for name, values in arrays_in(output).items():
        if name.startswith("environment_"):
            data = image.GetFieldData()
        else:
            data = image.GetPointData()
        np.testing.assert_array_equal(
            vtk_to_numpy(data.GetArray(name)).reshape(values.shape), values
        )
