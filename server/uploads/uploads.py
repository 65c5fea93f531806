"""Uploads: from a request's body to a volume on the shelf that is shown as a scene, and off it again."""

import asyncio
import logging
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fastapi import Request

from isogi_core.errors import IsogiError
from isogi_core.model.scene import Scene, build_scene
from isogi_core.model.source import SceneSource
from server.errors import FullError, StartingError, UnknownVolumeError, UploadsOffError
from server.gate import Gate
from server.settings import Settings
from server.uploads import child
from server.uploads.canonical import VOXEL, Kept, read_facts
from server.uploads.intake import receive
from server.uploads.shelf import Shelf, default_folder, named
from server.visits import attended

if TYPE_CHECKING:
    from server.studio import Studio

log = logging.getLogger("isogi.uploads")

AT_ONCE = 2
"""Uploads that are taken at once; others are told to come back."""

OFF = "This server takes no uploads: start it with --uploads-mb and how many megabytes they may take."


class Uploads:
    """The volumes that clients have sent to a ``studio``. Its coroutines belong to one event loop."""

    def __init__(self, studio: "Studio", settings: Settings) -> None:
        """Take none yet; see ``open``."""
        self.on = settings.uploads_mb > 0
        self.quota = settings.uploads_mb << 20
        self.limit = settings.max_upload_mb << 20
        self.shelf = Shelf(Path(settings.uploads) if settings.uploads else default_folder())
        self._studio, self._settings = studio, settings
        self._gate = Gate(AT_ONCE, "uploads are being taken")
        self._changing = asyncio.Lock()
        self._ready = False

    def open(self) -> None:
        """Show what is on the shelf, where uploads are on; what cannot be shown is told and left.

        Raises ShelfError.
        """
        if not self.on:
            return
        self.shelf.open()
        for kept in self.shelf.volumes.values():
            try:
                self._studio.admit(self._scene(kept))
            except IsogiError as error:
                log.error("the upload %s cannot be shown: %s", kept.id, error)
        self._ready = True

    def close(self) -> None:
        """Leave the shelf to another server."""
        self.shelf.close()

    @property
    def free(self) -> int:
        """Bytes that the quota has left."""
        return max(self.quota - self.shelf.held, 0)

    def find(self, number: str) -> Kept:
        """The volume with this id; UnknownVolumeError where there is none."""
        if number not in self.shelf.volumes:
            raise UnknownVolumeError(f"There is no volume '{number[:64]}': /v1/volumes lists those there are.")
        return self.shelf.volumes[number]

    async def take(self, request: Request, name: str) -> tuple[Kept, bool]:
        """Take the body of a request as a volume and show it; the volume, and whether it is new.

        Raises UploadsOffError, StartingError, BusyError, SlowUploadError, VolumeError, LateError, FullError,
        ShelfError, and Cancelled where the client has left.
        """
        if not self.on:
            raise UploadsOffError(OFF)
        self._check_ready()
        with self._gate.admitted(), self.shelf.drafts() as (body, draft):
            self._check_room(1)
            with named(self.shelf.folder):
                await receive(request, body, self._settings.body_seconds)
            limits = self.limit // VOXEL, self._settings.reading_seconds
            number = await attended(request, child.read(body, draft, name, *limits))
            async with self._changing:
                return await asyncio.to_thread(self._keep, draft, number)

    async def remove(self, number: str) -> None:
        """Show a volume no more, and have its file gone. Its light is left in the store: it may come again.

        Raises UnknownVolumeError, StartingError and ShelfError.
        """
        self.find(number)
        self._check_ready()
        async with self._changing:
            self.find(number)
            await asyncio.to_thread(self.shelf.remove, number)
            if number in self._studio.scenes:
                await asyncio.to_thread(self._studio.dismiss, number)

    def _keep(self, draft: IO[bytes], number: str) -> tuple[Kept, bool]:
        """Put a volume on the shelf and show it, unless it is there already; all or nothing."""
        if number in self.shelf.volumes:
            return self.shelf.volumes[number], False
        drafted = read_facts(Path(draft.name))
        self._check_room(drafted.held if drafted else 0)
        kept = self.shelf.put(draft, number)
        try:
            self._studio.admit(self._scene(kept))
        except Exception:
            self.shelf.remove(number)
            raise
        return kept, True

    def _check_ready(self) -> None:
        if not self._ready:
            raise StartingError("isogi is starting: ask again in a second.")

    def _check_room(self, size: int) -> None:
        """Raises FullError where so many bytes are more than the quota has left."""
        if size > self.free:
            told = f"{size} bytes are wanted and {self.free} free"
            raise FullError(f"Uploads may take {self._settings.uploads_mb} MB, {told}: delete volumes first.")

    def _scene(self, kept: Kept) -> Scene:
        """The scene of a volume: in default light, and found by the volume's id."""
        source = SceneSource(kept.name, {"volume": f"{kept.id}.nrrd"}, self.shelf.folder.resolve())
        return replace(build_scene(source), id=kept.id)
