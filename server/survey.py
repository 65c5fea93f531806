"""A survey: what views show with the light that there is, and what they lack of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from isogi_core.model.view import View
from server.progress import progress_bar

if TYPE_CHECKING:
    from isogi_core.bake.recipe import Index
    from isogi_core.frame.frame import Frame
    from isogi_core.frame.texels import Demand
    from server.studio import Studio


@dataclass(eq=False)
class Survey:
    """What ``views`` show with the light that there is, and by chunk what they lack of it.

    ``pixels`` show the surface, ``final`` of them with final light; ``error`` is the largest of any view.
    """

    views: Sequence[View]
    demands: dict[Index, Demand] = field(default_factory=dict)
    pixels: int = 0
    final: int = 0
    error: float = 0.0

    def add(self, frame: Frame) -> None:
        """Take in the frame of a view."""
        self.pixels += frame.surface
        self.final += frame.counts["final"]
        self.error = max(self.error, frame.estimated_error)
        for demand in frame.demands:
            other = self.demands.get(demand.index)
            self.demands[demand.index] = demand if other is None else demand.joined(other)

    @property
    def unlit(self) -> int:
        """Texels without light."""
        return sum(demand.effort.unlit for demand in self.demands.values())

    @property
    def lit(self) -> int:
        """Other texels of chunks that are not final: what of them is not good enough gets more samples."""
        return sum(len(demand.offsets) for demand in self.demands.values()) - self.unlit

    @property
    def share(self) -> float:
        """The share of surface pixels whose light is final; 1 where no surface is seen."""
        return self.final / self.pixels if self.pixels else 1.0


def survey(studio: Studio, scene: str, views: Sequence[View], error: float) -> Survey:
    """What the views show with the light that there is at a target ``error``."""
    found = Survey(views)
    with progress_bar("looking", "view", len(views)) as bar:
        for view in views:
            found.add(studio.survey(scene, view, error))
            bar.update()
    return found
