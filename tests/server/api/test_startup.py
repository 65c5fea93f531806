"""The order in which a service starts."""

import asyncio
import time
from types import SimpleNamespace
from typing import Any

from server.api.lifespan import Startup


def test_what_visitors_ask_for_is_surveyed_once_there_is_light() -> None:
    did: list[str] = []
    kernels = SimpleNamespace(progress=None, others=lambda: did.append("others"))
    engine: Any = SimpleNamespace(
        open=lambda: did.append("open"),
        light=lambda: did.append("light"),
        kernels=kernels,
        stop=lambda: None,
        scenes={"one": "a scene"},
    )

    engine.scenes = {"one": "a scene"}

    async def start() -> None:
        startup = Startup(engine)
        await startup.run(lambda: did.append("prepare"), did.append)
        assert startup.lit.is_set() and not startup.failure
        await startup.others("phong", 5.0)
        await startup.close()

    asyncio.run(start())
    assert did == ["open", "prepare", "light", "a scene", "others"]


def test_scenes_are_not_surveyed_once_it_is_to_stop() -> None:
    """A server of many scenes would stop late."""
    did: list[str] = []
    kernels = SimpleNamespace(progress=None, others=lambda: None)
    engine: Any = SimpleNamespace(open=lambda: None, light=lambda: None, kernels=kernels, stop=lambda: None)
    engine.scenes = {"one": "a scene", "other": "another"}

    async def start_and_stop() -> None:
        startup = Startup(engine)
        surveyed = asyncio.Event()
        loop = asyncio.get_running_loop()

        def survey(scene: str) -> None:
            did.append(scene)
            loop.call_soon_threadsafe(surveyed.set)
            time.sleep(0.2)

        await startup.run(lambda: None, survey)  # type: ignore[arg-type]
        await surveyed.wait()
        await startup.close()

    asyncio.run(start_and_stop())
    assert did == ["a scene"]
