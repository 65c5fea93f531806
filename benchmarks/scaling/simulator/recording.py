"""A recording: what views of a scene asked for and what a real bake of them took, chunk by chunk.
Kept as JSON.
"""

import base64
import json
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

FOLDER = Path(__file__).parent / "recordings"
TEXELS = 4096
"""Texels of a chunk."""


class Step(NamedTuple):
    """One task at all ``texels`` of a chunk that were wanted: what it took, and what it left.

    Processor ``seconds`` and ``paths``; the ``worth`` of the next paths, the share of the texels
    that are ``unfinished``, and the paths that these have ``taken`` and that are ``left`` to them.
    """

    seconds: float
    paths: int
    worth: float
    unfinished: float
    taken: float
    left: float


@dataclass(frozen=True)
class Ladder:
    """The steps of a chunk from nothing to final light of so many ``texels``."""

    texels: int
    steps: tuple[Step, ...]


@dataclass(frozen=True, eq=False)
class Sight:
    """What a view sees of a chunk: its texels' ``offsets`` and the ``weight`` that it has in the
    picture.
    """

    chunk: int
    weight: float
    offsets: np.ndarray


@dataclass(frozen=True, eq=False)
class Recording:
    """Where it is from, the seconds of a ``frame``, the chunks' ``ladders``, and ``views`` along an
    orbit.
    """

    origin: dict[str, Any]
    frame: float
    ladders: tuple[Ladder, ...]
    views: tuple[tuple[Sight, ...], ...] = field(repr=False)

    @property
    def seconds(self) -> float:
        """Processor seconds that all of it took."""
        return sum(step.seconds for ladder in self.ladders for step in ladder.steps)

    def save(self, path: Path) -> None:
        """Write it as JSON; the texels of a view as a packed bitmap, a bit for each of a chunk."""
        views = [
            {"chunks": [[s.chunk, rounded(s.weight)] for s in view], "texels": packed(view)}
            for view in self.views
        ]
        ladders = [
            {**asdict(each), "steps": [list(map(rounded, step)) for step in each.steps]}
            for each in self.ladders
        ]
        document = {
            "origin": self.origin,
            "frame": rounded(self.frame),
            "ladders": ladders,
            "views": views,
        }
        path.write_text(json.dumps(document, separators=(",", ":")) + "\n", encoding="utf-8")


def load(name: str) -> Recording:
    """The recording of this name in the repository, or in a file of this path."""
    if name.endswith(".json"):
        path = Path(name)
    else:
        path = FOLDER / f"{name}.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    ladders = tuple(
        Ladder(each["texels"], tuple(Step(s, int(p), *rest) for s, p, *rest in each["steps"]))
        for each in document["ladders"]
    )
    views = tuple(unpacked(each["chunks"], each["texels"]) for each in document["views"])
    return Recording(document["origin"], document["frame"], ladders, views)


def packed(view: Sequence[Sight]) -> str:
    """The texels that a view sees, as text."""
    bits = np.zeros((len(view), TEXELS), np.bool_)
    for row, sight in zip(bits, view, strict=True):
        row[sight.offsets] = True
    return base64.b85encode(zlib.compress(np.packbits(bits).tobytes(), 9)).decode()


def unpacked(chunks: Sequence[tuple[int, float]], text: str) -> tuple[Sight, ...]:
    """What ``packed`` was made of."""
    data = np.frombuffer(zlib.decompress(base64.b85decode(text)), np.uint8)
    rows = np.unpackbits(data).reshape(len(chunks), TEXELS)
    return tuple(
        Sight(chunk, weight, np.flatnonzero(row).astype(np.int32))
        for (chunk, weight), row in zip(chunks, rows, strict=True)
    )


def rounded(value: float) -> float:
    """A number to four digits."""
    return float(f"{value:.4g}")
