"""Light probes in OpenEXR files, beside what the library's authors write."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import LightError
from isogi_core.files.probes import parse_probe, read_probe
from isogi_core.files.radiance import write_hdr

LIGHT = np.random.default_rng(3).gamma(1.0, 2.0, (8, 16, 3)).astype(np.float32)


def written(path: Path, header: dict[str, Any] | None = None, **channels: np.ndarray) -> Path:
    """An OpenEXR file of these channels, of R, G and B of LIGHT unless others are given."""
    exr = pytest.importorskip("OpenEXR")
    planes = channels or {name: LIGHT[..., k].copy() for k, name in enumerate("RGB")}
    given = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage, **(header or {})}
    with exr.File(given, planes) as file:
        file.write(str(path))
    return path


def test_floats_come_back_to_the_bit(tmp_path: Path) -> None:
    path = written(tmp_path / "a.exr")
    assert np.array_equal(read_probe(path), LIGHT)
    assert np.array_equal(parse_probe(path.read_bytes(), "a"), LIGHT)


def test_halves_and_other_channels_are_read(tmp_path: Path) -> None:
    planes = {name: LIGHT[..., k].astype(np.float16) for k, name in enumerate("RGB")}
    path = written(tmp_path / "a.exr", A=np.ones((8, 16), np.float16), **planes)
    found = read_probe(path)
    assert found.dtype == np.float32 and np.array_equal(found, LIGHT.astype(np.float16))


def test_luminance_alone_is_grey(tmp_path: Path) -> None:
    found = read_probe(written(tmp_path / "a.exr", Y=LIGHT[..., 0].copy()))
    assert np.array_equal(found, np.repeat(LIGHT[..., :1], 3, axis=-1))


def test_radiance_pictures_are_read_as_before(tmp_path: Path) -> None:
    write_hdr(tmp_path / "a.hdr", LIGHT)
    assert np.allclose(read_probe(tmp_path / "a.hdr"), LIGHT, atol=LIGHT.max() / 128)


ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)


@pytest.mark.parametrize(
    ("header", "said"),
    [({"chromaticities": ACES}, "other primaries"), ({"envmap": "ENVMAP_CUBE"}, "a cube map")],
)
def test_what_is_no_probe_is_named(tmp_path: Path, header: dict[str, Any], said: str) -> None:
    exr = pytest.importorskip("OpenEXR")
    given = {
        key: getattr(exr, value) if isinstance(value, str) else value
        for key, value in header.items()
    }
    with pytest.raises(LightError, match=said):
        read_probe(written(tmp_path / "a.exr", given))


def test_other_channels_are_named(tmp_path: Path) -> None:
    with pytest.raises(LightError, match="the channels Z: save it with R, G and B"):
        read_probe(written(tmp_path / "a.exr", Z=LIGHT[..., 0].copy()))


def test_large_pictures_are_refused_by_their_header(tmp_path: Path) -> None:
    data = written(tmp_path / "a.exr").read_bytes()
    with pytest.raises(LightError, match="16 × 8 pixels, and 100 are the most"):
        parse_probe(data, "a", 100)


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.98])
def test_files_that_are_cut_short_are_damaged(tmp_path: Path, share: float) -> None:
    data = written(tmp_path / "a.exr").read_bytes()
    with pytest.raises(LightError, match="damaged or cut short"):
        parse_probe(data[: int(share * len(data))], "a")


def test_a_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.exr").write_bytes(b"\x76\x2f\x31\x01 and more")
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(LightError, match=r"pip install 'isogi\[formats\]'"):
        read_probe(tmp_path / "a.exr")


@pytest.mark.parametrize("version", ["1.3.9", "3.4.4"])
def test_an_old_library_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: str
) -> None:
    """Not the file, which newer ones read."""
    path = written(tmp_path / "a.exr")
    monkeypatch.setattr(sys.modules["OpenEXR"], "__version__", version)
    with pytest.raises(LightError, match=rf"OpenEXR 3\.5 or newer, and {version} is installed"):
        read_probe(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LightError, match="check its path"):
        read_probe(tmp_path / "absent.exr")
