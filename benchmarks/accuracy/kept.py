"""What was measured before: long tables are made in parts."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar


class Named(Protocol):
    """A dataclass of what was measured, under a name of its own."""

    @property
    def name(self) -> str:
        """Tells it from all others in a table."""


Found = TypeVar("Found", bound=Named)


class Kept(Generic[Found]):
    """What was measured, a line of JSON each in a file."""

    def __init__(self, path: Path | None, of: Callable[[Mapping[str, Any]], Found]) -> None:
        """Read what is in a file, if there is one; ``of`` makes it of what a line holds."""
        self._path = path
        lines = path.read_text(encoding="utf-8").splitlines() if path and path.exists() else ()
        self._found = {each["name"]: of(each) for each in map(json.loads, lines)}

    def get(self, name: str) -> Found | None:
        """What was measured under a name."""
        return self._found.get(name)

    def put(self, found: Found) -> Found:
        """Add what was measured."""
        if self._path:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(f"{json.dumps(asdict(found))}\n")  # type: ignore[call-overload]
        return found
