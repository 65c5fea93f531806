"""Files that are no volumes, or lie about what they hold: made by hand, and bytes of good ones
changed at random.
"""

import bz2
import gzip
import io
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import nrrd
import numpy as np

from tests.files.formats.every_kind import metaimage, written

FIELDS = {"type": "uint8", "dimension": "3", "sizes": "4 3 2", "encoding": "raw"}
VOXELS = bytes(range(24))
OTHERS = 600
"""Bytes that are taken as the header of a file that is no NRRD."""

LARGE = 1 << 26
"""Bytes of zeros in a bomb, which are small when they are packed."""


def headed(body: bytes = VOXELS, magic: str = "NRRD0004", end: str = "\n", **fields: str) -> bytes:
    """A file of the usual header, with these fields besides or in its place, and a body."""
    told = FIELDS | {name.replace("_", " "): value for name, value in fields.items()}
    lines = [magic, *(f"{name}: {value}" for name, value in told.items()), "", ""]
    return end.join(lines).encode() + body


def by_hand() -> dict[str, bytes]:
    """Files by what is wrong with them."""
    return {**headers(), **sizes(), **detached(), **packed(), **values(), **images()}


def headers() -> dict[str, bytes]:
    """Headers that are none, have no end, or say what cannot be."""
    good = headed()
    return {
        "nothing": b"",
        "four bytes": b"NRRD",
        "another format": b"\x89PNG\r\n\x1a\n" + bytes(64),
        "a form": b'--x\r\nContent-Disposition: form-data; name="file"\r\n\r\n'
        + good
        + b"\r\n--x--\r\n",
        "UTF-16": good.decode("latin-1").encode("utf-16"),
        "UTF-8 with a mark": b"\xef\xbb\xbf" + good,
        "a version to come": headed(magic="NRRD0009"),
        "a version that is no number": headed(magic="NRRDnnnn"),
        "only NUL bytes": bytes(1 << 16),
        "NUL bytes in a header": good.replace(b"uint8", b"uint8\0\0"),
        "CRLF": headed(end="\r\n"),
        "CR alone": headed(end="\r"),
        "one endless line": b"NRRD0004\n" + b"x" * (1 << 22),
        "endless lines": b"NRRD0004\n" + b"# x\n" * (1 << 20),
        "a million fields": b"NRRD0004\n"
        + b"".join(b"k%d:=v\n" % n for n in range(1_000_000))
        + b"\n",
        "a line without a colon": good.replace(b"encoding: raw", b"encoding raw"),
        "a field twice": good.replace(b"encoding: raw", b"encoding: raw\nencoding: raw"),
        "no type": good.replace(b"type: uint8\n", b""),
        "no sizes": good.replace(b"sizes: 4 3 2\n", b""),
        "type block": headed(type="block"),
        "type object": headed(type="object"),
        "a type of NumPy's": headed(type="O8"),
        "no byte order": headed(type="float"),
        "an encoding that is none": headed(encoding="pickle"),
        "hexadecimal": headed(encoding="hex"),
        "text": headed(encoding="ascii"),
        "quotes that do not end": headed(space_units='"mm "mm "mm'),
        "a vector that does not end": headed(
            space_dimension="3", space_directions="(1,0,0) (0,1,0) (0,0,"
        ),
        "directions in ten dimensions": headed(
            space_dimension="10", space_directions="none none none"
        ),
        "kinds of colours": headed(kinds="RGB-color domain domain"),
        "a format string": headed(content="%s%s%s%n{0}{0.__class__}"),
    }


def sizes() -> dict[str, bytes]:
    """Sizes that are not those of the body, or of nothing that can be."""
    told = {
        "zero": "0 3 2",
        "negative": "-4 3 -2",
        "one voxel": "1 1 1",
        "one plane": "6 4 1",
        "two axes": "6 4",
        "four axes": "4 3 2 1",
        "2^63": f"{2**63} 1 1",
        "2^63 in all": f"{2**21} {2**21} {2**21}",
        "2^64 and 24 in all": f"{2**32} {2**32} 24",
        "a hundred digits": "9" * 100 + " 3 2",
        "fractions": "4.5 3 2",
        "NaN": "nan 3 2",
        "words": "four three two",
        "more than the body": "400 300 200",
        "fewer than the body": "2 2 2",
    }
    files = {f"sizes: {name}": headed(sizes=text) for name, text in told.items()}
    skips = {"lines": {"line_skip": "99999999999"}, "bytes": {"byte_skip": str(2**62)}}
    backward = {"backward": {"byte_skip": "-5"}, "lines backward": {"line_skip": "-1"}}
    return {
        **files,
        **{
            f"skips: {name}": headed(VOXELS, **fields)
            for name, fields in {**skips, **backward}.items()
        },
    }


