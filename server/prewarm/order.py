"""What is asked of a prewarm: the same document from the command line, over HTTP and in the file beside the light."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, StrictBool, WithJsonSchema, model_validator

from isogi_core.model.scene import Scene
from isogi_core.model.view import View
from server.durations import LONGEST
from server.errors import ParameterError
from server.params import TURN, NoParams, ViewParams, read
from server.prewarm.directions import Direction, all_sides, orbit
from server.prewarm.levels import Levels, levels_of
from server.settings import Settings
from server.values import Span
from server.views import isovalue_of, view_of

MOST_DIRECTIONS, MOST_VIEWS = 10_000, 100_000
"""Directions of one kind, and views of all isovalues and directions together, at most."""

MOST_TOLD = 1000
"""Isovalues, directions and orbits that are told one by one, at most."""

USUAL = 12
"""Directions from all sides where nobody says."""

WAYS = ("views", "directions", "orbits")
"""Fields that say where views look from."""

Level = Annotated[
    str, BeforeValidator(str), WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]}), Field(max_length=64)
]
Count = Annotated[int, Span(1, MOST_DIRECTIONS, whole=True)]


def as_of_a_view(name: str) -> Any:
    """What a view says of a field that it has too."""
    return ViewParams.model_fields[name]


class From(NoParams):
    """A direction to look from."""

    azimuth: Annotated[float, TURN] = Field(description="Degrees; 0 looks from +x, 90 from +y.")
    elevation: Annotated[float, Span(-90, 90)] = Field(0.0, description="Degrees above the xy plane.")


class Orbit(NoParams):
    """Directions evenly around the object."""

    count: Count = Field(description="Azimuths, from 0 on.")
    elevation: Annotated[float, Span(-90, 90)] = Field(0.0, description="Degrees above the xy plane.")


class PrewarmOrder(NoParams):
    """Which light is to be baked ahead; what is left out takes the scene's defaults."""

    isovalues: tuple[Level, ...] = Field(
        (),
        max_length=MOST_TOLD,
        description="Numbers, ranges with a step (60:120:5), or ranges that mean every isovalue between (60:120), which"
        " takes all_directions; default: the scene's isovalue.",
    )
    views: Count | None = Field(
        None, description=f"Directions, spread evenly over all sides; default: {USUAL} where no others are told."
    )
    directions: tuple[From, ...] = Field((), max_length=MOST_TOLD, description="Directions, one by one.")
    orbits: tuple[Orbit, ...] = Field((), max_length=MOST_TOLD, description="Directions around the object.")
    all_directions: StrictBool = Field(
        False, description="Instead: whole isosurfaces, whatever a camera can see of them, from wherever."
    )
    distance: Annotated[float, Span(0.01, 1e7)] = as_of_a_view("distance")
    fov: Annotated[float, Span(0.01, 179)] = as_of_a_view("fov")
    width: Annotated[int, Span(1, 16383, whole=True)] = as_of_a_view("width")
    height: Annotated[int, Span(1, 16383, whole=True)] = as_of_a_view("height")
    target_error: Annotated[float | None, Span(0.0001, 1)] = Field(
        None, description="Relative error at which light is final; default: the scene's target_error."
    )
    deadline: Annotated[float | None, Span(0, LONGEST)] = Field(
        None, description="Seconds after which it ends, whatever is baked by then; default: none."
    )

    @model_validator(mode="before")
    @classmethod
    def without_nulls(cls, told: Any) -> Any:
        """What is null is as if it were left out."""
        return {name: value for name, value in told.items() if value is not None} if isinstance(told, dict) else told

    @model_validator(mode="after")
    def one_way(self) -> Self:
        """Refuses isovalues that nobody can list, where views are to be made of them."""
        others = [name for name in WAYS if getattr(self, name)]
        if self.all_directions and others:
            raise ValueError(f"all_directions leaves nothing to {', '.join(others)}: keep one.")
        if self.levels.ranges and not self.all_directions:
            first, last = self.levels.ranges[0]
            told = f"isovalues {first:g}:{last:g} means every isovalue between"
            raise ValueError(f"{told}, which takes all_directions; for views tell a step: {first:g}:{last:g}:5.")
        return self

    @cached_property
    def levels(self) -> Levels:
        """The isovalues that are told."""
        return levels_of(self.isovalues)

    @property
    def looks_from(self) -> list[Direction]:
        """The directions, each once."""
        told = [(each.azimuth, each.elevation) for each in self.directions]
        around = [each for path in self.orbits for each in orbit(path.count, path.elevation)]
        count = self.views if self.views is not None else 0 if told or around else USUAL
        return list(dict.fromkeys([*(all_sides(count) if count else ()), *told, *around]))

    def isovalues_of(self, scene: Scene) -> Levels:
        """The isovalues, the scene's own where none is told; ParameterError where the scene does not allow one."""
        for level in {min(self.levels.all), max(self.levels.all)} if self.isovalues else ():
            isovalue_of(scene, read(ViewParams, [("isovalue", level)]))
        return self.levels if self.isovalues else Levels((scene.isovalue,))

    def digest(self, scene: Scene) -> str:
        """Hex name of all that decides which light is baked in a scene; not of when that ends."""
        asked = self.model_dump(exclude={"deadline"})
        return hashlib.blake2b(json.dumps([scene.digest, asked]).encode(), digest_size=12).hexdigest()


class PrewarmRequest(PrewarmOrder):
    """An order, or the question what it would take."""

    dry_run: StrictBool = Field(False, description="Bake nothing: tell how much there is, and how long it takes.")

    @property
    def order(self) -> PrewarmOrder:
        """The order alone."""
        return PrewarmOrder(**self.model_dump(exclude={"dry_run"}))


class Views:
    """The views of an order in a ``scene``, made one by one; none where whole isosurfaces are asked for.

    Raises ViewError where one is not allowed, or they are too many.
    """

    def __init__(self, order: PrewarmOrder, scene: Scene, settings: Settings) -> None:
        """Make one of each isovalue and of each direction, so that what is wrong is told before anything is begun."""
        self._scene, self._settings = scene, settings
        self._knobs = {name: getattr(order, name) for name in ("distance", "fov", "width", "height")}
        self._levels = () if order.all_directions else order.isovalues_of(scene).single
        self._directions = order.looks_from
        if len(self) > MOST_VIEWS:
            asked = f"{len(self._directions):,} views of each of {len(self._levels):,} isovalues are {len(self):,}"
            raise ParameterError(f"{asked}: ask for {MOST_VIEWS:,} views at most.", "isovalues")
        for level in self._levels[:1]:
            self._view(level, self._directions[0])

    def __len__(self) -> int:
        return len(self._levels) * len(self._directions)

    def __iter__(self) -> Iterator[View]:
        return itertools.starmap(self._view, itertools.product(self._levels, self._directions))

    def _view(self, level: float, direction: Direction) -> View:
        place = {"isovalue": level, "azimuth": direction[0], "elevation": direction[1]}
        return view_of(self._scene, read(ViewParams, [*place.items(), *self._knobs.items()]), self._settings)


def order_of(told: dict[str, Any]) -> PrewarmOrder:
    """The order in a document; ParameterError on the first thing that is wrong."""
    return read(PrewarmOrder, told.items())
