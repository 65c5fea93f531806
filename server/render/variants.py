"""Variants: an engine's scenes in other light, at other times, with other surfaces, or cut open, each made when asked
for.

A variant is a scene like any other: it has a plan, and its layers are those that it needs. Transfer does not depend on
the environment, so variants in other light read and bake the same layers where their plans are of one kind. What is cut
open is another volume, which those in other light share; so is another step of a series in time.
"""

import asyncio
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING

from isogi_core.errors import LightError, SceneError, VolumeError
from isogi_core.files.scene_file import HIDDEN, Clears, read_clears
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.model.window import read_window
from isogi_core.plan.assembly import at_time, cut_open, under
from isogi_core.plan.scene import Scene
from isogi_core.plan.sides import with_clears
from isogi_core.plan.volumes.cuts import cut_digest
from server.errors import ParameterError
from server.values import shown

if TYPE_CHECKING:
    from server.render.engine import RenderEngine

MARK = "@"
"""Between a scene's id and what a variant is named by; ids of scenes have none."""

BESIDE = "~"
"""Between the environment that a variant is named by, and what its pinned surfaces let pass."""

STEP = "+"
"""Between the environment that a variant is named by, and its step in time."""

MOST = 64
"""Variants that an engine has at a time: those asked for last."""

MOST_CUTS = 4
"""Those of them that are cut open: each has voxels of its own."""

MOST_STEPS = 2
"""Those of them at other times than their scene's: so many steps' voxels are in memory besides the scene's own."""


Place = Callable[[str], str | None]
"""What gives an environment as scene files name it, by its name or id; None where there is none."""


def own_name(scene: str) -> str:
    """The id of the scene that one with this id is a variant of; its own where it is none."""
    return scene.partition(MARK)[0]


def variant_name(
    scene: str, environment: str | None, cut: str | None, time: int | None = None, clears: Clears | None = None
) -> str:
    """The id of the variant of a ``scene`` in an environment, with a cut, at a time, and with pinned surfaces that
    ``clears`` pass; of these one is given.
    """
    beside = "" if clears is None else BESIDE + ",".join(HIDDEN if each is None else f"{each!r}" for each in clears)
    lit = f"{scene}{MARK}{environment or ''}{beside}{'' if time is None else f'{STEP}{time}'}"
    if cut is None:
        return lit
    return f"{lit}{MARK}{hashlib.blake2b(repr(read_window(cut)).encode(), digest_size=6).hexdigest()}"


def is_cut(variant: str) -> bool:
    """Whether the variant with this id is cut open."""
    return variant.count(MARK) > 1


def step_of(variant: str) -> str:
    """The step in time of the variant with this id, empty where it is its scene's own."""
    return variant.partition(MARK)[2].partition(MARK)[0].partition(STEP)[2]


def same_series(other: str, scene: Scene) -> bool:
    """Whether the ``other`` scene, by its id, differs from a ``scene`` in its step in time; neither is cut open."""
    lit = [(own_name(each), each.partition(MARK)[2].partition(STEP)[0]) for each in (other, scene.id)]
    differ = other != scene.id and scene.volume.moment[1] > 1
    return differ and lit[0] == lit[1] and not is_cut(other) and not is_cut(scene.id)


def whole_name(variant: str) -> str:
    """The id of the same scene in the same light that is not cut open: a variant, or the scene itself."""
    return variant.rpartition(MARK)[0].removesuffix(MARK)


