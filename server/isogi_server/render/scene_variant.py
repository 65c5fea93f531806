"""The change that a request makes to a scene, read from its parameters, and the id of the
variant that it asks for.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import (
    HIDDEN_SURFACE,
    Clears,
    Hidden,
    MaterialSettings,
    read_clears,
    read_hidden,
    read_material_text,
    write_material_text,
)
from isogi_core.model.view import NO_TURN, Turn, read_window
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import made_of
from isogi_server.errors import ParameterError

T = TypeVar("T")


@dataclass(frozen=True)
class Change:
    """The changes of a scene that a request asks for, as its parameters spell them; None, or
    NO_TURN, for each part that is unchanged.

    ``environment`` is a name or an id, ``cut`` the text of planes, ``time`` a step of the series,
    ``smooth`` a width in voxels, ``surfaces`` the shares of rays that pass pinned surfaces,
    ``hide`` the labels that are not shown, ``material`` a name with numbers, ``turn`` the angles of
    the light.
    """

    environment: str | None = None
    cut: str | None = None
    time: int | None = None
    smooth: float | None = None
    surfaces: str | None = None
    hide: str | None = None
    material: str | None = None
    turn: Turn = NO_TURN


@dataclass(frozen=True)
class SceneVariant:
    """A variant of the scene with the id ``base``; None for each part that is as in the scene.

    ``clears`` are the shares of rays that pass pinned surfaces, ``hidden`` the labels that are not
    shown, ``smooth`` a width in voxels and ``cut`` the text of planes. ``material`` is a text for
    ``read_material_text``, in a form that is equal for equal materials. ``turn`` is the turn of the
    light that the variant's light is baked for; None where the light is kept so that it turns.
    """

    base: str
    environment: str | None = None
    clears: Clears | None = None
    material: str | None = None
    hidden: Hidden | None = None
    time: int | None = None
    smooth: float | None = None
    cut: str | None = None
    turn: Turn | None = None

    @classmethod
    def of(cls, scene: Scene, change: Change) -> "SceneVariant":
        """Return the variant of a ``scene`` that a ``change`` asks for, without changes that leave
        the scene as it is.

        Raises ParameterError if a parameter cannot be read.
        """
        # Read the parameters; errors name the parameter.
        pinned = len(scene.surfaces.pinned)
        clears = _read_parameter(
            "surfaces", lambda text: read_clears(text, pinned), change.surfaces
        )
        made = _read_parameter("material", read_material_text, change.material)
        hidden = _read_parameter("hide", read_hidden, change.hide)
        # A change to the value that the scene has is no change: it shares the scene's light.
        if made is None or made_of(scene, made):
            material = None
        else:
            material = write_material_text(made)
        if change.time == scene.volume.moment[0]:
            time = None
        else:
            time = change.time
        if change.smooth == scene.source.document.get("smooth", 0.0):
            smooth = None
        else:
            smooth = change.smooth
        turn = None if change.turn == NO_TURN else change.turn
        return cls(
            scene.id, change.environment, clears, material, hidden, time, smooth, change.cut, turn
        )

    @property
    def settings(self) -> MaterialSettings | None:
        """Return the settings of its material; None if that is the scene's."""
        if self.material is None:
            return None
        return read_material_text(self.material)

    @property
    def any(self) -> bool:
        """Return True if anything differs from the scene."""
        return self != SceneVariant(self.base)

    @property
    def id(self) -> str:
        """Return the id of the variant as a scene; equal changes have equal ids. The id of a
        scene that is no variant has no @.
        """
        clears = self.clears and ",".join(
            HIDDEN_SURFACE if each is None else f"{each!r}" for each in self.clears
        )
        if self.hidden is None:
            hidden = None
        else:
            hidden = ",".join(map(str, self.hidden))
        # A mark before each part keeps ids of different changes apart.
        parts = (
            ("", self.environment),
            ("~", clears),
            ("=", self.material),
            ("!", hidden),
            ("+", self.time),
            ("*", self.smooth),
            ("^", self.turn and ",".join(f"{angle:g}" for angle in self.turn)),
        )
        lit = "".join(f"{mark}{part}" for mark, part in parts if part is not None)
        # A cut is any number of planes: its digest keeps the id short.
        if self.cut is not None:
            lit += (
                "@"
                + hashlib.blake2b(repr(read_window(self.cut)).encode(), digest_size=16).hexdigest()
            )
        if self.any:
            return f"{self.base}@{lit}"
        return self.base

    @property
    def whole(self) -> "SceneVariant":
        """Return the same variant without its cut."""
        return replace(self, cut=None)

    @property
    def unturned(self) -> "SceneVariant":
        """Return the same variant without its turn of the light."""
        return replace(self, turn=None)

    @property
    def voxels(self) -> tuple[str, Hidden | None, int | None, float | None]:
        """Return all that the voxels depend on, except for a cut."""
        return self.base, self.hidden, self.time, self.smooth

    @property
    def has_voxels(self) -> bool:
        """Return True if its voxels are computed from those of its scene: cut, hidden or
        smoothed. Time steps are not counted.
        """
        return self.cut is not None or self.hidden is not None or self.smooth is not None

    def may_stand_in_for(self, other: "SceneVariant") -> bool:
        """Return True if its light may stand in for light of the ``other`` variant that is not
        baked yet.

        Both must be equal except for time step, hidden labels and smoothing, and neither may be
        cut.
        """
        alike = replace(self, hidden=other.hidden, time=other.time, smooth=other.smooth) == other
        return alike and self != other and self.cut is None


def _read_parameter(name: str, read: Callable[[str], T], text: str | None) -> T | None:
    """Return the value that ``read`` finds in a parameter's ``text``; None without a text.
    Raises ParameterError if it cannot be read.
    """
    try:
        return None if text is None else read(text)
    except SceneError as error:
        raise ParameterError(str(error), name) from None
