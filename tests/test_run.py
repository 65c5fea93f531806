"""What passes only when it runs again, alone, is named and counted; few such tests are forgiven."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import run

ROOT = Path(__file__).resolve().parent.parent
TESTS = """\
import pathlib

def test_steady(): ...

def test_unsteady():
    seen = pathlib.Path("seen")
    before = seen.exists()
    seen.touch()
    assert before

def test_broken():
    assert False
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to run tests in, where the test ``broken`` fails alone, and every other test
    passes.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "passes_alone", lambda test: test != "broken")
    return tmp_path


def test_a_test_that_passes_only_alone_is_named(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").touch()
    (tmp_path / "test_any.py").write_text(TESTS)
    command = [sys.executable, "-m", "tests.run", "-q"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert (
        "1 failed alone, too; 1 passed only when run again, alone (3 forgiven):\n  "
        "test_any.py::test_unsteady\n"
    ) in (done.stdout)


@pytest.mark.parametrize(
    ("failed", "status", "told"),
    [
        ([], 0, "0 failed alone, too; 0 passed only"),
        (["one"], 0, "0 failed alone, too; 1 passed only"),
        (["one", "two", "three"], 0, "0 failed alone, too; 3 passed only"),
        (["one", "two", "three", "four"], 1, "0 failed alone, too; 4 passed only"),
        (["broken"], 1, "1 failed alone, too; 0 passed only"),
        (["one", "broken"], 1, "1 failed alone, too; 1 passed only"),
    ],
)
def test_few_tests_are_forgiven_and_more_fail_the_run(
    here: Path, capsys: pytest.CaptureFixture[str], failed: list[str], status: int, told: str
) -> None:
    assert run.judge(failed) == status
    assert told in capsys.readouterr().out


def test_runs_of_one_make_are_counted_together(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run.judge(["one", "two", "three"]) == 0
    assert run.judge(["other"]) == 1
    assert capsys.readouterr().out.endswith("  three\n  other\n")
    assert run.judge([]) == 1


def test_of_many_failures_only_the_first_are_tried(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = [f"test {number}" for number in range(run.MAX_TRIED_ALONE + 5)]
    assert run.judge(failed) == 1
    assert (
        f"5 failed alone, too, or were not tried; {run.MAX_TRIED_ALONE} passed"
        in capsys.readouterr().out
    )
