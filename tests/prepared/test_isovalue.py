"""Isovalues of a file and normalised ones: mypy keeps them apart, and one function makes the
latter.
"""

import re
from pathlib import Path

import pytest
from mypy import api

ROOT = Path(__file__).parents[2]

USES = """
from dataclasses import replace

from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.prepared.prepared_scene import Surface


def allowed(prepared: PreparedScene, view: View) -> None:
    surface = prepared.surface(view.isovalue)
    prepared.maps.at(surface.isovalue)
    prepared.surface(prepared.scene.isovalue)
    prepared.scene.plan_digest(prepared.scene.plan, surface.isovalue)


def refused(prepared: PreparedScene, view: View) -> None:
    surface, scene = prepared.surface(view.isovalue), prepared.scene
    prepared.maps.at(view.isovalue)  # wrong
    prepared.maps.at(scene.presets[0].isovalue)  # wrong
    Surface(scene.isovalues[0], prepared.field, prepared.maps)  # wrong
    scene.plan_digest(scene.plan, scene.isovalue)  # wrong
    prepared.surface(surface.isovalue)  # wrong
    replace(view, isovalue=surface.isovalue)  # wrong
"""


@pytest.mark.slow
def test_mypy_keeps_isovalues_of_two_units_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the cache of `make check`, whose settings these are."""
    monkeypatch.chdir(ROOT)
    (tmp_path / "uses.py").write_text(USES)
    answer, trouble, _ = api.run(["--no-error-summary", str(tmp_path / "uses.py")])
    refused = {int(line) for line in re.findall(r"uses\.py:(\d+): error: .*\[arg-type\]", answer)}
    wrong = {number for number, line in enumerate(USES.splitlines(), 1) if line.endswith("# wrong")}
    assert refused == wrong and len(answer.splitlines()) == len(wrong), answer + trouble


def test_one_function_makes_normalised_isovalues() -> None:
    """Of a number: a parameter's kind has the same name, and is made of nothing."""
    sources = [
        path for room in ("isogi_core", "worker", "server") for path in (ROOT / room).rglob("*.py")
    ]
    makers = [
        path.relative_to(ROOT).as_posix()
        for path in sources
        if re.search(r"(?<!class )\bIsovalue\([^)]", path.read_text())
    ]
    assert makers == ["isogi_core/model/volume.py"]