def detached() -> dict[str, bytes]:
    """Headers that name other files, also by URL."""
    places = (
        "v.raw",
        "../v.raw",
        "/etc/passwd",
        "/dev/zero",
        "/proc/self/environ",
        "LIST 2",
        "v%03d.raw 1 9 1",
    )
    urls = ("http://127.0.0.1:9/v.raw", "file:///etc/passwd", "s3://bucket/key", "\\\\host\\share")
    files = {f"data file: {place}": headed(b"", data_file=place) for place in (*places, *urls)}
    spelt = {
        f"spelt {name}": headed(b"", **{name: "/etc/passwd"})
        for name in ("datafile", "DATA_FILE", "Data_File")
    }
    return files | spelt | {"a list of files": headed(b"a.raw\nb.raw\n", data_file="LIST")}


def packed() -> dict[str, bytes]:
    """Bodies that are cut, damaged, or far larger than they look."""
    zeros = gzip.compress(bytes(LARGE))
    small = gzip.compress(VOXELS)
    nested = gzip.compress(gzip.compress(bytes(LARGE)))
    cube = "400 400 400"
    return {
        "gzip, cut": headed(small[:-6], encoding="gzip"),
        "gzip, no header": headed(VOXELS, encoding="gzip"),
        "gzip, wrong sum": headed(small[:-8] + bytes(8), encoding="gzip"),
        "gzip, with more behind": headed(small + b"x" * 1000, encoding="gzip"),
        "gzip bomb": headed(zeros, encoding="gzip"),
        "gzip bomb of many members": headed(zeros * 64, encoding="gzip"),
        "gzip bomb to skip": headed(zeros * 100, encoding="gzip", byte_skip=str(2**50)),
        "gzip bomb of the size it tells": headed(zeros, encoding="gzip", sizes=cube),
        "gzip in gzip": headed(nested, encoding="gzip", sizes=cube),
        "gzip of sizes beyond the limit": headed(zeros, encoding="gzip", sizes="4000 4000 4000"),
        "bzip2, cut": headed(bz2.compress(VOXELS)[:-6], encoding="bzip2"),
        "bzip2 bomb": headed(bz2.compress(bytes(LARGE)), encoding="bzip2"),
        "bzip2 bomb to skip": headed(
            bz2.compress(bytes(LARGE)) * 99, encoding="bzip2", byte_skip=str(2**50)
        ),
    }


def values() -> dict[str, bytes]:
    """Voxels and spacings that cannot be shown."""
    kind = {"type": "double", "endian": "little"}
    odd = {"NaN": np.nan, "infinity": np.inf}
    fields = {
        f"all {name}": headed(np.full(24, value).tobytes(), **kind) for name, value in odd.items()
    }
    steps = ("nan 1 1", "inf 1 1", "0 1 1", "-1 1 1", "1e300 1 1", "1e-300 1 1", "1 1", "x y z")
    return fields | {f"spacings: {step}": headed(spacings=step) for step in steps}


