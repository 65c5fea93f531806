"""The page of a report and the files beside it: whole, self-contained, true to the sections, and
readable.
"""

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from isogi_report.journal import Entry
from isogi_report.metrics import shown_as
from isogi_report.page import write_report
from isogi_report.plots import draw, error_colours, keys, scales_of, standalone
from isogi_report.sections import Curve, Picture, Plot, document_of, section_of
from tests.report.samples import disc, errors, report_of, sections

NOTE = "Left out, as 4 minutes did not suffice: <everything>."


@pytest.fixture(scope="module")
def folder(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a report of the samples."""
    place = tmp_path_factory.mktemp("report")
    write_report(
        place, report_of(small_scene, [Entry(section, 31.25) for section in sections()], [NOTE])
    )
    return place


@pytest.fixture(scope="module")
def text(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8")


def test_the_page_asks_for_nothing_and_runs_nothing(text: str) -> None:
    sources = re.findall(r"""(?:src|href|srcset|data|action)=["']([^"']*)""", text) + re.findall(
        r"url\(([^)]*)\)", text
    )
    assert sources
    assert [source[:30] for source in sources if not source.startswith(("#", "data:"))] == []
    assert "<script" not in text
    assert "@import" not in text


def test_the_page_holds_every_section_table_plot_and_picture(text: str) -> None:
    assert text.count("<section ") == 3
    assert re.findall(r'<a href="#([^"]+)"', text) == ["split", "none", "setting"]
    assert (
        text.count('role="img" aria-label="relative RMSE over processor seconds: harmonics, paths.')
        == 1
    )
    assert text.count('src="data:image/png;base64,') == 4
    for words in (
        "What was done.</p>",
        "relative RMSE,\u00a0%",
        ">9.7<",
        ">12.3<",
        ">–<",
        "its error (±5\u00a0%)",
        "one part (±5\u00a0%)",
        "a small part (±0.2\u00a0%)",
        "31.2 s",
    ):
        assert words in text, words
    assert "Parts &lt;of&gt; the error" in text and "&lt;everything&gt;" in text
    assert text.count("alt=") == text.count("<img ")
    assert 'alt=""' not in text


def test_ids_are_unique_and_all_that_are_pointed_at_are_there(text: str) -> None:
    ids = re.findall(r'\sid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    pointed = re.findall(r'(?:href="#|url\(#|aria-labelledby=")([^")]+)', text)
    assert set(pointed) <= set(ids)


def test_the_same_report_is_the_same_bytes(folder: Path, small_scene: Path, tmp_path: Path) -> None:
    write_report(
        tmp_path, report_of(small_scene, [Entry(section, 31.25) for section in sections()], [NOTE])
    )
    names = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    assert names == sorted(
        path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()
    )
    assert all((folder / name).read_bytes() == (tmp_path / name).read_bytes() for name in names)


def refuse(word: str) -> Any:
    raise AssertionError(f"{word} is no JSON")


def test_the_data_hold_what_was_measured(folder: Path) -> None:
    data = json.loads((folder / "report.json").read_text(encoding="utf-8"), parse_constant=refuse)
    split = data["sections"][0]
    assert split["tables"][0]["rows"] == [["total", 0.0971, 12.3], ["noise", None, 1]]
    assert split["plots"][0]["curves"][1]["y"] == [0.5, None, 0.05]
    assert [picture.get("scale") for picture in split["pictures"]] == [None, 0.05, 0.05, 0.002]
    for picture, section in zip(split["pictures"], sections()[0].pictures, strict=True):
        assert np.array_equal(np.load(folder / picture["npy"]), section.pixels, equal_nan=True)
        assert pixels_of((folder / picture["png"]).read_bytes()).shape == (24, 24, 3)
    assert all((folder / plot["svg"]).is_file() for plot in split["plots"])
    assert data["scene"]["plan"]["representation"] == "transfer"
    assert data["machine"]["cores"] > 0 and data["versions"]["numpy"] and data["notes"] == [NOTE]


def test_a_section_survives_its_document() -> None:
    for section in sections():
        document = json.loads(json.dumps(document_of(section), allow_nan=False))
        again = section_of(document, [picture.pixels for picture in section.pictures])
        assert document_of(again) == document_of(section)
        assert (again.tables, again.key) == (section.tables, section.key)


def test_pictures_that_are_gone_are_removed(small_scene: Path, tmp_path: Path) -> None:
    for some in (sections(), sections()[1:]):
        write_report(tmp_path, report_of(small_scene, [Entry(each, 1.0) for each in some]))
    assert list(tmp_path.glob("p*/*")) == []


@pytest.mark.parametrize(
    ("most", "scale"), [(0.03, 0.05), (0.007, 0.01), (0.2, 0.2), (1.4, 2.0), (0.0, 0.01)]
)
def test_maps_share_a_round_scale(most: float, scale: float) -> None:
    maps = [Picture("", "error", errors(part)) for part in (most, most / 3)]
    assert scales_of(maps) == pytest.approx((scale, scale))


def test_a_faint_map_has_its_own_scale_and_light_has_none() -> None:
    light = Picture("", "radiance", np.ones((2, 2, 3), np.float32))
    maps = [Picture("", "error", errors(most)) for most in (0.4, 0.004, 0.0)]
    assert scales_of([light, *maps]) == (None, *map(pytest.approx, (0.5, 0.005, 0.5)))


def test_errors_are_blue_below_white_at_and_red_above_nothing() -> None:
    shown = error_colours(np.array([[-9.0, -0.1, 0.0, 0.1, np.nan]], np.float32), 0.1)[0].astype(
        int
    )
    red, blue = shown[:, 0], shown[:, 2]
    assert (shown[0] == shown[1]).all(), "beyond the scale is its end"
    assert blue[1] > red[1] + 50 and red[3] > blue[3] + 50
    assert shown[2].min() > 240
    assert 0 < shown[4].min() <= shown[4].max() < 40, "the film's background"


def pixels_of(png: bytes) -> np.ndarray:
    """The pixels of a picture's file."""
    return np.asarray(Image.open(io.BytesIO(png)))


def test_radiance_is_shown_at_the_exposure(small_scene: Path) -> None:
    light = np.full((24, 24, 3), 0.25, np.float32)
    reports = [report_of(small_scene, [], exposure=exposure) for exposure in (1.0, 2.0)]
    assert [
        int(shown_as(light, report.on, report.exposure)[disc()].min()) for report in reports
    ] == [139, 210]  # sRGB


def test_a_black_surface_is_black_and_not_the_background(small_scene: Path) -> None:
    report = report_of(small_scene, [])
    shown = shown_as(np.zeros((24, 24, 3), np.float32), report.on, report.exposure)
    assert (shown[disc()] == 0).all()
    assert (shown[~disc()] > 0).all()


@pytest.fixture
def plot() -> Plot:
    return sections()[0].plots[0]


def test_a_plot_names_its_colours_and_its_fonts(plot: Plot) -> None:
    svg = draw(plot)
    assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert {key.colour for key in keys(plot)} == {"var(--curve-1)", "var(--curve-2)"}
    assert all(f"stroke: {key.colour}" in svg for key in keys(plot))
    assert "#0" not in re.sub(r'"#[a-z0-9]{5,}"|url\(#[^)]*\)', "", svg), (
        "a colour that no scheme knows"
    )
    assert set(re.findall(r"font-family: ([^;\"]*)", svg)) == {"var(--text)"}
    for words in ("processor seconds", "relative RMSE", ">10 %<", ">1 s<"):
        assert words in svg, words


def test_points_that_a_logarithm_does_not_have_are_left_out(plot: Plot) -> None:
    assert draw(plot).count("<use ") == draw(sections()[0].plots[0]).count("<use ")
    assert "nan" not in draw(plot).lower()


def test_a_curve_without_points_is_not_in_the_legend(plot: Plot) -> None:
    more = replace(plot, curves=(Curve("empty", (), ()), *plot.curves))
    colours = {key.name: key.colour for key in keys(more)}
    assert colours == {"harmonics": "var(--curve-2)", "paths": "var(--curve-3)"}


def test_a_plot_that_stands_alone_has_its_own_colours(plot: Plot) -> None:
    file = standalone(plot)
    assert ElementTree.fromstring(file).tag.endswith("svg")
    assert "harmonics</text>" in file and 'viewBox="0 0 331.2 251.2"' in file
    assert "--curve-1: #" in file and "prefers-color-scheme: dark" in file
