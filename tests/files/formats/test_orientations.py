"""A letter F lies in the world as its file says, whoever wrote it and however its axes run: 48 ways
of them.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.files.formats.opening import open_file
from isogi_core.files.grid import on_right_angles
from isogi_core.files.radiance import write_hdr
from isogi_core.model.environment import pixel_directions
from isogi_core.model.volume import Orientation
from isogi_report.speed import make_renderer
from isogi_server.parameters import ViewParams, read
from isogi_server.settings import Settings
from isogi_server.views import view_of
from tests.files.formats.phantom import WAYS, affine, landmarks, letter, lying, world
from tests.loaded import load_scene

nib = pytest.importorskip("nibabel")

Way = tuple[tuple[int, ...], tuple[int, ...]]
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
SOME = WAYS[::7]
"""Ways for writers besides NIfTI's: each order of the axes, mirrored and not."""


def write_nifti(folder: Path, array: np.ndarray, placed: np.ndarray) -> Path:
    path = folder / "f.nii"
    nib.save(nib.Nifti1Image(array.transpose(2, 1, 0), placed), path)
    return path


def write_nrrd(folder: Path, array: np.ndarray, placed: np.ndarray) -> Path:
    import nrrd

    lps = LPS @ placed
    header = {
        "space": "left-posterior-superior",
        "space directions": lps[:3, :3].T,
        "space origin": lps[:3, 3],
    }
    nrrd.write(str(folder / "f.nrrd"), array, header, index_order="C")
    return folder / "f.nrrd"


def write_mha(folder: Path, array: np.ndarray, placed: np.ndarray) -> Path:
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(array)
    lps = LPS @ placed
    steps = np.linalg.norm(lps[:3, :3], axis=0)
    image.SetSpacing(steps.tolist())
    image.SetOrigin(lps[:3, 3].tolist())
    image.SetDirection((lps[:3, :3] / steps).ravel().tolist())
    sitk.WriteImage(image, str(folder / "f.mha"))
    return folder / "f.mha"


def write_dicom(folder: Path, array: np.ndarray, placed: np.ndarray) -> Path:
    pytest.importorskip("pydicom")
    from tests.files.formats.dicom_files import write_series

    return write_series(folder / "series", array, LPS @ placed)


def write_vti(folder: Path, array: np.ndarray, placed: np.ndarray) -> Path:
    pytest.importorskip("vtk")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    image = vtkImageData()
    steps = np.linalg.norm(placed[:3, :3], axis=0)
    image.SetDimensions(*array.shape[::-1])
    image.SetSpacing(*steps)
    image.SetOrigin(*placed[:3, 3])
    image.SetDirectionMatrix(*(placed[:3, :3] / steps).ravel())
    values = numpy_to_vtk(array.ravel(), deep=True)
    values.SetName("value")
    image.GetPointData().SetScalars(values)
    writer = vtkXMLImageDataWriter()
    writer.SetFileName(str(folder / "f.vti"))
    writer.SetInputData(image)
    writer.Write()
    return folder / "f.vti"


WRITERS: dict[str, Callable[[Path, np.ndarray, np.ndarray], Path]] = {
    "nifti": write_nifti,
    "nrrd": write_nrrd,
    "mha": write_mha,
    "dicom": write_dicom,
    "vti": write_vti,
}


def check_lies_right(path: Path) -> None:
    """Values at landmarks are the phantom's, where the world says that these are."""
    grid = on_right_angles(open_file(path, {}))
    orientation = Orientation.of(grid)
    voxels = grid.whole()
    assert np.linalg.det(orientation.matrix) == pytest.approx(1.0)
    for index, place in zip(landmarks(), world(landmarks()), strict=True):
        found = np.array(orientation.point_to_box(tuple(place))) / np.array(grid.spacing)
        x, y, z = np.rint(found).astype(int)
        assert np.abs(found - (x, y, z)).max() < 1e-3
        assert voxels[z, y, x] == letter()[tuple(index[::-1])]
        assert np.abs(orientation.to_world((x, y, z) * np.array(grid.spacing)) - place).max() < 1e-3


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_a_nifti_file_lies_where_it_says(tmp_path: Path, way: Way) -> None:
    check_lies_right(write_nifti(tmp_path, *lying(*way)))


