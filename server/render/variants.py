"""Variants: an engine's scenes in other light, each made when a view first asks for it.

A variant is a scene like any other: it has a plan, and its layers are those that the light needs. Transfer does not
depend on the environment, so variants read and bake the same layers where their plans are of one kind.
"""

import asyncio
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING

from isogi_core.errors import LightError, SceneError
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.plan.assembly import under
from isogi_core.plan.scene import Scene
from server.errors import ParameterError
from server.values import shown

if TYPE_CHECKING:
    from server.render.engine import RenderEngine

MARK = "@"
"""Between a scene's id and its environment's in the id of a variant; ids of scenes have none."""

MOST = 64
"""Variants that an engine has at a time: those asked for last."""


Place = Callable[[str], str | None]
"""What gives an environment as scene files name it, by its name or id; None where there is none."""


def own_name(scene: str) -> str:
    """The id of the scene that one with this id is a variant of; its own where it is none."""
    return scene.partition(MARK)[0]


class Variants:
    """The variants of an ``engine``. Safe to use from many threads."""

    def __init__(self, engine: "RenderEngine", place: Place, most: int = MOST) -> None:
        """None yet; ``place`` tells where an environment is.

        When there are more than ``most``, the engine dismisses what was asked for longest ago.
        """
        self._engine, self._place, self._most = engine, place, most
        self._asked: OrderedDict[str, None] = OrderedDict()
        self._making, self._lock = threading.Lock(), threading.Lock()

    async def lit(self, scene: Scene, name: str) -> Scene:
        """The scene in the environment of this name, or id, made off the event loop where there is none yet.

        Raises ParameterError where there is no such environment, and as ``make`` does.
        """
        place = self._place(name)
        if place is None:
            names = ", ".join(ENVIRONMENTS)
            sentence = f"environment must be one of {names}, or the id of one that was uploaded, not {shown(name)}."
            raise ParameterError(sentence, "environment")
        known = self.known(scene, name)
        return known if known is not None else await asyncio.to_thread(self.make, scene, name, place)

    def known(self, scene: Scene, name: str) -> Scene | None:
        """The scene in the environment of this name, where there is one already; never waits long."""
        known = self._engine.scenes.get(f"{scene.id}{MARK}{name}")
        if known is not None:
            with self._lock:
                self._asked[known.id] = None
                self._asked.move_to_end(known.id)
        return known

    def make(self, scene: Scene, name: str, environment: str) -> Scene:
        """The scene in an ``environment``, as scene files name it; ``name`` is what views call it.

        Raises ParameterError where the scene's own choices do not fit that light, or its file is damaged.
        """
        with self._making:
            if (known := self.known(scene, name)) is not None:
                return known
            made = self._made(scene, f"{scene.id}{MARK}{name}", environment)
            self._engine.admit(made)
        self.known(scene, name)
        with self._lock:
            old = [self._asked.popitem(last=False)[0] for _ in range(len(self._asked) - self._most)]
        for each in (each for each in old if each in self._engine.scenes):
            self._engine.dismiss(each)
        return made

    @staticmethod
    def _made(scene: Scene, name: str, environment: str) -> Scene:
        try:
            return under(scene, environment, name)
        except (SceneError, LightError) as error:
            raise ParameterError(f"This scene cannot be shown in that environment: {error}", "environment") from None
