"""The order of a prewarm: isovalues, directions and target,
from the command line, HTTP or a file.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, StrictBool, WithJsonSchema, model_validator

from isogi_core.files.spelling import shortest
from isogi_core.model.material import DULL
from isogi_core.model.view import View
from isogi_core.plan.projection import CELLS_WAITED_FOR, sample_range
from isogi_core.plan.projection import SPACING_KINDS as SAMPLINGS
from isogi_core.plan.scene import Scene
from isogi_server.errors import ParameterError
from isogi_server.knobs import KNOBS
from isogi_server.parameters import NoParams, ViewParams, knob, read
from isogi_server.settings import Settings
from isogi_server.values import LONGEST_SECONDS, Span, finite, shown
from isogi_server.views import isovalue_of, view_of

GOLDEN = 180.0 * (3.0 - math.sqrt(5.0))
"""The golden angle, in degrees."""

Direction = tuple[float, float]
"""Azimuth and elevation, in degrees."""


def all_sides(count: int) -> list[Direction]:
    """Return ``count`` directions spread evenly over a sphere, by a Fibonacci lattice."""
    heights = (1.0 - (2 * n + 1) / count for n in range(count))
    return [
        (n * GOLDEN % 360.0, math.degrees(math.asin(height))) for n, height in enumerate(heights)
    ]


def orbit(count: int, elevation: float) -> list[Direction]:
    """Return ``count`` azimuths around the object, from 0 on, at one elevation."""
    return [(360.0 * n / count, elevation) for n in range(count)]


MOST_ISOVALUES = 10_000
"""Most isovalues of an order, given with a step or one by one."""

VALUES_EXPECTED = (
    f"a number such as 70, first:last:step such as 60:120:5 with at most {MOST_ISOVALUES} of "
    "them, first:last for all between, or a number of levels of the scene's range, adaptive:20 or "
    "uniform:20"
)


@dataclass(frozen=True)
class Levels:
    """The isovalues of an order: ``single`` ones, each once, and ``ranges`` of all isovalues from
    one to another.

    ``sampled`` are numbers of isovalues to choose from a scene's range, each by one of SAMPLINGS.
    """

    single: tuple[float, ...] = ()
    ranges: tuple[tuple[float, float], ...] = ()
    sampled: tuple[tuple[str, int], ...] = ()

    def found_in(self, scene: Scene) -> Levels:
        """Return the levels, with the sampled isovalues chosen from the range of a ``scene``."""
        volume = scene.volume
        ends = scene.isovalues
        sets = (
            sample_range(volume, ends, count, way, CELLS_WAITED_FOR).levels
            for way, count in self.sampled
        )
        found = (float(f"{level:.12g}") for levels in sets for level in levels)
        return Levels(tuple(dict.fromkeys((*self.single, *found))), self.ranges)

    @property
    def all(self) -> tuple[float, ...]:
        """The single isovalues, and the ends of the ranges."""
        return (*self.single, *(end for ends in self.ranges for end in ends))

    @property
    def spans(self) -> tuple[tuple[float, float], ...]:
        """All levels as ranges; a single isovalue is a range of length 0."""
        return (*((level, level) for level in self.single), *self.ranges)


def levels_of(texts: Sequence[str]) -> Levels:
    """Return the isovalues that the texts name.

    Raises ParameterError if a text names none, or if they are too many.
    """
    single: dict[float, None] = {}
    ranges: dict[tuple[float, float], None] = {}
    sampled: dict[tuple[str, int], None] = {}
    for text in texts:
        # A text is a number of isovalues to sample, a range of two numbers, or single isovalues.
        if (way := text.partition(":")[0]) in SAMPLINGS:
            sampled[way, sampled_count(text)] = None
            continue
        numbers = numbers_in(text)
        if len(numbers) == 2:
            ranges[numbers[0], numbers[1]] = None
        else:
            single |= dict.fromkeys(float(f"{level:.12g}") for level in stepped(*numbers))
        if len(single) > MOST_ISOVALUES:
            raise ParameterError(
                f"isovalues are more than {MOST_ISOVALUES:,} together: ask for fewer.", "isovalues"
            )
    return Levels(tuple(single), tuple(ranges), tuple(sampled))


def sampled_count(text: str) -> int:
    """Return the number of isovalues in a text such as adaptive:20.

    Raises ParameterError if there is none.
    """
    count = text.partition(":")[2]
    if not re.fullmatch(r"[1-9]\d{0,4}", count, re.ASCII) or int(count) > MOST_ISOVALUES:
        raise ParameterError(f"isovalue must be {VALUES_EXPECTED}, not {shown(text)}.", "isovalues")
    return int(count)


def numbers_in(text: str) -> list[float]:
    """Return the one, two or three numbers in a text.

    Raises ParameterError if they are not an isovalue or a range.
    """
    numbers = [finite(part) for part in text.split(":")]
    if all(map(math.isfinite, numbers)) and sensible(numbers):
        return numbers
    raise ParameterError(f"isovalue must be {VALUES_EXPECTED}, not {shown(text)}.", "isovalues")


def sensible(numbers: Sequence[float]) -> bool:
    """Return True if the numbers are in order, and do not give too many isovalues."""
    match numbers:
        case [_]:
            return True
        case [first, last]:
            return first <= last
        case [first, last, step]:
            return step > 0.0 and first <= last and (last - first) / step < MOST_ISOVALUES
    return False


def stepped(first: float, last: float | None = None, step: float = 1.0) -> list[float]:
    """Return the numbers from ``first`` to ``last`` by ``step``;
    only the first without a ``last``.
    """
    if last is None:
        steps = 0
    else:
        steps = math.floor((last - first) / step + 1e-9)
    return [first + step * n for n in range(steps + 1)]


MOST_DIRECTIONS = 10_000
MOST_VIEWS = 100_000
"""Most directions of one kind, and most views of all isovalues and directions together."""

MOST_GIVEN = 1000
"""Most isovalues, directions and orbits that are given one by one."""

USUAL_DIRECTIONS = 12
"""Number of directions from all sides by default."""

VIEW_FIELDS = ("views", "directions", "orbits")
"""Fields that give the directions of views."""

Level = Annotated[
    str,
    BeforeValidator(str),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}),
    Field(max_length=64),
]
Count = Annotated[int, Span(1, MOST_DIRECTIONS, whole=True)]


class From(NoParams):
    """A direction to look from."""

    azimuth: float = knob("azimuth", default=..., otherwise="")
    elevation: float = knob("elevation", default=0.0)


class Orbit(NoParams):
    """Directions evenly spaced around the object."""

    count: Count = Field(description="Azimuths, from 0 on.")
    elevation: float = knob("elevation", default=0.0)


class PrewarmOrder(NoParams):
    """An order of light to bake ahead. Fields that are left out take the scene's defaults."""

    isovalues: tuple[Level, ...] = Field(
        (),
        max_length=MOST_GIVEN,
        description="Numbers, ranges with a step (60:120:5), ranges that mean every isovalue "
        "between (60:120; only with all_directions), or a number of isovalues of the scene's "
        "range, spread evenly (uniform:20) or so that the surfaces are evenly spaced "
        "(adaptive:20); default: the scene's isovalue.",
    )
    views: Count | None = Field(
        None,
        description=(
            f"Directions, spread evenly over all sides; default: {USUAL_DIRECTIONS} if "
            "no others are given."
        ),
    )
    directions: tuple[From, ...] = Field(
        (), max_length=MOST_GIVEN, description="Directions, one by one."
    )
    orbits: tuple[Orbit, ...] = Field(
        (), max_length=MOST_GIVEN, description="Directions around the object."
    )
    all_directions: StrictBool = Field(
        False,
        description="Bake whole isosurfaces, for cameras anywhere, instead of views.",
    )
    distance: float = knob("distance")
    fov: float = knob("fov")
    width: int = knob("width")
    height: int = knob("height")
    target_error: Annotated[float, KNOBS["max_error"].kind] | None = Field(
        None,
        description=(
            "Total relative error that pictures are to reach; default: the scene's target_error."
        ),
    )
    deadline: Annotated[float, Span(0, LONGEST_SECONDS)] | None = Field(
        None,
        description="Seconds after which the prewarm ends, even without all light; default: none.",
    )

    @model_validator(mode="before")
    @classmethod
    def without_nulls(cls, given: Any) -> Any:
        """Drop fields that are null, as if they were left out."""
        if isinstance(given, dict):
            return {name: value for name, value in given.items() if value is not None}
        return given

    @model_validator(mode="after")
    def one_way(self) -> Self:
        """Raise ValueError for directions along with all_directions, and for ranges of isovalues
        without it: views need single isovalues.
        """
        others = [name for name in VIEW_FIELDS if getattr(self, name)]
        if self.all_directions and others:
            raise ValueError(f"all_directions leaves nothing to {', '.join(others)}: keep one.")
        if self.levels.ranges and not self.all_directions:
            ends = ":".join(map(shortest, self.levels.ranges[0]))
            meaning = f"isovalues {ends} means every isovalue between"
            raise ValueError(
                f"{meaning}, which takes all_directions; for views give a step: {ends}:5."
            )
        return self

    @cached_property
    def levels(self) -> Levels:
        """The isovalues that are given."""
        return levels_of(self.isovalues)

    @property
    def looks_from(self) -> list[Direction]:
        """The directions of the order's views, each once; USUAL_DIRECTIONS from all sides if none
        is given.
        """
        single = [(each.azimuth, each.elevation) for each in self.directions]
        around = [each for path in self.orbits for each in orbit(path.count, path.elevation)]
        if self.views is not None:
            count = self.views
        elif single or around:
            count = 0
        else:
            count = USUAL_DIRECTIONS
        return list(dict.fromkeys([*(all_sides(count) if count else ()), *single, *around]))

    def isovalues_of(self, scene: Scene) -> Levels:
        """Return the isovalues, that of the ``scene`` if none is given.

        Raises ParameterError if the scene does not allow one.
        """
        if self.isovalues:
            levels = self.levels.found_in(scene)
        else:
            levels = Levels((scene.isovalue,))
        # The lowest and the highest stand for all.
        for level in {min(levels.all), max(levels.all)}:
            isovalue_of(scene, read(ViewParams, [("isovalue", level)]))
        return levels

    def digest(self, scene: Scene) -> str:
        """Return the digest, in hexadecimal, of everything that decides
        which light is baked in a scene; the deadline does not.
        """
        asked = self.model_dump(exclude={"deadline"})
        return hashlib.blake2b(
            json.dumps([scene.digest, asked]).encode(), digest_size=12
        ).hexdigest()


