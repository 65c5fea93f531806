"""Figures that the documents quote are refused once the code that they measure has moved on."""

import json
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks import release as module
from benchmarks.common.measurement import FOLDER
from benchmarks.release import PAGES, Page, faults, release


class History:
    """A repository of its own, with a folder of code and pages of measurements."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.pages = root / "docs" / "measurements"
        self.pages.mkdir(parents=True)
        self.git("init", "--quiet", "--initial-branch", "main")
        self.git("config", "user.email", "a@example.org")
        self.git("config", "user.name", "A")
        (root / "CHANGELOG.md").write_text("## 0.1.0 (not released)\n")
        (root / "pyproject.toml").write_text('name = "isogi"\nversion = "0.0.1"\n')

    def git(self, *arguments: str) -> str:
        command = ["git", *arguments]
        done = subprocess.run(command, cwd=self.root, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    def change(self, name: str, text: str) -> str:
        """Commit a file; the commit."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", f"Change {name}")
        return self.git("rev-parse", "HEAD")

    def measured(self, name: str, commit: str) -> None:
        self.change(f"docs/measurements/{name}.json", json.dumps({"commit": commit}))


@pytest.fixture
def history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> History:
    made = History(tmp_path)
    monkeypatch.setattr(module, "ROOT", made.root)
    monkeypatch.setattr(module, "FOLDER", made.pages)
    monkeypatch.setattr(module, "LONGEST_AGE", 2)
    return made


PAGE = Page("speed-x", ("speed", "x"), ("code",))


def test_figures_grow_old_by_changes_of_their_code_alone(history: History) -> None:
    history.measured("speed-x", history.change("code/a.py", "0"))
    for number in range(4):
        history.change("other/b.py", str(number))
    history.change("code/a.py", "1")
    history.change("code/a.py", "2")
    assert faults([PAGE]) == []
    history.change("code/a.py", "3")
    assert faults([PAGE]) == ["speed-x: 3 commits have changed code since then."]


def test_pages_that_are_lost_or_strange_are_named(history: History) -> None:
    history.measured("speed-x", "0" * 40)
    history.measured("speed-old", history.change("code/a.py", "0"))
    first, second, third = faults([PAGE, Page("speed-y", (), ("code",))])
    assert "not in the history" in first and second == "speed-y: there is no such page."
    assert third.startswith("speed-old") and "does not list" in third


def test_a_tag_is_made_of_a_clean_tree_with_young_figures(
    history: History, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PAGES", (PAGE,))
    monkeypatch.setattr(module, "faults", lambda: faults([PAGE]))
    history.measured("speed-x", "0" * 40)
    assert "not in the history" in CliRunner().invoke(release, ["tag", "0.1.0"]).output
    history.measured("speed-x", history.change("code/a.py", "0"))
    (history.root / "code" / "a.py").write_text("not committed")
    assert "Commit or remove" in CliRunner().invoke(release, ["tag", "0.1.0"]).output
    history.git("checkout", "--quiet", "code")
    history.change("changes/x.fixed.md", "One change.")
    assert "write x.fixed.md of changes/" in CliRunner().invoke(release, ["tag", "0.1.0"]).output
    history.git("rm", "--quiet", "changes/x.fixed.md")
    history.git("commit", "--quiet", "--message", "Join a change")
    made = CliRunner().invoke(release, ["tag", "0.1.0"])
    assert made.exit_code == 0 and "Tagged v0.1.0" in made.output
    assert history.git("describe", "--tags") == "v0.1.0"
    assert "not released" not in (history.root / "CHANGELOG.md").read_text()
    assert 'version = "0.1.0"' in (history.root / "pyproject.toml").read_text()
    assert "exists" in CliRunner().invoke(release, ["tag", "0.1.0"]).output
    assert "is no version" in CliRunner().invoke(release, ["tag", "new"]).output


def test_the_pages_are_those_of_the_repository() -> None:
    assert {page.name for page in PAGES} == {path.stem for path in FOLDER.glob("*.json")}


def test_each_page_has_a_part_of_a_suite() -> None:
    for page in PAGES:
        if page.command:
            suite, part = page.command[:2]
            assert page.name.startswith(f"{suite}-{part}"), page.name
