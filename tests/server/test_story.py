import asyncio
from collections.abc import AsyncGenerator
from types import SimpleNamespace
from typing import Any

from server.story import pictures


def test_a_listener_that_is_cancelled_again_and_again_closes_what_it_listens_to() -> None:
    """As a cancelled scope does, until whoever is in it has left."""
    closed: list[str] = []

    async def refinements(order: Any, viewer: Any) -> AsyncGenerator[str, None]:
        try:
            yield "first"
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0.05)
            closed.append("in order")

    async def listen() -> None:
        service: Any = SimpleNamespace(refinements=refinements)
        async for _ in pictures(service, None, None):  # type: ignore[arg-type]
            pass

    async def leave() -> None:
        listener = asyncio.create_task(listen())
        await asyncio.sleep(0.05)
        while not listener.done():
            listener.cancel()
            await asyncio.sleep(0)

    asyncio.run(leave())
    assert closed == ["in order"]
