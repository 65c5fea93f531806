"""``isogi inspect``: how stiff a volume is, as document, text and picture, and the lines that a
person needs first.
"""

import importlib.util
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest
from PIL import Image

from isogi_core.model.volume import make_volume
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_server.inspect.inspection import (
    InspectionSchema,
    StiffnessSchema,
    SurfaceSchema,
    faces_of,
    inspection_schema,
    isovalues_of,
    mark_of_nothing,
    percent,
    remarks,
)
from isogi_server.inspect.text import full_text, inspect, shown_places
from tests.server.asking import Told

needs_matplotlib = pytest.mark.skipif(
    importlib.util.find_spec("matplotlib") is None, reason="needs matplotlib"
)


def scene_of(array: np.ndarray, isovalue: float, solid: str = "above") -> Scene:
    volume = make_volume(array, solid=solid)
    scene = load_scene("demo:orbital", lights=[{"type": "constant"}])
    return replace(scene, volume=volume, isovalue=isovalue, isovalues=volume.value_range)


def mask(side: int = 12) -> np.ndarray:
    """A block of 1 that stands on z = 0, in 0."""
    array = np.zeros((side,) * 3, np.float32)
    array[: side // 2, 3:-3, 3:-3] = 1.0
    return array


def about(facts: InspectionSchema) -> dict[str, str]:
    return {remark.about: remark.means for remark in facts.stiffness.remarks}


def own(facts: InspectionSchema) -> SurfaceSchema:
    return facts.stiffness.surfaces[facts.stiffness.own]


def test_a_mask_is_told_to_be_steep_and_where_it_meets_the_box() -> None:
    facts = inspection_schema(scene_of(mask(), 0.5))
    assert own(facts).steep == 1.0
    assert list(own(facts).box) == ["z = 0"]
    assert "100 % of the surface lies on steps" in about(facts)["steep"]
    assert "meets the box at z = 0" in about(facts)["box"]


def test_faces_are_the_same_where_the_solid_is_below() -> None:
    facts = inspection_schema(scene_of(1.0 - mask(), 0.5, "below"))
    assert list(own(facts).box) == ["z = 0"] and own(facts).steep == 1.0


def test_a_smooth_field_is_told_not_to_be_stiff() -> None:
    z, y, x = np.indices((24,) * 3) - 11.5
    facts = inspection_schema(scene_of(np.sqrt(x * x + y * y + z * z), 8.0))
    assert set(about(facts)) == {"error"}
    assert "Nothing is stiff there." in about(facts)["error"]


def test_noise_is_told_to_be_noisy_and_what_to_do() -> None:
    noise = np.random.default_rng(1).normal(size=(16,) * 3)
    facts = inspection_schema(scene_of(noise, 0.0))
    noisy = next(remark for remark in facts.stiffness.remarks if remark.about == "noisy")
    assert noisy.does and any("smooth the volume" in can for can in noisy.can)


def test_holes_and_the_texels_beside_them() -> None:
    array = mask()
    array[4, 6, 3] = np.nan
    facts = inspection_schema(scene_of(array, 0.5))
    assert 0.0 < own(facts).holes < 0.5
    assert "not numbers" in about(facts)["holes"]


@pytest.mark.parametrize("isovalue", [1.0, 0.0])
def test_at_the_ends_of_the_range_nothing_or_a_plateau_is_seen(isovalue: float) -> None:
    facts = inspection_schema(scene_of(mask(), isovalue))
    assert next(iter(about(facts))) == ("nothing" if isovalue == 1.0 else "error")
    assert (own(facts).error is None) == (isovalue == 1.0)
    assert ("plateau" in about(facts)) == (isovalue == 0.0)


def test_a_constant_volume_has_nothing_to_see() -> None:
    facts = inspection_schema(scene_of(np.ones((4, 5, 6)), 1.0))
    assert len(facts.stiffness.surfaces) == 1 and list(about(facts)) == ["nothing"]
    assert "nothing is seen" in full_text(scene_of(np.ones((4, 5, 6)), 1.0), facts)


@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e300])
def test_figures_are_those_of_the_field_and_not_of_its_units(scale: float) -> None:
    expected, facts = (
        inspection_schema(scene_of(mask().astype(float) * s, 0.5 * s)) for s in (1.0, scale)
    )
    for one, other in zip(expected.stiffness.surfaces, facts.stiffness.surfaces, strict=True):
        left_out = {"isovalue", "spelled"}
        assert one.model_dump(exclude=left_out) == other.model_dump(exclude=left_out)