class PrewarmRequest(PrewarmOrder):
    """An order, or the question how much light it is and how long it takes."""

    dry_run: StrictBool = Field(
        False, description="Bake nothing, and forecast the amount of light and the time."
    )

    @property
    def order(self) -> PrewarmOrder:
        """The order itself."""
        return PrewarmOrder(**self.model_dump(exclude={"dry_run"}))


class Views:
    """The views of an order in a ``scene``, made one by one; none if the order asks for whole
    isosurfaces.

    Raises ViewError if a view is not allowed, ParameterError if they are too many, and SceneError
    if the scene keeps no light.
    """

    def __init__(self, order: PrewarmOrder, scene: Scene, settings: Settings) -> None:
        """Make the first view, so that errors come before any work begins."""
        scene.require_texels()
        self._scene = scene
        self._settings = settings
        self._knobs = {
            name: getattr(order, name) for name in ("distance", "fov", "width", "height")
        }
        if order.all_directions:
            self._levels: tuple[float, ...] = ()
        else:
            self._levels = order.isovalues_of(scene).single
        self._directions = order.looks_from
        # Refuse too many views, and one that is not allowed, before any work begins.
        if len(self) > MOST_VIEWS:
            asked = (
                f"{len(self._directions):,} views of each of {len(self._levels):,} isovalues are "
                f"{len(self):,}"
            )
            raise ParameterError(f"{asked}: ask for {MOST_VIEWS:,} views at most.", "isovalues")
        for level in self._levels[:1]:
            self._view(level, self._directions[0])

    def __len__(self) -> int:
        return len(self._levels) * len(self._directions)

    def __iter__(self) -> Iterator[View]:
        return itertools.starmap(self._view, itertools.product(self._levels, self._directions))

    def _view(self, level: float, direction: Direction) -> View:
        """Return the view of an isovalue from a direction."""
        place = {"isovalue": level, "azimuth": direction[0], "elevation": direction[1]}
        view = view_of(
            self._scene, read(ViewParams, [*place.items(), *self._knobs.items()]), self._settings
        )
        # Nothing is baked for shine, so leave it out.
        if self._scene.surfaces.shine is None:
            return view
        return replace(view, shine=DULL)


