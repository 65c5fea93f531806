"""Kinds of files: a table that recognises each by the beginning of files, else by their name, and
gives its reader, or advice if isogi has none.

A new kind is a new row, or a row of another package's plug-in. Readers, and the libraries that they
use, are imported when a file needs them.
"""

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import resolve_name
from pathlib import PurePath
from typing import NamedTuple

from isogi_core.files.formats.chemistry.cube import is_cube
from isogi_core.files.formats.chemistry.opendx import is_dx
from isogi_core.files.formats.chemistry.vasp import is_vasp
from isogi_core.files.formats.chemistry.xsf import is_xsf
from isogi_core.files.formats.source import Reader
from isogi_core.files.packed_files import BZIP2_MAGIC, GZIP_MAGIC, line_of
from isogi_core.files.plugins import READER_GROUP, Plugins, fault_of, load_object, plugins

FOLDER = "isogi_core.files.formats"
"""The package of isogi's readers."""

HEAD_BYTES = 4096
"""Bytes at the beginning of a file by which its kind is told."""

PACKED_SUFFIXES = (".gz", ".bz2")


class Head(NamedTuple):
    """How a file begins: its first bytes on the disk, those of its unpacked content, and its name's
    suffix in small letters, without that of a packing.
    """

    stored: bytes
    content: bytes
    suffix: str

    @property
    def is_packed(self) -> bool:
        """True if gzip or bzip2 packs the file."""
        return self.stored.startswith((GZIP_MAGIC, BZIP2_MAGIC))


def head_of(stored: bytes, content: bytes, name: str) -> Head:
    """Put together the head of a file of this ``name``."""
    path = PurePath(name.lower())
    if path.suffix in PACKED_SUFFIXES:
        path = path.with_suffix("")
    return Head(stored, content, path.suffix)


Test = Callable[[bytes], bool]


def never(content: bytes) -> bool:
    """Tell no content: the test of kinds that have no mark."""
    return False


@dataclass(frozen=True)
class Kind:
    """A kind of files.

    - ``begins``: a test of a file's first bytes, unpacked. A file that passes it is of the kind; if
      ``both`` is set, it must have one of the ``suffixes``, too. Without it, a suffix is enough for
      a file that no test recognises.
    - ``reader``: ``module:function`` of the function that opens files, in this folder if it begins
      with a dot; ``unpacks`` is True if it reads files packed by gzip and bzip2.
    - ``loads``: modules that the reader imports only when it reads.
    - ``hint``: in place of a reader, a description of such files, and advice.
    - ``package``: the package of a plug-in, empty for isogi's kinds.
    """

    name: str
    begins: Test = never
    suffixes: tuple[str, ...] = ()
    both: bool = False
    reader: str = ""
    unpacks: bool = False
    loads: tuple[str, ...] = ()
    hint: str = ""
    package: str = ""

    def __post_init__(self) -> None:
        """Raise TypeError for one suffix in place of several: its letters would be suffixes."""
        if isinstance(self.suffixes, str):
            raise TypeError(f"suffixes is a tuple of texts: give ('{self.suffixes}',)")

    def is_of(self, content: bytes, suffix: str) -> bool:
        """Return True if a file is of the kind by the beginning of its content."""
        return self.begins(content) and (not self.both or suffix in self.suffixes)

    def open(self) -> Reader:
        """Load the reader."""
        found: Reader = load_object(self.reader, FOLDER)
        return found

    @property
    def modules(self) -> tuple[str, ...]:
        """The names of all modules that reading a file of the kind imports."""
        return resolve_name(self.reader.partition(":")[0], FOLDER), *self.loads


def marked(*marks: bytes, at: int = 0) -> Test:
    """Make the test that content has one of the ``marks`` at a byte."""
    return lambda content: content[at:].startswith(marks)


def matching(pattern: bytes) -> Test:
    """Make the test that a text's first bytes match a ``pattern``, blanks and a byte order mark
    left out.
    """
    compiled = re.compile(pattern, re.IGNORECASE)
    return lambda content: (
        compiled.match(content.removeprefix(b"\xef\xbb\xbf").lstrip()) is not None
    )