class Variants:
    """The variants of an ``engine``. Safe to use from many threads."""

    def __init__(self, engine: "RenderEngine", place: Place, most: int = MOST, most_cuts: int = MOST_CUTS) -> None:
        """None yet; ``place`` tells where an environment is.

        When there are more than ``most``, or more than ``most_cuts`` that are cut open, the engine dismisses what was
        asked for longest ago.
        """
        self._engine, self._place, self._most, self._most_cuts = engine, place, most, most_cuts
        self._asked: OrderedDict[str, None] = OrderedDict()
        self._making, self._lock = threading.Lock(), threading.Lock()

    async def of(
        self,
        scene: Scene,
        environment: str | None,
        cut: str | None = None,
        time: int | None = None,
        surfaces: str | None = None,
    ) -> Scene:
        """The scene in the environment of this name, or id, with a ``cut``, at a ``time`` and with other ``surfaces``;
        itself without these.

        It is made off the event loop where there is none yet. Raises ParameterError where there is no such environment,
        and as ``make`` does.
        """
        time = None if time == scene.volume.moment[0] else time
        if environment is None and cut is None and time is None and surfaces is None:
            return scene
        place = None if environment is None else self._place(environment)
        if place is None and environment is not None:
            names = ", ".join(ENVIRONMENTS)
            sentence = f"environment must be one of {names}, or the id of one that was uploaded, not"
            raise ParameterError(f"{sentence} {shown(environment)}.", "environment")
        clears = None if surfaces is None else self._clears(scene, surfaces)
        name = variant_name(scene.id, environment, cut, time, clears)
        known = self.known(name)
        if known is not None:
            return known
        return await asyncio.to_thread(self.make, scene, name, place, cut, time, clears)

    def known(self, name: str) -> Scene | None:
        """The variant of this id, where there is one already; never waits long."""
        known = self._engine.scenes.get(name)
        if known is not None:
            with self._lock:
                self._asked[known.id] = None
                self._asked.move_to_end(known.id)
        return known

    def make(
        self,
        scene: Scene,
        name: str,
        environment: str | None,
        cut: str | None = None,
        time: int | None = None,
        clears: Clears | None = None,
    ) -> Scene:
        """The scene in an ``environment``, as scene files name it, with a ``cut``, at a ``time`` and with ``clears`` of
        its pinned surfaces; ``name`` is its id.

        Raises ParameterError where the scene's own choices do not fit that light, its file is damaged, or the volume
        cannot be cut so.
        """
        with self._making:
            if (known := self.known(name)) is not None:
                return known
            made = scene if time is None else self._at(scene, name, time)
            made = made if clears is None else with_clears(made, clears, name)
            made = made if environment is None else self._lit(made, name, environment)
            made = made if cut is None else self._cut(made, name, cut)
            self._engine.admit(made)
        self.known(name)
        for each in (each for each in self._outdated() if each in self._engine.scenes):
            self._engine.dismiss(each)
        return made

    def _outdated(self) -> list[str]:
        """Those that are too many: they count as not asked for."""
        with self._lock:
            cuts = [each for each in self._asked if is_cut(each)]
            old = cuts[: max(len(cuts) - self._most_cuts, 0)]
            steps = list(dict.fromkeys((own_name(each), step_of(each)) for each in reversed(self._asked)))
            late = [each for each in steps if each[1]][MOST_STEPS:]
            old += [each for each in self._asked if each not in old and (own_name(each), step_of(each)) in late]
            rest = [each for each in self._asked if each not in old]
            old += rest[: max(len(rest) - self._most, 0)]
            for each in old:
                del self._asked[each]
        return old

    def _at(self, scene: Scene, name: str, time: int) -> Scene:
        """The scene at another time, with the voxels of a variant that has them already."""
        kin = [each for each in list(self._engine.scenes.values()) if own_name(each.id) == scene.id]
        step = next((each.volume for each in kin if step_of(each.id) == str(time) and not is_cut(each.id)), None)
        try:
            return at_time(scene, time, name, step)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "time") from None

    @staticmethod
    def _clears(scene: Scene, surfaces: str) -> Clears:
        try:
            return read_clears(surfaces, len(scene.pinned))
        except SceneError as error:
            raise ParameterError(str(error), "surfaces") from None

    @staticmethod
    def _lit(scene: Scene, name: str, environment: str) -> Scene:
        try:
            return under(scene, environment, name)
        except (SceneError, LightError) as error:
            raise ParameterError(f"This scene cannot be shown in that environment: {error}", "environment") from None

    def _cut(self, scene: Scene, name: str, cut: str) -> Scene:
        try:
            digest = cut_digest(scene.volume, cut)
            volume = next((each.volume for each in self._engine.scenes.values() if each.volume.digest == digest), None)
            return cut_open(scene, cut, name, volume)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "cut") from None
