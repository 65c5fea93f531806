"""Uploads: from a request's body, through a confined reader, to a volume that is shown as a scene."""

import asyncio
import logging
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import aclosing
from dataclasses import replace
from pathlib import Path
from typing import IO, TypeVar

from fastapi import Request
from starlette.requests import ClientDisconnect

from isogi_core.errors import Cancelled, IsogiError
from isogi_core.files.scene_file import SceneSource
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from server.bearers import ANY_BEARER, Bearer, bearer_of, client_of
from server.errors import (
    ForbiddenError,
    FullError,
    SlowUploadError,
    StartingError,
    UnknownVolumeError,
    UploadFolderError,
    UploadsOffError,
)
from server.render.bakes import attended
from server.render.engine import RenderEngine
from server.render.scheduling import AdmissionLimit
from server.settings import Settings
from server.uploads.environments import ENVIRONMENT_KIND, VOLUME_KIND, UploadedEnvironment, read_environment
from server.uploads.folder import (
    SCENE_BYTES,
    VOXEL_BYTES,
    UploadedVolume,
    UploadFolder,
    default_folder,
    name_folder_in_errors,
    read_facts,
)
from server.uploads.reading import Reader
from server.uploads.sandbox import lacking

Kept = TypeVar("Kept")

WRITE_BLOCK_BYTES = 1 << 20
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
    """The body in blocks of at least WRITE_BLOCK_BYTES, but for the last."""
    block, stream = bytearray(), aiter(request.stream())
    while (part := await next_of(stream, seconds)) is not None:
        block += part
        if len(block) >= WRITE_BLOCK_BYTES:
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


log = logging.getLogger("isogi.uploads")

AT_ONCE = 2
"""Uploads that are taken at once, of which one is read at a time; others are answered with 429."""

UPLOADS_OFF = "This server takes no uploads: start it with --uploads-mb and how many megabytes they may take."