def test_integer_volumes_get_whole_isovalues_and_the_scenes_own() -> None:
    array = np.arange(8**3).reshape(8, 8, 8) % 251
    found = isovalues_of(scene_of(array.astype(np.uint8), 70.5))
    assert len(found) == 33 and found == sorted(found), "docs/volumes-change.md: 32 and its own"
    assert [each for each in found if each % 1.0] == [70.5]
    assert len(isovalues_of(scene_of(array.astype(np.float32), 70.5))) == 33


def test_the_faces_are_named_by_their_voxels() -> None:
    assert faces_of((9, 5, 3)) == ["x = 0", "x = 8", "y = 0", "y = 4", "z = 0", "z = 2"]


@pytest.mark.parametrize("solid", ["above", "below"])
@pytest.mark.parametrize("mark", [-9999.0, 1e30])
def test_a_mark_of_missing_data_is_noticed(mark: float, solid: str) -> None:
    array = np.random.default_rng(1).random((12,) * 3)
    array[:4] = mark
    assert mark_of_nothing(make_volume(array, solid=solid)) == mark
    facts = inspection_schema(scene_of(array, 0.5, solid))
    assert any(
        f"missing = {mark:.10g}" in can for remark in facts.stiffness.remarks for can in remark.can
    )


@pytest.mark.parametrize("kind", ["mask", "outlier", "ramp", "holes"])
def test_what_is_no_mark(kind: str) -> None:
    array = np.random.default_rng(1).random((12,) * 3)
    if kind == "mask":
        array = mask()
    elif kind == "outlier":
        array[5, 5, 5] = -9999.0
    elif kind == "holes":
        array[:4] = np.nan
    assert mark_of_nothing(make_volume(array)) is None


def test_remarks_follow_the_figures() -> None:
    surface = SurfaceSchema(
        isovalue=7,
        spelled="7",
        cells=100,
        steep=0,
        plateau=0,
        noisy=0,
        holes=0,
        box={"x = 0": 1e-5},
        error=None,
    )
    found = StiffnessSchema(surfaces=[surface], own=0, void=0.25, steps=1e6, mark=None)
    assert [remark.about for remark in remarks(found)] == ["void"]
    noisy = surface.model_copy(update={"noisy": 0.4})
    calm = surface.model_copy(update={"isovalue": 9.0, "spelled": "9", "noisy": 0.1})
    remark, coarse = remarks(
        StiffnessSchema(surfaces=[noisy, calm], own=0, void=0.0, steps=255.0, mark=None)
    )
    assert any("9 is near, and far less noisy, 10 %" in can for can in remark.can)
    assert "only 255 steps" in coarse.means


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (1e-6, "<0.1 %"),
        (0.0123, "1.2 %"),
        (0.0996, "10 %"),
        (0.5, "50 %"),
        (1.0, "100 %"),
    ],
)
def test_percent(share: float, text: str) -> None:
    assert percent(share) == text


def test_the_text_fits_a_terminal_and_marks_the_scenes_isovalue(
    told: Told, small_scene: Path
) -> None:
    lines = told("inspect", small_scene, "--plan").splitlines()
    stiffness = lines[next(i for i, line in enumerate(lines) if line.startswith("stiffness")) :]
    assert max(map(len, stiffness)) <= 100
    assert sum(bool(re.match(r">\s+0\.5 ", line)) for line in stiffness) == 1
    assert any(line.startswith("  error ") for line in stiffness)


