"""Variants: an engine's scenes in other light, at other times, of other materials, with other
surfaces, without some labels, or cut open, each made when asked for.

A variant is a scene like any other: it has a plan, and its layers are those that it needs. Transfer
does not depend on the environment, so variants in other light read and bake the same layers where
their plans are of one kind. What is cut open is another volume, which those in other light share;
so is another step of a series in time, and a segmentation that hides other labels.
"""

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from dataclasses import replace

from isogi_core.errors import LightError, SceneError, VolumeError
from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.files.scene_file import Hidden, MaterialSettings
from isogi_core.frame.entry_kernels import frame_kernels, other_kernels
from isogi_core.kernels._compilation import warm
from isogi_core.kernels._jit import entries_of
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import (
    at_time,
    cut_open,
    smoothed_by,
    under,
    with_clears,
    with_hidden,
    with_material,
)
from isogi_core.plan.volumes.masks import cut_digest
from server.errors import BusyError, ParameterError
from server.render.engine import RenderEngine
from server.render.scene_variant import Change, SceneVariant
from server.render.scheduling import Rank, Renders
from server.values import shown

MAX_VARIANTS = 64
"""Variants that an engine has at a time: those asked for last."""

MOST_CUTS = 4
"""Variants at a time that are cut open or hide labels, where their voxels are more than there is
room for.
"""

MOST_STEPS = 2
"""Steps of those at other times than their scene's, where their voxels are more than there is room
for.
"""

VARIANTS_TAKEN = (
    "Others asked for cuts, or other changes of scenes, before you: ask again in a while."
)
MATERIAL_COMPILING = (
    "What draws the surface of this material is being compiled, once on this "
    "machine: ask again in a while."
)

Place = Callable[[str], str | None]
"""What gives an environment as scene files name it, by its name or id; None where there is none."""


