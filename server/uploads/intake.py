"""The intake: what a client sends goes to a file as it comes, and no more than a block of it is in memory."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from typing import IO

from fastapi import Request
from starlette.requests import ClientDisconnect

from isogi_core.errors import Cancelled
from server.errors import SlowUploadError

BLOCK = 1 << 20
"""Bytes that are written at once."""


async def receive(request: Request, file: IO[bytes], seconds: float) -> None:
    """Write the body of a request to a file.

    Raises SlowUploadError where nothing comes for so many ``seconds``, Cancelled where the client has left, and what
    the file raises.
    """
    async with aclosing(blocks(request, seconds)) as arriving:
        async for block in arriving:
            await asyncio.to_thread(file.write, block)
    await asyncio.to_thread(file.flush)


async def blocks(request: Request, seconds: float) -> AsyncGenerator[bytes, None]:
    """The body in blocks of at least BLOCK bytes, but for the last."""
    block, stream = bytearray(), aiter(request.stream())
    while (part := await next_of(stream, seconds)) is not None:
        block += part
        if len(block) >= BLOCK:
            yield bytes(block)
            block.clear()
    yield bytes(block)


async def next_of(stream: AsyncIterator[bytes], seconds: float) -> bytes | None:
    """The next part of a body; None at its end."""
    try:
        async with asyncio.timeout(seconds):
            return await anext(stream, None)
    except TimeoutError:
        raise SlowUploadError(f"Nothing of the upload came for {seconds:g} s: send it again.") from None
    except ClientDisconnect:
        raise Cancelled("The client left before its upload was whole.") from None
