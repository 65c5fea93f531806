"""Values, spacing and choices of files that other fields write, each by the library that the field
keeps.
"""

import gzip
import importlib.util
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats import source
from isogi_core.files.formats.opening import open_file, open_upload, split_part
from isogi_core.files.grid import Grid, on_right_angles
from tests.files.formats.phantom import affine, letter

F = letter()


def opened(path: Path, **chosen: Any) -> Grid:
    return on_right_angles(open_file(path, chosen))


def check(path: Path, expected: np.ndarray, **chosen: Any) -> Grid:
    """The grid in a file, which holds the expected values and is read alike out of an open file."""
    grid = opened(path, **chosen)
    found = grid.whole()
    assert (found.shape, found.dtype) == (expected.shape, grid.dtype)
    np.testing.assert_allclose(found.astype(float), expected.astype(float), rtol=1e-6)
    if not chosen:
        upload = on_right_angles(open_upload(io.BytesIO(path.read_bytes()), path.name, 1 << 20))
        np.testing.assert_array_equal(upload.whole(), found)
    return grid


def nifti(path: Path, array: np.ndarray, **header: Any) -> Path:
    nib = pytest.importorskip("nibabel")
    image = nib.Nifti1Image(array.T, affine())
    for name, value in header.items():
        getattr(image.header, f"set_{name}")(*value)
    nib.save(image, path)
    return path


