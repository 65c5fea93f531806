"""Shares and errors in percent, for a person."""

from server.inspect.facts import ErrorFacts


def percent(share: float) -> str:
    """A share: no digits that it does not have, and never 0 for what is there."""
    if 0.0 < share < 0.001:
        return "<0.1 %"
    return f"{100.0 * share:.1f} %" if share < 0.0995 and share > 0.0 else f"{100.0 * share:.0f} %"


def span(error: ErrorFacts) -> str:
    """An expected error, and its range."""
    return f"{percent(error.likely)} ({percent(error.low)} – {percent(error.high)})"
