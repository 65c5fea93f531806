"""The benchmarks of faults, small: what they count is right, and none of it is anything but 0."""

import importlib
import json
from typing import Any

import pytest
from click.testing import CliRunner

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A scene that is baked in a second."""
    scene = tmp_path_factory.mktemp("scene") / "tiny.toml"
    scene.write_text('volume = "demo:orbital"\nlattice = 0.4\nbounces = 1\ntarget_error = 0.4\n')
    return str(scene)


def figures(name: str, *arguments: str) -> dict[str, Any]:
    main = importlib.import_module(f"benchmarks.{name}").main
    done = CliRunner().invoke(main, [*arguments, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_kills(tiny: str) -> None:
    found = figures("kills", tiny, "--victim", "server", "--cycles", "1")
    assert found["servers killed"] == 1 and found["views that became final"] >= 1
    assert found["objects read meanwhile"] >= found["objects"] > 0
    wrong = ("answers 5xx", "torn", "lost, or with less light than before", "processes left after 5 s")
    differ = ("objects with other bytes than undisturbed", "objects that undisturbed are none")
    assert not any(found[name] for name in (*wrong, *differ, "final pictures that differ")), found


def test_kills_of_prewarms(tiny: str) -> None:
    found = figures("kills", tiny, "--victim", "prewarm", "--cycles", "1")
    assert found["prewarms killed"] == 1 and found["prewarms begun"] >= 1 and found["objects"] > 0
    wrong = ("torn", "lost, or with less light than before", "processes left after 5 s", "half-written files left")
    differ = ("objects with other bytes than undisturbed", "objects that undisturbed are none")
    assert not any(found[name] for name in (*wrong, *differ, "prewarms that fail undisturbed")), found


def test_damage(tiny: str) -> None:
    found = figures("damage", tiny, "--damaged", "11", "--views", "1")
    assert found["damaged"] == 11 and found["final pixels"] > 0
    assert found["told as damaged"] >= 11 - found["not to be noticed: deleted"] > 0
    assert found["answers 5xx"] == found["wrong pixels"] == found["objects with other bytes in the end"] == 0
    assert found["pictures that differ in the end"] == 0
