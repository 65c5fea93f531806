"""Files as they are in the world: big-endian, oddly named, with missing filters, of spacing that
cannot be.
"""

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unicodedata import normalize

import nrrd
import numpy as np
import pytest
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import on_right_angles
from isogi_core.files.zarr_volume import open_zarr
from isogi_core.model.volume import make_volume
from tests.files.formats.dicom_files import dataset, write_series
from tests.files.formats.phantom import affine, letter
from tests.loaded import load_scene

F = letter()
BIG = F.astype(">i2")
Write = Callable[[Path, np.ndarray], Path]


def numpy_file(folder: Path, array: np.ndarray) -> Path:
    np.save(folder / "f.npy", array)
    return folder / "f.npy"


def nrrd_file(folder: Path, array: np.ndarray) -> Path:
    nrrd.write(str(folder / "f.nrrd"), array, {"endian": "big"}, index_order="C")
    return folder / "f.nrrd"


def nifti(folder: Path, array: np.ndarray) -> Path:
    nib = pytest.importorskip("nibabel")
    header = nib.Nifti1Header(endianness=">")
    header.set_data_dtype(array.dtype)
    nib.save(nib.Nifti1Image(array.T, affine(), header), folder / "f.nii")
    return folder / "f.nii"


def mgh(folder: Path, array: np.ndarray) -> Path:
    nib = pytest.importorskip("nibabel")
    nib.save(nib.MGHImage(array.T, affine()), folder / "f.mgz")
    return folder / "f.mgz"


def hdf5(folder: Path, array: np.ndarray) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "f.h5", "w") as file:
        file["entry/data"] = array
    return folder / "f.h5"


def tiff(folder: Path, array: np.ndarray) -> Path:
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(
        folder / "f.tif", array, photometric="minisblack", byteorder=">", tile=(16, 16)
    )
    return folder / "f.tif"


def mrc(folder: Path, array: np.ndarray) -> Path:
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.new(folder / "f.mrc") as made:
        made.set_data(array)
    return folder / "f.mrc"


def dicom(folder: Path, array: np.ndarray) -> Path:
    pytest.importorskip("pydicom")
    from pydicom.uid import ExplicitVRBigEndian

    for number, layer in enumerate(array):
        made = dataset(layer, np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine(), number)
        made.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
        made.PixelData = layer.astype(">i2").tobytes()
        made.save_as(folder / f"{number}.dcm", enforce_file_format=True)
    return folder


def raw(folder: Path, array: np.ndarray) -> Path:
    (folder / "f_16x20x12_int16_big.raw").write_bytes(array.tobytes())
    return folder / "f_16x20x12_int16_big.raw"


READ_AS: list[tuple[Write, str]] = [
    (numpy_file, "NumPy of int16, big-endian; it does not say where it lies"),
    (nrrd_file, "NRRD of int16, big-endian; it does not say where it lies"),
    (nifti, "NIfTI of int16, big-endian; placed by its sform"),
    (mgh, "MGH of int16, big-endian; placed by its header"),
    (hdf5, "HDF5 of int16, big-endian; it does not say where it lies"),
    (tiff, "TIFF of int16; it does not say where it lies; its planes are taken for depth"),
    (mrc, "MRC of int16, big-endian; placed by its cell and origin"),
    (dicom, "DICOM of int16; placed by its slices' positions"),
    (raw, "bare voxels of int16, big-endian; it does not say where it lies"),
]


@pytest.mark.parametrize(("write", "words"), READ_AS)
def test_big_endian_files_are_read_and_say_as_what(
    tmp_path: Path, write: Write, words: str
) -> None:
    path = write(tmp_path, BIG)
    grid = on_right_angles(open_file(path, {}))
    voxels = grid.whole()
    assert grid.dtype.newbyteorder("=") == np.int16
    assert make_volume(voxels).value_range == (0.0, float(F.max()))
    assert {tuple(np.sort(each.ravel())) for each in (voxels, voxels[:, ::-1])} == {
        tuple(np.sort(F.ravel()))
    }
    if grid.affine is None:
        np.testing.assert_array_equal(voxels, F)
    assert load_scene(path).volume.orientation.read_as == words


NAMES = ["with blanks", "a#1", "a%41", "æøå", "50%", "a&b=c", "#1"]