NUMBERS = ("u1", "i1", "<i2", ">i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", ">f4", "<f8")


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("kind", NUMBERS)
def test_nifti_holds_every_number(tmp_path: Path, kind: str, version: int) -> None:
    nib = pytest.importorskip("nibabel")
    array = (F // 8).astype(kind)
    make = getattr(nib, f"Nifti{version}Image")
    header = make.header_class(endianness=">" if kind[0] == ">" else "<")
    nib.save(make(array.T, affine(), header), tmp_path / "f.nii")
    assert check(tmp_path / "f.nii", array).unit == ""


@pytest.mark.parametrize("name", ["f.nii.gz", "f.img", "f.hdr"])
def test_packed_nifti_and_pairs_are_read(tmp_path: Path, name: str) -> None:
    nib = pytest.importorskip("nibabel")
    if name.endswith("gz"):
        kind = nib.Nifti1Image
    else:
        kind = nib.Nifti1Pair
    nib.save(kind(F.T, affine()), tmp_path / name.replace("hdr", "img"))
    np.testing.assert_array_equal(opened(tmp_path / name.replace("img", "hdr")).whole(), F)


def test_nifti_slope_and_intercept_are_applied(tmp_path: Path) -> None:
    scaled = nifti(tmp_path / "f.nii", F, slope_inter=(0.5, -100.0), xyzt_units=("mm",))
    grid = check(scaled, F * 0.5 - 100.0)
    assert (grid.dtype, grid.unit) == (np.float32, "mm")
    whole = check(nifti(tmp_path / "g.nii", F, slope_inter=(1.0, -1024.0)), F.astype(int) - 1024)
    assert whole.dtype == np.int32  # whole numbers stay whole


def test_a_time_step_of_a_nifti_file_is_chosen(tmp_path: Path) -> None:
    path = nifti(tmp_path / "f.nii.gz", np.stack([F, F + 1, F + 2]))
    check(path, F)
    assert (opened(path).moment, opened(path).unchosen) == ((0, 3), True)
    check(path, F + 2, time=2)
    assert (opened(path, time=2).moment, opened(path, time=2).unchosen) == ((2, 3), False)
    with pytest.raises(VolumeError, match="time = 3 is not in"):
        opened(path, time=3)


def test_channels_of_a_nifti_file_have_to_be_chosen(tmp_path: Path) -> None:
    path = nifti(tmp_path / "f.nii", np.stack([F, F + 1])[:, None])
    with pytest.raises(VolumeError, match=r"has 2 channels: choose one by channel = 0 to 1"):
        opened(path)


def test_transforms_that_differ_are_told(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    image = nib.Nifti1Image(F.T, affine())
    image.set_qform(affine() + np.eye(4, k=3) * 5.0, 1)
    image.set_sform(affine(), 1)
    nib.save(image, tmp_path / "f.nii")
    grid = check(tmp_path / "f.nii", F)
    assert "differ by 5 voxels: the sform is taken" in grid.notes[0]
    image.set_qform(None, 0)
    image.set_sform(None, 0)
    nib.save(image, tmp_path / "g.nii")
    grid = check(tmp_path / "g.nii", F)
    assert grid.affine is None and "does not say how it lies" in grid.notes[0]


def test_colours_and_complex_numbers_of_nifti(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    colours = np.zeros(F.shape, [("R", "u1"), ("G", "u1"), ("B", "u1")])
    colours["G"] = 100
    nib.save(nib.Nifti1Image(colours.T, affine()), tmp_path / "f.nii")
    assert "colours" in check(tmp_path / "f.nii", np.full(F.shape, 71.52)).notes[0]
    nib.save(nib.Nifti1Image(F.T.astype(np.complex64), affine()), tmp_path / "g.nii")
    assert opened(tmp_path / "g.nii").dtype == np.complex64  # which ``check`` of the survey refuses


@pytest.mark.parametrize("kind", ["<f4", "<i2", "<u2", "<f2", "i1"])
def test_mrc_maps_are_read(tmp_path: Path, kind: str) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.new(tmp_path / "f.mrc") as made:
        made.set_data((F // 8).astype(kind))
        made.voxel_size = (1.0, 1.25, 1.5)
        made.header.origin = (5.0, 6.0, 7.0)
    grid = check(tmp_path / "f.mrc", F // 8)
    np.testing.assert_allclose(grid.spacing, (1.0, 1.25, 1.5))
    assert grid.affine is not None
    assert (grid.affine.origin, grid.unit) == ((5.0, 6.0, 7.0), "Å")


def test_an_mrc_map_says_along_which_axes_it_runs(tmp_path: Path) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.new(tmp_path / "f.mrc") as made:
        made.set_data(F.astype("f4"))
        made.header.mapc, made.header.mapr, made.header.maps = 3, 1, 2
        made.header.cella = (20.0, 24.0, 16.0)
        made.header.mx = 20
        made.header.my = 12
        made.header.mz = 16
        made.header.nxstart = 4
        made.header.nystart = 2
        made.header.nzstart = -1
    grid = open_file(tmp_path / "f.mrc", {})
    assert grid.affine is not None
    np.testing.assert_allclose(
        grid.affine.array, [[0, 1, 0, 2], [0, 0, 2, -2], [1, 0, 0, 4]], atol=1e-6
    )


@pytest.mark.parametrize("chunks", [None, (4, 8, 8)])
def test_a_dataset_of_hdf5_is_named(tmp_path: Path, chunks: Any) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "f.h5", "w") as file:
        data = file.create_dataset(
            "entry/data", data=F, chunks=chunks, compression="gzip" if chunks else None
        )
        data.attrs["element_size_um"] = (1.5, 1.25, 1.0)
    assert check(tmp_path / "f.h5", F).spacing == (1.0, 1.25, 1.5)
    with h5py.File(tmp_path / "f.h5", "a") as file:
        file["entry/other"] = np.stack([F, F + 1])
    with pytest.raises(
        VolumeError, match=r"several volumes: choose of '.*f.h5#entry/data', '.*f.h5#entry/other'"
    ):
        opened(tmp_path / "f.h5")
    check(tmp_path / "f.h5", F, part="entry/data")
    check(tmp_path / "f.h5", F + 1, part="/entry/other", time=1)


def test_datasets_that_end_alike_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    with pytest.importorskip("h5py").File(path, "w") as file:
        for n, name in enumerate(("a/data", "b/data", "b/more")):
            file[name] = F + n
    with pytest.raises(VolumeError) as error:
        opened(path, part="data")
    assert f"several volumes 'data': choose of '{path}#a/data', '{path}#b/data'." in str(
        error.value
    )
    check(path, F + 2, part="/more")


def test_netcdf_coordinates_packing_and_fill_values(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "f.nc", "w") as file:
        data = file.create_dataset("temperature", data=F)
        data.attrs.update({"scale_factor": 0.5, "add_offset": 10.0, "_FillValue": np.int16(0)})
        for axis, (name, count, step) in enumerate(
            [("z", 12, -1.5), ("y", 20, 1.25), ("x", 16, 1.0)]
        ):
            file[name] = 3.0 + step * np.arange(count)
            file[name].attrs["units"] = "m"
            file[name].make_scale(name)
            data.dims[axis].attach_scale(file[name])
    grid = check(tmp_path / "f.nc", np.where(F == 0, np.nan, F * 0.5 + 10.0)[..., ::-1])
    assert (grid.spacing, grid.unit) == ((1.0, 1.25, 1.5), "m")
    assert grid.affine is not None and grid.affine.origin == (
        18.0,
        3.0,
        3.0,
    )  # z descends: x runs the other way


@pytest.mark.parametrize("order", "CF")
def test_numpy_files_are_read(tmp_path: Path, order: Any) -> None:
    np.save(tmp_path / "f.npy", np.asarray(F.astype(">i4"), order=order))
    check(tmp_path / "f.npy", F)
    np.savez_compressed(tmp_path / "f.npz", a=F, b=np.stack([F, F + 1]).astype(np.float16))
    with pytest.raises(VolumeError, match=r"choose of '.*f.npz#a', '.*f.npz#b'"):
        opened(tmp_path / "f.npz")
    check(tmp_path / "f.npz", F, part="a")
    check(tmp_path / "f.npz", (F + 1).astype(np.float16), part="b", time=1)
    np.save(tmp_path / "o.npy", np.array([None, F], dtype=object), allow_pickle=True)
    with pytest.raises(VolumeError, match="holds object"):
        opened(tmp_path / "o.npy")


TILED = {"tile": (16, 16), "compression": "zlib"}
PACKINGS: list[dict[str, Any]] = [
    {},
    {"compression": "zlib"},
    {"bigtiff": True},
    TILED,
    {**TILED, "bigtiff": True},
]
IMAGEJ: dict[str, Any] = {"imagej": True, "metadata": {"axes": "ZYX", "spacing": 0.5, "unit": "um"}}


@pytest.mark.parametrize("kind", ["u1", "<u2", ">i2", "<f2", "<f4"])
def test_tiff_stacks_are_read(tmp_path: Path, kind: str) -> None:
    tifffile = pytest.importorskip("tifffile")
    array = (F // 8).astype(kind)
    order = kind[0] if kind[0] == ">" else "<"
    for number, packing in enumerate(PACKINGS + ([IMAGEJ] if kind in ("u1", "<u2", "<f4") else [])):
        path = tmp_path / f"{number}.tif"
        tifffile.imwrite(path, array, photometric="minisblack", byteorder=order, **packing)
        grid = check(path, array)
        assert (grid.spacing, grid.unit) == (
            ((1.0, 1.0, 0.5), "µm") if packing is IMAGEJ else ((1.0, 1.0, 1.0), "")
        )


def test_planes_that_were_written_one_by_one_are_a_stack(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffWriter(tmp_path / "f.tif") as made:
        for layer in F:
            made.write(layer, photometric="minisblack")
    check(tmp_path / "f.tif", F)


@pytest.mark.parametrize(
    ("axes", "what"), [("TYX", "steps in time"), ("CYX", "channels"), ("ZYX", ""), ("", "")]
)
@pytest.mark.parametrize("kind", ["ome", "imagej"])
def test_frames_of_a_film_are_layers_and_it_says_so(
    tmp_path: Path, kind: str, axes: str, what: str
) -> None:
    tifffile = pytest.importorskip("tifffile")
    if axes:
        named = {kind: True, "metadata": {"axes": axes}}
    else:
        named = {}
    tifffile.imwrite(tmp_path / "f.tif", F.astype(np.uint16), photometric="minisblack", **named)
    grid = open_file(tmp_path / "f.tif", {})
    np.testing.assert_array_equal(grid.whole(), F)
    assert grid.notes == ((f"Its planes are {what}: they are shown as layers.",) if what else ())
    assert grid.read_as.endswith("; its planes are taken for depth") == (axes != "ZYX")


def test_a_packing_of_tiff_that_is_missing_is_named(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    if importlib.util.find_spec("imagecodecs") is not None:
        pytest.skip("imagecodecs is installed")
    tifffile.imwrite(tmp_path / "f.tif", F, photometric="minisblack")
    with tifffile.TiffFile(tmp_path / "f.tif", mode="r+b") as file:
        for page in file.pages:
            page.tags["Compression"].overwrite(5)  # LZW
    with pytest.raises(
        VolumeError, match=r"imagecodecs reads, which is not installed: pip install imagecodecs\."
    ):
        open_file(tmp_path / "f.tif", {}).whole()


def test_ome_tiff_says_spacing_channels_and_times(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    about = {"axes": "TCZYX", "PhysicalSizeX": 0.1, "PhysicalSizeY": 0.1, "PhysicalSizeZ": 0.3}
    fields = np.arange(6, dtype=np.int16).reshape(2, 3, 1, 1, 1) + F
    tifffile.imwrite(tmp_path / "f.ome.tif", fields, metadata=about, photometric="minisblack")
    with pytest.raises(VolumeError, match="3 elements of channel"):
        opened(tmp_path / "f.ome.tif")
    first = check(tmp_path / "f.ome.tif", fields[0, 1], channel=1)
    assert (first.moment, first.unchosen) == ((0, 2), True)
    grid = check(tmp_path / "f.ome.tif", fields[1, 2], time=1, channel=2)
    assert (grid.moment, grid.unchosen) == ((1, 2), False)
    assert (grid.spacing, grid.unit) == ((0.1, 0.1, 0.3), "µm")


def test_a_folder_of_tiff_slices_is_a_volume(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    for number, layer in enumerate(F):
        tifffile.imwrite(
            tmp_path / f"slice{number}.tif", layer
        )  # 10 comes after 9, and not after 1
    np.testing.assert_array_equal(opened(tmp_path).whole(), F)
    (tmp_path / "slice4.tif").unlink()
    with pytest.raises(VolumeError, match=r"'slice3.tif' is followed by 'slice5.tif'"):
        opened(tmp_path)
    tifffile.imwrite(tmp_path / "slice4.tif", F[4, 1:])
    with pytest.raises(VolumeError, match=r"'slice4.tif' .* is \(19, 16\)"):
        opened(tmp_path)


def test_what_is_not_installed_is_told_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(source, "import_module", missing)
    for name, head in (
        ("f.h5", b"\x89HDF\r\n\x1a\n"),
        ("f.mrc", bytes(208) + b"MAP "),
        ("f.tif", b"II*\0"),
    ):
        (tmp_path / name).write_bytes(head + bytes(1024))
        with pytest.raises(VolumeError, match=r"is not installed: pip install 'isogi\[formats\]'"):
            opened(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "place", "chosen"),
    [
        ("a.h5#entry/data", "a.h5", {"part": "entry/data"}),
        ("a.nii#time=3&channel=1", "a.nii", {"time": "3", "channel": "1"}),
        ("scans/ct#series=1", "scans/ct", {"series": "1"}),
        ("a.nii", "a.nii", {}),
    ],
)
def test_a_part_of_a_file_is_named_after_it(name: str, place: str, chosen: dict[str, str]) -> None:
    assert split_part(name) == (place, chosen)


def test_a_part_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(VolumeError, match="chooses nothing"):
        split_part("a.nii#slice=3")
    path = nifti(tmp_path / "f.nii", F)
    with pytest.raises(VolumeError, match="no whole number"):
        opened(path, time="last")
    with pytest.raises(VolumeError, match="has no 'series' to choose"):
        opened(path, series=1)


def test_bombs_and_files_cut_short_are_refused(tmp_path: Path) -> None:
    path = nifti(tmp_path / "f.nii", F)
    whole = path.read_bytes()
    (tmp_path / "cut.nii").write_bytes(whole[:-100])
    (tmp_path / "cut.nii.gz").write_bytes(gzip.compress(whole)[:-100])
    for name in ("cut.nii", "cut.nii.gz"):
        with pytest.raises(VolumeError, match=r"ends before its last voxel|damaged"):
            opened(tmp_path / name).whole()
    promise = bytearray(whole)
    promise[40:56] = np.array([3, 2000, 2000, 2000, 1, 1, 1, 1], "<i2").tobytes()
    (tmp_path / "promise.nii.gz").write_bytes(gzip.compress(bytes(promise)))
    with pytest.raises(VolumeError, match="ends before its last voxel"):
        list(opened(tmp_path / "promise.nii.gz").slabs())
    with pytest.raises(VolumeError, match="most that may be"):
        open_upload(io.BytesIO(bytes(promise)), "promise.nii", 1 << 20)
    bomb = gzip.compress(whole + bytes(1 << 26))
    (tmp_path / "bomb.nii.gz").write_bytes(bomb)
    np.testing.assert_array_equal(
        opened(tmp_path / "bomb.nii.gz").whole(), F
    )  # what is beyond is never unpacked


@pytest.mark.parametrize(
    ("stamp", "flags", "signed", "why"),
    [
        (1146047817, 0, False, "without a sign, as IMOD's flag in the file says"),
        (1146047817, 1, True, "with a sign, as IMOD's flag in the file says"),
        (1146047817, 6, False, "without a sign"),
        (0, 0, True, "with a sign, as MRC2014 says"),
    ],
)
@pytest.mark.parametrize("order", "<>")
def test_bytes_of_mrc_have_the_sign_that_imod_says(
    tmp_path: Path, order: str, stamp: int, flags: int, signed: bool, why: str
) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    array = np.arange(256, dtype=np.uint8).reshape(4, 8, 8)
    with mrcfile.new(tmp_path / "f.mrc") as made:
        made.set_data(array.view(np.int8))
    header = np.frombuffer((tmp_path / "f.mrc").read_bytes(), np.uint8).copy()
    if order == ">":
        with mrcfile.new(tmp_path / "f.mrc", overwrite=True) as made:
            made.set_data(array.view(np.int8).astype(">f4"))
            made.header.mode = 0
            header = np.frombuffer(made.header.tobytes() + array.tobytes(), np.uint8).copy()
    header[152:160] = np.frombuffer(np.array([stamp, flags], f"{order}u4").tobytes(), np.uint8)
    (tmp_path / "f.mrc").write_bytes(header.tobytes())
    grid = check(tmp_path / "f.mrc", array.view(np.int8) if signed else array)
    assert why in grid.notes[0]


@pytest.mark.parametrize("name", ["f.nii", "f.mrc", "f.nrrd"])
def test_a_gzip_file_without_its_checksum_is_whole(tmp_path: Path, name: str) -> None:
    whole = {"f.nii": nifti_bytes, "f.mrc": mrc_bytes, "f.nrrd": nrrd_bytes}[name](tmp_path)
    path = tmp_path / (name if name == "f.nrrd" else f"{name}.gz")
    for lost, words in ((0, False), (4, True), (8, True)):
        path.write_bytes(whole[: len(whole) - lost])
        grid = check(path, F)
        assert any("before its checksum" in note for note in grid.notes) == words
    path.write_bytes(whole[:-40])
    with pytest.raises(VolumeError, match=r"ends before its last voxel|damaged"):
        opened(path).whole()
    path.write_bytes(whole[:-8] + b"\0\0\0\0" + whole[-4:])
    with pytest.raises(VolumeError, match=r"damaged .*CRC"):
        opened(path).whole()


def nifti_bytes(folder: Path) -> bytes:
    return gzip.compress(nifti(folder / "f.nii", F).read_bytes())


def mrc_bytes(folder: Path) -> bytes:
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.new(folder / "f.mrc") as made:
        made.set_data(F)
    return gzip.compress((folder / "f.mrc").read_bytes())


def nrrd_bytes(folder: Path) -> bytes:
    nz, ny, nx = F.shape
    header = (
        f"NRRD0004\ntype: int16\ndimension: 3\nsizes: {nx} {ny} {nz}\nendian: "
        "little\nencoding: gzip\n\n"
    )
    return header.encode() + gzip.compress(F.astype("<i2").tobytes())


def test_gzip_of_several_members_is_whole(tmp_path: Path) -> None:
    whole = nifti(tmp_path / "f.nii", F).read_bytes()
    parts = (
        gzip.compress(whole[:999]) + gzip.compress(whole[999:]) + gzip.compress(b"")
    )  # as bgzip does
    (tmp_path / "f.nii.gz").write_bytes(parts)
    assert not check(tmp_path / "f.nii.gz", F).notes
    (tmp_path / "f.nii.gz").write_bytes(parts[:-24])  # the last member, and half of a checksum
    assert "before its checksum" in check(tmp_path / "f.nii.gz", F).notes[0]


@pytest.mark.parametrize("folder", [False, True])
def test_pixels_of_a_tiff_without_data_are_holes(tmp_path: Path, folder: bool) -> None:
    tifffile = pytest.importorskip("tifffile")
    tag = [(42113, 2, 5, "-9999", False)]
    holed = np.where(F == 0, -9999, F).astype(np.int16)
    if folder:
        for number, layer in enumerate(holed):
            tifffile.imwrite(tmp_path / f"{number}.tif", layer, extratags=tag)
    else:
        tifffile.imwrite(tmp_path / "f.tif", holed, photometric="minisblack", extratags=tag)
    grid = opened(tmp_path if folder else tmp_path / "f.tif")
    np.testing.assert_array_equal(grid.whole(), np.where(F == 0, np.nan, F))
    assert grid.notes == ("Holes are -9999 (no data).",)


@pytest.mark.parametrize("how", ["name", "unit"])
def test_netcdf_says_which_axis_is_time(tmp_path: Path, how: str) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "f.nc", "w") as file:
        data = file.create_dataset("v", data=np.stack([F, F + 1]))
        file["steps"] = np.arange(2.0)
        if how == "name":
            file["steps"].attrs["units"] = "1"
        else:
            file["steps"].attrs["units"] = "days since 2000-01-01"
        file["steps"].make_scale("time" if how == "name" else "step")
        data.dims[0].attach_scale(file["steps"])
    grid = check(tmp_path / "f.nc", F)
    assert (grid.moment, grid.unchosen) == ((0, 2), True)
    assert not check(tmp_path / "f.nc", F + 1, time=1).unchosen


@pytest.mark.data
@pytest.mark.parametrize("name", ["emd_3001.map", "emd_3197.map"])
def test_shared_maps_hold_what_mrcfile_reads(shared_data: Path, name: str) -> None:
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.open(shared_data / "formats" / name) as whole:
        grid = open_file(shared_data / "formats" / name, {})
        np.testing.assert_array_equal(grid.whole(), whole.data)
        np.testing.assert_allclose(
            np.sort(grid.spacing), np.sort(whole.voxel_size.tolist()), rtol=1e-5
        )


@pytest.mark.parametrize("shape", [(7,), (4, 5)])
def test_an_array_of_fewer_dimensions_says_what_to_do(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    np.save(tmp_path / "flat.npy", np.zeros(shape))
    said = rf"flat.npy' has {len(shape)} dimensions, .*: a volume has three \(z, y, x\)"
    with pytest.raises(VolumeError, match=said):
        open_file(tmp_path / "flat.npy", {})