def test_the_table_is_short_and_has_the_ends_and_the_stiffest() -> None:
    facts = inspection_schema(load_scene("demo:orbital"))
    errors = [each.error.likely if each.error else 0.0 for each in facts.stiffness.surfaces]
    places = shown_places(facts.stiffness)
    assert len(places) <= 12 and {facts.stiffness.own, 0, len(errors) - 1} <= set(places)
    assert max(errors) in [errors[place] for place in places]


def test_the_document_is_finite(small_scene: Path) -> None:
    def refuse(word: str) -> Any:
        raise AssertionError(word)

    found = json.loads(inspect(str(small_scene), as_json=True), parse_constant=refuse)["stiffness"]
    assert len(found["surfaces"]) >= 32
    for surface in found["surfaces"]:
        shares = [surface[name] for name in ("steep", "plateau", "noisy", "holes")]
        assert all(math.isfinite(share) and 0.0 <= share <= 1.0 for share in shares)


@needs_matplotlib
def test_the_picture(told: Told, small_scene: Path, tmp_path: Path) -> None:
    output = tmp_path / "stiffness.png"
    assert "stiffness" in told("inspect", small_scene, "--picture", output)
    with Image.open(output) as picture:
        assert picture.format == "PNG" and min(picture.size) > 500
        assert len(picture.convert("RGB").getcolors(1 << 20) or []) > 50


@needs_matplotlib
def test_a_volume_without_a_surface_has_a_picture_too(tmp_path: Path) -> None:
    from isogi_server.inspect.picture import save_picture

    save_picture(tmp_path / "a.png", inspection_schema(scene_of(np.ones((4, 5, 6)), 1.0)))
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize("name", ["a.svg", "a", "none/a.png"])
def test_bad_pictures(told: Told, small_scene: Path, tmp_path: Path, name: str) -> None:
    assert name.rpartition("/")[2] in told(
        "inspect", small_scene, "--picture", tmp_path / name, status=2
    )


def test_without_matplotlib_a_sentence_says_what_to_install(
    told: Told, monkeypatch: pytest.MonkeyPatch, small_scene: Path, tmp_path: Path
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert "isogi[report]" in told(
        "inspect", small_scene, "--picture", tmp_path / "a.png", status=1
    )


def test_an_inspection_without_a_picture_needs_no_matplotlib() -> None:
    code = "import sys; sys.modules['matplotlib'] = None; import isogi_server.inspect.text"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


Brief = Callable[[Path], dict[str, str]]


@pytest.fixture
def brief_of(told: Told) -> Brief:
    """Gives the lines of a brief inspection, by their names."""

    def brief_of(target: Path) -> dict[str, str]:
        *lines, last = told("inspect", target).splitlines()
        assert last.startswith("--plan shows") and len(lines) <= 12 and max(map(len, lines)) <= 100
        return {line[:14].strip(): line[14:] for line in lines}

    return brief_of


def test_ten_lines_say_what_matters(brief_of: Brief, small_scene: Path) -> None:
    told = brief_of(small_scene)
    scene = load_scene(small_scene)
    own = next(each for each in inspection_schema(scene).stiffness.surfaces if each.isovalue == 0.5)
    light = 2 * own.cells * 0.5**2 * scene.plan.bytes_per_texel / 1e6
    assert told["volume"] == "small, 24 × 20 × 16 voxels of float32, spacing 1 × 1 × 1"
    assert told["values"].endswith(", no holes")
    assert told["isovalue"].startswith("0.5, as the scene says") and told["isovalue"].endswith(
        "solid above"
    )
    assert told["surface"].startswith(f"{own.cells:,} cells at 0.5")
    assert told["light"].startswith("constant, sky;")
    assert told["cost"].startswith(f"about {light:.2g} MB of light for this surface")


def test_ten_lines_tell_of_holes_and_marks(brief_of: Brief, tmp_path: Path) -> None:
    array = np.random.default_rng(3).random((12,) * 3).astype(np.float32)
    array[:2] = -9999.0
    array[5:7, 5:7, 5:7] = np.nan
    nrrd.write(str(tmp_path / "a.nrrd"), array, {"spacings": [1, 1, 1]}, index_order="C")
    told = brief_of(tmp_path / "a.nrrd")
    assert told["values"].endswith("8 voxels are not numbers: holes")
    assert "proposed from the values" in told["isovalue"]
    assert told["missing"].startswith("Many voxels have the value -9999")


def test_ten_lines_tell_of_no_surface(brief_of: Brief, tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "a.nrrd"), np.ones((4, 5, 6), np.float32), index_order="C")
    told = brief_of(tmp_path / "a.nrrd")
    assert told["surface"] == "0 cells at 1"
    assert told["nothing"].startswith("No surface passes any cell at 1")
    assert "0 MB of light for this surface" in told["cost"]


