"""Run tests at the same time, and run a test that failed once more, alone: ``python -m tests.run
[options of pytest]``.

Tests wait for servers and browsers on a machine that is full of each other, so a test may fail only
there. Such a test is named and counted. Three are forgiven, more fail the run. ``RECORD`` counts
over the runs of one ``make``.
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

RECORD = Path("test-results") / "passed-alone.txt"
"""The tests that passed only when they ran alone, one a line; ``make test`` removes the file before
it starts.
"""

MAX_TRIED_ALONE = 20
MAX_FORGIVEN = 3


class Failures:
    """A plugin of pytest that keeps the ids of tests that failed, each once and in their order."""

    def __init__(self) -> None:
        self.ids: dict[str, None] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.ids[report.nodeid] = None


def say(*lines: str) -> None:
    """Print these lines at once."""
    sys.stdout.writelines(f"{line}\n" for line in lines)
    sys.stdout.flush()


def passes_alone(test: str) -> bool:
    """Whether a test passes in a process where no other test runs."""
    say(f"\nOnce more, alone: {test}")
    return subprocess.run([sys.executable, "-m", "pytest", "-q", test], check=False).returncode == 0


def recorded(passed: Sequence[str]) -> list[str]:
    """Add tests that ``passed`` alone to the record, and return all that it holds."""
    RECORD.parent.mkdir(exist_ok=True)
    with RECORD.open("a", encoding="utf-8") as record:
        record.writelines(f"{test}\n" for test in passed)
    return RECORD.read_text(encoding="utf-8").splitlines()


def judge(failed: Sequence[str]) -> int:
    """Try each test alone that ``failed``, print what came of it, and return the status of the
    run.
    """
    passed = [test for test in failed[:MAX_TRIED_ALONE] if passes_alone(test)]
    flaky = recorded(passed)
    broken = len(failed) - len(passed)
    if len(failed) > MAX_TRIED_ALONE:
        untried = ", or were not tried"
    else:
        untried = ""
    alone = f"{len(flaky)} passed only when run again, alone ({MAX_FORGIVEN} forgiven):"
    say(f"\n{broken} failed alone, too{untried}; {alone}")
    say(*(f"  {test}" for test in flaky))
    return int(broken > 0 or len(flaky) > MAX_FORGIVEN)


def main(options: Sequence[str]) -> int:
    """Run pytest with its ``options``, and judge what failed."""
    failures = Failures()
    status = pytest.main([*options], plugins=[failures])
    tried = status in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED) and (
        failures.ids or not status
    )
    if tried:
        return judge(list(failures.ids))
    return int(status)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
