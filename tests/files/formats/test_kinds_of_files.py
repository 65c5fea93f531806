"""Kinds of files are told by their first bytes: read, or named with a way out; headers of bare
voxels fill in what they are.
"""

import bz2
import gzip
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.kinds import READ_KINDS
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import Grid
from tests.files.formats.phantom import letter

F = letter()
NZ, NY, NX = F.shape
SIZES = f"{NX} {NY} {NZ}"


def refused(folder: Path, name: str, content: bytes) -> str:
    """The sentence that refuses a file, as a path and as an upload."""
    (folder / name).write_bytes(content)
    with pytest.raises(VolumeError) as one:
        open_file(folder / name, {})
    with pytest.raises(VolumeError) as other:
        open_upload(io.BytesIO(content), name, 1 << 20)
    assert str(one.value).replace(f"{folder}/", "") == str(other.value)
    return str(other.value)


NAMED = [
    ("a.vdb", b" BDV\0\0\0\0", "OpenVDB", "numpy.save"),
    ("a.nvdb", b"NanoVDB0", "OpenVDB", "numpy.save"),
    ("a.grb2", b"GRIB\0\0\0\2", "GRIB", "cdo -f nc4 copy"),
    ("a.hdf", b"\x0e\x03\x13\x01", "HDF4", "h4toh5"),
    ("a.mat", b"MATLAB 5.0 MAT-file, Platform", "MAT-file", "-v7.3"),
    ("a.am", b"# Avizo BINARY-LITTLE-ENDIAN 2.1\n", "AmiraMesh", "NRRD or TIFF"),
    ("a.am", b"# AmiraMesh 3D ASCII 2.0\n", "AmiraMesh", "NRRD or TIFF"),
    ("a.aim", b"AIMDATA_V030   ", "Scanco AIM", "Fiji"),
    ("a.slc", b"11111\n64 64 64 8\n", "SLC", "vtkSLCReader"),
    ("a.czi", b"ZISRAWFILE\0\0", "CZI", "bfconvert"),
    ("a.nd2", b"\xda\xce\xbe\x0a", "ND2", "bfconvert"),
    ("a.dm4", b"\0\0\0\4\0", "DM4", "bfconvert"),
    ("a.sgy", b"\xc3\x40\xf1\x40", "SEG-Y", "segyio"),
    ("a.vts", b'<?xml version="1.0"?><VTKFile type="StructuredGrid">', "mesh of VTK", "Resample"),
    ("a.vtu", b'<VTKFile type="UnstructuredGrid" version="1.0">', "mesh of VTK", "Resample"),
    ("a.vtp", b'<VTKFile type="PolyData" version="1.0">', "triangles", "the volume"),
    ("a.pvd", b'<VTKFile type="Collection" version="1.0">', "list of other files", "give one"),
    ("a.vtk", b"# vtk DataFile Version 3.0\na\nBINARY\nDATASET POLYDATA\n", "triangles", "volume"),
    ("a.vtk", b"# vtk DataFile Version 3.0\na\nASCII\nDATASET UNSTRUCTURED_GRID\n", "mesh", "Res"),
    ("a.vtk", b"# vtk DataFile Version 3.0\na\nASCII\nDATASET RECTILINEAR_GRID\n", "recti", ".vtr"),
    ("a.xz", b"\xfd7zXZ\0", "packed by xz", "unpack it"),
    ("a.tar", bytes(257) + b"ustar", "packed by tar", "unpack it"),
    ("a.dat", b"", "is empty", "copy or write it again"),
    ("a.txt", b"1 2 3\n4 5 6\n", "a text of no kind", "NumPy"),
    ("a.txt.gz", gzip.compress(b"1 2 3\n"), "a text of no kind", "NumPy"),
    ("a.frmsf", b" 15 15 12\n 1\n 3\n", "FermiSurfer", "BXSF"),
    ("a.dcm.gz", gzip.compress(bytes(128) + b"DICM"), "DICOM, packed by gzip", "unpack it first"),
    ("a.bin.bz2", bz2.compress(b"\0\1\2\3"), "bare voxels", "--raw"),
]


