"""Radiance pictures: every coding against a plain decoder, the real probes, damaged files."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import LightError
from isogi_core.files.radiance import read_hdr, write_hdr

HEAD = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def quads(height: int, width: int, seed: int = 1) -> np.ndarray:
    """RGBE bytes (h, w, 4) with runs in them, and no quad that old readers would take for a run."""
    random = np.random.default_rng(seed)
    values = random.integers(128, 256, (height, width, 4), np.uint8)
    values[:, width // 3 : 2 * width // 3] = values[:, :1]
    return values


def radiance_of(rgbe: np.ndarray) -> np.ndarray:
    """The format's own definition, in float64: mantissa · 2^(exponent - 136), black where exponent
    is 0.
    """
    exponent = rgbe[..., 3:].astype(int)
    return np.where(exponent > 0, rgbe[..., :3] * 2.0 ** (exponent - 136), 0.0)


def flat(rgbe: np.ndarray) -> bytes:
    """Bare quads."""
    return rgbe.tobytes()


def old_runs(rgbe: np.ndarray) -> bytes:
    """Old coding: a pixel, then (1, 1, 1, n) for n repeats, low byte first over several quads."""
    out = bytearray()
    pixels = [bytes(quad) for quad in rgbe.reshape(-1, 4)]
    at = 0
    while at < len(pixels):
        end = at
        while end < len(pixels) and pixels[end] == pixels[at]:
            end += 1
        out += pixels[at]
        repeats = end - at - 1
        while repeats:
            out += bytes([1, 1, 1, repeats & 255])
            repeats >>= 8
        at = end
    return bytes(out)


def new_runs(rgbe: np.ndarray) -> bytes:
    """New coding: per line a mark, then each component in runs and dumps of at most 127 and 128
    bytes.
    """
    out = bytearray()
    for line in rgbe:
        out += bytes([2, 2, len(line) >> 8, len(line) & 255])
        for component in line.T:
            out += coded(component.tobytes())
    return bytes(out)


def coded(values: bytes) -> bytes:
    """One component of one line."""
    out = bytearray()
    at = 0
    while at < len(values):
        run = 1
        while at + run < len(values) and run < 127 and values[at + run] == values[at]:
            run += 1
        if run > 2:
            out += bytes([128 + run, values[at]])
        else:
            out += bytes([1, values[at]])
        at += run if run > 2 else 1
    return bytes(out)


def write(folder: Path, height: int, width: int, body: bytes, head: bytes = HEAD) -> Path:
    """A picture file of these parts."""
    path = folder / "probe.hdr"
    path.write_bytes(head + b"-Y %d +X %d\n" % (height, width) + body)
    return path


@pytest.mark.parametrize("encode", [flat, old_runs, new_runs])
@pytest.mark.parametrize(("height", "width"), [(1, 8), (4, 9), (3, 300), (2, 1024)])
def test_every_coding_gives_the_same_pixels(
    tmp_path: Path, encode: Callable[[np.ndarray], bytes], height: int, width: int
) -> None:
    rgbe = quads(height, width)
    picture = read_hdr(write(tmp_path, height, width, encode(rgbe)))
    assert picture.dtype == np.float32 and picture.flags.c_contiguous
    np.testing.assert_array_equal(picture, radiance_of(rgbe).astype(np.float32))


@pytest.mark.parametrize("encode", [flat, old_runs])
@pytest.mark.parametrize("width", [1, 7, 40000])
def test_widths_that_new_coding_cannot_hold(
    tmp_path: Path, encode: Callable[[np.ndarray], bytes], width: int
) -> None:
    rgbe = quads(2, width)
    picture = read_hdr(write(tmp_path, 2, width, encode(rgbe)))
    np.testing.assert_array_equal(picture, radiance_of(rgbe).astype(np.float32))


def test_old_runs_longer_than_a_byte(tmp_path: Path) -> None:
    body = bytes([200, 100, 50, 128]) + bytes([1, 1, 1, 0x2B]) + bytes([1, 1, 1, 0x02]) + bytes(4)
    picture = read_hdr(write(tmp_path, 1, 0x22B + 2, body))
    assert (picture[0, :-1] == radiance_of(np.array([200, 100, 50, 128]))).all()
    assert not picture[0, -1].any()


@pytest.mark.parametrize(
    ("lines", "gain"),
    [
        (b"EXPOSURE=2\n", (2.0, 2.0, 2.0)),
        (b"EXPOSURE= 4.0\nEXPOSURE=0.5\n", (2.0, 2.0, 2.0)),
        (b"COLORCORR=1 2 4\nEXPOSURE=2\n", (2.0, 4.0, 8.0)),
        (b"# a remark\nGAMMA=1\nVIEW= -vtl\n", (1.0, 1.0, 1.0)),
    ],
)
def test_exposure_is_divided_out(tmp_path: Path, lines: bytes, gain: tuple[float, ...]) -> None:
    rgbe = quads(2, 9)
    path = write(tmp_path, 2, 9, flat(rgbe), b"#?RGBE\n" + lines + b"\n")
    np.testing.assert_allclose(read_hdr(path), radiance_of(rgbe) / gain, rtol=1e-6)


def test_what_is_written_is_read_to_eight_bits(tmp_path: Path) -> None:
    random = np.random.default_rng(2)
    rgb = random.random((16, 32, 3)) * 10.0 ** random.uniform(-6, 6, (16, 32, 1))
    rgb[0, 0] = 0.0
    rgb[0, 1] = (1.0, 0.0, 0.5)
    rgb[0, 2] = (0.9999, 0.1, 0.0)
    write_hdr(tmp_path / "p.hdr", rgb)
    again = read_hdr(tmp_path / "p.hdr")
    assert (np.abs(again - rgb) <= rgb.max(axis=-1, keepdims=True) / 255.0).all()
    np.testing.assert_array_equal(again[0, :2], rgb[0, :2])
    write_hdr(tmp_path / "q.hdr", again)
    assert (tmp_path / "q.hdr").read_bytes() == (tmp_path / "p.hdr").read_bytes()


def test_extremes_that_rgbe_can_hold(tmp_path: Path) -> None:
    rgb = np.array([[[1e6, 0, 0], [8e37, 8e37, 1], [1e-37, 0, 1e-37], [1e-60, 0, 0]]])
    write_hdr(tmp_path / "p.hdr", rgb)
    again = read_hdr(tmp_path / "p.hdr")
    np.testing.assert_allclose(again[0, :3].max(axis=-1), [1e6, 8e37, 1e-37], rtol=4e-3)
    assert not again[0, 3].any()


@pytest.mark.parametrize("bad", [-1e-9, np.nan, np.inf, 1e39])
def test_what_rgbe_cannot_hold_is_not_written(tmp_path: Path, bad: float) -> None:
    rgb = np.ones((2, 2, 3))
    rgb[1, 1, 1] = bad
    with pytest.raises(LightError, match="not written"):
        write_hdr(tmp_path / "p.hdr", rgb)
    assert not (tmp_path / "p.hdr").exists()


GOOD = new_runs(quads(4, 9))
DAMAGES = {
    "empty": (b"", "not a Radiance picture"),
    "other format": (b"\x89PNG\r\n\x1a\n\n\n", "not a Radiance picture"),
    "no resolution": (HEAD, "not a Radiance picture"),
    "from the bottom": (HEAD + b"+Y 4 +X 9\n" + GOOD, "+Y 4 +X 9"),
    "mirrored": (HEAD + b"-Y 4 -X 9\n" + GOOD, "top left"),
    "turned": (HEAD + b"+X 9 -Y 4\n" + GOOD, "top left"),
    "no pixels": (HEAD + b"-Y 0 +X 9\n", "cannot be"),
    "absurd size": (HEAD + b"-Y 999999999 +X 999999999\n" + GOOD, "cannot be"),
    "large promise": (HEAD + b"-Y 8192 +X 16384\n" + GOOD, "cut short"),
    "xyze": (HEAD.replace(b"rgbe", b"xyze") + b"-Y 4 +X 9\n" + GOOD, "xyze"),
    "exposure 0": (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 4 +X 9\n" + GOOD, "EXPOSURE=0"),
    "exposure word": (b"#?RADIANCE\nEXPOSURE=bright\n\n-Y 4 +X 9\n" + GOOD, "EXPOSURE=bright"),
    "two corrections": (b"#?RADIANCE\nCOLORCORR=1 1\n\n-Y 4 +X 9\n" + GOOD, "COLORCORR"),
    "cut runs": (HEAD + b"-Y 4 +X 9\n" + GOOD[:-5], "cut short"),
    "other width": (HEAD + b"-Y 4 +X 12\n" + GOOD, "cut short"),
    "long run": (HEAD + b"-Y 1 +X 9\n" + bytes([2, 2, 0, 9, 255, 7]), "damaged"),
    "empty dumps": (HEAD + b"-Y 1 +X 9\n" + bytes([2, 2, 0, 9]) + bytes(40), "damaged"),
    "cut flat": (HEAD + b"-Y 4 +X 9\n" + bytes(4 * 35 + 3), "cut short"),
    "run of nothing": (HEAD + b"-Y 1 +X 9\n" + bytes([1, 1, 1, 9]), "damaged"),
    "run past the end": (HEAD + b"-Y 1 +X 9\n" + bytes([9, 9, 9, 9, 1, 1, 1, 9]), "damaged"),
    "no bytes": (HEAD + b"-Y 1 +X 9\n", "cut short"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_files_are_refused_in_a_sentence(tmp_path: Path, damage: str) -> None:
    data, words = DAMAGES[damage]
    path = tmp_path / "probe.hdr"
    path.write_bytes(data)
    with pytest.raises(LightError, match=re.escape(words)) as caught:
        read_hdr(path)
    assert str(path) in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(LightError, match="cannot be read"):
        read_hdr(tmp_path / "absent.hdr")


@pytest.mark.data
def test_real_probes_read_and_survive_a_round_trip(shared_data: Path, tmp_path: Path) -> None:
    probes = sorted(shared_data.glob("probe_*.hdr"))
    assert len(probes) == 8
    for probe in probes:
        picture = read_hdr(probe)
        width, height = (int(n) for n in probe.stem.rpartition("_")[2].split("x"))
        assert picture.shape == (height, width, 3)
        assert np.isfinite(picture).all() and picture.min() >= 0.0
        write_hdr(tmp_path / "again.hdr", picture)
        np.testing.assert_array_equal(read_hdr(tmp_path / "again.hdr"), picture)