@pytest.mark.parametrize("way", SOME, ids=str)
@pytest.mark.parametrize("kind", list(WRITERS)[1:])
def test_other_files_lie_where_they_say(tmp_path: Path, kind: str, way: Way) -> None:
    check_lies_right(WRITERS[kind](tmp_path, *lying(*way)))


PLAIN: dict[str, Any] = {"lights": [{"type": "constant"}], "isovalue": 200.0, "bounces": 0}


def pictured(
    path: Path, folder: Path, shading: str = "lambert", **settings: Any
) -> tuple[np.ndarray, np.ndarray]:
    """The picture of a file and the world positions in it, from a place in the world."""
    scene = load_scene(path, **{**PLAIN, **settings})
    params = {
        "eye": "12,58,34",
        "target": "0.5,43.4,4",
        "shading": shading,
        "width": 64,
        "height": 64,
    }
    view = view_of(scene, read(ViewParams, params.items()), Settings())
    frame = make_renderer(scene, str(folder), 1).render(view)
    return frame.radiance, frame.position


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    folder = tmp_path_factory.mktemp("reference")
    return pictured(write_nifti(folder, letter(), affine()), folder)


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_the_picture_of_the_letter_is_the_same(
    tmp_path: Path, way: Way, reference: tuple[np.ndarray, np.ndarray]
) -> None:
    radiance, positions = pictured(write_nifti(tmp_path, *lying(*way)), tmp_path)
    assert np.count_nonzero(reference[0][..., 0]) > 500
    apart = np.abs(radiance - reference[0]).max(axis=-1)
    assert np.count_nonzero(apart > 1e-3) <= 4  # pixels at the outline fall to either side
    assert np.abs(positions - reference[1])[apart <= 1e-3].max() < 1e-3


def test_a_mirrored_letter_makes_another_picture(
    tmp_path: Path, reference: tuple[np.ndarray, np.ndarray]
) -> None:
    array, placed = lying((0, 1, 2), (-1, 1, 1))
    mirrored, _ = pictured(write_nifti(tmp_path, array, affine()), tmp_path)
    assert np.abs(mirrored - reference[0]).mean() > 0.02
    again, _ = pictured(write_nifti(tmp_path, array, placed), tmp_path)
    assert np.abs(again - reference[0]).mean() < 1e-3


PROBE = {"type": "probe", "file": "probe.hdr"}
LIGHTS: dict[str, dict[str, Any]] = {
    "turning": {"lights": [PROBE]},
    "fixed": {"lights": [PROBE], "rotating": False},
    "lamp": {"lights": [{"type": "point", "position": [14.0, 50.0, 18.0], "intensity": 900.0}]},
    "sun": {"lights": [{"type": "directional", "azimuth": 60.0, "elevation": 40.0}]},
}
TOWARDS = (0.4, 0.6, 0.7)


@pytest.mark.parametrize("kind", LIGHTS)
def test_light_stays_in_the_world(tmp_path: Path, kind: str) -> None:
    shares = np.maximum(pixel_directions(32, 64) @ TOWARDS, 0.0) ** 4
    write_hdr(tmp_path / "probe.hdr", np.repeat(shares[..., None], 3, axis=-1).astype(np.float32))
    pictures = []
    for order, signs in (WAYS[0], WAYS[22], WAYS[33]):
        path = write_nifti(tmp_path, *lying(order, signs))
        pictures.append(pictured(path, tmp_path / str(order), "lambert_shadow", **LIGHTS[kind])[0])
    for radiance in pictures[1:]:
        assert np.ptp(pictures[0]) > 0.2
        apart = np.abs(radiance - pictures[0]).max(axis=-1) / np.ptp(pictures[0])
        assert np.count_nonzero(apart > 0.02) < 0.02 * apart.size
