"""What a client prefers (RFC 7240): to wait for a better picture, or to be told later where it is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, TypeVar

from fastapi import Depends, Header

from server.params import LONGEST_WAIT, ViewParams

MEMBER = re.compile(r'(?:[^,"]|"(?:[^"\\]|\\.)*"?)+')
"""One member of a list, in whose quoted parts commas are text."""

DESCRIPTION = (
    "Preferences (RFC 7240). wait=5: wait up to 5 seconds for baking, where wait_ms is left out;"
    f" {LONGEST_WAIT // 1000} at most. respond-async: where a frame is not final by then, answer with a job that bakes"
    " it. Others are ignored."
)

Params = TypeVar("Params", bound=ViewParams)


@dataclass(frozen=True)
class Preferences:
    """To ``wait`` for so many seconds, if any, and to be answered with a job rather than wait longer."""

    wait: int | None = None
    respond_async: bool = False

    def fill(self, params: Params) -> tuple[Params, dict[str, str]]:
        """The parameters with the wait that is preferred, and the header that says so; a given ``wait_ms`` stands."""
        if self.wait is None or "wait_ms" in params.model_fields_set:
            return params, {}
        filled = params.model_copy(update={"wait_ms": 1000 * self.wait})
        return filled, {"Preference-Applied": f"wait={self.wait}"}


def preferences(headers: Iterable[str]) -> Preferences:
    """What Prefer headers say; of a preference that is given twice the first counts, and what makes no sense does not.

    A longer wait than is allowed is taken for the longest.
    """
    found: dict[str, str] = {}
    for member in (member for header in headers for member in MEMBER.findall(header)):
        name, _, value = member.partition(";")[0].partition("=")
        found.setdefault(name.strip().lower(), value.strip().strip('"'))
    return Preferences(seconds(found.get("wait", "")), "respond-async" in found)


def seconds(text: str) -> int | None:
    """The whole seconds that a text spells, LONGEST_WAIT at most; None where it spells none."""
    if not re.fullmatch(r"\d+", text, re.ASCII):
        return None
    return min(int(text), LONGEST_WAIT // 1000) if len(text) < 10 else LONGEST_WAIT // 1000


async def preferred(prefer: Annotated[list[str] | None, Header(description=DESCRIPTION)] = None) -> Preferences:
    """The preferences of a request."""
    return preferences(prefer or ())


PreferencesDep = Annotated[Preferences, Depends(preferred)]
