"""The child: runs the reader of uploads, and does not wait for it for ever."""

import asyncio
import json
import logging
import math
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from pathlib import Path
from typing import IO

from isogi_core.errors import VolumeError
from server.errors import LateError

log = logging.getLogger("isogi.uploads")

ROOT = Path(__file__).resolve().parents[2]
"""Where Python finds the reader."""

PACE = 8 << 20
"""Bytes of an upload for which the reader has a second more."""

SHARE = 0.6
"""How much of the reader's time the processor may be at it: who needs more asks too much, else the machine is busy."""


async def read(upload: IO[bytes], into: IO[bytes], name: str, voxels: int, seconds: float) -> str:
    """Have a child read ``upload`` from its beginning and write it as a canonical file ``into`` another; its id.

    It may have ``voxels`` at most, and the child so many ``seconds`` besides those for its size. Raises VolumeError,
    with the child's own sentence or one about its end, and LateError.
    """
    upload.seek(0)
    patience = seconds + os.fstat(upload.fileno()).st_size / PACE
    arguments = [name, into.fileno(), voxels, math.ceil(SHARE * patience)]
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", "server.uploads.reader", *map(str, arguments)),
        stdin=upload,
        stdout=PIPE,
        stderr=DEVNULL,
        pass_fds=[into.fileno()],
        cwd="/",
        env={"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUTF8": "1"},
    )
    try:
        async with asyncio.timeout(patience):
            return await hear(process)
    except TimeoutError:
        raise LateError(f"The file could not be read within {patience:.0f} s: send it again in a while.") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def hear(process: Process) -> str:
    """The id that a child tells; VolumeError where it refuses the file, or has ended without a word."""
    assert process.stdout
    line = await process.stdout.readline()
    status = await process.wait()
    if not line:
        log.warning("the reader of an upload ended with status %d", status)
        raise VolumeError("The file takes more time or memory to read than it may: save it raw, or a smaller part.")
    answer: dict[str, str] = json.loads(line)
    if "refused" in answer:
        raise VolumeError(answer["refused"])
    return answer["id"]
