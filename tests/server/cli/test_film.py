"""``isogi film``: paths of views, frames that are gone on from, and movies."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from isogi_server.cli.film_path import film_path, view_in, views_in
from isogi_server.cli.reel import ReelRequest, time_of_others
from isogi_server.errors import ParameterError
from tests.loaded import load_scene
from tests.server.asking import Told

SIZE = ["--width", "24", "--height", "20"]


pytestmark = pytest.mark.usefixtures("inline")


def values(path: list[dict[str, str]], name: str) -> list[float]:
    return [float(view[name]) for view in path]


def test_with_nothing_given_the_camera_goes_round_evenly() -> None:
    path = film_path({"elevation": "10"}, [], {}, 4)
    assert values(path, "azimuth") == [30, 120, 210, 300]
    assert {view["elevation"] for view in path} == {"10"}


def test_a_sweep_begins_and_ends_at_rest() -> None:
    path = film_path({"isovalue": "60:120", "yaw": "-90:90"}, [], {}, 101)
    isovalues = np.array(values(path, "isovalue"))
    t = np.linspace(0, 1, 101)
    np.testing.assert_allclose(isovalues, 60 + 60 * (3 * t**2 - 2 * t**3), rtol=1e-12)
    np.testing.assert_allclose(
        (np.array(values(path, "yaw")) + 90) / 180, (isovalues - 60) / 60, atol=1e-12
    )
    assert "azimuth" not in path[0]


def test_a_way_along_views_meets_each_and_passes_none() -> None:
    views = [
        {"azimuth": "350", "distance": "3"},
        {"azimuth": "20"},
        {"azimuth": "20", "distance": "5"},
    ]
    path = film_path({}, views, {"distance": "4"}, 21)
    azimuths = np.array(values(path, "azimuth"))
    distances = np.array(values(path, "distance"))
    assert azimuths[[0, 10, 20]] % 360 == pytest.approx([350, 20, 20])
    assert distances[[0, 10, 20]] == pytest.approx([3, 4, 5])
    steps = np.diff(np.unwrap(azimuths, period=360))
    assert steps.min() > -1e-9 and steps.sum() == pytest.approx(30)
    assert np.diff(distances).min() >= 0


def test_a_closed_way_has_no_corner_where_it_begins() -> None:
    views = [{"azimuth": text} for text in ("0", "90", "180", "270", "360")]
    assert np.diff(values(film_path({}, views, {}, 36), "azimuth")) == pytest.approx(10)


def test_light_goes_the_short_way_whatever_its_sign() -> None:
    path = film_path({}, [{"light": "1,0,0,0"}, {"light": "-1,0,0,-0.1"}], {}, 3)
    assert path[-1]["light"].startswith("1.0")


def test_links_and_files_are_views() -> None:
    link = "http://127.0.0.1:8000/?scene=engine&isovalue=70&azimuth=-40.5&target=1,2,3&shading=gi&compare=phong"
    link += "&rulers=off&measure=1,2,3;4,5,6&measure=1,2,3;4,5,6;7,8,9"
    wanted = {"isovalue": "70", "azimuth": "-40.5", "target": "1,2,3", "shading": "gi"}
    assert view_in(link) == wanted
    assert views_in([link, {"isovalue": 70, "target": [1, 2, 3]}])[1] == {
        "isovalue": "70",
        "target": "1,2,3",
    }
    for wrong in ({}, [], [7]):
        with pytest.raises(ParameterError):
            views_in(wrong)


@pytest.mark.parametrize(
    ("given", "views", "sentence"),
    [
        ({"isovalue": "1:2"}, [{"azimuth": "1"}, {"azimuth": "2"}], "keep one"),
        ({"isovalue": "1:2:3"}, [], "first:last"),
        ({"isovalue": "low:high"}, [], "first:last"),
        ({"width": "10:20"}, [], "width cannot change"),
        ({}, [{"environment": "studio"}, {"azimuth": "2"}], "environment cannot change"),
        ({}, [{"material": "glass"}, {"material": "glass,index=2"}], "material cannot change"),
        ({}, [{"eye": "1,2,3"}, {"azimuth": "2"}], "eye is given by some"),
    ],
)
def test_paths_that_make_no_sense(
    given: dict[str, str], views: list[dict[str, str]], sentence: str
) -> None:
    with pytest.raises(ParameterError, match=sentence):
        film_path(given, views, {}, 3)


def test_views_of_the_page_are_filmed_as_it_shows_them(
    small_scene: Path, tmp_path: Path, told: Told
) -> None:
    views = [
        {"isovalue": 0.5, "azimuth": azimuth, "exposure": 2, "background": "light"}
        for azimuth in (10, 50)
    ]
    shown = {"environment": "studio", "cut": "x>16", "material": "glass,index=1.3"}
    (tmp_path / "lit.json").write_text(json.dumps({"views": [{**view, **shown} for view in views]}))
    (tmp_path / "own.json").write_text(json.dumps({"views": views}))
    options = ["--store", tmp_path / "store", "--length", "1", "--fps", "2", *SIZE]
    given = shown.items()
    pictures = []
    for name, keys, more in (
        ("a", "lit", []),
        ("b", "own", []),
        ("c", "own", [f"--{x}={text}" for x, text in given]),
    ):
        keys_file = tmp_path / f"{keys}.json"
        told("film", small_scene, "-o", tmp_path / name, "--views-file", keys_file, *options, *more)
        pictures.append([path.read_bytes() for path in sorted((tmp_path / name).glob("*.png"))])
    lit, own, same = pictures
    assert len(lit) == 2 and lit == same and lit[0] != own[0] and lit[1] != own[1]


def test_the_tint_of_a_link_colours_the_albedo() -> None:
    """As the page does it: shares of the albedo, linear in the light."""
    links = [
        "http://here/?scene=s&albedo=0.5&tint=%23ff0080",
        "http://here/?scene=s&tint=%23ff0080",
    ]
    path = film_path({}, [view_in(link) for link in links], {"albedo": "0.8,0.4,0.1"}, 2)
    assert "tint" not in path[0]
    found = [[float(share) for share in view["albedo"].split(",")] for view in path]
    np.testing.assert_allclose(
        found, [[0.5, 0.0, 0.5 * 0.21586], [0.8, 0.0, 0.8 * 0.21586]], rtol=1e-4
    )
    with pytest.raises(ParameterError, match="tint must be a colour such as #ff8800, not 'red'"):
        film_path({}, [view_in("?tint=red")], {"albedo": "0.7,0.7,0.7"}, 2)


def test_budgets_share_what_is_left() -> None:
    for each, whole, share in ((None, None, None), (3, None, 3), (3, 20, 2), (None, 5, 0)):
        assert ReelRequest(Path(), None, each, whole, lambda: 110.0, 100.0).share(5) == share


def test_the_first_picture_says_nothing_of_others() -> None:
    """Its light is theirs, too: a film was to take nine hours by it."""
    assert time_of_others([], 9) is None and time_of_others([100.0], 9) is None
    left = time_of_others([100.0, 2.0, 4.0], 5)
    assert left is not None and left.low < left.likely == 15.0 < left.high


def test_a_film_goes_on_and_becomes_a_movie(small_scene: Path, tmp_path: Path, told: Told) -> None:
    def film(name: str) -> dict[str, object]:
        options = ["--store", tmp_path / "store", "--json", *SIZE, "--length", "1", "--fps", "4"]
        return dict(json.loads(told("film", small_scene, "-o", tmp_path / name, *options)))

    facts = film("turn")
    assert (facts["pictures"], facts["kept"], facts["final"]) == (4, 0, 1.0)
    pictures = sorted((tmp_path / "turn").glob("*.png"))
    assert len({path.read_bytes() for path in pictures}) == len(pictures) == 4
    pictures[2].unlink()
    assert film("turn")["kept"] == 3
    (tmp_path / "turn").rename(tmp_path / "turn.gif.frames")
    assert film("turn.gif")["kept"] == 4
    with Image.open(tmp_path / "turn.gif") as movie:
        assert (movie.size, movie.n_frames, movie.info["duration"]) == ((24, 20), 4, 250)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store", "turn.gif"]


def test_a_film_and_a_grid_show_what_render_shows(
    small_scene: Path, tmp_path: Path, told: Told
) -> None:
    """The same camera, ground and exposure, to the byte, where one view of each is the same."""
    level = float(load_scene(small_scene).isovalue)
    options = ["--store", tmp_path / "store", "--elevation", "40", *SIZE]
    for name in ("a.png", "a.webp"):
        told("render", small_scene, "-o", tmp_path / name, *options)
    sweep = ["--isovalue", f"{level}:{level}", "--length", "1", "--fps", "1"]
    told("film", small_scene, "-o", tmp_path / "film", *sweep, *options)
    told(
        "publish",
        small_scene,
        "-o",
        tmp_path / "grid",
        "--isovalue",
        f"{level}:{level}:1",
        *options,
    )
    assert (tmp_path / "film" / "frame-00001.png").read_bytes() == (tmp_path / "a.png").read_bytes()
    assert (tmp_path / "grid" / "pictures" / "0.webp").read_bytes() == (
        tmp_path / "a.webp"
    ).read_bytes()


def covered(picture: Path) -> np.ndarray:
    """The rows and the columns of a picture without its ground that show something: the first and
    the last, (2, 2).
    """
    with Image.open(picture) as opened:
        cover = np.asarray(opened)[..., 3] > 0
    places = (np.flatnonzero(cover.any(axis=axis)) for axis in (1, 0))
    return np.array([[place[0], place[-1]] for place in places])


def test_a_film_sees_all_of_what_it_goes_round(
    small_scene: Path, tmp_path: Path, told: Told
) -> None:
    """Unless the camera is placed: then it is as far away as it was told."""
    options = [
        "--store",
        tmp_path / "store",
        "--length",
        "1",
        "--fps",
        "4",
        "--background",
        "transparent",
    ]
    options += ["--time", "1", "--width", "60", "--height", "60"]
    for name, more in (("whole", []), ("near", ["--distance", "2"]), ("far", ["--distance", "9"])):
        told("film", small_scene, "-o", tmp_path / name, *options, *more)
    reach = {}
    for name in ("whole", "near", "far"):
        ends = np.array([covered(path) for path in sorted((tmp_path / name).glob("*.png"))])
        reach[name] = (np.abs(ends - 29.5).max() + 0.5) / 30.0
    assert reach["whole"] == pytest.approx(0.9, abs=0.06)
    assert reach["near"] == 1.0 and reach["far"] < 0.6


def test_a_folder_of_another_film_is_left(small_scene: Path, tmp_path: Path, told: Told) -> None:
    (tmp_path / "turn").mkdir()
    (tmp_path / "turn" / "pictures.json").write_text('{"asked": "another", "pictures": {}}')
    assert "something else" in told("film", small_scene, "-o", tmp_path / "turn", *SIZE, status=2)


def test_mp4_is_what_players_read(small_scene: Path, tmp_path: Path, told: Told) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    more = ["--length", "1", "--fps", "4", "--store", str(tmp_path / "store"), *SIZE]
    for name in ("a.mp4", "a.webm"):
        told("film", small_scene, "-o", tmp_path / name, *more)
        reading = [
            ffmpeg.get_ffmpeg_exe(),
            "-i",
            tmp_path / name,
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-",
        ]
        pixels = subprocess.run(reading, capture_output=True, check=True).stdout
        frames = np.frombuffer(pixels, np.uint8).reshape(4, 20, 24, 3)
        assert (
            frames.max() > 200 and frames.min() < 150
        )  # the light ground, and shades of the surface