@pytest.mark.parametrize(
    ("name", "content", "kind", "way_out"),
    NAMED,
    ids=[f"{name} {kind}" for name, _, kind, _ in NAMED],
)
def test_a_file_is_named_with_a_way_out(
    tmp_path: Path, name: str, content: bytes, kind: str, way_out: str
) -> None:
    said = refused(tmp_path, name, content)
    assert kind in said and way_out in said and said.endswith(".")


FOLDERS = [
    ({"attributes.json": "{}"}, "seems to be N5: write it as OME-Zarr"),
    ({"info": "{}"}, "precomputed volume of Neuroglancer"),
    ({"snapshots/1": "", "manifests/1": ""}, "icechunk"),
    ({"a.png": "", "b.png": ""}, "slices as PNG: save them as TIFF"),
    ({"a.txt": "1", "b.txt": "2"}, r"holds 2 files \(a.txt, b.txt\) and no slice"),
    ({}, "holds no files"),
    ({"a.nrrd": "NRRD0004\n", "readme.txt": "words"}, "a.nrrd in it would open"),
]


@pytest.mark.parametrize(("files", "said"), FOLDERS)
def test_a_folder_is_named(tmp_path: Path, files: dict[str, str], said: str) -> None:
    for name, text in files.items():
        path = tmp_path / "held" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "held").mkdir(exist_ok=True)
    with pytest.raises(VolumeError, match=said):
        open_file(tmp_path / "held", {})


def test_readers_of_all_kinds_are_there() -> None:
    assert all(callable(kind.open()) for kind in READ_KINDS)


META = (
    "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {msb}\n"
    "TransformMatrix = 0 1 0 -1 0 0 0 0 1\nOffset = 5 6 7\nElementSpacing = 1 1.25 1.5\n"
    f"DimSize = {SIZES}\nElementType = MET_SHORT\nElementDataFile = {{data}}\n"
)
BOV = (
    f"TIME: 0\nDATA_FILE: {{data}}\nDATA_SIZE: {SIZES}\nDATA_FORMAT: SHORT\nDATA_ENDIAN: LITTLE\n"
    f"CENTERING: nodal\nBRICK_ORIGIN: 1 2 3\nBRICK_SIZE: {NX - 1} {1.25 * (NY - 1)} "
    f"{1.5 * (NZ - 1)}\n"
)
VGI = (
    f"{{volume1}}\n[representation]\nsize = {SIZES}\ndatatype = signed integer\n"
    "bitsperelement = 16\n[file1]\nName = {data}\n[geometry]\nresolution = 1 1.25 1.5\n"
)
DAT = f"ObjectFileName: {{data}}\nResolution: {SIZES}\nSliceThickness: 1 1.25 1.5\nFormat: SHORT\n"


def check(grid: Grid) -> None:
    """That a grid is the phantom, with its spacing."""
    np.testing.assert_array_equal(grid.whole(), F)
    np.testing.assert_allclose(grid.spacing, (1.0, 1.25, 1.5))


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    ("name", "header"),
    [("f.mhd", META), ("f.bov", BOV), ("f.vgi", VGI), ("f.dat", DAT)],
    ids=["mhd", "bov", "vgi", "dat"],
)
def test_headers_say_what_bare_voxels_are(tmp_path: Path, name: str, header: str, end: str) -> None:
    text = header.replace("{data}", "f.raw").replace("{msb}", "False")
    (tmp_path / name).write_bytes(text.replace("\n", end).encode())
    with pytest.raises(VolumeError, match=r"'f.raw' with its voxels is not next to it"):
        open_file(tmp_path / name, {})
    (tmp_path / "f.raw").write_bytes(F.astype("<i2").tobytes())
    check(open_file(tmp_path / name, {}))
    given = open_file(tmp_path / "f.raw", {})
    check(given)
    assert f"'{name}' says what" in given.notes[-1]
    (tmp_path / "f.raw").write_bytes(F.astype("<i2").tobytes()[:-2])
    with pytest.raises(VolumeError, match="ends before its last voxel"):
        open_file(tmp_path / name, {}).whole()


