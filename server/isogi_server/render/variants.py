"""Variants of an engine's scenes, made on request: other light, time, material or surfaces, hidden
labels, a cut, or a turn of light that is baked for each turn.

A variant is a scene like any other, with a plan and the layers that it needs. Transfer does not
depend on the environment: variants in other light read and bake the same layers if their plans are
of one kind. A cut makes another volume, as do another step of a series in time and other hidden
labels of a segmentation; variants that differ in light alone share it.
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
    turned_by,
    under,
    with_clears,
    with_hidden,
    with_material,
)
from isogi_core.plan.volumes.masks import cut_digest
from isogi_server.errors import BusyError, ParameterError
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change, SceneVariant
from isogi_server.render.scheduling import Rank, Renders
from isogi_server.values import shown

MAX_VARIANTS = 64
"""Variants of an engine at a time: the ones asked for last."""

MOST_CUTS = 4
"""Variants that are cut, smoothed or hide labels, at a time, if their voxels take more memory
than is set aside for them (``room`` of Variants).
"""

MOST_STEPS = 2
"""Time steps other than their scene's, of all variants at a time, if all voxels of variants take
more memory than is set aside for them (``room`` of Variants).
"""

MOST_TURNS = 8
"""Variants in turned light at a time: each has an environment with an image of its own, some 10 MB.
"""

VARIANTS_TAKEN = (
    "Others asked for cuts, or other changes of scenes, before you: ask again in a while."
)
MATERIAL_COMPILING = (
    "What draws the surface of this material is being compiled, once on this "
    "machine: ask again in a while."
)

Place = Callable[[str], str | None]
"""Returns the place of an environment by its name or id: the text by which scene files name it,
such as the path of an uploaded file. None if there is no such environment.
"""


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
        """Make none yet; ``place`` finds environments.

        ``most`` variants are kept; the engine dismisses those asked for longest ago, and makes them
        again if it needs them. Voxels of variants may take ``room`` bytes, by default MOST_CUTS
        times the size of the largest volume that is not mapped to a file. Above that, ``most_cuts``
        variants that are cut, smoothed or hide labels are kept, and those of MOST_STEPS time steps.

        Variants are made one at a time, so that each finds the voxels that an earlier one has
        computed and shares them. Clients take turns, and a request waits for its turn for at most
        ``patience`` seconds.
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
        self._queue = Renders(1, late=VARIANTS_TAKEN)
        self._patience = patience
        self._compiling: threading.Thread | None = None

    async def of(self, scene: Scene, change: Change, client: Hashable = None) -> Scene:
        """Return the scene that a ``change`` makes of ``scene``, made now if there is none yet; the
        scene itself if nothing changes.

        It is made off the event loop when it is the turn of the ``client``. Raises ParameterError
        if there is no such environment, BusyError if the variants of others take too long, and the
        errors of ``make``.
        """
        variant = SceneVariant.of(scene, change)
        unturned = await self._find_or_make(scene, variant.unturned, client)
        # Unless light is baked for each turn, views turn the light of the unturned scene: all turns
        # share it. The environment, material and plan of that scene decide, so make it first.
        if variant.turn is None or not unturned.lighting.baked_by_turn:
            return unturned
        return await self._find_or_make(scene, variant, client)

    async def _find_or_make(self, scene: Scene, variant: SceneVariant, client: Hashable) -> Scene:
        """Return a ``variant`` of the scene, made on the thread of the queue if there is none yet.
        Raises as ``of`` does.
        """
        # Do not queue if nothing is to be made, or if the environment's name is wrong.
        if not variant.any:
            return scene
        place = self._placed(variant)
        if (known := self.known(variant.id)) is not None:
            return known
        # Every client has the same weight, 1, and all its variants are equally urgent, due in 0 s.
        # A request gives up if it has not had its turn after ``patience`` seconds.
        rank = Rank.within(0.0, longest=self._patience, client=self._queue.client(client, 1.0))
        return await self._queue.run(lambda: self.make(scene, variant, place), rank)

    def close(self) -> None:
        """Make no more variants."""
        self._queue.close()

    def _placed(self, variant: SceneVariant) -> str | None:
        """Return a variant's environment as scene files name it; None if it is its scene's.
        Raises ParameterError if there is no such environment.
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
        """Return the variant with this id if it is made; note that it was asked for. Never
        waits long.
        """
        known = self._engine.scenes.get(name)
        if known is not None:
            with self._lock:
                self._asked[known.id] = None
                self._asked.move_to_end(known.id)
        return known

    def again(self, name: str) -> Scene | None:
        """Make the variant with this id again, after it was dismissed. None if the id is no
        variant's, or if its scene is gone. Raises as ``make`` does.

        The engine calls this when a client asks for a frame of it by the id. An id holds only a
        digest of a cut, so the engine remembers the changes of the variants that it dismissed.
        """
        variant = self._engine.variant(name)
        scene = self._engine.scenes.get(variant.base)
        if scene is None or not variant.any:
            return None
        return self.make(scene, variant, self._placed(variant))

    def make(self, scene: Scene, variant: SceneVariant, place: str | None) -> Scene:
        """Make the ``variant`` of a scene, in the environment ``place`` as scene files name it, and
        admit it to the engine.

        Raises ParameterError if the variant contradicts settings of the scene, if a file is
        damaged, or if the volume cannot be changed so; and BusyError while kernels for its material
        are compiled.
        """
        name = variant.id
        settings = variant.settings
        with self._making:
            if (known := self.known(name)) is not None:
                return known
            # Apply changes of the voxels before those of the light, and the cut last, as it takes
            # the voxels as they then are.
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
            if variant.turn is not None:
                made = turned_by(made, variant.turn, name)
            if variant.cut is not None:
                made = self._cut(made, name, variant.cut)
            if made.surfaces.material != scene.surfaces.material:
                self._check_compiled(scene, made)
            self._engine.admit(made, variant)
        # Admit first, then dismiss: the variant counts as the one asked for last.
        self.known(name)
        for each in (each for each in self._outdated() if each in self._engine.scenes):
            self._engine.dismiss(each)
        return made

    def _check_compiled(self, scene: Scene, made: Scene) -> None:
        """Raise BusyError while kernels are compiled that pictures of the scene ``made`` call;
        start to compile them if need be.

        Kernels that pictures of the former ``scene`` call too are compiled by the engine.
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
        """Return the variants that are to be dismissed because there are too many, and forget
        that they were asked for.
        """
        with self._lock:
            asked = {each: self._engine.variant(each) for each in self._asked}
            # If voxels of cuts take more than their room, keep the newest cuts.
            cuts = [each for each in asked if asked[each].has_voxels]
            if self._crowded(cuts):
                old = cuts[: max(len(cuts) - self._most_cuts, 0)]
            else:
                old = []
            # Keep the newest turns of the light.
            turned = [each for each in asked if asked[each].turn is not None and each not in old]
            old += turned[: max(len(turned) - MOST_TURNS, 0)]
            # If those of all take more, keep the variants of the newest time steps.
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
            # Of the others, keep as many as there may be.
            rest = [each for each in self._asked if each not in old]
            old += rest[: max(len(rest) - self._most, 0)]
            for each in old:
                del self._asked[each]
        return old

    def _crowded(self, names: Iterable[str]) -> bool:
        """Return True if the voxels of the variants with these ``names`` (ids) take more than
        ``_room`` bytes together. Voxels that variants share count once; those that they share with
        a scene that is no variant do not count, as they stay in memory without the variants, too.
        """
        scenes = self._engine.scenes
        volumes = [scenes[each].volume for each in names if each in scenes]
        own = {id(each.volume.voxels) for each in self._engine.own_scenes}
        sizes = {
            id(each.voxels): each.voxels.nbytes for each in volumes if id(each.voxels) not in own
        }
        return sum(sizes.values()) > self._room

    def _like(self, variant: SceneVariant) -> Scene | None:
        """Return a scene that has the voxels of a variant, before its cut; None if there is
        none.
        """
        for scene in list(self._engine.scenes.values()):
            other = self._engine.variant(scene.id)
            if other.cut is None and other.voxels == variant.voxels:
                return scene
        return None

    def _at(self, scene: Scene, variant: SceneVariant, time: int) -> Scene:
        """Return the scene at another time step, with the voxels of a scene that has them
        already, if there is one.
        """
        like = self._like(replace(variant, hidden=None, smooth=None))
        try:
            return at_time(scene, time, variant.id, like.volume if like else None)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "time") from None

    def _smoothed(self, scene: Scene, variant: SceneVariant, sigma: float) -> Scene:
        """Return the scene smoothed by ``sigma`` voxels, with the voxels of a scene that has
        them already, if there is one.
        """
        like = self._like(replace(variant, hidden=None))
        try:
            return smoothed_by(scene, sigma, variant.id, like.volume if like else None)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "smooth") from None

    def _hiding(self, scene: Scene, variant: SceneVariant, hidden: Hidden) -> Scene:
        """Return the scene with other labels hidden, with the voxels of a scene that has them
        already, if there is one.
        """
        try:
            return with_hidden(scene, hidden, variant.id, self._like(variant))
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "hide") from None

    @staticmethod
    def _made_of(scene: Scene, name: str, settings: MaterialSettings) -> Scene:
        """Return the scene with other ``settings`` of its material."""
        try:
            return with_material(scene, settings, name)
        except SceneError as error:
            raise ParameterError(str(error), "material") from None

    @staticmethod
    def _lit(scene: Scene, name: str, environment: str) -> Scene:
        """Return the scene in another ``environment``."""
        try:
            return under(scene, environment, name)
        except (SceneError, LightError) as error:
            raise ParameterError(
                f"This scene cannot be shown in that environment: {error}", "environment"
            ) from None

    def _cut(self, scene: Scene, name: str, cut: str) -> Scene:
        """Return the scene with a ``cut``, with the voxels of a scene that has them already, if
        there is one.
        """
        try:
            digest = cut_digest(scene.volume, cut)
            same = (each for each in self._engine.scenes.values() if each.volume.digest == digest)
            like = next(same, None)
            return cut_open(scene, cut, name, like.volume if like else None)
        except (SceneError, VolumeError) as error:
            raise ParameterError(str(error), "cut") from None
