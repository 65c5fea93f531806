"""NRRD: every type, order and encoding as written by pynrrd, axes that are none of space, real and
damaged files.
"""

import gzip
import hashlib
import io
import os
import re
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any
from unicodedata import normalize

import nrrd
import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import LabelName
from isogi_core.model.volume import make_volume
from tests.loaded import read_nrrd

RAMP = np.arange(24).reshape(2, 3, 4)
TYPES = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]
PLAIN = "type: uint8\ndimension: 3\nsizes: 4 3 2\nencoding: raw\n"


def write(
    folder: Path, fields: str = PLAIN, body: bytes = bytes(range(24)), name: str = "v.nrrd"
) -> Path:
    """An attached NRRD file of these header lines and bytes."""
    path = folder / name
    path.write_bytes(f"NRRD0004\n{fields}\n".encode() + body)
    return path


@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2"])
@pytest.mark.parametrize("suffix", ["nrrd", "nhdr"])
def test_reads_what_pynrrd_wrote(tmp_path: Path, suffix: str, encoding: str) -> None:
    for kind, order in product(TYPES, "<>"):
        values = RAMP.astype(np.dtype(kind).newbyteorder(order))
        header = {"encoding": encoding, "endian": "little" if order == "<" else "big"}
        path = tmp_path / f"v.{suffix}"
        nrrd.write(str(path), values, header, index_order="C")
        array, spacing = read_nrrd(path)
        assert array.dtype.newbyteorder("=") == np.dtype(kind)
        np.testing.assert_array_equal(array, RAMP, err_msg=f"{kind}, {order}")
        assert spacing == (1.0, 1.0, 1.0)


@pytest.mark.parametrize("value", [2**53 + 1, 2**64 - 1])
def test_wide_integers_are_exact(tmp_path: Path, value: int) -> None:
    values = np.array([0, value] * 4, np.uint64).reshape(2, 2, 2)
    nrrd.write(str(tmp_path / "v.nrrd"), values, index_order="C")
    assert read_nrrd(tmp_path / "v.nrrd")[0].max() == value


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("spacings: 0.5 1 2.25\n", (0.5, 1.0, 2.25)),
        ("space dimension: 3\nspace directions: (0.5,0,0) (0,1,0) (0,0,2.25)\n", (0.5, 1.0, 2.25)),
        (
            "space: left-posterior-superior\nspace directions: (0,-3,4) (2,0,0) (0,0,-1)\n",
            (5.0, 2.0, 1.0),
        ),
        ("kinds: domain domain domain\n", (1.0, 1.0, 1.0)),
    ],
)
def test_spacing(tmp_path: Path, line: str, expected: tuple[float, float, float]) -> None:
    array, spacing = read_nrrd(write(tmp_path, PLAIN + line))
    np.testing.assert_array_equal(array, RAMP)
    assert spacing == pytest.approx(expected)


@pytest.mark.parametrize(
    "line", ["spacings: nan 1 1\n", "space directions: none (0,1,0) (0,0,1)\n"]
)
def test_unknown_spacing_is_left_to_the_scene(tmp_path: Path, line: str) -> None:
    array, spacing = read_nrrd(write(tmp_path, PLAIN + line))
    with pytest.raises(VolumeError, match="set spacing"):
        make_volume(array, spacing)
    assert make_volume(array, (1.0, 1.0, 1.0)).size == (4, 3, 2)


@pytest.mark.parametrize(
    ("line", "before"),
    [
        ("byte skip: 5\n", b"12345"),
        ("line skip: 2\n", b"a\nbcd\n"),
        ("byte skip: -1\n", b"any number of bytes"),
    ],
)
def test_skips(tmp_path: Path, line: str, before: bytes) -> None:
    array, _ = read_nrrd(write(tmp_path, PLAIN + line, before + bytes(range(24))))
    np.testing.assert_array_equal(array, RAMP)


def test_byte_skip_counts_decoded_bytes(tmp_path: Path) -> None:
    fields = PLAIN.replace("raw", "gzip") + "byte skip: 5\n"
    array, _ = read_nrrd(write(tmp_path, fields, gzip.compress(b"12345" + bytes(range(24)))))
    np.testing.assert_array_equal(array, RAMP)


