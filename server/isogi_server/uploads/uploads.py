"""Uploads: the way from a request's body, through a confined reader, to a volume that is shown as a
scene, or to an environment.

Each upload has a reader, a process that starts while the body arrives. One reader reads at a time.
"""

import asyncio
import json
import logging
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO

from fastapi import Request
from starlette.requests import ClientDisconnect

from isogi_core.errors import Cancelled, IsogiError, VolumeError
from isogi_core.files.formats.kinds import reader_plugins
from isogi_core.files.scene_file import SceneSource
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_server.bearers import ANY_BEARER, Bearer, bearer_of, client_of
from isogi_server.errors import (
    ForbiddenError,
    FullError,
    LateError,
    SlowUploadError,
    StartingError,
    UnknownVolumeError,
    UploadFolderError,
    UploadsOffError,
)
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scheduling import AdmissionLimit
from isogi_server.render.viewers import run_while_connected
from isogi_server.settings import Settings
from isogi_server.uploads.folder import (
    ENVIRONMENT_KIND,
    READERS,
    SCENE_BYTES,
    VOLUME_KIND,
    VOXEL_BYTES,
    Upload,
    UploadFolder,
    default_folder,
    name_folder_in_errors,
)
from isogi_server.uploads.sandbox import lacking

PYTHON_ROOT = Path(__file__).resolve().parents[2]
"""The folder in which Python finds the module of the reader."""

BYTES_PER_CPU_SECOND = 8 << 20
"""Bytes of an upload for which the reader may use one more second of processor time."""

CLOCK_SECONDS_PER_CPU_SECOND = 10.0
READER_SECONDS = 60.0
"""Seconds of clock time for each second of processor time, and in addition, after which a
reader is given up: other processes compute too.
"""

READER_ENVIRONMENT = {
    "PYTHONPATH": str(PYTHON_ROOT),
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONDONTWRITEBYTECODE": "1",
    "PYTHONUTF8": "1",
}
"""The environment of a reader: nothing of the server's, such as tokens or keys, is in it."""


def reader_environment() -> dict[str, str]:
    """Return the environment of a reader, in which Python finds plug-ins where the server does."""
    roots = [PYTHON_ROOT, *(each.folder for each in reader_plugins().found)]
    return {**READER_ENVIRONMENT, "PYTHONPATH": os.pathsep.join(dict.fromkeys(map(str, roots)))}


LIMITS_EXCEEDED = (
    "The file takes more time or memory to read than it may: save it raw, or a smaller part."
)


class Reader:
    """A child process that reads one upload, of the ``kind`` VOLUME_KIND or ENVIRONMENT_KIND:
    see ``isogi_server.uploads.reader``.
    """

    def __init__(self, process: Process, upload: IO[bytes]) -> None:
        self._process = process
        self._upload = upload

    @classmethod
    @asynccontextmanager
    async def started(
        cls, upload: IO[bytes], into: IO[bytes], name: str, voxels: int, kind: str = VOLUME_KIND
    ) -> AsyncIterator["Reader"]:
        """Start a reader of ``upload``, of at most ``voxels`` voxels, which writes a canonical file
        ``into`` another; for the block.

        The process starts at once, so that it is ready when the body is complete, and is killed at
        the end of the block.
        """
        # The child gets descriptors, no paths: it has no access to the folder.
        files = upload.fileno(), into.fileno()
        process = await asyncio.create_subprocess_exec(
            *(
                sys.executable,
                "-P",
                "-m",
                "isogi_server.uploads.reader",
                name,
                *map(str, files),
                kind,
                str(voxels),
            ),
            stdin=PIPE,
            stdout=PIPE,
            stderr=DEVNULL,
            pass_fds=files,
            cwd="/",
            env=reader_environment(),
        )
        try:
            yield cls(process, upload)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()

    async def read(self, seconds: float) -> str:
        """Have the complete upload read, and return its id.

        Reading may take ``seconds`` of processor time, and more in proportion to the size. Raises
        VolumeError if the child refuses the file or dies, and LateError if the machine is too busy.
        """
        patience = seconds + os.fstat(self._upload.fileno()).st_size / BYTES_PER_CPU_SECOND
        try:
            async with asyncio.timeout(READER_SECONDS + CLOCK_SECONDS_PER_CPU_SECOND * patience):
                return await self._answer(patience)
        except TimeoutError:
            raise LateError(
                "The machine is too busy to read the file: send it again in a while."
            ) from None

    async def _answer(self, seconds: float) -> str:
        """Tell the child its limit of processor ``seconds``, and return the id that it answers.
        Raises VolumeError if it refuses the file, or ends without an answer.
        """
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(f"{seconds}\n".encode())
        # A child that is killed, by its limits or the sandbox, closes stdout without an answer.
        line = await self._process.stdout.readline()
        status = await self._process.wait()
        if not line:
            log.warning("the reader of an upload ended with status %d", status)
            raise VolumeError(LIMITS_EXCEEDED)
        answer: dict[str, str] = json.loads(line)
        if "refused" in answer:
            raise VolumeError(answer["refused"])
        return answer["id"]


