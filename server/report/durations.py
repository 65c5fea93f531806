"""Spans of time as a person writes them: 90, 90s, 10m, 1.5h."""

import re

from server.values import NUMBER, shown

NAMES = (("hour", 3600.0), ("minute", 60.0), ("second", 1.0))

UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}

DURATION = re.compile(rf"({NUMBER.pattern})(s|m|h|)", re.ASCII)

LONGEST = 1e9


def seconds_of(text: str) -> float:
    """Seconds of a span of time; ValueError, which says what is allowed, where it is none."""
    match = DURATION.fullmatch(text) if len(text) <= 40 else None
    seconds = float(match[1]) * UNITS[match.groups()[-1]] if match else -1.0
    if not 0.0 < seconds <= LONGEST:
        raise ValueError(f"must be a span of time such as 90, 90s, 10m or 1h, not {shown(text)}.")
    return seconds


def span(seconds: float) -> str:
    """Seconds as text, in the largest unit that they reach."""
    name, size = next(((name, size) for name, size in NAMES if seconds >= size), NAMES[-1])
    count = f"{seconds / size:.3g}"
    return f"{count} {name}" if count == "1" else f"{count} {name}s"