@pytest.mark.parametrize("msb", [False, True])
def test_metaimage_lies_as_itk_says(tmp_path: Path, msb: bool) -> None:
    """Its directions are rows, of a patient's left, posterior, superior."""
    header = META.format(msb=msb, data="LOCAL").encode()
    content = header + F.astype(">i2" if msb else "<i2").tobytes()
    (tmp_path / "f.mha").write_bytes(content)
    grid = open_file(tmp_path / "f.mha", {})
    check(grid)
    check(open_upload(io.BytesIO(content), "f.mha", 1 << 20))
    assert grid.affine is not None and grid.affine.letters == "RAS"
    known = [[0.0, 1.25, 0.0, -5.0], [-1.0, 0.0, 0.0, -6.0], [0.0, 0.0, 1.5, 7.0]]
    np.testing.assert_allclose(grid.affine.array, known)
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.ReadImage(str(tmp_path / "f.mha"))
    turn = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
    np.testing.assert_allclose(grid.affine.array[:, :3], np.diag([-1, -1, 1]) @ turn)


@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress])
def test_voxels_at_the_end_of_a_file_are_found(tmp_path: Path, pack: Any) -> None:
    """HeaderSize = -1: whatever is before them, and also if they are packed."""
    text = META.format(msb=False, data="f.raw").replace(
        "ElementType", "HeaderSize = -1\nElementType"
    )
    (tmp_path / "f.mhd").write_text(text)
    (tmp_path / "f.raw").write_bytes(pack(b"a header of its own" + F.astype("<i2").tobytes()))
    check(open_file(tmp_path / "f.mhd", {}))


def isq() -> bytes:
    """A scan of Scanco's, with a block between header and voxels."""
    head = bytearray(1024)
    head[:16] = b"CTDATA-HEADER_V1"
    micrometres = (1000 * NX, 1250 * NY, 1500 * NZ)
    head[44:68] = np.array([NX, NY, NZ, *micrometres], "<i4").tobytes()
    head[88:92] = np.array([4096], "<i4").tobytes()
    head[508:512] = np.array([1], "<i4").tobytes()
    return bytes(head) + F.astype("<i2").tobytes()


def vff() -> bytes:
    """A scan of GE's."""
    head = f"ncaa\nrank=3;\nbits=16;\nbands=1;\nsize={SIZES};\nspacing=1 1.25 1.5;\n\x0c\n"
    return head.encode() + F.astype(">i2").tobytes()


def amira() -> bytes:
    """A lattice of Amira."""
    box = f"0 {NX - 1} 0 {1.25 * (NY - 1)} 0 {1.5 * (NZ - 1)}"
    head = (
        f"# AmiraMesh BINARY-LITTLE-ENDIAN 2.1\n\ndefine Lattice {SIZES}\n\nParameters {{\n"
        f' BoundingBox {box},\n CoordType "uniform"\n}}\n\nLattice {{ short Data }} @1\n\n'
        "# Data section follows\n@1\n"
    )
    return head.encode() + F.astype("<i2").tobytes() + b"\n"


