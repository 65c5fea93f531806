"""``isogi publish``: a grid of pictures and a page that needs nothing else."""

import json
import re
from pathlib import Path

import pytest
from PIL import Image

from isogi_core.plan.isovalue_presets import front_of
from isogi_server.cli.publish import first_place, ground_colour, sliders_of, values_in
from isogi_server.errors import ParameterError
from tests.loaded import load_scene
from tests.server.asking import Told

pytestmark = pytest.mark.usefixtures("inline")


def test_a_grid_is_published_and_gone_on_with(
    small_scene: Path, tmp_path: Path, told: Told
) -> None:
    size = ["--width", "24", "--height", "20", "--store", tmp_path / "store"]
    grid = ["--azimuth", "0:270:90", "--isovalue", "0.4:0.6:0.1", "--json"]
    folder = tmp_path / "out"
    for kept in (0, 11):
        facts = json.loads(told("publish", small_scene, "-o", folder, *grid, *size))
        assert (facts["pictures"], facts["kept"], facts["final"]) == (12, kept, 1.0)
        (folder / "pictures" / "2-1.webp").unlink()
    page = (folder / "index.html").read_text()
    data = json.loads(re.search(r"const data = (.*);", page)[1])  # type: ignore[index]
    assert [len(each["values"]) for each in data["sliders"]] == [3, 4] and len(data["errors"]) == 12
    assert not re.search(r"https?:|src=|href=", page)
    names = {f"{n}-{m}.webp" for n in range(3) for m in range(4)}
    assert {path.name for path in (folder / "pictures").iterdir()} == names - {"2-1.webp"}
    with Image.open(folder / "pictures" / "0-0.webp") as picture:
        assert picture.size == (24, 20)


def test_the_page_begins_at_the_first_view() -> None:
    scene = load_scene("demo:orbital")
    azimuths = [15.0 * n for n in range(24)]
    azimuth, elevation = front_of(scene.volume, False)
    assert abs(azimuths[first_place(scene, "azimuth", azimuths)] - azimuth) <= 7.5
    assert first_place(scene, "elevation", [0.0, elevation + 1.0, 60.0]) == 1
    assert first_place(scene, "isovalue", [0.0, scene.isovalue, 1.0]) == 1
    assert first_place(scene, "yaw", [90.0, 350.0, 200.0]) == 1, "ten degrees from 0"
    assert first_place(scene, "roughness", [0.1, 0.2]) == 0, "there is none"


@pytest.mark.parametrize(
    ("background", "colour"),
    [("light", "#cbced1"), ("#102030", "#102030"), ("dark", "#1a1d22"), ("transparent", "")],
)
def test_the_pages_ground_is_the_pictures(background: str, colour: str) -> None:
    assert ground_colour(background) == colour


def test_sliders_are_what_is_given_as_ranges() -> None:
    assert sliders_of({"fov": "30"}) == {"azimuth": [15.0 * n for n in range(24)]}
    assert sliders_of({"isovalue": "60:70:5", "fov": "30"}) == {"isovalue": [60, 65, 70]}


@pytest.mark.parametrize("text", ["1:2", "a:b:c", "2:1:1", "1:2:0", "0:1:1e-9"])
def test_ranges_that_make_no_sense(text: str) -> None:
    with pytest.raises(ParameterError, match="first:last:step"):
        values_in("isovalue", text)
    with pytest.raises(ParameterError, match="more than"):
        sliders_of({"azimuth": "0:300:1", "yaw": "0:300:1", "elevation": "0:80:1"})
