"""What the benchmark of the card tells of pictures: shares of all pixels, worst views, and goals that are met."""

from pathlib import Path

from benchmarks.accuracy.card import CASES, GOALS, LOBES, NEW, TEXELS, Found, body, figures_of, place_of


def test_there_are_twenty_views_of_six_scenes(tmp_path: Path) -> None:
    assert len(TEXELS) == 20 and len({case.volume for case in TEXELS}) == 6
    assert {case.light for case in TEXELS} == {"constant light", "uffizi"}
    assert any(case.window for case in TEXELS) and any(case.parallel for case in TEXELS)
    assert len({place_of(tmp_path, case, 128) for case in CASES}) == len(CASES)


def test_figures_weigh_views_by_their_pixels() -> None:
    read = {
        TEXELS[0]: Found(1.0, 0.001, 300, 0, 10),
        TEXELS[1]: Found(0.5, 0.004, 100, 1, 10),
        LOBES[0]: Found(0.99, 0.01, 50, 0, 7),
    }
    found = figures_of(read)
    assert found["texels, within 2/255, all pixels"] == 350 / 400
    assert (found["texels, within 2/255, least"], found["texels, RMSE, most"]) == (0.5, 0.004)
    assert (found["texels, views as asked"], found["moving, views as asked"]) == (1, 1)
    assert found["bytes of a first view of the engine"] == 7 and "new, views" not in found


def test_each_kind_of_view_has_a_table_with_its_goal() -> None:
    text = body({case: Found(1.0, 0.0, 100, 0, 1) for case in (*TEXELS, *LOBES, *NEW)})
    assert text.count("\n## ") + 1 == len(GOALS) and text.count("asked: ") == len(GOALS)
    assert text.count("100.000%") == len(CASES)