SURFACE_VIEWS = 6
SURFACE_VIEW_PIXELS = 192
MAX_VIEWED_ISOVALUES = 4
"""Number of views, from all sides, that stand for a whole isosurface,
their pixels a side, and the most isovalues that get such views.
"""


def views_around(order: PrewarmOrder, levels: Levels, scene: Scene, settings: Settings) -> Views:
    """Return the views that stand for the whole isosurfaces of ``levels``:
    of the lowest, the highest and some between.
    """
    every = sorted(set(levels.all))
    # Choose isovalues evenly by rank, and views of moderate size from all sides.
    chosen = {
        every[round(n * (len(every) - 1) / (MAX_VIEWED_ISOVALUES - 1))]
        for n in range(MAX_VIEWED_ISOVALUES)
    }
    around = {
        "all_directions": False,
        "views": SURFACE_VIEWS,
        "directions": (),
        "orbits": (),
        "isovalues": tuple(map(repr, sorted(chosen))),
        "width": SURFACE_VIEW_PIXELS,
        "height": SURFACE_VIEW_PIXELS,
    }
    return Views(order_of(order.model_dump() | around), scene, settings)


def order_of(fields: dict[str, Any]) -> PrewarmOrder:
    """Return the order in a document. Raises ParameterError for the first fault."""
    return read(PrewarmOrder, fields.items())