@pytest.mark.parametrize("form", ["NFC", "NFD"])
@pytest.mark.parametrize("name", NAMES)
def test_files_and_folders_have_any_names(tmp_path: Path, name: str, form: Any) -> None:
    folder = tmp_path / normalize(form, name)
    folder.mkdir()
    path = numpy_file(folder, F).rename(folder / f"{normalize(form, name)}.npy")
    np.save(folder / "two.npy", np.stack([F, F + 1]))
    expected = make_volume(F).digest
    assert load_scene(path).volume.digest == expected
    assert load_scene(f"{path}#axes=raw").volume.digest == expected
    (tmp_path / "s.toml").write_text(f'volume = "{folder.name}/{path.name}"\n', encoding="utf-8")
    assert load_scene(tmp_path / "s.toml").volume.digest == expected
    again = path.rename(folder / f"{normalize(form, name)} two.npy")
    np.save(again, np.stack([F + 1, F]))
    assert load_scene(f"{again}#time=1").volume.digest == expected
    (tmp_path / "s.toml").write_text(
        f'volume = "{folder.name}/{again.name}#time=1"\n', encoding="utf-8"
    )
    assert load_scene(tmp_path / "s.toml").volume.digest == expected


@pytest.mark.parametrize("name", NAMES)
def test_parts_of_files_with_any_names_are_chosen(tmp_path: Path, name: str) -> None:
    pytest.importorskip("h5py")
    path = hdf5(tmp_path, F).rename(tmp_path / f"{name}.h5")
    assert load_scene(f"{path}#entry/data").volume.digest == make_volume(F).digest


@pytest.mark.parametrize("name", NAMES)
def test_series_in_folders_of_any_names_are_read(tmp_path: Path, name: str) -> None:
    pytest.importorskip("pydicom")
    folder = write_series(tmp_path / name, F, np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine())
    assert load_scene(folder).volume.shape == F.shape
    zarr.create_array(tmp_path / f"{name}.zarr", shape=F.shape, dtype=F.dtype, chunks=(4, 8, 8))[
        :
    ] = F
    assert load_scene(tmp_path / f"{name}.zarr").volume.digest == make_volume(F).digest


