"""The start of a service: its socket answers at once, pictures come without light first, then with light."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

from isogi_core.plan.scene import Scene
from server.errors import BusyError, StartingError
from server.render.engine import RenderEngine

LOOK = 0.02
"""Seconds between two looks at whether the service is ready."""

SCENE_NOT_OPEN = "isogi is starting: its scene is not open yet."
COMPILING = "What draws {shading} pictures is being compiled, once on this machine: ask again in a while."


class Startup:
    """How far the start of an ``engine`` is; for the event loop alone.

    It is ``settled`` once pictures can be drawn, or a ``failure`` says why they cannot. They are ``lit`` once kernels
    of light are there, which takes longer where these must be compiled.
    """

    def __init__(self, engine: RenderEngine) -> None:
        """Begin nothing yet."""
        self._engine = engine
        self.settled, self.lit, self._all = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self.failure: Exception | None = None
        self._compiling: asyncio.Task[None] | None = None
        self._closing = False

    async def run(self, prepare: Callable[[], None], survey: Callable[[Scene], None]) -> None:
        """Open the engine, and ``prepare`` what comes with it.

        Kernels that must be compiled come after that, and then a ``survey`` of each scene, which visitors ask for.
        """
        try:
            await asyncio.to_thread(self._engine.open)
            await asyncio.to_thread(prepare)
            if self._engine.kernels.progress is None:
                await self._light()
        except Exception as error:
            self.failure = error
        self._compiling = asyncio.create_task(self._compile(survey))
        self.settled.set()

    async def close(self) -> None:
        """Have nothing more compiled, once the engine is open."""
        self._closing = True
        await self.settled.wait()
        if self._compiling:
            self._engine.stop()
            await self._compiling

    async def ready(self) -> None:
        """Returns once the service is ready, or has failed to start."""
        await self.settled.wait()
        while not self.failure and await asyncio.to_thread(self.reasons) != []:
            await asyncio.sleep(LOOK)

    def reasons(self) -> list[str]:
        """Why the service is not ready; empty when it is."""
        if not self.settled.is_set():
            return [self._engine.kernels.compiling or SCENE_NOT_OPEN]
        return [f"isogi did not start: {self.failure}"] if self.failure else self._engine.unready()

    @property
    def open(self) -> bool:
        """Whether the engine is up."""
        return self.settled.is_set() and not self.failure

    def check(self) -> None:
        """Raise StartingError until the engine is up."""
        if not self.open:
            raise StartingError(self.reasons()[0])

    async def others(self, shading: str, patience: float) -> None:
        """Wait for kernels that no scene needs by itself; BusyError where they take more seconds than this."""
        await within(patience, self._all)
        if not self._all.is_set():
            raise BusyError(COMPILING.format(shading=shading))

    async def _light(self) -> None:
        """Have kernels of light."""
        await asyncio.to_thread(self._engine.light)
        self.lit.set()

    async def _compile(self, survey: Callable[[Scene], None]) -> None:
        """Have kernels of light compiled, ``survey`` scenes, and then compile those that no scene needs by itself."""
        try:
            if not (self.failure or self.lit.is_set()):
                await self._light()
            for scene in [] if self.failure else list(self._engine.scenes.values()):
                if self._closing:
                    break
                await asyncio.to_thread(survey, scene)
            await asyncio.to_thread(self._engine.kernels.others)
        except Exception as error:
            self.failure = error
        finally:
            self.lit.set()
            self._all.set()


async def within(seconds: float, event: asyncio.Event) -> None:
    """Returns when the event is set, after so many seconds at the latest."""
    if not event.is_set():
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await event.wait()
