"""Which format a request gets, and what the encoders make of its picture."""

import io

import numpy as np
import pytest
from PIL import Image

from server.errors import NotAcceptableError, ParameterError
from server.params import FrameParams, read
from server.pictures import ENCODER_OPTIONS, format_for, media_range, negotiate

CHROMIUM = "image/avif,image/webp,image/apng,image/svg+xml,image/*,*/*;q=0.8"


@pytest.mark.parametrize(
    ("accept", "form"),
    [
        (None, "png"),
        ("", "png"),
        ("*/*", "png"),
        ("image/*", "png"),
        ("image/jpeg", "jpeg"),
        ("IMAGE/WEBP", "webp"),
        ("image/png;q=0.5, image/webp", "webp"),
        ("image/png;q=0, */*", "jpeg"),
        ("application/x-npy", "npy"),
        ("text/html, image/webp;q=0.1", "webp"),
        ("image/avif,image/webp,*/*;q=0.8", "webp"),
        (CHROMIUM, "png"),
    ],
)
def test_accept(accept: str | None, form: str) -> None:
    assert negotiate(accept) == form


@pytest.mark.parametrize("accept", ["text/html", "image/avif", "image/png;q=0", "image/png;q=x", "png", ";;,,"])
def test_nothing_fits(accept: str) -> None:
    with pytest.raises(NotAcceptableError, match="image/png, image/jpeg, image/webp, application/x-npy"):
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


@pytest.mark.parametrize("form", ["png", "jpeg", "webp"])
def test_encoders_keep_the_picture(form: str) -> None:
    """PNG to the bit; the others to what the eye lets pass."""
    y, x = np.mgrid[:64, :80]
    picture = np.stack([3 * y, 255 - 2 * x, (x + y)], axis=-1).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, form, **ENCODER_OPTIONS[form])
    back = np.asarray(Image.open(buffer).convert("RGB")).astype(int)
    assert np.abs(back - picture).max() <= (0 if form == "png" else 12)