@pytest.mark.parametrize("write", [isq, vff, amira])
def test_voxels_after_a_header(tmp_path: Path, write: Any) -> None:
    content = write()
    (tmp_path / "f.bin").write_bytes(content)
    check(open_file(tmp_path / "f.bin", {}))
    check(open_upload(io.BytesIO(content), "f.bin", 1 << 20))
    (tmp_path / "f.bin").write_bytes(content[: len(content) // 2])
    with pytest.raises(VolumeError, match="ends before its last voxel"):
        open_file(tmp_path / "f.bin", {}).whole()


def test_a_header_without_an_end_is_no_packed_file() -> None:
    for content in (vff()[:60], vff().replace(b"\x0c\n", b" " * (1 << 16) + b"\x0c\n")):
        with pytest.raises(VolumeError, match=r"header of 'f.vff' does not end within 65536 bytes"):
            open_upload(io.BytesIO(content), "f.vff", 1 << 20)


def test_a_header_of_several_is_to_be_chosen(tmp_path: Path) -> None:
    for name in ("a.mhd", "b.mhd"):
        (tmp_path / name).write_text(META.format(msb=False, data="f.raw"))
    (tmp_path / "f.raw").write_bytes(F.astype("<i2").tobytes())
    with pytest.raises(VolumeError, match=r"'a.mhd', 'b.mhd' next to it name it: give one"):
        open_file(tmp_path / "f.raw", {})


def test_a_header_that_leads_elsewhere_reads_its_place(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "f.raw").write_bytes(F.astype("<i2").tobytes())
    for outside in ("../f.raw", f"{tmp_path}/f.raw"):
        (tmp_path / "in" / "f.mhd").write_text(META.format(msb=False, data=outside))
        with pytest.raises(VolumeError, match=r"'f.raw' with its voxels is not next to it"):
            open_file(tmp_path / "in" / "f.mhd", {})


@pytest.mark.parametrize(
    ("given", "fits"),
    [
        ("16x20x12,uint8", "16 × 20 × 12 of uint16"),
        ("16x20x11,int16", "16 × 20 × 12 of int16"),
        ("9x9x9,uint8", "would fit"),
    ],
)
def test_a_wrong_size_says_which_would_fit(tmp_path: Path, given: str, fits: str) -> None:
    content = F.astype("<i2").tobytes() if "9x9" not in given else bytes(8 * 8 * 8)
    (tmp_path / "f.raw").write_bytes(content)
    with pytest.raises(VolumeError, match=fits):
        open_file(tmp_path / "f.raw", {"raw": given})


@pytest.mark.filterwarnings("ignore")
def test_parrec_is_read_by_its_header_or_its_voxels(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    held = Path(nib.__file__).parent / "tests" / "data"
    pair = [held / f"phantom_EPI_asc_CLEAR_2_1.{end}" for end in ("PAR", "REC")]
    if not all(path.is_file() for path in pair):
        pytest.skip("nibabel came without its files of tests")
    known = nib.parrec.load(str(pair[0]), strict_sort=True)
    for path in pair:
        for step in (0, 2):
            grid = open_file(path, {"time": step})
            assert grid.affine is not None and grid.moment == (step, 3)
            np.testing.assert_allclose(grid.affine.array, known.affine[:3])
            np.testing.assert_allclose(grid.whole(), known.dataobj[..., step].T, rtol=1e-6)
    (tmp_path / "f.PAR").write_bytes(pair[0].read_bytes())
    with pytest.raises(VolumeError, match=r"'f.REC' with its voxels is not next to it"):
        open_file(tmp_path / "f.PAR", {})


@pytest.mark.filterwarnings("ignore")
def test_ecat_is_read_as_nibabel_reads_it() -> None:
    nib = pytest.importorskip("nibabel")
    path = Path(nib.__file__).parent / "tests" / "data" / "tinypet.v"
    if not path.is_file():
        pytest.skip("nibabel came without its files of tests")
    grid = open_file(path, {})
    known = nib.ecat.load(str(path))
    np.testing.assert_allclose(grid.whole(), known.get_frame(0).T, rtol=1e-6)
    assert grid.affine is not None
    np.testing.assert_allclose(grid.affine.array, known.affine[:3])


def cards(**values: Any) -> bytes:
    """A header of FITS."""
    lines = [
        f"{key:<8}= {('T' if value is True else value)!s:>20}".ljust(80)
        for key, value in values.items()
    ]
    text = "".join([*lines, "END".ljust(80)])
    return text.ljust(-(-len(text) // 2880) * 2880).encode()


def fits(**more: Any) -> bytes:
    """A cube of FITS: 16 bits with a slope, and a number that stands for a hole."""
    head = cards(SIMPLE=True, BITPIX=16, NAXIS=3, NAXIS1=NX, NAXIS2=NY, NAXIS3=NZ, **more)
    data = F.astype(">i2").tobytes()
    return head + data + bytes(-len(data) % 2880)


def test_fits_without_its_library_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "astropy.io.fits", None)
    assert "pip install 'isogi[fits]'" in refused(tmp_path, "f.fits", fits())


def test_cubes_of_fits(tmp_path: Path) -> None:
    pytest.importorskip("astropy")
    places = {"CDELT1": 1.0, "CDELT2": 1.25, "CDELT3": -1.5}
    content = fits(BSCALE=0.5, BZERO=3.0, BLANK=int(F.max()), **places)
    for name, data in (("f.fits", content), ("f.fits.gz", gzip.compress(content))):
        (tmp_path / name).write_bytes(data)
        grid = open_file(tmp_path / name, {})
        np.testing.assert_allclose(grid.spacing, (1.0, 1.25, 1.5))
        known = np.where(F.max() == F, np.nan, 0.5 * F + 3.0)
        np.testing.assert_allclose(grid.whole(), known)
        assert grid.affine is not None and grid.affine.matrix[2][2] == -1.5
        assert grid.read_as == "FITS of int16, values 0.5 · stored +3; placed by its axes"
    (tmp_path / "sky.fits").write_bytes(fits(CTYPE1="'RA---TAN'", **places))
    assert "cubes, as its axes are RA---TAN" in open_file(tmp_path / "sky.fits", {}).notes[0]


@pytest.mark.parametrize("scaled", [{}, {"BSCALE": 0.5}, {"BZERO": 32768}])
@pytest.mark.parametrize("blank", [0, int(F.max())])
def test_blanks_of_fits_are_holes(tmp_path: Path, scaled: dict[str, Any], blank: int) -> None:
    """Also if they are 0, and in whole numbers without a sign."""
    pytest.importorskip("astropy")
    (tmp_path / "f.fits").write_bytes(fits(BLANK=blank, **scaled))
    values = scaled.get("BSCALE", 1) * F.astype(np.float64) + scaled.get("BZERO", 0)
    expected = np.where(blank == F, np.nan, values)
    np.testing.assert_array_equal(open_file(tmp_path / "f.fits", {}).whole(), expected)


@pytest.mark.parametrize(("bits", "zero", "kind"), [(16, 32768, np.uint16), (8, -128, np.int8)])
def test_fits_of_the_other_sign_stays_whole(
    tmp_path: Path, bits: int, zero: int, kind: type[np.integer[Any]]
) -> None:
    pytest.importorskip("astropy")
    stored = (F % 256).astype(f">i{bits // 8}" if bits > 8 else np.uint8)
    sizes = {"NAXIS1": NX, "NAXIS2": NY, "NAXIS3": NZ}
    head = cards(SIMPLE=True, BITPIX=bits, NAXIS=3, **sizes, BZERO=zero)
    (tmp_path / "f.fits").write_bytes(head + stored.tobytes() + bytes(-stored.nbytes % 2880))
    grid = open_file(tmp_path / "f.fits", {})
    assert grid.dtype == kind and grid.read_as.startswith(f"FITS of {grid.dtype};")
    np.testing.assert_array_equal(grid.whole(), stored.astype(np.int64) + zero)


def test_bytes_of_fits_have_no_sign(tmp_path: Path) -> None:
    pytest.importorskip("astropy")
    head = cards(SIMPLE=True, BITPIX=8, NAXIS=3, NAXIS1=NX, NAXIS2=NY, NAXIS3=NZ)
    data = (F % 256).astype(np.uint8)
    content = head + data.tobytes() + bytes(-data.size % 2880)
    (tmp_path / "f.fits").write_bytes(content)
    grid = open_file(tmp_path / "f.fits", {})
    assert data.max() > 127 and grid.read_as.startswith("FITS of uint8;")
    np.testing.assert_array_equal(grid.whole(), data)


def test_fits_without_a_cube_is_named(tmp_path: Path) -> None:
    pytest.importorskip("astropy")
    head = cards(SIMPLE=True, BITPIX=16, NAXIS=2, NAXIS1=NX, NAXIS2=NY)
    data = F[0].astype(">i2").tobytes()
    said = refused(tmp_path, "f.fits", head + data + bytes(-len(data) % 2880))
    assert "tables or images of two axes alone: give a file with a cube" in said


def test_a_name_of_several_cubes_of_fits_chooses_none(tmp_path: Path) -> None:
    astropy = pytest.importorskip("astropy.io.fits")
    cubes = [astropy.ImageHDU(F + n, name=name) for n, name in enumerate(("SCI", "SCI", "DQ"))]
    astropy.HDUList([astropy.PrimaryHDU(), *cubes]).writeto(tmp_path / "f.fits")
    for part, added in (("dq", 2), ("2", 1)):
        whole = open_file(tmp_path / "f.fits", {"part": part}).whole()
        np.testing.assert_array_equal(whole, F + added)
    with pytest.raises(VolumeError, match=r"holds no one cube: choose of '.*f.fits#1' SCI, "):
        open_file(tmp_path / "f.fits", {"part": "sci"})


def test_texts_that_name_each_other_are_no_headers(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_text("see b.dat")
    (tmp_path / "b.dat").write_text("see a.dat")
    with pytest.raises(VolumeError, match="a text of no kind"):
        open_file(tmp_path / "a.dat", {})