def test_series_and_segmentations_have_no_more_lines(brief_of: Brief, tmp_path: Path) -> None:
    z, y, x = np.indices((12,) * 3)
    series = np.stack([np.hypot(z - 5, y - 5) + x, z + y + 0.0]).astype(np.float32)
    np.save(tmp_path / "a.npy", series)
    (tmp_path / "a.toml").write_text('volume = "a.npy#time=0"\n')
    assert brief_of(tmp_path / "a.toml")["volume"].endswith(", step 0 of 0 to 1")
    parts = np.zeros((12,) * 3, np.uint8)
    parts[2:10, 2:10, 2:10] = np.arange(1, 9)[:, None, None]
    named = {f"Segment{n}_LabelValue": str(n + 1) for n in range(8)}
    named |= {f"Segment{n}_Name": f"a part with a long name, number {n}" for n in range(8)}
    nrrd.write(str(tmp_path / "parts.seg.nrrd"), parts, named, index_order="C")
    assert "number 0" in brief_of(tmp_path / "parts.seg.nrrd")["light"]


def printed(text: str) -> list[str]:
    """Isovalues in what ``inspect`` prints: the proposed one, others, and those of the table."""
    lines = text.splitlines()
    line = next(line for line in lines if line.startswith("isovalue"))
    found = re.findall(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", line.partition(";")[0])
    head = next(n for n, line in enumerate(lines) if "error about" in line)
    for row in lines[head + 1 :]:
        if not re.match(r"[> ] +\S+ +[\d,]+ ", row):
            break
        found.append(row[1:].split()[0])
    return found


OFFSETS = [
    *((0.0, 1.0), (0.0, 1e-30), (0.0, 1e30), (1e6, 0.1), (-1e6, 0.1), (1e9, 1e-4)),
    *((1e9, 1e6), (2.0**60, 1e6), (-(2.0**60), 1e9), (273.15, 0.01), (0.1, 1e-9), (5e-324, 1e300)),
]


@pytest.mark.parametrize(("offset", "scale"), OFFSETS)
def test_printed_isovalues_give_the_same_surface(offset: float, scale: float) -> None:
    """Twelve offsets and scales: each number, typed back, is the same level of the same cells."""
    ball = np.exp(-(np.mgrid[-1:1:10j, -1:1:11j, -1:1:12j] ** 2).sum(0))
    scene = scene_of(offset + scale * ball, offset + scale * 0.54321)
    facts = inspection_schema(scene)
    text = full_text(scene, facts)
    levels = {scene.volume.normalise_isovalue(each.isovalue) for each in facts.stiffness.surfaces}
    levels |= {scene.volume.normalise_isovalue(end) for end in scene.isovalues}
    numbers = printed(text)
    assert len(numbers) > 5
    assert {scene.volume.normalise_isovalue(float(number)) for number in numbers[1:]} <= levels
    assert scene.volume.normalise_isovalue(
        float(scene.volume.spell(scene.isovalue))
    ) == scene.volume.normalise_isovalue(scene.isovalue)


def test_neighbours_of_a_type_are_told_apart() -> None:
    """Floats next to each other around a million are printed as different numbers."""
    values = np.nextafter(np.float32(1e6), np.float32(2e6)) + np.arange(4, dtype=np.float32) / 16
    volume = make_volume(np.resize(values, (4, 5, 6)))
    assert len({volume.spell(float(value)) for value in np.unique(values)}) == 4
