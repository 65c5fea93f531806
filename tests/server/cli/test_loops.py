"""Movies that repeat without end: GIF and WebP, as Pillow reads them."""

import resource
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from isogi_server.cli.film import write_movie

SIZE = (41, 30)


def pictures_in(folder: Path, count: int, mode: str = "RGB") -> list[Path]:
    """Pictures of a disc that moves over a smooth ground, as files."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    paths = []
    for number in range(count):
        disc = np.hypot(x - 8 - 0.25 * number, y - 14) < 6
        shades = [np.where(disc, 230, 3 * x), np.where(disc, 190 - number, 4 * y), 60 + 0 * x]
        if mode == "RGBA":
            shades.append(np.where(disc, 255, 0))
        paths.append(folder / f"frame-{number:05d}.png")
        Image.fromarray(np.dstack(shades).astype(np.uint8), mode).save(paths[-1])
    return paths


@pytest.mark.parametrize("mode", ["RGB", "RGBA"])
@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_movie_shows_its_pictures(tmp_path: Path, kind: str, mode: str) -> None:
    pictures = pictures_in(tmp_path, 6, mode)
    write_movie(tmp_path / f"a.{kind}", pictures, 20.0)
    with Image.open(tmp_path / f"a.{kind}") as movie:
        assert (movie.size, movie.n_frames, movie.info["loop"]) == (SIZE, 6, 0)
        for number, path in enumerate(pictures):
            movie.seek(number)
            shown = np.asarray(movie.convert("RGBA"), float)
            assert movie.info["duration"] == 50
            asked = np.asarray(Image.open(path).convert("RGBA"), float)
            np.testing.assert_array_equal(shown[..., 3], asked[..., 3])
            wrong = (shown - asked)[asked[..., 3] > 0]
            assert np.sqrt(np.mean(wrong**2)) < 12.0
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".png") == [
        f"a.{kind}"
    ]


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_picture_that_stays_is_shown_for_longer(tmp_path: Path, kind: str) -> None:
    first, second = pictures_in(tmp_path, 2)
    write_movie(tmp_path / f"a.{kind}", [first, first, first, second], 10.0)
    assert durations(tmp_path / f"a.{kind}") == [300, 100]
    # One that stays for minutes is shown again and again.
    write_movie(tmp_path / f"b.{kind}", [first] * 130, 1.0)
    shown = durations(tmp_path / f"b.{kind}")
    assert sum(shown) == 130_000 and 30_000 <= max(shown) <= 120_000


def durations(path: Path) -> list[float]:
    found = []
    with Image.open(path) as movie:
        for number in range(movie.n_frames):
            movie.seek(number)
            movie.load()
            found.append(movie.info["duration"])
    return found


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_long_movie_opens_one_picture_at_a_time(tmp_path: Path, kind: str) -> None:
    pictures = pictures_in(tmp_path, 60)
    least, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    opened = len(list(Path("/proc/self/fd").iterdir()))
    resource.setrlimit(resource.RLIMIT_NOFILE, (opened + 20, most))
    try:
        write_movie(tmp_path / f"a.{kind}", pictures, 20.0)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (least, most))
    assert len(durations(tmp_path / f"a.{kind}")) == 60
