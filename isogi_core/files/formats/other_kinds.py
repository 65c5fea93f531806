"""Kinds of files that isogi recognises by their beginning, but does not read, each with advice."""

from pathlib import Path

from isogi_core.files.formats.kinds import (
    Head,
    Kind,
    legacy_vtk,
    marked,
    matching,
    vtk_file,
)

PICTURE_HINT = (
    "a picture, and a volume is many slices: give the folder of a stack of TIFFs, or one NRRD"
)
MESH_HINT = "a mesh of triangles, which has no values inside: give the volume that it was made from"
CELLS_HINT = (
    "a mesh of VTK, whose points lie on no even grid: resample it in ParaView, by the filter "
    "Resample To Image, and save that as .vti"
)
BARE_VOXELS_HINT = (
    "bare voxels without a header: say what they are by --raw "
    "256x256x128,uint8,little, or in the name of the file"
)
LIGHT_PROBE_HINT = (
    "a light probe: give it as --environment, or name it in a scene, environment = 'file.hdr'"
)
WEB_PAGE_HINT = "a web page, as of a download that went wrong: fetch the file again"
MICROSCOPE_HINT = (
    "a microscope's file ({}): write it as OME-TIFF by Bio-Formats, bfconvert IN OUT.ome.tif"
)
SCANNER_HINT = "a microCT scanner's file ({}): open it in Fiji, and save it as TIFF or NRRD"
UNPACK_HINT = "packed by {}: unpack it, and give the volume in it"
TEXT_HINT = (
    "a text of no kind that is known here: give NRRD, or save the numbers as an array of "
    "NumPy (z, y, x)"
)

