"""Spans of time as a person reads and writes them: 90, 90s, 10m, 1.5h."""

import re

from server.values import NUMBER, shown

NAMES = (("h", 3600.0), ("min", 60.0), ("s", 1.0), ("ms", 1e-3))

UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}

DURATION = re.compile(rf"({NUMBER.pattern})(s|m|h|)", re.ASCII)

LONGEST = 1e9


def seconds_of(text: str) -> float:
    """Seconds of a span of time, none included; ValueError, which says what is allowed, where it is no span."""
    match = DURATION.fullmatch(text) if len(text) <= 40 else None
    seconds = float(match[1]) * UNITS[match.groups()[-1]] if match else -1.0
    if not 0.0 <= seconds <= LONGEST:
        raise ValueError(f"must be a span of time such as 90, 90s, 10m or 1h, not {shown(text)}.")
    return seconds


def span(seconds: float, digits: int = 3) -> str:
    """Seconds as text to so many digits, in the largest unit that they reach; ``0 s`` for less than a millisecond."""
    name, size = next(((name, size) for name, size in NAMES if seconds >= size), ("s", 1.0))
    count = float(f"{seconds / size:.{digits}g}") if seconds >= NAMES[-1][1] else 0.0
    return f"{count:,g} {name}"
