"""Lines of an inspection: as wide as a terminal, the text beside its name."""

import textwrap

WIDTH, LEAD = 100, 14
"""Columns of a line, and of the name at its beginning."""


def wrapped(lead: str, text: str) -> list[str]:
    """Lines of at most WIDTH, the first after its ``lead`` and the others under the text."""
    return textwrap.wrap(text, WIDTH, initial_indent=lead, subsequent_indent=" " * len(lead))
