"""The summary of a prewarm: what was asked, what there was to do, and what it came to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import BaseModel

from server.durations import span
from server.facts import TimeLeftFacts
from server.prewarm.order import PrewarmOrder
from server.progress import left_text
from worker.outlook import TimeLeft

MOST_FAILURES = 100
"""Failures that are told one by one; the rest is counted."""


class Errors(BaseModel):
    """The estimated relative errors of the views, or of the texels where whole isosurfaces were asked for."""

    worst: float
    mean: float


class Failure(BaseModel):
    """A chunk (z, y, x) that could not be baked, and why."""

    chunk: tuple[int, int, int]
    reason: str


class Summary(BaseModel):
    """What a prewarm had to do, and what it did.

    ``chunks``, ``texels`` without light, ``refined`` texels with some and ``bytes`` before compression are what was
    lacking at the start, with what adaptive scenes asked for since; ``stored_bytes`` is what these chunks take in the
    store. ``final`` is the share of the views' surface that is final, or that of the texels of whole isosurfaces;
    ``error`` is the worst of ``errors``. ``paths`` and ``processor_seconds`` were spent on these chunks, ``seconds``
    passed meanwhile; ``time_left`` is the time that was told at the start. ``stopped`` says what ended it. A dry run
    tells ``stored_bytes`` and ``processor_seconds`` ahead.
    """

    scene: str
    order: PrewarmOrder
    views: int
    isovalues: tuple[float, ...]
    ranges: tuple[tuple[float, float], ...]
    target_error: float
    chunks: int
    texels: int
    refined: int
    bytes: int
    stored_bytes: int
    workers: int
    final: float
    error: float
    errors: Errors
    time_left: TimeLeftFacts
    paths: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0
    stopped: Literal["dry run", "target", "deadline", "failures"] = "dry run"
    failed: int = 0
    failures: tuple[Failure, ...] = ()
    file: str | None = None

    def __str__(self) -> str:
        """For a person, on one line."""
        what = f"{self.views:,} views" if self.views else "whole isosurfaces"
        share = f"{what}, {self.final:.1%} of their {'surface' if self.views else 'texels'} final"
        told = f"{share} at {self.target_error:g}"
        return f"{told}; {self._ahead()}" if self.stopped == "dry run" else f"{told}, {self._done()}"

    def _ahead(self) -> str:
        size = f"{self.bytes / 1e6:.1f} MB before compression, about {self.stored_bytes / 1e6:.1f} MB after"
        rest = f"and {self.refined:,} to be refined, in {self.chunks:,} chunks"
        left = left_text(TimeLeft(**self.time_left.model_dump()))
        lacking = f"to bake: {self.texels:,} texels without light ({size}) {rest}"
        return f"{lacking}; time with --workers {self.workers}: {left}"

    def _done(self) -> str:
        told = span(self.time_left.likely, digits=2)
        done = f"{self.paths:,} paths in {span(self.seconds)} (told: {told}), worst error {self.error:.2g}"
        wrong = f"; {self.failed:,} chunks cannot be baked: {self.failures[0].reason}" if self.failures else ""
        return f"{done}{wrong}" + (f"; {self.file}" if self.file else "")


def failures_of(reasons: Sequence[tuple[tuple[int, int, int], str]]) -> tuple[Failure, ...]:
    """The first of the failures."""
    return tuple(Failure(chunk=chunk, reason=reason) for chunk, reason in reasons[:MOST_FAILURES])
