"""Spans of time as a person reads and writes them: 90, 90s, 10m, 1.5h."""

import re

from server.values import NUMBER, shown

NAMES = (("h", 3600.0), ("min", 60.0), ("s", 1.0), ("ms", 1e-3))

UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}

DURATION = re.compile(rf"({NUMBER.pattern})(s|m|h|)", re.ASCII)

AGES = {"d": 86400.0, "w": 7 * 86400.0}

AGE = re.compile(rf"({NUMBER.pattern})(d|w)", re.ASCII)

LONGEST = 1e9


def seconds_of(text: str) -> float:
    """Seconds of a span of time, none included; ValueError, which says what is allowed, where it is no span."""
    match = DURATION.fullmatch(text) if len(text) <= 40 else None
    seconds = float(match[1]) * UNITS[match.groups()[-1]] if match else -1.0
    if not 0.0 <= seconds <= LONGEST:
        raise ValueError(f"must be a span of time such as 90, 90s, 10m or 1h, not {shown(text)}.")
    return seconds


def seconds_of_age(text: str) -> float:
    """Seconds of a span of time that may also be told in days or weeks: 12h, 30d, 4w; ValueError as ``seconds_of``."""
    match = AGE.fullmatch(text) if len(text) <= 40 else None
    if match and float(match[1]) >= 0.0:
        return float(match[1]) * AGES[match.groups()[-1]]
    try:
        return seconds_of(text)
    except ValueError:
        raise ValueError(f"must be a span of time such as 12h, 30d or 4w, not {shown(text)}.") from None


def span(seconds: float, digits: int = 3) -> str:
    """Seconds as text to so many digits, in the largest unit that they reach; ``0 s`` for less than a millisecond."""
    name, size = next(((name, size) for name, size in NAMES if seconds >= size), ("s", 1.0))
    count = float(f"{seconds / size:.{digits}g}") if seconds >= NAMES[-1][1] else 0.0
    return f"{count:,g} {name}"