class Variants:
    """The variants of an ``engine``. Safe to use from many threads."""

    def __init__(
        self,
        engine: RenderEngine,
        place: Place,
        most: int = MAX_VARIANTS,
        most_cuts: int = MOST_CUTS,
        room: int | None = None,
        patience: float = math.inf,
    ) -> None:
        """None yet; ``place`` finds where an environment is.

        When there are more than ``most``, the engine dismisses what was asked for longest ago.
        Voxels of cuts, and of steps, may take ``room`` bytes: by default what volumes in memory may
        take, MOST_CUTS times. Beyond that there are ``most_cuts`` that have voxels of their own.
        What made way is made again when the engine needs it. One is made at a time, in turns of the
        clients that ask, each of which waits for ``patience`` seconds at most.
        """
        self._engine = engine
        self._place = place
        self._most = most
        self._most_cuts = most_cuts
        if room is None:
            self._room = int(MOST_CUTS * UNMAPPED_SHARE * budget())
        else:
            self._room = room
        self._asked: OrderedDict[str, None] = OrderedDict()
        engine.again = self.again
        self._making = threading.Lock()
        self._lock = threading.Lock()
        self._turns = Renders(1, late=VARIANTS_TAKEN)
        self._patience = patience
        self._compiling: threading.Thread | None = None

    async def of(self, scene: Scene, change: Change, client: Hashable = None) -> Scene:
        """The scene that a ``change`` makes of one; itself where nothing changes.

        It is made off the event loop where there is none yet, when it is the turn of the
        ``client``. Raises ParameterError where there is no such environment, BusyError where too
        many others are made before, and as ``make`` does.
        """
        variant = SceneVariant.of(scene, change)
        if not variant.any:
            return scene
        place = self._placed(variant)
        if (known := self.known(variant.id)) is not None:
            return known
        turn = Rank.within(0.0, self._patience, self._turns.client(client, 1.0))
        return await self._turns.run(lambda: self.make(scene, variant, place), turn)

    def close(self) -> None:
        """Make no more."""
        self._turns.close()

    def _placed(self, variant: SceneVariant) -> str | None:
        """Where a variant's environment is; None where it is its scene's. ParameterError where
        there is none.
        """
        if variant.environment is None:
            return None
        if (place := self._place(variant.environment)) is None:
            names = ", ".join(ENVIRONMENTS)
            sentence = (
                f"environment must be one of {names}, or the id of one that was uploaded, not"
            )
            raise ParameterError(f"{sentence} {shown(variant.environment)}.", "environment")
        return place

    def known(self, name: str) -> Scene | None:
        """The variant of this id, where there is one already; never waits long."""
        known = self._engine.scenes.get(name)
        if known is not None:
            with self._lock:
                self._asked[known.id] = None
                self._asked.move_to_end(known.id)
        return known

    def again(self, name: str) -> Scene | None:
        """The variant of this id, made again where it made way for others; None where it is none,
        or its scene is gone.

        Raises as ``make`` does.
        """
        variant = self._engine.variant(name)
        scene = self._engine.scenes.get(variant.base)
        if scene is None or not variant.any:
            return None
        return self.make(scene, variant, self._placed(variant))

    def make(self, scene: Scene, variant: SceneVariant, place: str | None) -> Scene:
        """The ``variant`` of a scene, in the environment at a ``place``, as scene files name it.

        Raises ParameterError where the scene's own choices do not fit that light, its file is
        damaged, or the volume cannot be shown so, and BusyError while kernels of another material
        are compiled.
        """
        name = variant.id
        settings = variant.settings
        with self._making:
            if (known := self.known(name)) is not None:
                return known
            if variant.time is None:
                made = scene
            else:
                made = self._at(scene, variant, variant.time)
            if variant.smooth is not None:
                made = self._smoothed(made, variant, variant.smooth)
            if variant.hidden is not None:
                made = self._hiding(made, variant, variant.hidden)
            if variant.clears is not None:
                made = with_clears(made, variant.clears, name)
            if settings is not None:
                made = self._made_of(made, name, settings)
            if place is not None:
                made = self._lit(made, name, place)
            if variant.cut is not None:
                made = self._cut(made, name, variant.cut)
            if made.surfaces.material != scene.surfaces.material:
                self._check_compiled(scene, made)
            self._engine.admit(made, variant)
        self.known(name)
        for each in (each for each in self._outdated() if each in self._engine.scenes):
            self._engine.dismiss(each)
        return made

    def _check_compiled(self, scene: Scene, made: Scene) -> None:
        """Raise BusyError while kernels are compiled that a scene ``made`` of another calls; that
        begins where some never were. Those that pictures of the other ``scene`` call are the
        engine's own work.
        """
        others = set(other_kernels([made])) - set(other_kernels([scene]))
        kernels = (*frame_kernels([made]), *others)
        if all(kernel.loaded or kernel.stored for kernel in entries_of(kernels)):
            return
        if self._compiling is None or not self._compiling.is_alive():
            self._compiling = threading.Thread(
                target=warm, args=[kernels], name="compiling", daemon=True
            )
            self._compiling.start()
        raise BusyError(MATERIAL_COMPILING, "compiling")

    def _outdated(self) -> list[str]:
        """The variants that are too many: they count as not asked for."""
        with self._lock:
            asked = {each: self._engine.variant(each) for each in self._asked}
            cuts = [each for each in asked if asked[each].has_voxels]
            if self._crowded(cuts):
                old = cuts[: max(len(cuts) - self._most_cuts, 0)]
            else:
                old = []
            steps = {
                (each.base, each.time): None
                for each in reversed(asked.values())
                if each.time is not None
            }
            late = list(steps)[MOST_STEPS:]
            at_these = [
                each for each, variant in asked.items() if (variant.base, variant.time) in late
            ]
            if self._crowded(self._asked):
                old += [each for each in at_these if each not in old]
            rest = [each for each in self._asked if each not in old]
            old += rest[: max(len(rest) - self._most, 0)]
            for each in old:
                del self._asked[each]
        return old

    def _crowded(self, names: Iterable[str]) -> bool:
        """Whether the voxels of these variants are more than there is room for; their scenes' own
        do not count.
        """
        scenes = self._engine.scenes
        volumes = [scenes[each].volume for each in names if each in scenes]
        own = {id(each.volume.voxels) for each in self._engine.own_scenes}
        sizes = {
            id(each.voxels): each.voxels.nbytes for each in volumes if id(each.voxels) not in own
        }
        return sum(sizes.values()) > self._room

    def _like(self, variant: SceneVariant) -> Scene | None:
        """A variant that has the voxels of one already, but for a cut."""
        kin = ((each, self._engine.variant(each.id)) for each in list(self._engine.scenes.values()))
        return next(
            (each for each, its in kin if its.cut is None and its.voxels == variant.voxels), None
        )

    def _at(self, scene: Scene, variant: SceneVariant, time: int) -> Scene:
        """The scene at another time, with the voxels of a variant that has them already."""
        like = self._like(replace(variant, hidden=None, smooth=None))
        try:
            return at_time(scene, time, variant.id, like.volume if like else None)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "time") from None

    def _smoothed(self, scene: Scene, variant: SceneVariant, sigma: float) -> Scene:
        """The scene smoothed otherwise, with the voxels of a variant that has them already."""
        like = self._like(replace(variant, hidden=None))
        try:
            return smoothed_by(scene, sigma, variant.id, like.volume if like else None)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "smooth") from None

    def _hiding(self, scene: Scene, variant: SceneVariant, hidden: Hidden) -> Scene:
        """The scene with other labels hidden, with the voxels of a variant that has them
        already.
        """
        try:
            return with_hidden(scene, hidden, variant.id, self._like(variant))
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
            raise ParameterError(
                f"This scene cannot be shown in that environment: {error}", "environment"
            ) from None

    def _cut(self, scene: Scene, name: str, cut: str) -> Scene:
        try:
            digest = cut_digest(scene.volume, cut)
            volume = next(
                (
                    each.volume
                    for each in self._engine.scenes.values()
                    if each.volume.digest == digest
                ),
                None,
            )
            return cut_open(scene, cut, name, volume)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "cut") from None