def is_nifti(content: bytes) -> bool:
    """Tell NIfTI-1 and -2 by the header's size and magic, in either byte order."""
    size = {content[:4], content[:4][::-1]}
    one = (348).to_bytes(4, "little") in size and content[344:348] in (b"n+1\0", b"ni1\0")
    return one or ((540).to_bytes(4, "little") in size and content[4:7] in (b"n+2", b"ni2"))


def has_analyze_size(content: bytes) -> bool:
    """Return True if a header begins with the size of Analyze's, in either byte order."""
    return (348).to_bytes(4, "little") in (content[:4], content[:4][::-1])


def is_analyze(content: bytes) -> bool:
    """Tell Analyze 7.5 by its size and the r that most of its headers have."""
    return has_analyze_size(content) and content[38:39] == b"r"


def is_hdf5(content: bytes) -> bool:
    """Tell HDF5 by its magic, which may come after a block of the user, as in MATLAB's files.

    Source: HDF5 File Format Specification, "Superblock".
    """
    return any(content[at:].startswith(HDF5_MAGIC) for at in (0, 512, 1024, 2048))


def xml_of(root: bytes, *, having: bytes = b"") -> Test:
    """Make the test that content is XML whose first element begins as ``root``, a pattern, and that
    has some bytes near its beginning.
    """
    pattern = re.compile(rb"\s*(?:<\?.*?\?>|<!--.*?-->|<!DOCTYPE.*?>|\s)*<" + root, re.DOTALL)

    def fits(content: bytes) -> bool:
        return (
            pattern.match(content.removeprefix(b"\xef\xbb\xbf")) is not None and having in content
        )

    return fits


def vtk_file(kind: bytes) -> Test:
    """Make the test that content is an XML file of VTK of some type."""
    return xml_of(rb"VTKFile\b[^>]*\btype\s*=\s*[\"']" + kind + rb"[\"']")


def brick(content: bytes) -> bool:
    """Tell the header of a brick of values by two of its keys."""
    return b"DATA_FILE:" in content and b"DATA_SIZE:" in content


def legacy_vtk(*datasets: bytes) -> Test:
    """Make the test that content is a legacy file of VTK with one of these data sets."""
    named = re.compile(rb"\n\s*DATASET\s+(?:" + b"|".join(datasets) + rb")\b", re.IGNORECASE)
    return lambda content: content.startswith(b"# vtk DataFile") and bool(named.search(content))


HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
ZIP_MAGIC = b"PK\x03\x04"
GIPL_MAGIC = b"\xef\xff\xe9\xb0"

TIFF_CODECS = ("imcd", "zlib", "deflate", "jpeg8", "zstd")
"""Packings of TIFF that are worth the time to load them, in a library that may be missing."""

TIFF_MODULES = (
    "tifffile",
    "tifffile._imagecodecs",
    "xml.etree.ElementTree",
    "imagecodecs",
    *(f"imagecodecs._{codec}" for codec in TIFF_CODECS),
)

DICOM_DECODERS = ("rle", "pillow", "pylibjpeg", "pyjpegls", "gdcm")
PILLOW_FORMATS = ("Bmp", "Gif", "Ppm", "Png", "Jpeg", "Jpeg2K")
DICOM_MODULES = (
    "pydicom.pixels",
    *(f"pydicom.pixels.decoders.{name}" for name in DICOM_DECODERS),
    "openjpeg",
    "nibabel.nicom.csareader",
    *(f"PIL.{name}ImagePlugin" for name in PILLOW_FORMATS),
)
"""Packages that unpack DICOM's packed pixels, if they are installed."""

VTK_MODULES = (
    "vtk",
    *(
        f"vtkmodules.{name}"
        for name in ("vtkIOXML", "vtkCommonExecutionModel", "util.numpy_support")
    ),
)

HDF5_MODULES = ("h5py", "h5py._hl.dims", "h5py._hl.filters")

