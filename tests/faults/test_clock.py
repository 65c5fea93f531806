"""A calendar that jumps: nothing that waits, leases or times out goes by it."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
CALENDAR = {
    "time.time",
    "datetime.now",
    "datetime.utcnow",
    "datetime.today",
    "time.localtime",
    "time.gmtime",
}

TOLD_TO_PEOPLE = {
    "server/isogi_server/render/jobs.py",  # when a job began and ended, and until when it is known
    "isogi_core/storage/store.py",  # how old objects are, by the dates that the store gives them
}


def names_in(path: Path) -> set[str]:
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return {ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute)}


def test_the_calendar_is_asked_only_for_what_people_are_told() -> None:
    sources = [
        path for room in ("isogi_core", "worker", "server") for path in (ROOT / room).rglob("*.py")
    ]
    users = {path.relative_to(ROOT).as_posix() for path in sources if names_in(path) & CALENDAR}
    assert users == TOLD_TO_PEOPLE