WRITE_BLOCK_BYTES = 1 << 20
"""Bytes of a body that are collected, at least, before they are written in one call."""


async def receive(request: Request, file: IO[bytes], seconds: float) -> None:
    """Write the body of a request to a file, in threads, so that the event loop goes on. The reader
    process sees all of it when this returns.

    Raises SlowUploadError if no part of the body comes for ``seconds``, Cancelled if the client
    disconnects, and OSError if the file cannot be written.
    """
    async with aclosing(blocks(request, seconds)) as arriving:
        async for block in arriving:
            await asyncio.to_thread(file.write, block)
    await asyncio.to_thread(file.flush)


async def blocks(request: Request, seconds: float) -> AsyncGenerator[bytes, None]:
    """Yield the body in blocks of at least WRITE_BLOCK_BYTES, except for the last one."""
    block = bytearray()
    stream = aiter(request.stream())
    while (part := await next_of(stream, seconds)) is not None:
        block += part
        if len(block) >= WRITE_BLOCK_BYTES:
            yield bytes(block)
            block.clear()
    yield bytes(block)


async def next_of(stream: AsyncIterator[bytes], seconds: float) -> bytes | None:
    """Return the next part of a body; None at its end. Raises SlowUploadError and Cancelled."""
    try:
        async with asyncio.timeout(seconds):
            return await anext(stream, None)
    except TimeoutError:
        raise SlowUploadError(f"The upload stopped for {seconds:g} s: send it again.") from None
    except ClientDisconnect:
        raise Cancelled("The client left before its upload was whole.") from None


log = logging.getLogger("isogi.uploads")

AT_ONCE = 2
"""Uploads that are taken at a time, of which one is read; further ones are answered with 429."""

UPLOADS_OFF = (
    "This server takes no uploads: start it with --uploads-mb and how many megabytes they may take."
)