READ_KINDS: tuple[Kind, ...] = (
    Kind("NRRD", marked(b"NRRD"), (".nrrd", ".nhdr"), reader=".nrrd:open_nrrd"),
    Kind("NIfTI", is_nifti, reader=".brain_files:open_nifti", unpacks=True, loads=("nibabel",)),
    Kind(
        "Analyze", is_analyze, reader=".brain_files:open_analyze", unpacks=True, loads=("nibabel",)
    ),
    Kind(
        "Analyze",
        has_analyze_size,
        (".hdr", ""),
        both=True,
        reader=".brain_files:open_analyze",
        unpacks=True,
        loads=("nibabel",),
    ),
    Kind(
        "MGH",
        marked(b"\0\0\0\1"),
        (".mgh", ".mgz"),
        both=True,
        reader=".brain_files:open_mgh",
        unpacks=True,
        loads=("nibabel", "nibabel.freesurfer.mghformat"),
    ),
    Kind(
        "AFNI",
        matching(rb"type\s*=\s*\w+-attribute"),
        (".head",),
        both=True,
        reader=".brain_files:open_afni",
    ),
    Kind(
        "PAR/REC",
        matching(rb"# === DATA DESCRIPTION FILE"),
        (".par",),
        reader=".scanner_files:open_parrec",
    ),
    Kind(
        "ECAT",
        marked(b"MATRIX7"),
        reader=".scanner_files:open_ecat",
        loads=("nibabel.ecat",),
    ),
    Kind(
        "DICOM",
        marked(b"DICM", at=128),
        (".dcm", ".ima"),
        reader=".dicom:open_dicom",
        loads=DICOM_MODULES,
    ),
    Kind(
        "TIFF",
        marked(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
        reader=".tiff:open_tiff",
        loads=TIFF_MODULES,
    ),
    Kind(
        "MRC",
        marked(b"MAP", at=208),
        reader=".mrc:open_mrc",
        unpacks=True,
        loads=("mrcfile.utils", "mrcfile.mrcinterpreter"),
    ),
    Kind(
        "MINC",
        marked(b"CDF", HDF5_MAGIC),
        (".mnc",),
        both=True,
        reader=".brain_files:open_minc",
        loads=(*HDF5_MODULES, "nibabel.minc2", "nibabel.externals.netcdf", "nibabel.minc1"),
    ),
    Kind("HDF5", is_hdf5, reader=".hdf5:open_hdf5", loads=HDF5_MODULES),
    Kind(
        "BigDataViewer's XML",
        xml_of(b"SpimData"),
        reader=".hdf5:open_bdv",
        loads=HDF5_MODULES,
    ),
    Kind(
        "XDMF",
        xml_of(b"Xdmf"),
        (".xdmf", ".xmf"),
        reader=".xdmf:open_xdmf",
        loads=("xml.etree.ElementTree", *HDF5_MODULES),
    ),
    Kind(
        "NetCDF",
        marked(b"CDF\1", b"CDF\2", b"CDF\5"),
        reader=".hdf5:open_netcdf",
        loads=("nibabel.externals.netcdf",),
    ),
    Kind(
        "FITS",
        matching(rb"SIMPLE  =\s+T"),
        (".fits", ".fit", ".fts"),
        reader=".fits:open_fits",
        unpacks=True,
        loads=("astropy.io.fits",),
    ),
    Kind("NumPy", marked(b"\x93NUMPY"), reader=".array_files:open_numpy"),
    Kind(
        "VTI", vtk_file(b"ImageData"), (".vti",), reader=".image_files:open_vti", loads=VTK_MODULES
    ),
    Kind(
        "PVTI",
        vtk_file(b"PImageData"),
        (".pvti",),
        reader=".image_files:open_pvti",
        loads=VTK_MODULES,
    ),
    Kind(
        "VTR",
        vtk_file(b"RectilinearGrid"),
        (".vtr",),
        reader=".image_files:open_vtr",
        loads=VTK_MODULES,
    ),
    Kind(
        "MetaImage",
        matching(rb"(?:ObjectType|NDims|Comment)\s*="),
        (".mha", ".mhd"),
        reader=".side_headers:open_metaimage",
    ),
    Kind("ISQ", marked(b"CTDATA-HEADER_V1"), reader=".headed_files:open_isq"),
    Kind("VFF", marked(b"ncaa"), reader=".headed_files:open_vff"),
    Kind("AmiraMesh", matching(rb"# (?:AmiraMesh|Avizo)"), reader=".headed_files:open_amira"),
    Kind("BOV", brick, (".bov",), reader=".side_headers:open_bov"),
    Kind("VGI", matching(rb"\{volume\d*\}"), (".vgi",), reader=".side_headers:open_vgi"),
    Kind("a .dat header", matching(rb"ObjectFileName\s*:"), reader=".side_headers:open_dat"),
    Kind(
        "legacy VTK",
        legacy_vtk(b"STRUCTURED_POINTS"),
        (".vtk",),
        reader=".image_files:open_itk",
    ),
    Kind("GIPL", marked(GIPL_MAGIC, at=252), (".gipl",), reader=".image_files:open_itk"),
    # Files of chemistry are text with few marks: they come after all that have one.
    Kind("XSF", is_xsf, reader=".chemistry.xsf:open_xsf", unpacks=True),
    Kind("OpenDX", is_dx, reader=".chemistry.opendx:open_dx", unpacks=True),
    Kind("Gaussian cube", is_cube, reader=".chemistry.cube:open_cube", unpacks=True),
    Kind("VASP", is_vasp, reader=".chemistry.vasp:open_vasp", unpacks=True),
    Kind("an image of ITK", suffixes=(".hdr", ".img"), reader=".image_files:open_itk"),
)
"""Kinds that isogi reads, in the order in which a file is compared with them."""


def reader_plugins() -> Plugins:
    """Find the kinds that other packages read."""
    return plugins(READER_GROUP, Kind)


@cache
def added_kinds() -> tuple[Kind, ...]:
    """List the kinds of plug-ins, each with its package."""
    return tuple(replace(each.record, package=each.package) for each in reader_plugins().found)


def added_reader_of(head: Head) -> Kind | None:
    """Return the kind of a plug-in that recognises a file by its content; None if no plug-in does,
    or if isogi recognises the file itself.

    A plug-in whose test raises an error counts as one that does not recognise the file.
    """
    if any(kind.is_of(head.content, head.suffix) for kind in READ_KINDS):
        return None
    for kind in added_kinds():
        with suppress(Exception):
            if kind.is_of(head.content, head.suffix):
                return kind
    return None


def plugin_faults(head: Head) -> list[str]:
    """Return a sentence for each plug-in that cannot be loaded, and for each whose test of a file
    fails.
    """
    faults = list(reader_plugins().faults)
    for kind in added_kinds():
        try:
            kind.is_of(head.content, head.suffix)
        except Exception as error:
            faults.append(fault_of(kind.package, f"fails to tell kinds ({line_of(error)})"))
    return faults


def reader_of(head: Head) -> Kind | None:
    """Find the kind that reads a file: by how its content begins, else by its suffix; None if there
    is none. Kinds of plug-ins come after isogi's.
    """
    for kind in READ_KINDS:
        if kind.is_of(head.content, head.suffix):
            return kind
    if (added := added_reader_of(head)) is not None:
        return added
    for kind in (*READ_KINDS, *added_kinds()):
        if not kind.both and head.suffix in kind.suffixes:
            return kind
    return None


ARCHIVE_MODULES = ("encodings.cp437", "zipfile", "isogi_core.files.formats.array_files")


def libraries_for(stored: bytes) -> list[str]:
    """Name the modules that a file may need which begins so on the disk: more than it does, and
    never less. An archive may hold files of all kinds but VTK's.
    """
    if stored.startswith(ZIP_MAGIC[:2]):
        kinds = [kind for kind in READ_KINDS if kind.loads is not VTK_MODULES]
        kinds += added_kinds()
        return [*ARCHIVE_MODULES, *dict.fromkeys(name for kind in kinds for name in kind.modules)]
    packed = stored.startswith((GZIP_MAGIC, BZIP2_MAGIC))
    found = [
        kind
        for kind in READ_KINDS
        if (packed and kind.unpacks) or kind.begins(stored) or kind.begins is never
    ]
    # Tests of plug-ins are not tried here: all of their modules are loaded.
    found += added_kinds()
    return list(dict.fromkeys(name for kind in found for name in kind.modules))
