"""Variants: an engine's scenes in other light, at other times, of other materials, with other surfaces, without some
labels, or cut open, each made when asked for.

A variant is a scene like any other: it has a plan, and its layers are those that it needs. Transfer does not depend on
the environment, so variants in other light read and bake the same layers where their plans are of one kind. What is cut
open is another volume, which those in other light share; so is another step of a series in time, and a segmentation
that hides other labels.
"""

import asyncio
import hashlib
import math
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from isogi_core.errors import LightError, SceneError, VolumeError
from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.files.scene_changes import (
    HIDDEN,
    Clears,
    Hidden,
    MaterialSettings,
    read_clears,
    read_hidden,
    read_material_text,
    write_material_text,
)
from isogi_core.frame.entry_kernels import frame_kernels, other_kernels
from isogi_core.kernels._compilation import warm
from isogi_core.kernels._jit import entries_of
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.model.window import read_window
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import at_time, cut_open, made_of, under, with_clears, with_hidden, with_material
from isogi_core.plan.volumes.cuts import cut_digest
from server.errors import BusyError, ParameterError
from server.values import shown

if TYPE_CHECKING:
    from server.render.engine import RenderEngine

MARK = "@"
"""Between a scene's id and what a variant is named by; ids of scenes have none."""

BESIDE = "~"
"""Between the environment that a variant is named by, and what its pinned surfaces let pass."""

MADE_OF = "="
"""Between the environment that a variant is named by, and its material."""

STEP_MARK = "+"
"""Between the environment that a variant is named by, and its step in time."""

WITHOUT = "!"
"""Between the environment that a variant is named by, and the labels that are hidden."""

MAX_VARIANTS = 64
"""Variants that an engine has at a time: those asked for last."""

MOST_CUTS = 4
"""Variants at a time that are cut open or hide labels, where their voxels are more than there is room for."""

MOST_STEPS = 2
"""Steps of those at other times than their scene's, where their voxels are more than there is room for."""

REMEMBERED = 4096
"""Variants whose change is known after they made way: those made last."""


VARIANTS_TAKEN = "Others asked for cuts, or other changes of scenes, before you: ask again in a while."
COMPILING = "What draws the surface of this material is being compiled, once on this machine: ask again in a while."

Place = Callable[[str], str | None]
"""What gives an environment as scene files name it, by its name or id; None where there is none."""

T = TypeVar("T")


@dataclass(frozen=True)
class Change:
    """What a request changes of a scene, as its parameters spell it; None of what stays.

    The ``environment`` by its name or id, the planes of a ``cut``, the step in ``time``, what pinned ``surfaces`` let
    pass, the labels to ``hide``, and the ``material`` with its numbers.
    """

    environment: str | None = None
    cut: str | None = None
    time: int | None = None
    surfaces: str | None = None
    hide: str | None = None
    material: str | None = None

    def clears(self, pinned: int) -> Clears | None:
        """What so many ``pinned`` surfaces let pass. Raises ParameterError."""
        given = self.surfaces
        return None if given is None else _read("surfaces", lambda text: read_clears(text, pinned), given)

    @property
    def hidden(self) -> Hidden | None:
        """The labels that are hidden. Raises ParameterError."""
        return None if self.hide is None else _read("hide", read_hidden, self.hide)

    @property
    def made_of(self) -> MaterialSettings | None:
        """The settings of the material. Raises ParameterError."""
        return None if self.material is None else _read("material", read_material_text, self.material)

    def apart_from(self, scene: Scene) -> "Change":
        """The change without what a ``scene`` has by itself. Raises ParameterError."""
        time = None if self.time == scene.volume.moment[0] else self.time
        own = self.made_of is not None and made_of(scene, self.made_of)
        return replace(self, time=time, material=None if own else self.material)


def _read(name: str, read: Callable[[str], T], text: str) -> T:
    """What a parameter's ``text`` says, as it is ``read``; ParameterError where that cannot be."""
    try:
        return read(text)
    except SceneError as error:
        raise ParameterError(str(error), name) from None


def own_name(scene: str) -> str:
    """The id of the scene that one with this id is a variant of; its own where it is none."""
    return scene.partition(MARK)[0]


def variant_name(scene: Scene, change: Change) -> str:
    """The id of the variant of a ``scene`` that a ``change`` makes. Raises ParameterError."""
    clears, hidden, made = change.clears(len(scene.surfaces.pinned)), change.hidden, change.made_of
    beside = "" if clears is None else BESIDE + ",".join(HIDDEN if each is None else f"{each!r}" for each in clears)
    without = "" if hidden is None else WITHOUT + ",".join(map(str, hidden))
    material = "" if made is None else MADE_OF + write_material_text(made)
    step = "" if change.time is None else f"{STEP_MARK}{change.time}"
    lit = f"{scene.id}{MARK}{change.environment or ''}{beside}{material}{without}{step}"
    if change.cut is None:
        return lit
    return f"{lit}{MARK}{hashlib.blake2b(repr(read_window(change.cut)).encode(), digest_size=16).hexdigest()}"