OTHER_KINDS: tuple[Kind, ...] = (
    Kind("PNG", marked(b"\x89PNG"), hint=PICTURE_HINT),
    Kind("JPEG", marked(b"\xff\xd8\xff"), hint=PICTURE_HINT),
    Kind("GIF", marked(b"GIF8"), hint=PICTURE_HINT),
    Kind("JPEG 2000", marked(b"\0\0\0\x0cjP  ", b"\xff\x4f\xff\x51"), hint=PICTURE_HINT),
    Kind("WebP", marked(b"WEBP", at=8), hint=PICTURE_HINT),
    Kind("Radiance", marked(b"#?R"), hint=LIGHT_PROBE_HINT),
    Kind("OpenEXR", marked(b"\x76\x2f\x31\x01"), hint=LIGHT_PROBE_HINT),
    Kind("PDF", marked(b"%PDF"), hint="a PDF document: give the file of the volume itself"),
    Kind("STL", matching(rb"solid [^\n]*\n\s*(?:facet|endsolid)"), hint=MESH_HINT),
    Kind("PLY", marked(b"ply\n", b"ply\r"), hint=MESH_HINT),
    Kind("glTF", marked(b"glTF"), hint=MESH_HINT),
    Kind("HTML", matching(rb"<!doctype html|<html"), hint=WEB_PAGE_HINT),
    Kind(
        "Git LFS",
        marked(b"version https://git-lfs"),
        hint="a pointer of Git LFS, not the file: fetch that by git lfs pull",
    ),
    Kind(
        "OpenVDB",
        marked(b" BDV\0\0\0\0", b"NanoVDB"),
        hint="a sparse grid of OpenVDB: copy it into a dense array by copyToArray of openvdb, and "
        "save that by numpy.save, as z, y, x",
    ),
    Kind(
        "GRIB",
        marked(b"GRIB"),
        hint="GRIB of weather and climate: convert it to NetCDF, by cdo -f nc4 copy IN OUT.nc",
    ),
    Kind(
        "HDF4",
        marked(b"\x0e\x03\x13\x01"),
        hint="HDF4, which is older than HDF5: convert it, by h4toh5 IN OUT.h5",
    ),
    Kind(
        "MATLAB",
        marked(b"MATLAB 5.0 MAT-file"),
        hint="a MAT-file of MATLAB's older form: save it by save('volume.mat', 'name', '-v7.3') "
        "in MATLAB, or by numpy.save of what scipy.io.loadmat reads",
    ),
    Kind(
        "SEG-Y",
        marked(b"\xc3\x40\xf1", b"\xc3\x40\x40\xf1"),
        hint="SEG-Y of seismic surveys: save its cube by numpy.save(OUT, segyio.tools.cube(IN))",
    ),
    Kind("Scanco AIM", marked(b"AIMDATA_V0"), hint=SCANNER_HINT.format("Scanco AIM")),
    Kind(
        "SLC",
        matching(rb"11111\s+\d+\s+\d+\s+\d+\s"),
        hint="SLC of VolVis: read it by vtkSLCReader in Python, and write .vti by "
        "vtkXMLImageDataWriter",
    ),
    Kind("ZVI and OIB", marked(b"\xd0\xcf\x11\xe0"), hint=MICROSCOPE_HINT.format("ZVI or OIB")),
    Kind("CZI", marked(b"ZISRAWFILE"), hint=MICROSCOPE_HINT.format("Zeiss CZI")),
    Kind("ND2", marked(b"\xda\xce\xbe\x0a"), hint=MICROSCOPE_HINT.format("Nikon ND2")),
    Kind("LIF", marked(b"\x70\0\0\0"), (".lif",), both=True, hint=MICROSCOPE_HINT.format("LIF")),
    Kind(
        "DM3 and DM4",
        marked(b"\0\0\0\3", b"\0\0\0\4"),
        (".dm3", ".dm4"),
        both=True,
        hint=MICROSCOPE_HINT.format("Gatan DM3 or DM4"),
    ),
    Kind("VTK grid", vtk_file(b"P?(?:Structured|Unstructured)Grid"), hint=CELLS_HINT),
    Kind(
        "VTK AMR",
        vtk_file(b"(?:vtk)?(?:Overlapping|NonOverlapping|Hierarchical)\\w*"),
        hint=CELLS_HINT,
    ),
    Kind("VTK mesh", vtk_file(b"P?PolyData"), hint=MESH_HINT),
    Kind(
        "VTK list",
        vtk_file(b"(?:vtkMultiBlockDataSet|Collection|vtkPartitioned\\w*)"),
        hint="a list of other files of VTK: give one that it names",
    ),
    Kind("VTK mesh", legacy_vtk(b"POLYDATA"), hint=MESH_HINT),
    Kind(
        "VTK grid",
        legacy_vtk(b"RECTILINEAR_GRID"),
        hint="a rectilinear grid in VTK's legacy form: open it in ParaView, and save it as .vtr",
    ),
    Kind(
        "PVTR",
        vtk_file(b"PRectilinearGrid"),
        hint="pieces of a rectilinear grid of VTK: open it in ParaView, and save it as one .vtr",
    ),
    Kind("VTK grid", legacy_vtk(b"STRUCTURED_GRID", b"UNSTRUCTURED_GRID"), hint=CELLS_HINT),
    Kind("gzip in Zstandard", marked(b"\x28\xb5\x2f\xfd"), hint=UNPACK_HINT.format("Zstandard")),
    Kind("xz", marked(b"\xfd7zXZ\0"), hint=UNPACK_HINT.format("xz")),
    Kind("7z", marked(b"7z\xbc\xaf\x27\x1c"), hint=UNPACK_HINT.format("7-Zip")),
    Kind("RAR", marked(b"Rar!\x1a\x07"), hint=UNPACK_HINT.format("RAR")),
    Kind("tar", marked(b"ustar", at=257), hint=UNPACK_HINT.format("tar")),
    Kind(
        "pickle",
        marked(b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"),
        (".pkl", ".pickle", ".pt", ".pth"),
        both=True,
        hint="a pickle of Python, which may run any code: save the array by numpy.save",
    ),
    Kind("Parquet", marked(b"PAR1"), hint="a table of Parquet: save an array by numpy.save"),
)
"""Kinds without a reader, in the order in which a file is compared with them."""

WRONG_SUFFIXES = {
    ".stl": MESH_HINT,
    ".obj": MESH_HINT,
    ".ply": MESH_HINT,
    ".frmsf": "a Fermi surface of FermiSurfer: write the bands as BXSF",
    ".aim": SCANNER_HINT.format("Scanco AIM"),
    ".raw": BARE_VOXELS_HINT,
    ".bin": BARE_VOXELS_HINT,
}
"""Hints by the suffix of a file whose beginning is not known."""

TEXT_BYTES = bytes((*range(0x20, 0x7F), *b"\t\n\r\f\x1a", *range(0x80, 0x100)))
"""Bytes that texts have, in ASCII, Latin-1 and UTF-8."""


def hint_of(head: Head) -> str:
    """Return a hint on the likely kind of a file by its first bytes, and advice; empty if they are
    not known.
    """
    for kind in OTHER_KINDS:
        if kind.is_of(head.content, head.suffix):
            return kind.hint
    return ""


def is_text(head: Head) -> bool:
    """Return True if a file begins as a text, of any language."""
    return bool(head.content) and not head.content.translate(None, TEXT_BYTES)


def guess_of(head: Head) -> str:
    """Return a hint on a file of no known kind: that it is a text, by its bytes, else by its
    suffix.
    """
    if is_text(head):
        return WRONG_SUFFIXES.get(head.suffix) or TEXT_HINT
    if head.is_packed:
        return WRONG_SUFFIXES.get(head.suffix, BARE_VOXELS_HINT)
    return WRONG_SUFFIXES.get(head.suffix, "")


TO_OME_ZARR = "write it as OME-Zarr"

FOLDER_KINDS: tuple[tuple[tuple[str, ...], str], ...] = (
    (
        ("snapshots", "manifests"),
        f"a repository of icechunk: {TO_OME_ZARR}, or open it by icechunk "
        "and save the array by numpy.save",
    ),
    (("attributes.json",), f"N5: {TO_OME_ZARR}, by File > Save As > HDF5/N5/Zarr/OME-NGFF in Fiji"),
    (
        ("info",),
        f"a precomputed volume of Neuroglancer: {TO_OME_ZARR}, or read a part of it by "
        "cloud-volume and save that by numpy.save",
    ),
    (("__array_schema",), "an array of TileDB: save it by numpy.save"),
    (("__schema",), "an array of TileDB: save it by numpy.save"),
)
"""Names of files and folders by which folders are recognised, and hints on these."""


def hint_of_folder(folder: Path) -> str:
    """Return a hint on the likely kind of a folder by the names in it, and advice; empty if these
    are not known.
    """
    for names, hint in FOLDER_KINDS:
        if all((folder / name).exists() for name in names):
            return hint
    pictures = [each for each in folder.iterdir() if each.suffix.lower() in PICTURE_SUFFIXES]
    if len(pictures) > 1:
        return (
            f"slices as {pictures[0].suffix[1:].upper()}: save them as TIFF, in Fiji or by magick"
        )
    return ""


PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".jp2")
