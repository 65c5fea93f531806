"""The key of a variant: what a request changes of a scene, read and checked."""

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
from isogi_core.model.view import read_window
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import made_of
from server.errors import ParameterError

T = TypeVar("T")


@dataclass(frozen=True)
class Change:
    """What a request changes of a scene, as its parameters spell it; None of what stays.

    The ``environment`` by its name or id, the planes of a ``cut``, the step in ``time``, how far it
    is to ``smooth``, what pinned ``surfaces`` let pass, the labels to ``hide``, and the
    ``material`` with its numbers.
    """

    environment: str | None = None
    cut: str | None = None
    time: int | None = None
    smooth: float | None = None
    surfaces: str | None = None
    hide: str | None = None
    material: str | None = None


@dataclass(frozen=True)
class SceneVariant:
    """The variant of the scene with the id ``base``; None of what stays as it is there.

    ``clears`` are the shares of rays that pass pinned surfaces, ``hidden`` the labels that are not
    shown, ``material`` is a text that ``read_material_text`` reads, ``smooth`` is in voxels, and
    ``cut`` the text of planes.
    """

    base: str
    environment: str | None = None
    clears: Clears | None = None
    material: str | None = None
    hidden: Hidden | None = None
    time: int | None = None
    smooth: float | None = None
    cut: str | None = None

    @classmethod
    def of(cls, scene: Scene, change: Change) -> "SceneVariant":
        """The variant of a ``scene`` that a ``change`` makes, without what the scene has by itself.

        Raises ParameterError.
        """
        pinned = len(scene.surfaces.pinned)
        clears = _read_parameter(
            "surfaces", lambda text: read_clears(text, pinned), change.surfaces
        )
        made = _read_parameter("material", read_material_text, change.material)
        hidden = _read_parameter("hide", read_hidden, change.hide)
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
        return cls(scene.id, change.environment, clears, material, hidden, time, smooth, change.cut)

    @property
    def settings(self) -> MaterialSettings | None:
        """The settings of its material."""
        if self.material is None:
            return None
        return read_material_text(self.material)

    @property
    def any(self) -> bool:
        """Whether anything changes: it is the scene itself if not."""
        return self != SceneVariant(self.base)

    @property
    def id(self) -> str:
        """The id of its scene; equal changes have the same. Ids of scenes that are no variants have
        no @.
        """
        clears = self.clears and ",".join(
            HIDDEN_SURFACE if each is None else f"{each!r}" for each in self.clears
        )
        if self.hidden is None:
            hidden = None
        else:
            hidden = ",".join(map(str, self.hidden))
        parts = (
            ("", self.environment),
            ("~", clears),
            ("=", self.material),
            ("!", hidden),
            ("+", self.time),
            ("*", self.smooth),
        )
        lit = "".join(f"{mark}{part}" for mark, part in parts if part is not None)
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
        """The variant that is not cut open."""
        return replace(self, cut=None)

    @property
    def voxels(self) -> tuple[str, Hidden | None, int | None, float | None]:
        """What the voxels depend on, but for a cut."""
        return self.base, self.hidden, self.time, self.smooth

    @property
    def has_voxels(self) -> bool:
        """Whether it has voxels that its scene has not, but for its step in time."""
        return self.cut is not None or self.hidden is not None or self.smooth is not None

    def may_stand_in_for(self, other: "SceneVariant") -> bool:
        """Whether its light may stand in for that of the ``other``.

        They differ in their step in time, in which labels are hidden and in how far they are
        smoothed alone, and neither is cut open.
        """
        alike = replace(self, hidden=other.hidden, time=other.time, smooth=other.smooth) == other
        return alike and self != other and self.cut is None


def _read_parameter(name: str, read: Callable[[str], T], text: str | None) -> T | None:
    """What a parameter's ``text`` says, as it is ``read``; ParameterError where that cannot be."""
    try:
        return None if text is None else read(text)
    except SceneError as error:
        raise ParameterError(str(error), name) from None
