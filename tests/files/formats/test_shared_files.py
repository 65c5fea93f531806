"""Files of the shared data lie in the world, and hold the values, that nibabel and mrcfile say."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.formats.opening import open_file
from isogi_core.files.grid import on_right_angles
from isogi_core.model.orientation import Orientation

pytestmark = pytest.mark.data


NIFTI = ("anatomical.nii", "example4d.nii.gz", "someones_anatomy.nii.gz", "reoriented_anat_moved.nii")


@pytest.mark.parametrize("name", NIFTI)
def test_shared_nifti_files_lie_where_nibabel_says(shared_data: Path, name: str) -> None:
    nib = pytest.importorskip("nibabel")
    path = shared_data / "formats" / name
    image = nib.load(path)
    values = np.asarray(image.dataobj)
    grid = on_right_angles(open_file(path, {"time": 1} if values.ndim == 4 else {}))
    found, orientation = grid.whole(), Orientation.of(grid)
    values = values[..., 1] if values.ndim == 4 else values
    for index in product(*((0, n // 3, n - 1) for n in values.shape)):
        place = nib.affines.apply_affine(image.affine, index)
        box = np.array(orientation.point_to_box(tuple(place))) / np.array(grid.spacing)
        x, y, z = np.rint(box).astype(int)
        assert np.abs(box - (x, y, z)).max() < 1e-3
        assert found[z, y, x] == pytest.approx(values[index], rel=1e-6)


@pytest.mark.parametrize("name", ["emd_3001.map", "emd_3197.map"])
def test_shared_maps_hold_what_mrcfile_reads(shared_data: Path, name: str) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.open(shared_data / "formats" / name) as whole:
        grid = open_file(shared_data / "formats" / name, {})
        np.testing.assert_array_equal(grid.whole(), whole.data)
        np.testing.assert_allclose(np.sort(grid.spacing), np.sort(whole.voxel_size.tolist()), rtol=1e-5)