def test_gzip_of_several_members(tmp_path: Path) -> None:
    body = gzip.compress(bytes(range(10))) + gzip.compress(bytes(range(10, 24)))
    array, _ = read_nrrd(write(tmp_path, PLAIN.replace("raw", "gzip"), body))
    np.testing.assert_array_equal(array, RAMP)


SQUEEZED = gzip.compress(bytes(range(24)))
GZIP = PLAIN.replace("raw", "gzip")
DAMAGES = {
    "not NRRD": (None, b"P5 4 3 255 " + bytes(24), "not a NRRD file"),
    "empty": (None, b"", "not a NRRD file"),
    "no version": (None, b"NRRDxyz\n\n", "header"),
    "no colon": (PLAIN + "nonsense\n", b"", "damaged"),
    "word for a size": (PLAIN.replace("4 3 2", "4 three 2"), b"", "damaged"),
    "huge size": (PLAIN.replace("4 3 2", f"4 3 {10**30}"), b"", "damaged"),
    "duplicate": (PLAIN + "type: uint8\n", b"", "damaged"),
    "no type": (PLAIN.replace("type: uint8\n", ""), bytes(24), "no type"),
    "no encoding": (PLAIN.replace("encoding: raw\n", ""), bytes(24), "no encoding"),
    "unknown type": (PLAIN.replace("uint8", "quad"), bytes(24), "quad"),
    "block": (PLAIN.replace("uint8", "block"), bytes(24), "block"),
    "no byte order": (PLAIN.replace("uint8", "int16"), bytes(48), "byte order"),
    "2-D": (PLAIN.replace(": 3", ": 2").replace("4 3 2", "8 3"), bytes(24), "2 dimensions"),
    "4-D": (
        PLAIN.replace(": 3", ": 4").replace("4 3 2", "2 2 3 2"),
        bytes(24),
        "2 channels: choose one by channel",
    ),
    "dimension lies": (PLAIN.replace("4 3 2", "4 3 2 1"), bytes(24), "dimensions"),
    "colour axis": (PLAIN + "kinds: RGB-color domain domain\n", bytes(24), "RGB-color"),
    "zero size": (PLAIN.replace("4 3 2", "4 0 2"), b"", "cannot be"),
    "negative size": (PLAIN.replace("4 3 2", "4 -3 -2"), bytes(24), "cannot be"),
    "absurd product": (PLAIN.replace("4 3 2", "4000000 3000000 2000000"), bytes(24), "cannot be"),
    "large promise": (PLAIN.replace("4 3 2", "2000 2000 2000"), bytes(24), "fewer"),
    "too short": (PLAIN, bytes(23), "fewer"),
    "too long": (PLAIN, bytes(25), "more"),
    "bomb": (GZIP, gzip.compress(bytes(1 << 20)), "more"),
    "gzip cut": (GZIP, SQUEEZED[:-12], "cut short"),
    "gzip flipped": (GZIP, SQUEEZED[:-6] + b"\0\0" + SQUEEZED[-4:], "damaged"),
    "not gzip": (GZIP, bytes(24), "damaged"),
    "not bzip2": (PLAIN.replace("raw", "bzip2"), b"BZh9 no more", "damaged"),
    "text": (PLAIN.replace("raw", "ascii"), b"1 2 3", "fewer"),
    "long text": (PLAIN.replace("raw", "ascii"), b"1 2 3 " * 9, "more"),
    "word in a text": (PLAIN.replace("raw", "ascii"), b"1 two 3 " * 8, "no uint8"),
    "text out of range": (PLAIN.replace("raw", "ascii"), b"1 256 3 " * 8, "no uint8"),
    "hex": (PLAIN.replace("raw", "hex"), b"00" * 24, "hex"),
    "negative skip": (PLAIN + "byte skip: -2\n", bytes(24), "skips"),
    "skip past the end": (PLAIN + f"byte skip: {10**18}\n", bytes(24), "fewer"),
    "lines past the end": (PLAIN + f"line skip: {10**18}\n", bytes(24), "fewer"),
    "two spacings": (PLAIN + "spacings: 1 1\n", bytes(24), "2 spacings"),
    "missing data": (PLAIN + "data file: absent.raw\n", b"", "no file"),
    "data elsewhere": (PLAIN + "data file: ../secret.raw\n", b"", "outside"),
    "data anywhere": (PLAIN + "data file: /anywhere/v.raw\n", b"", "outside"),
    "data unnamed": (PLAIN + "data file:\n", b"", "cannot be read"),
    "data unnameable": (PLAIN + "data file: a\0b\n", b"", "cannot be read"),
    "data list": (PLAIN + "data file: LIST\n", b"", "0 data files"),
    "data list elsewhere": (PLAIN + "data file: LIST\na.raw\n../b.raw\n", b"", "outside"),
    "data pattern": (PLAIN + "data file: slice%03d.raw 1 2 1\n", b"", "no file"),
    "wide data pattern": (PLAIN + "data file: s%099999999d.raw 1 2 1\n", b"", "data files"),
    "endless data pattern": (PLAIN + "data file: slice%03d.raw 1 999999999 1\n", b"", "data files"),
    "data pattern that goes nowhere": (
        PLAIN + "data file: slice%03d.raw 1 2 0\n",
        b"",
        "0 data files",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_files_are_refused_in_a_sentence(tmp_path: Path, damage: str) -> None:
    fields, body, words = DAMAGES[damage]
    path = tmp_path / "v.nrrd"
    if fields is None:
        path.write_bytes(body)
    else:
        write(tmp_path, fields, body)
    with pytest.raises(VolumeError, match=re.escape(words)) as caught:
        read_nrrd(path)
    assert str(tmp_path) in str(caught.value) and str(caught.value).endswith(".")


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(VolumeError, match="no file"):
        read_nrrd(tmp_path / "absent.nrrd")
    with pytest.raises(VolumeError, match="cannot be read"):
        read_nrrd(tmp_path)


@pytest.mark.parametrize("detached", [False, True])
def test_every_flipped_byte_is_read_or_refused(tmp_path: Path, detached: bool) -> None:
    (tmp_path / "data.gz").write_bytes(SQUEEZED)
    fields = GZIP + "spacings: 1 1 2\n" + "data file: data.gz\n" * detached
    good = write(tmp_path, fields, b"" if detached else SQUEEZED).read_bytes()
    path = tmp_path / "bad.nrrd"
    random = np.random.default_rng(11)
    refused = 0
    for at in range(len(good)):
        for byte in (*random.integers(0, 256, 6), 0, 255):
            path.write_bytes(good[:at] + bytes([int(byte)]) + good[at + 1 :])
            try:
                array, _ = read_nrrd(path)
            except VolumeError:
                refused += 1
            else:
                assert array.ndim == 3
    assert refused > 3 * len(good)


def listed(folder: Path) -> dict[str, dict[str, str]]:
    """What the README of the shared data says of each volume: shape, type, spacing, range, digest,
    hist5.
    """
    facts: dict[str, dict[str, str]] = {}
    for line in (folder / "README.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        name = cells[0].strip("`").removesuffix(".raw.gz")
        if not cells[0].endswith(".raw.gz`"):
            continue
        if len(cells) == 5:
            facts[name] |= {"digest": cells[3].strip("`"), "hist5": cells[4]}
        else:
            facts[name] = dict(zip(("shape", "dtype", "spacing", "range"), cells[2:6], strict=True))
    return facts


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.data
def test_real_volumes_are_what_their_list_says(shared_data: Path) -> None:
    facts = listed(shared_data)
    headers = sorted(shared_data.glob("*.nhdr"))
    assert {header.stem for header in headers} == set(facts)
    for header in headers:
        said = facts[header.stem]
        array, spacing = read_nrrd(header)
        assert array.shape[::-1] == tuple(int(n) for n in said["shape"].split(" × "))
        assert array.dtype.name == said["dtype"]
        assert spacing == tuple(float(step) for step in said["spacing"].split(","))
        assert hashlib.sha256(array.tobytes()).hexdigest() == said["digest"]
        low, high = (float(end) for end in said["range"].split("…"))
        assert (float(array.min()), float(array.max())) == pytest.approx((low, high), rel=1e-5)
        counts, _ = make_volume(array, spacing).histogram(5)
        assert counts.tolist() == [int(count) for count in said["hist5"].split(",")]


def attached(fields: str = PLAIN, body: bytes = bytes(range(24)), most: int = 24) -> np.ndarray:
    """A file that nobody vouches for."""
    return open_upload(io.BytesIO(f"NRRD0004\n{fields}\n".encode() + body), "v.nrrd", most).whole()


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_an_attached_file_is_read_as_any(pack: Callable[[bytes], bytes]) -> None:
    encoding = "gzip" if pack is gzip.compress else "raw"
    np.testing.assert_array_equal(
        attached(PLAIN.replace("raw", encoding), pack(bytes(range(24)))), RAMP
    )


@pytest.mark.parametrize("field", ["data file", "datafile", "Data File", "DATAFILE", " data file"])
@pytest.mark.parametrize(
    "name",
    [
        "v.raw",
        "../v.raw",
        "/etc/passwd",
        "LIST 2",
        "v%d.raw 1 2 1",
        "http://127.0.0.1/v",
        "data file:=v",
    ],
)
def test_no_other_file_is_opened_for_one_that_nobody_vouches_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, field: str, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "v.raw").write_bytes(bytes(24))
    with pytest.raises(VolumeError, match="is a header whose data is in another file"):
        attached(f"{PLAIN}{field}: {name}\n")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\n \t\n"])
def test_a_header_that_nobody_vouches_for_has_to_end(end: str) -> None:
    comments = "# long\n" * (65536 // 7)
    with pytest.raises(VolumeError, match="does not end within 65536 bytes"):
        attached(f"{PLAIN}{comments}{end}")


def test_voxels_are_counted_before_they_are_read() -> None:
    assert attached(most=24).size == 24
    with pytest.raises(VolumeError, match="has 24 voxels, and 23 are the most"):
        attached(body=b"", most=23)


# --- axes, data files and segmentations
# -------------------------------------------------------------------------------


SHORTS = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
BIG = np.dtype(">i2")


def written(path: Path, array: np.ndarray, **header: Any) -> Path:
    nrrd.write(str(path), array, {"encoding": "raw", **header}, index_order="C")
    return path


def detached(folder: Path, lines: str, name: str = "v.nhdr", endian: str = "endian: big\n") -> Path:
    """A header of RAMP as int16, whose voxels are elsewhere."""
    fields = f"NRRD0004\ntype: int16\ndimension: 3\nsizes: 4 3 2\n{endian}{lines}\n"
    (folder / name).write_bytes(fields.encode())
    return folder / name


@pytest.mark.parametrize("encoding", ["ascii", "text", "TXT"])
def test_numbers_written_out_have_no_byte_order(tmp_path: Path, encoding: str) -> None:
    words = " ".join(map(str, SHORTS.ravel() - 7)).replace(" 3 ", ",3\n\t")
    path = detached(tmp_path, f"encoding: {encoding}\n\n{words}", endian="")
    np.testing.assert_array_equal(open_file(path, {}).whole(), SHORTS - 7)


def test_written_floats_are_what_numpy_reads(tmp_path: Path) -> None:
    floats = np.random.default_rng(3).normal(size=SHORTS.shape).astype(np.float32)
    fields = "NRRD0004\ntype: float\ndimension: 3\nsizes: 4 3 2\nencoding: ascii\n\n"
    (tmp_path / "v.nrrd").write_text(fields + "\n".join(f"{value:.9g}" for value in floats.ravel()))
    np.testing.assert_array_equal(open_file(tmp_path / "v.nrrd", {}).whole(), floats)


@pytest.mark.parametrize(
    ("shape", "kinds"),
    [
        ((2, 3, 4, 1), ["list", "domain", "domain", "domain"]),
        ((1, 2, 3, 4), ["space", "space", "space", "time"]),
        ((2, 3, 4, 1), ["vector", "???", "???", "???"]),
        ((1, 2, 3, 4, 1), None),
    ],
)
def test_axes_of_one_element_are_dropped(
    tmp_path: Path, shape: tuple[int, ...], kinds: Any
) -> None:
    path = written(
        tmp_path / "v.nrrd", SHORTS.reshape(shape), **({"kinds": kinds} if kinds else {})
    )
    grid = open_file(path, {})
    np.testing.assert_array_equal(grid.whole(), SHORTS)
    assert not grid.unchosen


@pytest.mark.parametrize("last", [True, False])
def test_one_of_several_numbers_a_voxel_is_chosen(tmp_path: Path, last: bool) -> None:
    fields = np.stack([SHORTS, SHORTS * 2, SHORTS * 3], axis=-1 if last else 0)
    if last:
        kinds = ["vector", "domain", "domain", "domain"]
    else:
        kinds = ["domain", "domain", "domain", "list"]
    path = written(tmp_path / "v.nrrd", fields, kinds=kinds)
    with pytest.raises(VolumeError, match=r"has 3 channels: choose one by channel = 0 to 2"):
        open_file(path, {})
    for number in range(3):
        np.testing.assert_array_equal(
            open_file(path, {"channel": number}).whole(), SHORTS * (number + 1)
        )
    with pytest.raises(VolumeError, match="channel = 3 is not in"):
        open_file(path, {"channel": 3})


def test_an_axis_without_direction_is_a_channel(tmp_path: Path) -> None:
    directions = np.array([[np.nan] * 3, [0, 2, 0], [3, 0, 0], [0, 0, 4.0]])
    path = tmp_path / "v.nrrd"
    header = {"space": "LPS", "space directions": directions, "space origin": [1.0, 2.0, 3.0]}
    written(path, np.stack([SHORTS, SHORTS * 2], axis=-1), **header)
    grid = open_file(path, {"channel": 1})
    np.testing.assert_array_equal(grid.whole(), SHORTS * 2)
    assert grid.spacing == (2.0, 3.0, 4.0) and grid.affine is not None
    np.testing.assert_array_equal(grid.affine.array, [[0, -3, 0, -1], [-2, 0, 0, -2], [0, 0, 4, 3]])


def test_an_axis_of_time_is_a_series(tmp_path: Path) -> None:
    fields = np.stack([SHORTS, SHORTS + 1, SHORTS + 2])
    path = written(
        tmp_path / "v.nrrd", fields, kinds=["domain", "domain", "domain", "time"], encoding="gzip"
    )
    grid = open_file(path, {})
    assert (grid.moment, grid.unchosen) == ((0, 3), True)
    np.testing.assert_array_equal(grid.whole(), SHORTS)
    later = open_file(path, {"time": 2})
    assert (later.moment, later.unchosen) == ((2, 3), False)
    np.testing.assert_array_equal(later.whole(), SHORTS + 2)


def test_a_list_of_slicer_that_is_time_is_a_series(tmp_path: Path) -> None:
    fields = np.stack([SHORTS, SHORTS + 1], axis=-1)
    path = tmp_path / "v.seq.nrrd"
    written(
        path,
        fields,
        kinds=["list", "domain", "domain", "domain"],
        **{"axis 0 index type": "numeric"},
    )
    assert open_file(path, {}).moment == (0, 2)
    np.testing.assert_array_equal(open_file(path, {"time": 1}).whole(), SHORTS + 1)


def test_colours_of_nrrd_are_shown_as_luminance(tmp_path: Path) -> None:
    colours = np.zeros((*SHORTS.shape, 3), np.uint8)
    colours[..., 1] = 100
    path = written(tmp_path / "v.nrrd", colours, kinds=["RGB-color", "domain", "domain", "domain"])
    grid = open_file(path, {})
    np.testing.assert_allclose(grid.whole(), 71.52, rtol=1e-6)
    assert "colours" in grid.notes[0]
    np.testing.assert_array_equal(open_file(path, {"channel": 1}).whole(), 100)


def test_an_axis_between_those_of_space_is_refused(tmp_path: Path) -> None:
    kinds = ["domain", "domain", "vector", "domain"]
    path = written(tmp_path / "v.nrrd", np.stack([SHORTS, SHORTS], axis=1), kinds=kinds)
    with pytest.raises(VolumeError, match="kind 'vector' between those of space"):
        open_file(path, {})


SLICES = {
    "pattern": "data file: sl%03d.raw 1 2 1\n",
    "backwards": "data file: sl%03d.raw 2 1 -1 2\n",
    "list": "data file: LIST\nsl001.raw\nsl002.raw\n",
    "list of planes": "data file: LIST 2\nsl001.raw\nsl002.raw\n",
}


@pytest.mark.parametrize("encoding", ["raw", "gzip"])
@pytest.mark.parametrize("way", SLICES)
def test_voxels_in_several_files_are_read_in_order(tmp_path: Path, way: str, encoding: str) -> None:
    if encoding == "gzip":
        pack = gzip.compress
    else:
        pack = bytes
    for number, layer in enumerate(SHORTS if way != "backwards" else SHORTS[::-1], 1):
        (tmp_path / f"sl{number:03}.raw").write_bytes(pack(layer.astype(BIG).tobytes()))
    path = detached(tmp_path, f"encoding: {encoding}\n{SLICES[way]}")
    grid = open_file(path, {})
    np.testing.assert_array_equal(grid.whole(), SHORTS)
    before = grid.stamp()
    (tmp_path / "sl002.raw").write_bytes(pack(SHORTS[1].astype(BIG).tobytes()[:-1]))
    assert grid.stamp() != before
    with pytest.raises(VolumeError, match="holds fewer than the 24 bytes"):
        grid.whole()


@pytest.mark.parametrize("lines", [SLICES["list"], SLICES["pattern"], "data file: sl002.raw\n"])
def test_a_pipe_among_data_files_is_refused(tmp_path: Path, lines: str) -> None:
    """To open it would wait for ever."""
    (tmp_path / "sl001.raw").write_bytes(SHORTS[0].astype(BIG).tobytes())
    os.mkfifo(tmp_path / "sl002.raw")
    with pytest.raises(VolumeError, match="it is a device, a pipe or a socket"):
        open_file(detached(tmp_path, f"encoding: raw\n{lines}"), {})


NAMES = ["with blanks.raw", "a#1.raw", "a%41.raw", "æøå.raw", "50% of it.raw", "LISTED.raw"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_data_files_have_any_names(tmp_path: Path, name: str, form: Any) -> None:
    (tmp_path / normalize(form, name)).write_bytes(SHORTS.astype(BIG).tobytes())
    for number, other in enumerate(("NFC", "NFD")):
        lines = f"encoding: raw\ndata file: {normalize(other, name)}\n"  # type: ignore[arg-type]
        path = detached(tmp_path, lines, name=f"{number} {name}.nhdr")
        np.testing.assert_array_equal(open_file(path, {}).whole(), SHORTS)


def slicer(path: Path, array: np.ndarray, **more: Any) -> Path:
    """A segmentation as 3D Slicer writes it."""
    facts = {
        "Segment0_ID": "Segment_1",
        "Segment0_Name": "left kidney",
        "Segment0_Color": "0.5 0 1",
        "Segment0_LabelValue": "1",
        "Segment0_Layer": "0",
        "Segment1_Name": "tumour",
        "Segment1_Color": "0.0196 0.6784 1",
        "Segment1_LabelValue": "3",
        "Segment1_Layer": "0",
    }
    return written(path, array, **{**facts, **more})


def test_a_segmentation_of_slicer_names_its_labels(tmp_path: Path) -> None:
    grid = open_file(slicer(tmp_path / "v.seg.nrrd", SHORTS % 4), {})
    assert grid.labels == (
        LabelName(1, "left kidney", "#8000ff"),
        LabelName(3, "tumour", "#05adff"),
    )
    assert open_file(written(tmp_path / "v.nrrd", SHORTS), {}).labels is None


def test_layers_of_a_segmentation_are_chosen(tmp_path: Path) -> None:
    layers = np.stack([SHORTS % 2, SHORTS % 3], axis=-1)
    path = slicer(
        tmp_path / "v.seg.nrrd",
        layers,
        kinds=["list", "domain", "domain", "domain"],
        Segment1_Layer="1",
    )
    grid = open_file(path, {})
    np.testing.assert_array_equal(grid.whole(), SHORTS % 2)
    assert grid.labels == (LabelName(1, "left kidney", "#8000ff"),)
    assert "2 layers: the first is shown" in grid.notes[0]
    other = open_file(path, {"channel": 1})
    np.testing.assert_array_equal(other.whole(), SHORTS % 3)
    assert other.labels == (LabelName(3, "tumour", "#05adff"),)