def is_cut(variant: str) -> bool:
    """Whether the variant with this id is cut open."""
    return variant.count(MARK) > 1


def step_of(variant: str) -> str:
    """The step in time of the variant with this id, empty where it is its scene's own."""
    return variant.partition(MARK)[2].partition(MARK)[0].partition(STEP_MARK)[2]


def labels_of(variant: str) -> str:
    """The labels that the variant with this id hides, with a WITHOUT before them; empty where they are its scene's."""
    lit = variant.partition(MARK)[2].partition(MARK)[0].partition(STEP_MARK)[0]
    return "".join(lit.partition(WITHOUT)[1:])


def has_voxels(variant: str) -> bool:
    """Whether the variant with this id has voxels of its own, but for its step in time."""
    return is_cut(variant) or bool(labels_of(variant))


def may_lend(other: str, scene: str) -> bool:
    """Whether the light of the ``other`` variant may stand in for that of one, by their ids.

    They differ in their step in time and in which labels are hidden alone, and neither is cut open.
    """
    lit = [(own_name(each), re.split(MAY_DIFFER, each.partition(MARK)[2])[0]) for each in (other, scene)]
    return other != scene and lit[0] == lit[1] and not is_cut(other) and not is_cut(scene)


MAY_DIFFER = f"[{WITHOUT}{STEP_MARK}]"
"""From where on names of variants differ that lend each other light."""


def whole_name(variant: str) -> str:
    """The id of the same scene in the same light that is not cut open: a variant, or the scene itself."""
    return variant.rpartition(MARK)[0].removesuffix(MARK)


