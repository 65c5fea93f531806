"""Kinds of values that text spells: numbers in a range, tuples of numbers, words, durations;
and files of these.
"""

import json
import math
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from annotated_types import GroupedMetadata, MaxLen

from isogi_core.errors import ViewError
from isogi_core.files.packed_files import read_small
from isogi_core.files.spelling import shortest
from isogi_server.errors import ParameterError

NUMBER_PATTERN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
WHOLE_PATTERN = re.compile(r"[+-]?\d+", re.ASCII)
MAX_COORDINATE = 1e12


def shown(value: object) -> str:
    """Quote a value, short enough for a sentence."""
    # JSON can spell half a surrogate pair, which cannot be encoded.
    text = str(value).encode(errors="backslashreplace").decode()
    if len(text) <= 40:
        return f"'{text}'"
    return f"'{text[:39]}…'"


def finite(value: object) -> float:
    """Return the number that ``value`` is or spells; NaN for anything else."""
    if isinstance(value, str):
        if len(value) <= 64 and NUMBER_PATTERN.fullmatch(value):
            return float(value)
        return math.nan
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not abs(value) <= sys.float_info.max
    ):
        return math.nan
    return float(value)


class Kind(GroupedMetadata):
    """A kind of value that text spells. It annotates fields of pydantic models, and can be used
    without importing pydantic.
    """

    example: str = ""

    @property
    def schema(self) -> dict[str, Any]:
        """Return the kind as JSON Schema."""
        return {"type": "string", "example": self.example}

    def read(self, value: object) -> Any:
        """Return the value that ``value`` spells. Raises ValueError, which says what is
        allowed, for any other text.
        """
        return value

    def __iter__(self) -> Iterator[Any]:
        """Yield the annotations that pydantic needs."""
        from pydantic import BeforeValidator, WithJsonSchema  # noqa: PLC0415 (help of commands does without it)

        yield BeforeValidator(self.read)
        yield WithJsonSchema(self.schema)


@dataclass(frozen=True)
class Span(Kind):
    """A number from ``low`` to ``high``, both included; an integer if ``whole``."""

    low: float
    high: float
    whole: bool = False

    @property
    def schema(self) -> dict[str, Any]:
        """Return the kind as JSON Schema."""
        return {
            "type": "integer" if self.whole else "number",
            "minimum": self.low,
            "maximum": self.high,
        }

    def read(self, value: object) -> float:
        """Return the number. Raises ValueError if it is none, or out of range."""
        number = finite(value)
        spelt = not self.whole or WHOLE_PATTERN.fullmatch(str(value)) is not None
        if not (spelt and self.low <= number <= self.high):
            if self.whole:
                kind = "a whole number"
            else:
                kind = "a number"
            raise ValueError(
                f"must be {kind} from {shortest(self.low)} to {shortest(self.high)}, not "
                f"{shown(value)}."
            )
        return int(number) if self.whole else number


@dataclass(frozen=True)
class Row(Kind):
    """Finite numbers, one for each of ``names``, separated by commas, such as ``eye=1,2,3``."""

    names: tuple[str, ...]

    @property
    def schema(self) -> dict[str, Any]:
        """Return the kind as JSON Schema."""
        return {"type": "string", "example": ",".join("0" for _ in self.names)}

    def read(self, value: object) -> tuple[float, ...]:
        """Return the numbers of a text or a sequence. Raises ValueError if their count or size
        is wrong.
        """
        parts = value.split(",") if isinstance(value, str) else value
        if isinstance(parts, list | tuple):
            numbers = tuple(map(finite, parts))
        else:
            numbers = ()
        if len(numbers) != len(self.names) or not all(
            abs(number) <= MAX_COORDINATE for number in numbers
        ):
            wanted = f"{len(self.names)} finite numbers {','.join(self.names)}"
            raise ValueError(
                f"must be {wanted} (each at most {MAX_COORDINATE:g} in size), not {shown(value)}."
            )
        return numbers


@dataclass(frozen=True)
class Rows(Kind):
    """A range of rows of a picture, ``first,last``; the last is excluded."""

    example = "0,512"

    def read(self, value: object) -> tuple[int, int]:
        """Return the two numbers. Raises ValueError if the text spells no range."""
        if isinstance(value, str):
            parts = value.split(",")
        else:
            parts = []
        if len(parts) == 2 and all(
            len(part) <= 6 and part.isascii() and part.isdigit() for part in parts
        ):
            first, last = map(int, parts)
            if first < last:
                return first, last
        raise ValueError(
            f"must be two whole numbers first,last, the first below the last, not {shown(value)}."
        )


@dataclass(frozen=True)
class Colour(Kind):
    """Linear RGB, each from 0 to 1, such as ``albedo=0.7,0.5,0.3``; one number stands for all
    three.
    """

    example = "0.7"

    def read(self, value: object) -> tuple[float, float, float]:
        """Return the three numbers of a number, a text or a sequence. Raises ValueError for
        anything else.
        """
        parts: Any = [value]
        if isinstance(value, str):
            parts = value.split(",")
        elif isinstance(value, list | tuple):
            parts = value
        numbers = tuple(map(finite, parts))
        if len(numbers) not in (1, 3) or not all(0.0 <= number <= 1.0 for number in numbers):
            raise ValueError(
                f"must be one number from 0 to 1, or three with commas between, not {shown(value)}."
            )
        if len(numbers) == 3:
            red, green, blue = numbers
        else:
            red, green, blue = numbers * 3
        return red, green, blue


