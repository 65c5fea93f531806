"""The readers of uploads as the server sees them: processes that start while a body arrives, and read one at a time."""

import asyncio
import json
import logging
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import IO

from isogi_core.errors import VolumeError
from server.errors import LateError
from server.uploads.environments import VOLUME_KIND

log = logging.getLogger("isogi.uploads")

PYTHON_ROOT = Path(__file__).resolve().parents[2]
"""Where Python finds the reader."""

BYTES_PER_CPU_SECOND = 8 << 20
"""Bytes of an upload for which the reader has a second more of the processor."""

CLOCK_SECONDS_PER_CPU_SECOND, READER_SECONDS = 10.0, 60.0
"""Seconds on the clock for each of the processor, and besides, after which a reader is given up: others compute."""

READER_ENVIRONMENT = {
    "PYTHONPATH": str(PYTHON_ROOT),
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONDONTWRITEBYTECODE": "1",
    "PYTHONUTF8": "1",
}
"""What a reader has of an environment: nothing of the server's."""

LIMITS_EXCEEDED = "The file takes more time or memory to read than it may: save it raw, or a smaller part."


class Reader:
    """A child that reads one upload, of a ``kind``, VOLUME_KIND or ENVIRONMENT_KIND: see ``server.uploads.reader``."""

    def __init__(self, process: Process, upload: IO[bytes]) -> None:
        self._process, self._upload = process, upload

    @classmethod
    @asynccontextmanager
    async def started(
        cls, upload: IO[bytes], into: IO[bytes], name: str, voxels: int, kind: str = VOLUME_KIND
    ) -> AsyncIterator["Reader"]:
        """A reader of ``upload``, of at most so many ``voxels``, which writes a canonical file ``into`` another.

        It starts at once, and is gone at the end.
        """
        files = upload.fileno(), into.fileno()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", "server.uploads.reader", name, *map(str, files), kind, str(voxels)),
            stdin=PIPE,
            stdout=PIPE,
            stderr=DEVNULL,
            pass_fds=files,
            cwd="/",
            env=READER_ENVIRONMENT,
        )
        try:
            yield cls(process, upload)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()

    async def read(self, seconds: float) -> str:
        """Have the upload read, now that it is whole; its id.

        That may take so many processor ``seconds``, besides those for its size. Raises VolumeError, with the child's
        own sentence or one about its end, and LateError.
        """
        patience = seconds + os.fstat(self._upload.fileno()).st_size / BYTES_PER_CPU_SECOND
        try:
            async with asyncio.timeout(READER_SECONDS + CLOCK_SECONDS_PER_CPU_SECOND * patience):
                return await self._answer(patience)
        except TimeoutError:
            raise LateError("The machine is too busy to read the file: send it again in a while.") from None

    async def _answer(self, seconds: float) -> str:
        """The id that the child answers; VolumeError where it refuses the file, or ends without an answer."""
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(f"{seconds}\n".encode())
        line = await self._process.stdout.readline()
        status = await self._process.wait()
        if not line:
            log.warning("the reader of an upload ended with status %d", status)
            raise VolumeError(LIMITS_EXCEEDED)
        answer: dict[str, str] = json.loads(line)
        if "refused" in answer:
            raise VolumeError(answer["refused"])
        return answer["id"]
