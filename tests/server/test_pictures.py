"""Which format a request gets, and what the encoders make of its picture."""

import io

import numpy as np
import pytest
from PIL import Image

from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_server import pictures
from isogi_server.errors import NotAcceptableError, ParameterError
from isogi_server.parameters import FrameParams, read
from isogi_server.pictures import (
    compress,
    encode,
    format_for,
    grey,
    media_range,
    negotiate,
    npy_bytes,
    npy_parts,
)

CHROMIUM = "image/avif,image/webp,image/apng,image/svg+xml,image/*,*/*;q=0.8"


@pytest.mark.parametrize(
    ("accept", "form"),
    [
        *[(accept, "png") for accept in (None, "", "*/*", "image/*", CHROMIUM)],
        *[(accept, "jpeg") for accept in ("image/jpeg", "image/png;q=0, */*")],
        *[(accept, "webp") for accept in ("IMAGE/WEBP", "image/png;q=0.5, image/webp")],
        *[
            (accept, "webp")
            for accept in ("text/html, image/webp;q=0.1", "image/avif,image/webp,*/*;q=0.8")
        ],
        ("application/x-npy", "npy"),
    ],
)
def test_accept(accept: str | None, form: str) -> None:
    assert negotiate(accept) == form


@pytest.mark.parametrize(
    "accept", ["text/html", "image/avif", "image/png;q=0", "image/png;q=x", "png", ";;,,"]
)
def test_nothing_fits(accept: str) -> None:
    with pytest.raises(
        NotAcceptableError, match="image/png, image/jpeg, image/webp, application/x-npy"
    ):
        negotiate(accept)


@pytest.mark.parametrize(
    ("text", "parsed"),
    [
        ("image/png", ("image/png", 1.0)),
        (" Image/PNG ; Q=0.3", ("image/png", 0.3)),
        ("a/b;level=1;q=0.2", ("a/b", 0.2)),
        ("a/b;q=nan", ("a/b", 0.0)),
        ("a/b;q=7", ("a/b", 0.0)),
    ],
)
def test_media_range(text: str, parsed: tuple[str, float]) -> None:
    assert media_range(text) == parsed


def test_f_beats_accept() -> None:
    assert format_for(read(FrameParams, [("f", "webp")]), "text/html") == "webp"


@pytest.mark.parametrize("name", ["exposure", "overlay"])
def test_npy_does_not_read_what_makes_eight_bits(name: str) -> None:
    params = read(FrameParams, [(name, {"exposure": "1", "overlay": "none"}[name])])
    assert format_for(params, "image/png") == "png"
    with pytest.raises(ParameterError, match=f"does not read {name}"):
        format_for(params, "application/x-npy")


@pytest.mark.parametrize(
    ("form", "error", "smaller"), [("png", 0.0, 4), ("jpeg", 1.5, 8), ("webp", 3.0, 30)]
)
def test_encoders_keep_the_picture(form: str, error: float, smaller: int) -> None:
    """PNG to the bit; the others to what the eye lets pass, in so many times fewer bytes."""
    y, x = np.mgrid[:64, :80]
    picture = np.stack([3 * y, 255 - 2 * x, (x + y)], axis=-1).astype(np.uint8)
    packed = compress(picture, form)
    back = np.asarray(Image.open(io.BytesIO(packed)).convert("RGB")).astype(int)
    assert np.sqrt(np.square(back - picture).mean()) <= error
    assert len(packed) < picture.nbytes / smaller


@pytest.mark.parametrize("band", [1, 3 * 36 * 5, 1 << 20])
def test_npy_is_the_same_in_parts_of_any_size(monkeypatch: pytest.MonkeyPatch, band: int) -> None:
    """A picture of 7 × 5 pixels whose surface is in every third one."""
    monkeypatch.setattr(pictures, "BAND", band)
    rng = np.random.default_rng(3)
    scene = load_scene("demo:orbital")
    view = View(scene.isovalue, scene.camera(0.0, 0.0, 3.0, 30.0), width=5, height=7)
    pixels = np.arange(1, 35, 3, dtype=np.uint32)
    points = rng.random((12, 3), np.float32)
    surface = GBuffer((7, 5), (1.0, 2.0, 0.5), (9.0, 0.0, 0.0), 0.5, pixels, points)
    radiance = rng.random((7, 5, 3), np.float32)
    error = rng.random((7, 5), np.float32)
    state = rng.integers(0, 4, (7, 5)).astype(np.uint8)
    frame = Frame(view, radiance, state, error, surface, "", {})
    parts = list(npy_parts(frame))
    assert len(parts) == 1 + (7 if band == 1 else -(-7 // max(band // 180, 1)))
    assert sum(map(len, parts)) == npy_bytes(frame)
    whole = np.load(io.BytesIO(encode(frame, "npy", 1.0)))
    assert whole.dtype == np.float32 and whole.flags.c_contiguous
    position = np.zeros((35, 3), np.float32)
    position[pixels] = points * np.float32([1.0, 2.0, 0.5])
    planes = [state > 0, state, frame.total_error]
    expected = [radiance, *(each[..., None] for each in planes), position.reshape(7, 5, 3)]
    assert np.array_equal(whole, np.concatenate(expected, axis=-1))
    assert b"".join(parts) == encode(frame, "npy", 1.0)


def test_grey_goes_from_low_to_high_and_holes_are_black() -> None:
    values = np.array([[-9.0, 0.0, 1.0], [2.0, 9.0, np.nan]])
    assert grey(values, 0.0, 2.0).tolist() == [[0, 0, 128], [255, 255, 0]]
    assert grey(values, 3.0, 3.0).tolist() == [[128, 128, 128], [128, 128, 0]]
    most = np.finfo(np.float64).max
    assert grey(np.array([[-most, 0.0, most]]), -most, most).tolist() == [[0, 128, 255]]


@pytest.mark.parametrize(
    ("values", "near", "form"),
    [
        *[
            ([[0.0, 255.0]], 1e-4, "|u1"),
            ([[0.0, 256.0]], 1e-4, "<u2"),
            ([[-1.0, 300.0]], 1e-4, "<i2"),
        ],
        ([[-1.0, 40000.0]], 1e-2, "<f4"),
        ([[0.5, 0.1]], 1e-6, "<f4"),
        ([[1e9, 1e9 + 0.001]], 1e-9, "<f8"),
        ([[1e300, 0.0]], 1e294, "<f8"),
        ([[3.0, np.nan]], 1e-6, "<f4"),
        ([[np.nan, np.nan]], 0.0, "<f4"),
    ],
)
def test_values_take_the_narrowest_numbers(
    values: list[list[float]], near: float, form: str
) -> None:
    told = np.load(io.BytesIO(pictures.values_npy(np.array(values), near)))
    assert told.dtype == np.dtype(form)
    np.testing.assert_allclose(told, values, rtol=0, atol=near)
