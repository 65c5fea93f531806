"""The order in which a service starts."""

import asyncio
from types import SimpleNamespace
from typing import Any

from server.api.startup import Startup


def test_what_visitors_ask_for_is_surveyed_once_there_is_light() -> None:
    did: list[str] = []
    kernels = SimpleNamespace(progress=None, others=lambda: did.append("others"))
    engine: Any = SimpleNamespace(
        open=lambda: did.append("open"), light=lambda: did.append("light"), kernels=kernels, stop=lambda: None
    )

    async def start() -> None:
        startup = Startup(engine)
        await startup.run(lambda: did.append("prepare"), lambda: did.append("survey"))
        assert startup.lit.is_set() and not startup.failure
        await startup.others("phong", 5.0)
        await startup.close()

    asyncio.run(start())
    assert did == ["open", "prepare", "light", "survey", "others"]