def images() -> dict[str, bytes]:
    """Images of ITK and VTK that name other files, or are larger than they look."""
    meta = (
        "ObjectType = Image\nNDims = 3\nDimSize = {}\nElementType = "
        "MET_UCHAR\nElementDataFile = {}\n"
    )
    told = {
        "another file": ("4 3 2", "/etc/passwd"),
        "a pattern": ("4 3 2", "%03d 1 9 1"),
        "2^63": ("9" * 19, "LOCAL"),
    }
    extent = (
        '<ImageData WholeExtent="0 {} 0 1 0 1"><Piece Extent="0 {} 0 1 0 '
        '1"><PointData>{}</PointData></Piece>'
    )
    array = '<DataArray type="UInt8" Name="a" format="ascii">{}</DataArray>'
    vti = '<?xml version="1.0"?>{}<VTKFile type="ImageData">' + extent + "</ImageData></VTKFile>"
    laughs = "".join(f'<!ENTITY e{n} "{10 * f"&e{n - 1};"}">' for n in range(1, 12))
    bomb = f'<!DOCTYPE x [<!ENTITY e0 "1 ">{laughs}]>'
    foreign = '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
    made = {
        "endless arrays": vti.format("", 1, 1, array.format("1 ") * 20000),
        "a bomb of entities": vti.format(bomb, 1, 1, array.format("&e11;")),
        "an entity elsewhere": vti.format(foreign, 1, 1, array.format("&e;")),
        "2^31 points": vti.format("", 2**31 - 1, 2**31 - 1, array.format("1 2 3")),
        "no end": vti.format("", 1, 1, array.format("1 2"))[:-60],
    }
    images = {
        f"MetaImage: {name}": meta.format(*words).encode() + VOXELS for name, words in told.items()
    }
    return images | {f"VTI: {name}": text.encode() for name, text in made.items()}


def good(encoding: str) -> bytes:
    """A volume that can be shown."""
    z, y, x = np.mgrid[:8, :8, :8] - 3.5
    file = io.BytesIO()
    fields: dict[str, Any] = {"encoding": encoding, "spacings": [1.0, 1.0, 2.0]}
    nrrd.write(
        file, (9.0 - np.sqrt(x**2 + y**2 + z**2)).astype(np.float32), fields, index_order="C"
    )
    return file.getvalue()


def mutations(count: int, seed: int) -> Iterator[bytes]:
    """So many good files of each kind in turn, their bytes changed in one way; the same for the
    same ``seed``.
    """
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        others = [path.read_bytes() for path in (*written(Path(folder)), *metaimage(Path(folder)))]
    files = [*(good(encoding) for encoding in ("raw", "gzip", "bzip2")), *others]
    for number in range(count):
        file = bytearray(files[number % len(files)])
        WAYS[number // len(files) % len(WAYS)](file, random)
        yield bytes(file)


def header_of(file: bytearray) -> int:
    """Bytes of the header of a file: of NRRD, as it says; of other kinds, as most have."""
    if file.startswith(b"NRRD"):
        return file.index(b"\n\n")
    return min(OTHERS, len(file))


def flip(file: bytearray, random: np.random.Generator) -> None:
    """Flip some bits."""
    for place in random.integers(0, len(file), 1 + random.integers(8)):
        file[place] ^= 1 << int(random.integers(8))


def flip_header(file: bytearray, random: np.random.Generator) -> None:
    """Set some bytes of the header to anything."""
    for place in random.integers(4, header_of(file), 1 + random.integers(4)):
        file[place] = int(random.integers(256))


def cut(file: bytearray, random: np.random.Generator) -> None:
    """Cut the end off."""
    del file[int(random.integers(len(file))) :]


def repeat(file: bytearray, random: np.random.Generator) -> None:
    """Repeat a piece."""
    start, stop = sorted(int(place) for place in random.integers(0, len(file), 2))
    file[stop:stop] = file[start:stop] * int(1 + random.integers(20))


def drop(file: bytearray, random: np.random.Generator) -> None:
    """Take a piece out."""
    start, stop = sorted(int(place) for place in random.integers(0, len(file), 2))
    del file[start:stop]


def renumber(file: bytearray, random: np.random.Generator) -> None:
    """Put an odd number in the place of a digit of the header."""
    digits = [place for place in range(header_of(file)) if file[place : place + 1].isdigit()]
    odd = (b"-1", b"0", b"999999999999", b"1e308", b"nan", b"0x10", b"", b"2147483648")
    if digits:
        place = digits[int(random.integers(len(digits)))]
    else:
        place = 0
    file[place : place + 1] = odd[int(random.integers(len(odd)))]


WAYS: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    flip,
    flip_header,
    cut,
    repeat,
    drop,
    renumber,
)
