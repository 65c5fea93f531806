"""``isogi publish --interactive``: a page that draws by itself, its size and its error."""

import gzip
import json
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.card.coding import Coding
from isogi_server.exports.page_files import imports, joined_modules, module_order
from tests.published import document_in, files_in, light_in, voxels_in
from tests.server.asking import Told

pytestmark = pytest.mark.usefixtures("inline")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that all of these tests bake into."""
    return tmp_path_factory.mktemp("store")


Publish = Callable[..., dict[str, Any]]


@pytest.fixture
def publish(told: Told, store: Path) -> Publish:
    """Publishes a page of isovalues 0.4 to 0.6, and returns its facts."""
    given = ["--interactive", "--store", store, "--isovalue", "0.4:0.6", "--json"]
    return lambda scene, folder, *words: json.loads(
        told("publish", scene, "-o", folder, *given, *words)
    )


def test_a_range_of_isovalues_is_published(
    publish: Publish, small_scene: Path, tmp_path: Path
) -> None:
    facts = publish(small_scene, tmp_path / "page", "--target-error", "0.3", "--azimuth", "20")
    assert (
        facts["isovalues"] == [0.4, 0.6]
        and facts["error"]["low"] <= facts["error"]["likely"] <= 0.3
    )
    files = {
        path.relative_to(tmp_path / "page").as_posix(): path
        for path in (tmp_path / "page").rglob("*.*")
    }
    assert facts["bytes"] == sum(path.stat().st_size for path in files.values())
    document = document_in(files["index.html"])
    assert document["scene"]["ranges"]["isovalue"] == {"min": 0.4, "max": 0.6}
    assert (
        document["scene"]["start"]["azimuth"] == 20
        and document["scene"]["start"]["isovalue"] == 0.5
    )
    named = {
        document["light"]["coarse"]["file"],
        *document["light"]["files"],
        *(slab["href"] for slab in document["card"]["volume"]["slabs"]),
    }
    assert named == {name for name in files if name.endswith(".bin")}
    nx, ny, nz = document["card"]["grid"]["size"]
    depth = 0
    for slab in document["card"]["volume"]["slabs"]:
        layers = slab["last"] - slab["first"]
        data = gzip.decompress(files[slab["href"]].read_bytes())
        assert np.ptp(voxels_in(data, "<f4", (layers, ny, nx))) > 0.1
        depth += layers
    assert depth == nz and document["light"]["error"] == facts["error"]


def test_one_file_has_all_of_the_page(
    publish: Publish, told: Told, small_scene: Path, tmp_path: Path
) -> None:
    words = ("--target-error", "0.3", "--caption", "Two <balls> & light.")
    publish(small_scene, tmp_path / "page", *words)
    facts = publish(small_scene, tmp_path / "page.html", *words)
    page = tmp_path / "page.html"
    assert facts["one_file"] and facts["bytes"] == page.stat().st_size
    files = files_in(page)
    beside = {
        path.relative_to(tmp_path / "page").as_posix(): gzip.decompress(path.read_bytes())
        for path in (tmp_path / "page").rglob("*.bin")
    }
    assert beside and {name: files[name] for name in beside} == beside
    assert document_in(page)["light"]["caption"] == "Two <balls> & light."
    said = json.loads(files["scene.json"])["light"]["bytes"]
    assert abs(said - page.stat().st_size) < 100
    assert not re.search(r"https?://(?!localhost|www.w3.org)", page.read_text()), "no other site"
    (tmp_path / "file").write_text("")
    args = ("publish", small_scene, "-o")
    assert "names one file" in told(*args, tmp_path / "other.html", status=2)
    assert "takes a folder" in told(*args, tmp_path / "file", "--interactive", status=2)


def test_the_first_camera_is_fitted_to_narrow_and_wide_stages(
    publish: Publish, small_scene: Path, tmp_path: Path
) -> None:
    publish(small_scene, tmp_path / "page", "--target-error", "0.3")
    fits = document_in(tmp_path / "page" / "index.html")["scene"]["fits"]
    aspects = [fit["aspect"] for fit in fits]
    distances = [fit["distance"] for fit in fits]
    assert aspects == sorted(aspects)
    nearer = [wide < 1.01 * narrow for narrow, wide in pairwise(distances)]
    assert all(nearer), "but for the pixels that a fit is found by"
    assert distances[0] > 1.5 * distances[aspects.index(1.0)]
    publish(small_scene, tmp_path / "placed", "--target-error", "0.3", "--distance", "3")
    assert document_in(tmp_path / "placed" / "index.html")["scene"]["fits"] == []


def test_joined_modules_come_after_what_they_import() -> None:
    order = module_order("published/published.js")
    assert order[-1] == "published/published.js" and len(set(order)) == len(order) > 20
    for place, name in enumerate(order):
        assert set(imports(name)) <= set(order[:place]), name
    script = joined_modules("published/published.js")
    assert not re.search(r"^(?:import|export)\b", script, re.MULTILINE)
    assert not any("main.js" in name for name in order)


def texels_in(page: Path) -> int:
    """The records of all light files, whose numbers are whole steps."""
    document = document_in(page / "index.html")
    records = 0
    coding = Coding(np.array(document["light"]["steps"], np.float32))
    for name in document["light"]["files"]:
        data = gzip.decompress((page / name).read_bytes())
        for chunk in light_in(data, coding.steps.astype(float)):
            assert np.isfinite(chunk.numbers).all()
            records += len(chunk.words)
    return records


@pytest.mark.long
@pytest.mark.slow
def test_a_limit_takes_bits_from_the_light(
    publish: Publish, told: Told, small_scene: Path, store: Path, tmp_path: Path
) -> None:
    scene = small_scene.with_name("fine.toml")
    words = ("--target-error", "0.08")
    scene.write_text(small_scene.read_text().replace("lattice = 0.5", "lattice = 2.0"))
    whole = publish(scene, tmp_path / "page", *words)
    records = texels_in(tmp_path / "page")
    limit = (whole["bytes"] - 0.05 * whole["light_bytes"]) / 1e6
    less = publish(scene, tmp_path / "page", *words, "--megabytes", f"{limit}")
    assert less["bytes"] <= 1e6 * limit and less["light_bytes"] < 0.95 * whole["light_bytes"]
    assert (
        whole["error"]["likely"] < less["error"]["likely"] <= 0.08
        and texels_in(tmp_path / "page") == records
    )
    page = ("publish", scene, "-o", tmp_path / "no", "--interactive", "--store", store)
    said = told(*page, "--isovalue", "0.4:0.6", *words, "--megabytes", "0.14", status=2)
    assert "allow --megabytes" in said and (
        "--target-error" in said or "of these isovalues" in said
    )


def test_several_surfaces_are_not_published(
    told: Told, store: Path, small_scene: Path, tmp_path: Path
) -> None:
    scene = small_scene.with_name("shells.toml")
    scene.write_text(f"{small_scene.read_text()}\n[[surfaces]]\nisovalue = 0.35\nclear = 0.6\n")
    words = ("publish", scene, "-o", tmp_path / "page", "--interactive", "--store", store)
    said = told(*words, "--isovalue", "0.4:0.6", status=2)
    assert "outer side alone" in said and "Publish pictures" in said
