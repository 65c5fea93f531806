"""``isogi publish --interactive``: a page that draws by itself, its size and its error, and what it refuses."""

import gzip
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.card.blocks import Coding
from server.cli.command import run
from server.exports.live_page import MODULE_IMPORT, page_files
from tests.card_twin import read_coded

Capture = pytest.CaptureFixture[str]


pytestmark = pytest.mark.usefixtures("inline")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that all of these tests bake into."""
    return tmp_path_factory.mktemp("store")


def publish(capsys: Capture, store: Path, scene: Path | str, folder: Path, *words: str) -> tuple[int, str]:
    """The status of a command, and what it printed."""
    command = ["publish", str(scene), "-o", str(folder), "--interactive", "--store", str(store), *words]
    status = run(command)
    printed = capsys.readouterr()
    return status, printed.out if status == 0 else re.sub(r"[^\n]*\r", "", printed.err).strip().splitlines()[-1]


def published(capsys: Capture, store: Path, scene: Path, folder: Path, *words: str) -> dict[str, Any]:
    """The facts of a page that is published of isovalues 0.4 to 0.6."""
    status, printed = publish(capsys, store, scene, folder, "--isovalue", "0.4:0.6", "--json", *words)
    assert status == 0, printed
    facts: dict[str, Any] = json.loads(printed)
    return facts


def test_a_range_of_isovalues_is_published(small_scene: Path, store: Path, tmp_path: Path, capsys: Capture) -> None:
    facts = published(capsys, store, small_scene, tmp_path / "page", "--target-error", "0.3", "--azimuth", "20")
    assert facts["isovalues"] == [0.4, 0.6] and facts["error"]["low"] <= facts["error"]["likely"] <= 0.3
    files = {path.relative_to(tmp_path / "page").as_posix(): path for path in (tmp_path / "page").rglob("*.*")}
    assert facts["bytes"] == sum(path.stat().st_size for path in files.values())
    document = json.loads(files["scene.json"].read_text())
    assert document["scene"]["ranges"]["isovalue"] == {"min": 0.4, "max": 0.6}
    assert document["scene"]["start"]["azimuth"] == 20 and document["scene"]["start"]["isovalue"] == 0.5
    named = {*document["light"]["files"], *(slab["href"] for slab in document["card"]["volume"]["slabs"])}
    assert named == {name for name in files if name.endswith(".bin")}
    codes = [
        np.frombuffer(gzip.decompress(files[slab["href"]].read_bytes()), "<f4")
        for slab in document["card"]["volume"]["slabs"]
    ]
    assert sum(map(len, codes)) == 24 * 20 * 16 and document["light"]["error"] == facts["error"]


def test_the_page_brings_all_that_it_imports() -> None:
    files = page_files()
    for name, content in files.items():
        for path in MODULE_IMPORT.findall(content.decode()) if name.endswith(".js") else []:
            assert (Path("/") / Path(name).parent / path).resolve().relative_to("/").as_posix() in files, (name, path)
    assert "web/card/shaders/view.glsl" in files and not any("main.js" in name for name in files)
    assert not re.search(r"https?://(?!localhost)", files["index.html"].decode()), "nothing is loaded from elsewhere"


def texels_in(page: Path) -> int:
    """The records of all light files, whose numbers are whole steps."""
    document, records = json.loads((page / "scene.json").read_text()), 0
    coding = Coding(np.array(document["light"]["steps"], np.float32))
    for name in document["light"]["files"]:
        data = gzip.decompress((page / name).read_bytes())
        while data:
            size, bricks, count = (int.from_bytes(data[a : a + 4], "little") for a in (4, 16, 20))
            numbers, _ = read_coded(data[32 + 16 * bricks : size], count, coding.steps.astype(float))
            assert np.isfinite(numbers).all()
            records, data = records + count, data[size:]
    return records


@pytest.mark.slow
def test_a_limit_takes_bits_from_the_light(small_scene: Path, store: Path, tmp_path: Path, capsys: Capture) -> None:
    scene, words = small_scene.with_name("fine.toml"), ("--target-error", "0.08")
    scene.write_text(small_scene.read_text().replace("lattice = 0.5", "lattice = 2.0"))
    whole = published(capsys, store, scene, tmp_path / "page", *words)
    records, limit = texels_in(tmp_path / "page"), (whole["bytes"] - 0.05 * whole["light_bytes"]) / 1e6
    less = published(capsys, store, scene, tmp_path / "page", *words, "--megabytes", f"{limit}")
    assert less["bytes"] <= 1e6 * limit and less["light_bytes"] < 0.95 * whole["light_bytes"]
    assert whole["error"]["likely"] < less["error"]["likely"] <= 0.08 and texels_in(tmp_path / "page") == records
    status, said = publish(
        capsys, store, scene, tmp_path / "no", "--isovalue", "0.4:0.6", *words, "--megabytes", "0.25"
    )
    assert status == 2 and "allow --megabytes" in said and ("--target-error" in said or "of these isovalues" in said)


def test_a_limit_that_is_too_low_says_what_fits(
    small_scene: Path, store: Path, tmp_path: Path, capsys: Capture
) -> None:
    words = ("--isovalue", "0.4:0.6", "--target-error", "0.3", "--megabytes", "0.1")
    status, said = publish(capsys, store, small_scene, tmp_path / "page", *words)
    assert status == 2 and "allow --megabytes" in said and "modules alone" in said
    assert not (tmp_path / "page").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--window", "x>4"], "window"),
        (["--azimuth", "0:90:30"], "azimuth 0:90:30"),
        (["--time", "5"], "--time"),
        (["--isovalue", "0.1:0.6"], "isovalue"),
        (["--background", "#102030"], "light or dark"),
    ],
)
def test_what_a_page_does_not_take_is_refused(
    small_scene: Path, store: Path, tmp_path: Path, capsys: Capture, words: list[str], said: str
) -> None:
    status, printed = publish(capsys, store, small_scene, tmp_path / "page", *words)
    assert status in (1, 2) and said in printed and not (tmp_path / "page").exists()


def test_what_a_card_cannot_draw_is_refused(store: Path, tmp_path: Path, capsys: Capture) -> None:
    status, said = publish(capsys, store, "demo:orbital#material=subsurface", tmp_path / "page")
    assert status == 2 and "Light from inside" in said and "Publish pictures" in said


def test_megabytes_are_for_pages_that_draw(small_scene: Path, tmp_path: Path, capsys: Capture) -> None:
    assert run(["publish", str(small_scene), "-o", str(tmp_path / "out"), "--megabytes", "4"]) in (1, 2)
    assert "--interactive" in capsys.readouterr().err
