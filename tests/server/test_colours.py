"""What a server tells of a surface with colours by data, and what it refuses."""

from pathlib import Path
from typing import Any

import httpx
import nrrd
import numpy as np
import pytest

from isogi_core.plan.assembly import load_scene
from isogi_server.answers import colour_scale, scene_schema
from tests.live import serving
from tests.server.asking import final

TABLE: dict[str, Any] = {
    "use": "colour",
    "of": "gradient",
    "map": "magma",
    "range": [0.0, 0.05],
    "name": "steepness",
}


def test_the_document_has_what_a_legend_needs() -> None:
    schema = scene_schema(load_scene("demo:orbital", volumes=[TABLE], shine={"kind": "plastic"}))
    assert schema.colours is not None and schema.albedos is None and schema.shines == ["plastic"]
    scale = schema.colours
    assert (scale.name, scale.map, scale.low, scale.high) == ("steepness", "magma", 0.0, 0.05)
    assert scale.colours[0] == "#000004" and len(scale.colours) == 17
    assert any("colours" in each.why for each in schema.plan.left_out)


def test_the_document_of_one_albedo_has_no_colours() -> None:
    assert colour_scale(load_scene("demo:orbital")) is None


def test_the_document_names_labels_and_their_colours(tmp_path: Path) -> None:
    parts = np.zeros((9, 9, 9), np.uint8)
    parts[2:7, 2:7, 2:5], parts[2:7, 2:7, 5:7] = 3, 8
    nrrd.write(str(tmp_path / "seg.nrrd"), parts, index_order="C")
    labels = [{"value": 3, "name": "liver", "colour": "#b5523a"}, {"value": 8, "hidden": True}]
    scale = colour_scale(load_scene(tmp_path / "seg.nrrd", labels=labels))
    assert scale is not None and (scale.name, scale.map, scale.colours) == (
        "seg",
        "labels",
        ["#b5523a"],
    )
    told = [(label.value, label.name, label.shown) for label in scale.labels]
    assert (
        told == [(3, "liver", True), (8, "label 8", False)] and scale.labels[0].colour == "#b5523a"
    )


@pytest.fixture
def coloured(small_scene: Path) -> Path:
    """The small scene in colours."""
    scene = small_scene.with_name("coloured.toml")
    scene.write_text(f'{small_scene.read_text()}\n[[volumes]]\nuse = "colour"\nof = "gradient"\n')
    return scene


@pytest.mark.slow
def test_a_server_lights_the_colours_and_takes_no_albedo(coloured: Path, tmp_path: Path) -> None:
    with serving(coloured, tmp_path / "store") as url, httpx.Client(base_url=url) as client:
        assert client.get("/v1/scenes/coloured").json()["colours"]["name"] == "gradient"
        view = {"width": 16, "height": 12, "max_error": 0.5}
        assert "final=1" in final(client, "coloured", **view).headers["Isogi-Coverage"]
        refused = client.get("/v1/scenes/coloured/frame", params={**view, "albedo": 0.5})
        assert (refused.status_code, refused.json()["parameter"]) == (422, "albedo")
        assert "has its albedo from 'gradient'" in refused.json()["detail"]
