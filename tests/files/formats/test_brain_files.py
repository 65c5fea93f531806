"""Files of brains by many programs, against what nibabel reads of them."""

import gzip
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import Grid, on_right_angles
from isogi_core.model.volume import Orientation
from tests.files.formats.phantom import WAYS, affine, letter, lying

nib = pytest.importorskip("nibabel")

pytestmark = [  # nibabel leaves files of MGH open
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

F = letter()


def check(path: Path, loaded: Any, **chosen: int) -> Grid:
    """The grid of a file, whose values lie in the world where nibabel has them."""
    grid = on_right_angles(open_file(path, chosen))
    found = grid.whole()
    orientation = Orientation.of(grid)
    values = np.asarray(loaded.dataobj)
    if values.ndim == 4:
        values = values[..., chosen["time"]]
    for index in product(*((0, n // 3, n - 1) for n in values.shape)):
        place = nib.affines.apply_affine(loaded.affine, index)
        box = np.array(orientation.point_to_box(tuple(place))) / np.array(grid.spacing)
        x, y, z = np.rint(box).astype(int)
        assert np.abs(box - (x, y, z)).max() < 1e-3
        assert found[z, y, x] == pytest.approx(values[index], rel=1e-6)
    return grid


@pytest.mark.parametrize("way", range(0, len(WAYS), 5))
@pytest.mark.parametrize("name", ["f.mgh", "f.mgz"])
def test_a_file_of_freesurfer_lies_where_nibabel_says(tmp_path: Path, name: str, way: int) -> None:
    array, placed = lying(*WAYS[way])
    nib.save(nib.MGHImage(array.T, placed), tmp_path / name)
    grid = check(tmp_path / name, nib.load(tmp_path / name))
    assert (grid.unit, grid.affine is not None and grid.affine.letters) == ("mm", "RAS")


@pytest.mark.parametrize("kind", ["u1", "i2", "i4", "f4"])
def test_numbers_of_freesurfer_are_read(tmp_path: Path, kind: str) -> None:
    nib.save(nib.MGHImage((F // 8).astype(kind).T, affine()), tmp_path / "f.mgz")
    check(tmp_path / "f.mgz", nib.load(tmp_path / "f.mgz"))
    with (tmp_path / "f.mgz").open("rb") as file:
        np.testing.assert_array_equal(
            open_upload(file, "f.mgz", 1 << 20).whole(), (F // 8).astype(kind)
        )


def test_steps_in_time_of_freesurfer_are_a_series(tmp_path: Path) -> None:
    nib.save(nib.MGHImage(np.stack([F.T, F.T + 1], axis=-1), affine()), tmp_path / "f.mgz")
    grid = open_file(tmp_path / "f.mgz", {})
    assert (grid.moment, grid.unchosen) == ((0, 2), True)
    check(tmp_path / "f.mgz", nib.load(tmp_path / "f.mgz"), time=1)


def test_a_file_of_freesurfer_that_does_not_say_how_it_lies(tmp_path: Path) -> None:
    nib.save(nib.MGHImage(F.T, affine()), tmp_path / "f.mgh")
    data = bytearray((tmp_path / "f.mgh").read_bytes())
    data[28:30] = b"\0\0"  # goodRASFlag
    (tmp_path / "f.mgh").write_bytes(data)
    check(tmp_path / "f.mgh", nib.load(tmp_path / "f.mgh"))
    (tmp_path / "f.mgh").write_bytes(data[:-4000])
    with pytest.raises(VolumeError, match="ends before its last voxel"):
        open_file(tmp_path / "f.mgh", {}).whole()


@pytest.mark.parametrize("kind", ["AnalyzeImage", "Spm99AnalyzeImage", "Spm2AnalyzeImage"])
@pytest.mark.parametrize("name", ["f.hdr", "f.img"])
@pytest.mark.parametrize("order", "<>")
def test_a_pair_of_analyze_is_read_with_its_sides(
    tmp_path: Path, kind: str, name: str, order: str
) -> None:
    image = getattr(nib, kind)(
        F.T, np.diag([-1.0, 1.25, 1.5, 1.0]), getattr(nib, kind).header_class(endianness=order)
    )
    nib.save(image, tmp_path / "f.img")
    (tmp_path / "f.mat").unlink(missing_ok=True)
    grid = check(tmp_path / name, nib.load(tmp_path / "f.hdr"))
    assert "x is taken to go to the patient's left" in grid.notes[0] and len(grid.notes) == 1
    (tmp_path / "f.img.gz").write_bytes(gzip.compress((tmp_path / "f.img").read_bytes()))
    (tmp_path / "f.img").unlink()
    np.testing.assert_array_equal(open_file(tmp_path / "f.hdr", {}).whole(), F)
    (tmp_path / "f.img.gz").unlink()
    with pytest.raises(VolumeError, match=r"'f.img' with its voxels is not beside it"):
        open_file(tmp_path / "f.hdr", {})


def test_slopes_of_analyze_are_applied(tmp_path: Path) -> None:
    image = nib.Spm2AnalyzeImage(F.T / 2.0, np.diag([-1.0, 1.25, 1.5, 1.0]))
    image.set_data_dtype(np.int16)
    nib.save(image, tmp_path / "f.img")
    (tmp_path / "f.mat").write_bytes(b"")
    grid = open_file(tmp_path / "f.hdr", {})
    np.testing.assert_allclose(grid.whole(), F / 2.0, atol=0.01)
    assert "'f.mat' beside it is not read" in grid.notes[1]


def write_afni(path: Path, bricks: np.ndarray, placed: np.ndarray, **more: tuple[str, Any]) -> None:
    """Write the header and the voxels (bricks, z, y, x) of AFNI's pair; attributes are their type
    and their value.
    """
    lps = (placed[:3] * [[-1.0], [-1.0], [1.0]]).ravel()
    whole = {
        "DATASET_RANK": ("integer", [3, len(bricks)]),
        "DATASET_DIMENSIONS": ("integer", bricks.shape[:0:-1]),
        "DELTA": ("float", np.linalg.norm(placed[:3, :3], axis=0)),
        "IJK_TO_DICOM_REAL": ("float", lps),
        "BRICK_TYPES": (
            "integer",
            [{"u1": 0, "i2": 1, "f4": 3}[bricks.dtype.str[1:]]] * len(bricks),
        ),
        "BYTEORDER_STRING": (
            "string",
            "MSB_FIRST" if bricks.dtype.byteorder == ">" else "LSB_FIRST",
        ),
        **more,
    }
    lines = [
        f"\ntype = {kind}-attribute\nname = {name}\ncount = {len(value)}\n"
        + (f"'{value}~" if kind == "string" else " " + " ".join(map(str, value)))
        for name, (kind, value) in whole.items()
    ]
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".BRIK").write_bytes(bricks.tobytes())


@pytest.mark.parametrize("way", range(0, len(WAYS), 7))
@pytest.mark.parametrize("kind", ["<i2", ">i2", "<f4"])
def test_a_pair_of_afni_lies_where_nibabel_says(tmp_path: Path, way: int, kind: str) -> None:
    array, placed = lying(*WAYS[way])
    write_afni(tmp_path / "f+orig.HEAD", array[None].astype(kind), placed)
    loaded = nib.load(tmp_path / "f+orig.HEAD")
    loaded = nib.Nifti1Image(np.asarray(loaded.dataobj)[..., 0], loaded.affine)
    for name in ("f+orig.HEAD", "f+orig.BRIK"):
        grid = check(tmp_path / name, loaded)
        assert (grid.unit, grid.affine is not None and grid.affine.letters) == ("mm", "RAS")
    assert open_file(tmp_path / "f+orig.HEAD", {}).read_as.startswith("AFNI of ")


def test_bricks_of_afni_have_slopes_of_each(tmp_path: Path) -> None:
    facs = ("float", [0.5, 0.0, 3.0])
    series = ("integer", [3, 0, 77001])
    write_afni(
        tmp_path / "f+tlrc.HEAD",
        np.stack([F, F, F]),
        affine(),
        BRICK_FLOAT_FACS=facs,
        TAXIS_NUMS=series,
    )
    grid = open_file(tmp_path / "f+tlrc.HEAD", {})
    assert (grid.moment, grid.unchosen) == ((0, 3), True)
    for time, slope in enumerate((0.5, 1.0, 3.0)):
        np.testing.assert_array_equal(
            open_file(tmp_path / "f+tlrc.HEAD", {"time": time}).whole(), F * slope
        )
        check(tmp_path / "f+tlrc.HEAD", nib.load(tmp_path / "f+tlrc.HEAD"), time=time)


def test_bricks_of_afni_that_are_no_series_are_channels(tmp_path: Path) -> None:
    write_afni(tmp_path / "f+orig.HEAD", np.stack([F, F + 1]), affine())
    with pytest.raises(VolumeError, match="has 2 channels: choose one by channel = 0 to 1"):
        open_file(tmp_path / "f+orig.HEAD", {})
    np.testing.assert_array_equal(
        open_file(tmp_path / "f+orig.HEAD", {"channel": 1}).whole(), F + 1
    )


def test_voxels_of_afni_are_found_beside_it(tmp_path: Path) -> None:
    write_afni(tmp_path / "f+orig.HEAD", F[None], affine())
    voxels = tmp_path / "f+orig.BRIK"
    (tmp_path / "f+orig.BRIK.gz").write_bytes(gzip.compress(voxels.read_bytes()))
    voxels.unlink()
    for name in ("f+orig.HEAD", "f+orig.BRIK.gz"):
        np.testing.assert_array_equal(open_file(tmp_path / name, {}).whole(), F)
    (tmp_path / "f+orig.BRIK.gz").unlink()
    with pytest.raises(VolumeError, match=r"'f\+orig.BRIK' with its voxels is not beside it"):
        open_file(tmp_path / "f+orig.HEAD", {})
    with (
        (tmp_path / "f+orig.HEAD").open("rb") as file,
        pytest.raises(VolumeError, match=r"save both as one \.nii file"),
    ):
        open_upload(file, "f+orig.HEAD", 1 << 20)


def test_a_damaged_header_of_afni_is_refused(tmp_path: Path) -> None:
    write_afni(tmp_path / "f+orig.HEAD", F[None], affine())
    head = (tmp_path / "f+orig.HEAD").read_bytes()
    for at in range(len(b"\ntype = integer-attribute"), len(head) - 40, 23):
        (tmp_path / "f+orig.HEAD").write_bytes(head[:at])
        with pytest.raises(VolumeError):
            open_file(tmp_path / "f+orig.HEAD", {})
    (tmp_path / "f+orig.HEAD").write_bytes(head)
    (tmp_path / "f+orig.BRIK").write_bytes(F.tobytes()[:-2])
    with pytest.raises(VolumeError, match="ends before its last voxel"):
        open_file(tmp_path / "f+orig.HEAD", {}).whole()


NIFTI = (
    "anatomical.nii",
    "example4d.nii.gz",
    "someones_anatomy.nii.gz",
    "reoriented_anat_moved.nii",
)


@pytest.mark.data
@pytest.mark.parametrize("name", NIFTI)
def test_shared_nifti_files_lie_where_nibabel_says(shared_data: Path, name: str) -> None:
    image = nib.load(shared_data / "formats" / name)
    check(shared_data / "formats" / name, image, **({"time": 1} if len(image.shape) == 4 else {}))