def test_a_filter_of_hdf5_that_is_missing_is_named(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    for number, words in ((32026, "Blosc2"), (40000, "filter 40000")):
        with h5py.File(tmp_path / "f.h5", "w") as file:
            packed = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            packed.set_chunk((4, 8, 8))
            packed.set_filter(number, h5py.h5z.FLAG_OPTIONAL, None)
            space = h5py.h5s.create_simple(F.shape)
            data = h5py.h5d.create(file.id, b"v", h5py.h5t.NATIVE_INT16, space, packed)
            data.write_direct_chunk((0, 0, 0), gzip.compress(F[:4, :8, :8].tobytes()))
        with pytest.raises(
            VolumeError,
            match=f"f.h5#v' are packed by {words}, which is not installed: pip install hdf5p",
        ):
            open_file(tmp_path / "f.h5", {})


def test_what_is_not_read_of_minc_is_told(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["minc-2.0/image/0/image"] = F
    assert "The file is MINC" in open_file(tmp_path / "f.h5", {}).notes[0]


def test_a_virtual_dataset_is_read_whole_or_not_at_all(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    layout = h5py.VirtualLayout(F.shape, F.dtype)
    for number in range(3):
        with h5py.File(tmp_path / f"part {number}.h5", "w") as file:
            file["v"] = F[4 * number : 4 * number + 4]
        layout[4 * number : 4 * number + 4] = h5py.VirtualSource(
            f"part {number}.h5", "v", (4, *F.shape[1:])
        )
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_virtual_dataset("v", layout)
    grid = open_file(tmp_path / "f.h5", {})
    np.testing.assert_array_equal(grid.whole(), F)
    before = grid.stamp()
    (tmp_path / "part 1.h5").rename(tmp_path / "elsewhere.h5")
    with pytest.raises(VolumeError, match=r"'part 1.h5' is not beside it"):
        open_file(tmp_path / "f.h5", {})
    (tmp_path / "elsewhere.h5").rename(tmp_path / "part 1.h5")
    assert grid.stamp() != before


def test_an_upload_has_its_values_in_itself(tmp_path: Path) -> None:
    """A file may have them in another one."""
    h5py = pytest.importorskip("h5py")
    (tmp_path / "f.raw").write_bytes(F.tobytes())
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset(
            "v", F.shape, F.dtype, external=[(str(tmp_path / "f.raw"), 0, F.nbytes)]
        )
    np.testing.assert_array_equal(open_file(tmp_path / "f.h5", {}).whole(), F)
    with (
        (tmp_path / "f.h5").open("rb") as upload,
        pytest.raises(VolumeError, match="are in other datasets"),
    ):
        open_upload(upload, "f.h5", F.size)


def placed_nrrd(folder: Path, step: float) -> Path:
    nrrd.write(str(folder / "f.nrrd"), F, {"spacings": [step, 1.0, 1.0]}, index_order="C")
    return folder / "f.nrrd"


def directed_nrrd(folder: Path, step: float) -> Path:
    header = {
        "space": "RAS",
        "space directions": np.diag([step, 1.0, 1.0]),
        "space origin": np.zeros(3),
    }
    nrrd.write(str(folder / "f.nrrd"), F, header, index_order="C")
    return folder / "f.nrrd"


def placed_nifti(folder: Path, step: float) -> Path:
    nib = pytest.importorskip("nibabel")
    image = nib.Nifti1Image(F.T, np.eye(4))
    image.header["srow_x"][0] = image.header["pixdim"][1] = step
    image.header["qform_code"] = 0
    nib.Nifti1Header.copy(image.header)
    path = folder / "f.nii"
    nib.save(nib.Nifti1Image(F.T, np.eye(4)), path)
    data = bytearray(path.read_bytes())
    data[280:284] = data[80:84] = np.float32(step).tobytes()
    data[252:254] = b"\0\0"
    path.write_bytes(data)
    return path


def placed_mrc(folder: Path, step: float) -> Path:
    path = mrc(folder, F)
    data = bytearray(path.read_bytes())
    data[40:44] = np.float32(step * 16).tobytes()
    path.write_bytes(data)
    return path


def placed_hdf5(folder: Path, step: float) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "f.h5", "w") as file:
        file["v"] = F
        file["v"].attrs["element_size_um"] = (1.0, 1.0, step)
    return folder / "f.h5"


def placed_zarr(folder: Path, step: float) -> Path:
    group = zarr.open_group(folder / "f.zarr", mode="w")
    zarr.create_array(folder / "f.zarr" / "0", shape=F.shape, dtype=F.dtype, chunks=(4, 8, 8))[
        :
    ] = F
    steps = [{"type": "scale", "scale": [1.0, 1.0, step]}]
    datasets = [{"path": "0", "coordinateTransformations": steps}]
    group.attrs["ome"] = {
        "multiscales": [{"axes": [{"name": name} for name in "zyx"], "datasets": datasets}]
    }
    return folder / "f.zarr"


def placed_dicom(folder: Path, step: float) -> Path:
    lps = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine()
    return write_series(folder / "series", F, lps, PixelSpacing=["1", f"{step:g}"])


PLACED = [
    placed_nrrd,
    directed_nrrd,
    placed_nifti,
    placed_mrc,
    placed_hdf5,
    placed_zarr,
    placed_dicom,
]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("step", [0.0, np.nan, np.inf, -1.0])
@pytest.mark.parametrize("write", PLACED)
def test_spacing_that_cannot_be_is_refused_or_left_out(
    tmp_path: Path, write: Any, step: float
) -> None:
    """A negative one mirrors the axis, where a file can say so; in MRC zero is none, and 1 Å is
    taken.
    """
    path = write(tmp_path, step)
    try:
        grid = on_right_angles(open_zarr(path) if path.suffix == ".zarr" else open_file(path, {}))
        volume = make_volume(grid.whole(), grid.spacing)
    except VolumeError as error:
        assert any(word in str(error) for word in ("spacing", "no direction", "cannot be"))
        assert str(error).endswith(".")
    else:
        assert step < 0.0 or write is placed_mrc
        assert all(0.0 < each < 1e3 for each in volume.spacing)


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_planar_colours_of_tiff_are_shown_as_luminance(tmp_path: Path, planar: Any) -> None:
    tifffile = pytest.importorskip("tifffile")
    colours = np.zeros((*F.shape, 3), np.uint8)
    colours[..., 1] = F // 4
    if planar == "contig":
        saved = colours
    else:
        saved = np.moveaxis(colours, -1, 1)
    tifffile.imwrite(tmp_path / "f.tif", saved, photometric="rgb", planarconfig=planar)
    grid = open_file(tmp_path / "f.tif", {})
    np.testing.assert_allclose(grid.whole(), 0.7152 * (F // 4), rtol=1e-5)
    assert "colours" in grid.notes[0]


def test_calibrated_values_of_imagej_are_what_it_shows(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    about = {
        "axes": "ZYX",
        "spacing": 2.5,
        "unit": "micron",
        "cf": 0,
        "c0": -1000.0,
        "c1": 0.5,
        "vunit": "HU",
    }
    tifffile.imwrite(
        tmp_path / "f.tif", F.astype(np.uint16), imagej=True, metadata=about, resolution=(2.0, 4.0)
    )
    grid = open_file(tmp_path / "f.tif", {})
    np.testing.assert_array_equal(grid.whole(), F * 0.5 - 1000.0)
    assert (tuple(grid.spacing), grid.unit) == ((0.5, 0.25, 2.5), "µm")
    assert "calibration" in grid.notes[0]


@pytest.mark.parametrize("seed", range(3))
def test_enhanced_frames_may_have_any_order(tmp_path: Path, seed: int) -> None:
    pytest.importorskip("pydicom")
    from pydicom.dataset import Dataset
    from pydicom.sequence import Sequence

    def group(**values: Any) -> Any:
        inner = Dataset()
        for name, value in values.items():
            setattr(inner, name, value)
        return Sequence([inner])

    lps = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine()
    order = np.random.default_rng(seed).permutation(12)
    made = dataset(F[0], lps, 0, NumberOfFrames=12, PixelData=F[order].astype("<i2").tobytes())
    shared = Dataset()
    frames = []
    shared.PixelMeasuresSequence = group(PixelSpacing=list(made.PixelSpacing), SliceThickness="9")
    shared.PlaneOrientationSequence = group(
        ImageOrientationPatient=list(made.ImageOrientationPatient)
    )
    shared.PixelValueTransformationSequence = group(RescaleSlope="2", RescaleIntercept="-100")
    for number in order:
        frame = Dataset()
        place = [f"{x:.9g}" for x in lps[:3, 3] + number * lps[:3, 2]]
        frame.PlanePositionSequence = group(ImagePositionPatient=place)
        frames.append(frame)
    del made.ImagePositionPatient, made.ImageOrientationPatient, made.PixelSpacing
    made.SharedFunctionalGroupsSequence = Sequence([shared])
    made.PerFrameFunctionalGroupsSequence = Sequence(frames)
    made.save_as(tmp_path / "a.dcm", enforce_file_format=True)
    grid = on_right_angles(open_file(tmp_path / "a.dcm", {}))
    np.testing.assert_array_equal(grid.whole(), 2 * F.astype(int) - 100)
    np.testing.assert_allclose(grid.spacing, (1.0, 1.25, 1.5))


@pytest.mark.parametrize(
    "space", ["left-anterior-superior", "LAS", "RAS", "LPS", "right-anterior-superior-time"]
)
def test_spaces_of_nrrd_are_one_world(tmp_path: Path, space: str) -> None:
    """Oblique, and in whatever directions the header counts."""
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0] @ np.diag([1.0, 1.25, 1.5])
    place = np.array([-7.0, 31.5, -4.25])
    signs = {"L": -1.0, "R": 1.0, "P": -1.0, "A": 1.0, "S": 1.0}
    if "-" in space:
        letters = "".join(word[0] for word in space.split("-")[:3]).upper()
    else:
        letters = space
    there = np.array([signs[each] for each in letters])
    header = {
        "space": space.removesuffix("-time"),
        "space directions": turn.T * there,
        "space origin": place * there,
    }
    nrrd.write(str(tmp_path / "f.nrrd"), F, header, index_order="C")
    grid = open_file(tmp_path / "f.nrrd", {})
    assert grid.affine is not None and grid.affine.letters == "RAS"
    np.testing.assert_allclose(grid.affine.array, np.column_stack([turn, place]), atol=1e-12)


def test_the_line_says_how_numbers_become_values(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "f.nc", "w") as file:
        file.create_dataset("v", data=F.astype(np.int8)).attrs.update(
            {
                "_Unsigned": "true",
                "scale_factor": 0.5,
                "add_offset": -3.0,
                "element_size_um": (1.0, 2.0, 3.0),
            }
        )
    scene = load_scene(tmp_path / "f.nc")
    assert (
        scene.volume.orientation.read_as
        == "HDF5 of uint8, values 0.5 · stored -3; placed by 'element_size_um'"
    )