@dataclass(frozen=True)
class Planes(Kind):
    """Planes separated by semicolons, such as ``window=x>40;0,1,-1<12.5``: each removes the
    points for which it is true.
    """

    example = "x>40"

    def read(self, value: object) -> str:
        """Return ``value`` if it spells planes; else raises ValueError."""
        from isogi_core.model.view import read_window  # noqa: PLC0415 (NumPy, which help of commands does without)

        try:
            read_window(str(value))
        except ViewError as error:
            raise ValueError(f"cannot be read. {error}") from None
        return str(value)


BACKGROUND_NAMES = ("dark", "light", "transparent")


@dataclass(frozen=True)
class Ground(Kind):
    """A background: one of BACKGROUND_NAMES, or sRGB as ``#rrggbb``."""

    example = "light"

    def read(self, value: object) -> str:
        """Return the background in lower case. Raises ValueError for anything else."""
        text = str(value).lower()
        if text not in BACKGROUND_NAMES and not re.fullmatch("#[0-9a-f]{6}", text):
            raise ValueError(
                f"must be {', '.join(BACKGROUND_NAMES)}, or a colour such as #ffffff, not "
                f"{shown(value)}."
            )
        return text


@dataclass(frozen=True)
class Choice(Kind):
    """One of several ``words``."""

    words: tuple[str, ...]

    @property
    def schema(self) -> dict[str, Any]:
        """Return the kind as JSON Schema."""
        return {"type": "string", "enum": list(self.words)}

    def read(self, value: object) -> object:
        """Return ``value`` if it is one of the words; else raises ValueError."""
        if value not in self.words:
            raise ValueError(f"must be one of {', '.join(self.words)}, not {shown(value)}.")
        return value


@dataclass(frozen=True)
class Words(Kind):
    """A text of at most ``longest`` characters, such as ``example``; the code that uses it
    checks its content.
    """

    longest: int
    example: str

    def __iter__(self) -> Iterator[Any]:
        """Yield the annotations that pydantic needs."""
        yield MaxLen(self.longest)
        yield from super().__iter__()


class Isovalue(Kind):
    """An isovalue: a number, which is checked against the range of the scene later."""

    @property
    def schema(self) -> dict[str, Any]:
        """Return the kind as JSON Schema."""
        return {"type": "number"}


TIME_UNITS = (("h", 3600.0), ("min", 60.0), ("s", 1.0), ("ms", 1e-3))

DURATION_UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}

DURATION_PATTERN = re.compile(rf"({NUMBER_PATTERN.pattern})(s|m|h|)", re.ASCII)

AGE_UNITS = {"d": 86400.0, "w": 7 * 86400.0}

AGE_PATTERN = re.compile(rf"({NUMBER_PATTERN.pattern})(d|w)", re.ASCII)

LONGEST_SECONDS = 1e9


def seconds_of(text: str) -> float:
    """Return the seconds of a duration such as 90, 90s, 10m or 1h. Raises ValueError, which
    says what is allowed.
    """
    if len(text) <= 40:
        match = DURATION_PATTERN.fullmatch(text)
    else:
        match = None
    if match:
        seconds = float(match[1]) * DURATION_UNITS[match.groups()[-1]]
    else:
        seconds = -1.0
    if not 0.0 <= seconds <= LONGEST_SECONDS:
        raise ValueError(f"must be a span of time such as 90, 90s, 10m or 1h, not {shown(text)}.")
    return seconds


def seconds_of_age(text: str) -> float:
    """Return the seconds of a duration that may also be in days or weeks, such as 12h, 30d or
    4w. Raises ValueError.
    """
    if len(text) <= 40:
        match = AGE_PATTERN.fullmatch(text)
    else:
        match = None
    if match and float(match[1]) >= 0.0:
        return float(match[1]) * AGE_UNITS[match.groups()[-1]]
    try:
        return seconds_of(text)
    except ValueError:
        raise ValueError(
            f"must be a span of time such as 12h, 30d or 4w, not {shown(text)}."
        ) from None


def span(seconds: float, digits: int = 3) -> str:
    """Return seconds as text with this many digits, in the largest unit that they reach; ``0
    s`` below a millisecond.
    """
    name, size = next(((name, size) for name, size in TIME_UNITS if seconds >= size), ("s", 1.0))
    if seconds >= TIME_UNITS[-1][1]:
        count = float(f"{seconds / size:.{digits}g}")
    else:
        count = 0.0
    return f"{count:,g} {name}"


MAX_DOCUMENT_BYTES = 1 << 26
"""Bytes of a file of views or directions, at most."""


def document_in(file: Path, otherwise: Callable[[str], Any]) -> Any:
    """Return the content of a JSON or TOML ``file``; other files are read by ``otherwise``,
    from their text. Raises ParameterError.
    """
    readers = {".json": json.loads, ".toml": tomllib.loads}
    try:
        return readers.get(file.suffix, otherwise)(read_small(file, MAX_DOCUMENT_BYTES).decode())
    except (OSError, RecursionError, ValueError) as error:
        raise ParameterError(f"{file.name} cannot be read: {error}.", "views-file") from None