class Uploads:
    """The volumes that clients have sent to an ``engine``. Its coroutines belong to one event loop."""

    def __init__(self, engine: "RenderEngine", settings: Settings) -> None:
        """Take none yet; see ``open``."""
        self.on = settings.upload_quota_mb > 0
        self.quota = settings.upload_quota_mb << 20
        self.limit = settings.max_upload_mb << 20
        self.folder = UploadFolder(Path(settings.uploads) if settings.uploads else default_folder())
        self._engine, self._settings = engine, settings
        self._admission = AdmissionLimit(AT_ONCE, "uploads are being taken", work=True)
        self._reading, self._changing = asyncio.Lock(), asyncio.Lock()
        self._ready = False
        self._lacking = ""
        self._off = UPLOADS_OFF

    def open(self) -> None:
        """Show the volumes in the folder, where uploads are on, as far as the quota goes; others are logged and left.

        Raises UploadFolderError where uploads were asked for and the folder cannot be used. Uploads that are on by
        default are off then.
        """
        if not self.on:
            return
        try:
            self.folder.open()
        except (UploadFolderError, FullError) as error:
            if self._settings.uploads_mb is not None:
                raise
            self.on, self._off = False, f"This server takes no uploads. {error}"
            log.warning("%s", self._off)
            return
        self._lacking = lacking()
        left = self.quota
        for kept in self.folder.volumes.values():
            try:
                left -= kept.held
                if left < 0:
                    raise FullError(f"Uploads may take {self.quota >> 20} MB: delete volumes, or give them more.")
                self._engine.admit(self._scene(kept))
            except IsogiError as error:
                log.error("the upload %s cannot be shown: %s", kept.id, error)
        self._ready = True

    def close(self) -> None:
        """Leave the folder to another server."""
        self.folder.close()

    def notes(self) -> list[str]:
        """What a person should know of the reader: what its sandbox lacks on this system."""
        return [self._lacking] if self._lacking else []

    @property
    def free(self) -> int:
        """Bytes that the quota has left."""
        return max(self.quota - self.folder.held, 0)

    def find(self, number: str) -> UploadedVolume:
        """The volume with this id; UnknownVolumeError where there is none."""
        if number not in self.folder.volumes:
            raise UnknownVolumeError(f"There is no volume '{number[:64]}': /v1/volumes lists them all.")
        return self.folder.volumes[number]

    async def take(self, request: Request, name: str) -> tuple[UploadedVolume, bool]:
        """Take the body of a request as a volume and show it; the volume, and whether it is new.

        It belongs to all who have sent it by name.

        Raises UploadsOffError, StartingError, BusyError, SlowUploadError, VolumeError, LateError, FullError,
        UploadFolderError, and Cancelled where the client has left.
        """
        return await self._take(request, name, VOLUME_KIND, self._keep)

    async def take_environment(self, request: Request, name: str) -> tuple[UploadedEnvironment, bool]:
        """Take the body of a request as light, a Radiance picture; see ``take``, which this does likewise."""
        return await self._take(request, name, ENVIRONMENT_KIND, self._keep_environment)

    async def _take(
        self, request: Request, name: str, kind: str, keep: Callable[[IO[bytes], str], tuple[Kept, bool]]
    ) -> tuple[Kept, bool]:
        """Take the body of a request as a file of a ``kind``, and ``keep`` its canonical form."""
        if not self.on:
            raise UploadsOffError(self._off)
        self._check_ready()
        with self._admission.admitted(client_of(request.scope)) as place, self.folder.drafts() as (body, draft):
            self._check_room(SCENE_BYTES if kind == VOLUME_KIND else 0)  # no volume takes less
            async with Reader.started(body, draft, name, self.limit // VOXEL_BYTES, kind) as reader:
                with name_folder_in_errors(self.folder.path):
                    await place.keep(receive(request, body, self._settings.body_seconds))
                number = await attended(request, place.keep(self._read(reader)))
            async with self._changing:
                kept = await asyncio.to_thread(keep, draft, number)
                if kept[1] or self.folder.owners_of(number):
                    await asyncio.to_thread(self.folder.give, number, bearer_of(request.scope).name)
                return kept

    async def _read(self, reader: Reader) -> str:
        """The id of what a reader reads, when it is its turn. Raises as that does."""
        async with self._reading:
            return await reader.read(self._settings.reading_seconds)

    async def remove(self, number: str, bearer: Bearer = ANY_BEARER) -> None:
        """Show a volume no more, and have its file gone. Its light is left in the store: it may come again.

        It stays where it belongs to others besides this bearer. Raises UnknownVolumeError, ForbiddenError,
        StartingError and UploadFolderError.
        """
        self.find(number)
        if await self._remove(number, bearer) and number in self._engine.scenes:
            await asyncio.to_thread(self._engine.dismiss, number)

    async def remove_environment(self, number: str, bearer: Bearer = ANY_BEARER) -> None:
        """Have an environment gone, and what is shown in it; see ``remove``."""
        if number not in self.folder.environments:
            raise UnknownVolumeError(f"There is no environment '{number[:64]}': /v1/environments lists them all.")
        if await self._remove(number, bearer):
            for lit in [each for each in self._engine.scenes if self._engine.variant(each).environment == number]:
                await asyncio.to_thread(self._engine.dismiss, lit)

    async def _remove(self, number: str, bearer: Bearer) -> bool:
        """Have an upload's file gone, unless it belongs to others besides; whether it is."""
        self._check_ready()
        async with self._changing:
            if number not in self.folder.volumes and number not in self.folder.environments:
                raise UnknownVolumeError(f"There is no upload '{number}' any more.")
            owners = self.folder.owners_of(number)
            if not any(map(bearer.owns, owners or [""])):
                raise ForbiddenError(f"The upload '{number}' belongs to another: its sender or an admin may delete it.")
            if not bearer.may("admin") and len(owners) > 1:
                await asyncio.to_thread(self.folder.take_back, number, bearer.name)
                return False
            await asyncio.to_thread(self.folder.remove, number)
            return True

    def environment_at(self, name: str) -> str | None:
        """An environment as a scene file names it, by its name or the id of an uploaded one; None where none is."""
        if name in ENVIRONMENTS:
            return name
        return str(self.folder.place(name).resolve()) if name in self.folder.environments else None

    def _keep(self, draft: IO[bytes], number: str) -> tuple[UploadedVolume, bool]:
        """Keep a volume in the folder and show it, unless it is there already; all or nothing."""
        if number in self.folder.volumes:
            return self.folder.volumes[number], False
        drafted = read_facts(Path(draft.name))
        self._check_room(drafted.held if drafted else 0)
        kept = self.folder.put(draft, number)
        try:
            self._engine.admit(self._scene(kept))
        except Exception:
            self.folder.remove(number)
            raise
        return kept, True

    def _keep_environment(self, draft: IO[bytes], number: str) -> tuple[UploadedEnvironment, bool]:
        """Keep an environment in the folder, unless it is there already."""
        if number in self.folder.environments:
            return self.folder.environments[number], False
        drafted = read_environment(Path(draft.name))
        self._check_room(drafted.held if drafted else 0)
        return self.folder.put_environment(draft, number), True

    def _check_ready(self) -> None:
        if not self._ready:
            raise StartingError("isogi is starting: ask again in a second.")

    def _check_room(self, size: int) -> None:
        """Raises FullError where so many bytes are more than the quota has left."""
        if size > self.free:
            room = f"{size} bytes are wanted and {self.free} free"
            raise FullError(f"Uploads may take {self.quota >> 20} MB, {room}: delete volumes first.")

    def _scene(self, kept: UploadedVolume) -> Scene:
        """The scene of a volume: in default light, and found by the volume's id."""
        source = SceneSource(kept.name, {"volume": f"{kept.id}.nrrd"}, self.folder.path.resolve())
        return replace(build_scene(source), id=kept.id)
