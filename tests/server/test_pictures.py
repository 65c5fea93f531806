"""Which format a request gets."""

import pytest

from server.errors import NotAcceptableError, ParameterError
from server.params import FrameParams, read
from server.pictures import format_for, media_range, negotiate

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