class Uploads:
    """The uploads that an ``engine`` shows. Its coroutines belong to one event loop."""

    def __init__(self, engine: "RenderEngine", settings: Settings) -> None:
        """Read the settings; the folder is opened by ``open``."""
        self.on = settings.upload_quota_mb > 0
        self.quota = settings.upload_quota_mb << 20
        self.limit = settings.max_upload_mb << 20
        self.folder = UploadFolder(Path(settings.uploads) if settings.uploads else default_folder())
        self._engine = engine
        self._settings = settings
        self._admission = AdmissionLimit(AT_ONCE, "uploads are being taken", work=True)
        self._reading = asyncio.Lock()
        self._changing = asyncio.Lock()
        self._ready = False
        self._lacking = ""
        self._off = UPLOADS_OFF

    def open(self) -> None:
        """Open the folder, if uploads are on, and show its volumes as far as the quota allows;
        others are logged and kept.

        Raises UploadFolderError if uploads were asked for and the folder cannot be used. Uploads
        that are on by default are turned off instead.
        """
        if not self.on:
            return
        try:
            self.folder.open()
        except (UploadFolderError, FullError) as error:
            # If uploads were not asked for, start without them.
            if self._settings.uploads_mb is not None:
                raise
            self.on = False
            self._off = f"This server takes no uploads. {error}"
            log.warning("%s", self._off)
            return
        self._lacking = lacking()
        left = self.quota
        for kept in self.folder.volumes:
            try:
                # Volumes above the quota stay on disk, but are not shown.
                left -= kept.held
                if left < 0:
                    raise FullError(
                        f"Uploads may take {self.quota >> 20} MB: delete volumes, or give them "
                        "more."
                    )
                self._engine.admit(self._scene(kept))
            except IsogiError as error:
                log.error("the upload %s cannot be shown: %s", kept.id, error)
        self._ready = True

    def close(self) -> None:
        """Release the folder for another server."""
        self.folder.close()

    def notes(self) -> list[str]:
        """Return sentences for the operator: the protections that readers lack on this system."""
        return [self._lacking] if self._lacking else []

    @property
    def free(self) -> int:
        """Return the bytes that are left of the quota."""
        return max(self.quota - self.folder.held, 0)

    def find(self, number: str, kind: str = VOLUME_KIND) -> Upload:
        """Return the upload of a ``kind`` with this id. Raises UnknownVolumeError if there is
        none.
        """
        kept = self.folder.uploads.get(number)
        if kept is None or kept.kind != kind:
            raise UnknownVolumeError(
                f"There is no {kind} '{number[:64]}': /v1/{kind}s lists them all."
            )
        return kept

    async def take(
        self, request: Request, name: str, kind: str = VOLUME_KIND
    ) -> tuple[Upload, bool]:
        """Take the body of a request as an upload of a ``kind``, and show it if it is a volume.
        Return the upload, and True if it is new.

        An upload belongs to all bearers that have sent it. Raises UploadsOffError, StartingError,
        BusyError, SlowUploadError, VolumeError, LateError, FullError, UploadFolderError, and
        Cancelled if the client disconnects.
        """
        if not self.on:
            raise UploadsOffError(self._off)
        self._check_ready()
        with (
            self._admission.admitted(client_of(request.scope)) as place,
            self.folder.drafts() as (body, draft),
        ):
            # No volume needs less than SCENE_BYTES: refuse it before its body comes.
            self._check_room(SCENE_BYTES if kind == VOLUME_KIND else 0)
            async with Reader.started(body, draft, name, self.limit // VOXEL_BYTES, kind) as reader:
                with name_folder_in_errors(self.folder.path):
                    await place.keep(receive(request, body, self._settings.patience.body_seconds))
                number = await run_while_connected(request, place.keep(self._read(reader)))
            # Check and change the folder as one step.
            async with self._changing:
                kept = await asyncio.to_thread(self._keep, draft, number, kind)
                # An upload without owners belongs to everyone: sending it again takes it from no
                # one.
                if kept[1] or self.folder.owners_of(number):
                    await asyncio.to_thread(self.folder.give, number, bearer_of(request.scope).name)
                return kept

    async def _read(self, reader: Reader) -> str:
        """Have a reader read when it is its turn, and return the id. Raises as ``Reader.read``
        does.
        """
        async with self._reading:
            return await reader.read(self._settings.reading_seconds)

    async def remove(
        self, number: str, bearer: Bearer = ANY_BEARER, kind: str = VOLUME_KIND
    ) -> None:
        """Delete an upload and the scenes that show it. Baked light remains in the store, as the
        upload may come again.

        If the upload belongs to others too, only this ``bearer`` ceases to be an owner. Raises
        UnknownVolumeError, ForbiddenError, StartingError and UploadFolderError.
        """
        self.find(number, kind)
        self._check_ready()
        async with self._changing:
            # Another request may have removed it meanwhile.
            self.find(number, kind)
            owners = self.folder.owners_of(number)
            if not any(map(bearer.owns, owners or [""])):
                raise ForbiddenError(
                    f"The upload '{number}' belongs to another client: only its sender or an admin "
                    "may delete it."
                )
            if not bearer.may("admin") and len(owners) > 1:
                await asyncio.to_thread(self.folder.take_back, number, bearer.name)
                return
            await asyncio.to_thread(self.folder.remove, number)
        for each in list(self._engine.scenes):
            if number in (each, self._engine.variant(each).environment):
                await asyncio.to_thread(self._engine.dismiss, each)

    def environment_at(self, name: str) -> str | None:
        """Return an environment as scene files name it, by its name or by the id of an upload;
        None if there is none.
        """
        if name in ENVIRONMENTS:
            return name
        kept = self.folder.uploads.get(name)
        if kept and kept.kind == ENVIRONMENT_KIND:
            return str(self.folder.place(name).resolve())
        return None

    def _keep(self, draft: IO[bytes], number: str, kind: str) -> tuple[Upload, bool]:
        """Keep an upload in the folder and show it if it is a volume, unless it is there; do
        all of it or nothing.
        """
        if number in self.folder.uploads:
            return self.folder.uploads[number], False
        drafted = READERS[kind](Path(draft.name))
        self._check_room(drafted.held if drafted else 0)
        kept = self.folder.put(draft, number, kind)
        if kind == VOLUME_KIND:
            try:
                self._engine.admit(self._scene(kept))
            except Exception:
                # A volume that cannot be shown is not kept.
                self.folder.remove(number)
                raise
        return kept, True

    def _check_ready(self) -> None:
        """Raise StartingError until the folder is open."""
        if not self._ready:
            raise StartingError("isogi is starting: ask again in a second.")

    def _check_room(self, size: int) -> None:
        """Raise FullError if the quota has less than ``size`` bytes left."""
        if size > self.free:
            room = f"{size} bytes are wanted and {self.free} free"
            raise FullError(
                f"Uploads may take {self.quota >> 20} MB, {room}: delete volumes first."
            )

    def _scene(self, kept: Upload) -> Scene:
        """Return the scene of a volume, in default light, with the volume's id."""
        source = SceneSource(kept.name, {"volume": f"{kept.id}.nrrd"}, self.folder.path.resolve())
        return replace(build_scene(source), id=kept.id)