class Variants:
    """The variants of an ``engine``. Safe to use from many threads."""

    def __init__(
        self,
        engine: "RenderEngine",
        place: Place,
        most: int = MAX_VARIANTS,
        most_cuts: int = MOST_CUTS,
        room: int | None = None,
        patience: float = math.inf,
    ) -> None:
        """None yet; ``place`` finds where an environment is.

        When there are more than ``most``, the engine dismisses what was asked for longest ago. Voxels of cuts, and
        of steps, may take ``room`` bytes: by default what volumes in memory may take, MOST_CUTS times. Beyond that
        there are ``most_cuts`` that have voxels of their own. What made way is made again when the engine needs it.
        One is made at a time, and whoever asks waits for ``patience`` seconds at most.
        """
        self._engine, self._place, self._most, self._most_cuts = engine, place, most, most_cuts
        self._room = int(MOST_CUTS * UNMAPPED_SHARE * budget()) if room is None else room
        self._asked: OrderedDict[str, None] = OrderedDict()
        self._made: OrderedDict[str, tuple[Change, str | None]] = OrderedDict()
        engine.again = self.again
        self._making, self._lock = threading.Lock(), threading.Lock()
        self._turn, self._patience = asyncio.Lock(), patience
        self._compiling: threading.Thread | None = None

    async def of(self, scene: Scene, change: Change) -> Scene:
        """The scene that a ``change`` makes of one; itself where nothing changes.

        It is made off the event loop where there is none yet. Raises ParameterError where there is no such environment,
        BusyError where too many others are made before, and as ``make`` does.
        """
        change = change.apart_from(scene)
        if change == Change():
            return scene
        environment = change.environment
        place = None if environment is None else self._place(environment)
        if place is None and environment is not None:
            names = ", ".join(ENVIRONMENTS)
            sentence = f"environment must be one of {names}, or the id of one that was uploaded, not"
            raise ParameterError(f"{sentence} {shown(environment)}.", "environment")
        if (known := self.known(variant_name(scene, change))) is not None:
            return known
        try:
            async with asyncio.timeout(None if math.isinf(self._patience) else self._patience):
                await self._turn.acquire()
        except TimeoutError:
            raise BusyError(VARIANTS_TAKEN) from None
        try:
            return await asyncio.to_thread(self.make, scene, change, place)
        finally:
            self._turn.release()

    def known(self, name: str) -> Scene | None:
        """The variant of this id, where there is one already; never waits long."""
        known = self._engine.scenes.get(name)
        if known is not None:
            with self._lock:
                self._asked[known.id] = None
                self._asked.move_to_end(known.id)
        return known

    def again(self, name: str) -> Scene | None:
        """The variant of this id, made again where it made way for others; None where it is none, or its scene is gone.

        Raises as ``make`` does.
        """
        scene, made = self._engine.scenes.get(own_name(name)), self._made.get(name)
        return None if scene is None or made is None else self.make(scene, *made)

    def make(self, scene: Scene, change: Change, place: str | None) -> Scene:
        """The scene that a ``change`` makes of one, in the environment at a ``place``, as scene files name it.

        Raises ParameterError where the scene's own choices do not fit that light, its file is damaged, or the volume
        cannot be shown so, and BusyError while kernels of another material are compiled.
        """
        name, clears = variant_name(scene, change), change.clears(len(scene.surfaces.pinned))
        with self._making:
            if (known := self.known(name)) is not None:
                return known
            made = scene if change.time is None else self._at(scene, name, change.time)
            made = made if change.hidden is None else self._hiding(made, name, change.hidden)
            made = made if clears is None else with_clears(made, clears, name)
            made = made if change.made_of is None else self._made_of(made, name, change.made_of)
            made = made if place is None else self._lit(made, name, place)
            made = made if change.cut is None else self._cut(made, name, change.cut)
            if made.surfaces.material != scene.surfaces.material:
                self._check_compiled(scene, made)
            self._engine.admit(made)
            self._remember(name, change, place)
        self.known(name)
        for each in (each for each in self._outdated() if each in self._engine.scenes):
            self._engine.dismiss(each)
        return made

    def _check_compiled(self, scene: Scene, made: Scene) -> None:
        """Raise BusyError while kernels are compiled that a scene ``made`` of another calls; that begins where some
        never were. Those that pictures of the other ``scene`` call are the engine's own work.
        """
        others = set(other_kernels([made])) - set(other_kernels([scene]))
        kernels = (*frame_kernels([made]), *others)
        if all(kernel.loaded or kernel.stored for kernel in entries_of(kernels)):
            return
        if self._compiling is None or not self._compiling.is_alive():
            self._compiling = threading.Thread(target=warm, args=[kernels], name="compiling", daemon=True)
            self._compiling.start()
        raise BusyError(COMPILING)

    def _outdated(self) -> list[str]:
        """The variants that are too many: they count as not asked for."""
        with self._lock:
            cuts = [each for each in self._asked if has_voxels(each)]
            old = cuts[: max(len(cuts) - self._most_cuts, 0)] if self._crowded(cuts) else []
            steps = list(dict.fromkeys((own_name(each), step_of(each)) for each in reversed(self._asked)))
            late = [each for each in steps if each[1]][MOST_STEPS:]
            at_these = [each for each in self._asked if (own_name(each), step_of(each)) in late]
            old += [each for each in at_these if each not in old] if self._crowded(self._asked) else []
            rest = [each for each in self._asked if each not in old]
            old += rest[: max(len(rest) - self._most, 0)]
            for each in old:
                del self._asked[each]
        return old

    def _remember(self, name: str, change: Change, place: str | None) -> None:
        self._made[name] = change, place
        self._made.move_to_end(name)
        if len(self._made) > REMEMBERED:
            self._made.popitem(last=False)

    def _crowded(self, names: Iterable[str]) -> bool:
        """Whether the voxels of these variants are more than there is room for; their scenes' own do not count."""
        scenes = self._engine.scenes
        volumes = [scenes[each].volume for each in names if each in scenes]
        own = {id(each.volume.voxels) for each in scenes.values() if MARK not in each.id}
        sizes = {id(each.voxels): each.voxels.nbytes for each in volumes if id(each.voxels) not in own}
        return sum(sizes.values()) > self._room

    def _at(self, scene: Scene, name: str, time: int) -> Scene:
        """The scene at another time, with the voxels of a variant that has them already."""
        kin = [each for each in list(self._engine.scenes.values()) if own_name(each.id) == scene.id]
        step = next((each.volume for each in kin if step_of(each.id) == str(time) and not has_voxels(each.id)), None)
        try:
            return at_time(scene, time, name, step)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "time") from None

    def _hiding(self, scene: Scene, name: str, hidden: Hidden) -> Scene:
        """The scene with other labels hidden, with the voxels of a variant that has them already."""
        voxels = own_name(name), labels_of(name), step_of(name)
        whole = [each for each in list(self._engine.scenes.values()) if not is_cut(each.id)]
        like = next((x for x in whole if (own_name(x.id), labels_of(x.id), step_of(x.id)) == voxels), None)
        try:
            return with_hidden(scene, hidden, name, like)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "hide") from None

    @staticmethod
    def _made_of(scene: Scene, name: str, settings: MaterialSettings) -> Scene:
        try:
            return with_material(scene, settings, name)
        except SceneError as error:
            raise ParameterError(str(error), "material") from None

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
