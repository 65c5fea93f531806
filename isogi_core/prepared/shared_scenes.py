"""Scenes that processes of this machine share: one process has read and measured them, the others
map its memory.

The shared data lies in a file without a name, which disappears with the process that made it.
Others open it through /proc, as the same user; on a system that lacks either they open scenes
themselves.
"""

import mmap
import os
import pickle
import secrets
import threading
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path
from typing import Any

from isogi_core.errors import SharedMemoryError
from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.model.volume import Volume
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene

KEY_BYTES = 16
"""Bytes at the start of a file that identify it: its file descriptor may be another file's by
now.
"""

LENGTH_BYTES = 8
"""Bytes that hold the length of a file's pickle."""

ALIGNMENT = 64
"""Alignment in bytes of arrays in a file."""


@dataclass(frozen=True)
class SharedFile:
    """A file that a process of this machine keeps: its ``path``, and the ``key`` at its start."""

    path: str
    key: bytes


@dataclass(frozen=True)
class SharedScene:
    """A scene in one file, and its ``volume`` in another, which several scenes may share."""

    scene: SharedFile
    volume: SharedFile


class SharedScenes:
    """The scenes that this process shares. The file of a scene is closed when the scene is deleted,
    that of its volume when the volume is. Safe to use from many threads.
    """

    def __init__(self) -> None:
        """Share nothing yet."""
        self._files: weakref.WeakKeyDictionary[Volume | Scene, SharedFile] = (
            weakref.WeakKeyDictionary()
        )
        self._lock = threading.Lock()

    def share(self, prepared: PreparedScene) -> SharedScene | None:
        """Share a scene with its volume and all that was measured of its voxels. Return None if it
        cannot be shared.

        Volumes that take much of the memory budget are not shared: they lie in files already, which
        each process maps.
        """
        scene = prepared.scene
        if scene.volume.voxels.nbytes > UNMAPPED_SHARE * budget():
            return None
        with self._lock, suppress(OSError, AttributeError, pickle.PicklingError, TypeError):
            volume = self._shared(scene.volume, lambda: parts_of(prepared))
            # ``packed`` leaves the volume out of the scene.
            return SharedScene(self._shared(scene, lambda: scene), volume)
        return None

    def _shared(self, owner: Volume | Scene, content: Callable[[], Any]) -> SharedFile:
        """Return the file of an ``owner``, into which its ``content`` is written once. It is closed
        when the owner is deleted.
        """
        if owner not in self._files:
            # The file lies in memory, and exists as long as its descriptor is open.
            number = os.memfd_create("isogi", os.MFD_CLOEXEC)
            key = secrets.token_bytes(KEY_BYTES)
            try:
                with open(number, "wb", closefd=False) as file:
                    file.write(key)
                    file.writelines(packed(content()))
            except BaseException:
                # The owner may live on, and be shared again.
                os.close(number)
                raise
            weakref.finalize(owner, os.close, number)
            self._files[owner] = SharedFile(f"/proc/{os.getpid()}/fd/{number}", key)
        return self._files[owner]


def parts_of(prepared: PreparedScene) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the fields of a scene's volume, and the arrays measured on its voxels, by name."""
    volume = prepared.scene.volume
    facts = {each.name: getattr(volume, each.name) for each in fields(volume)}
    macrocells = prepared.field.low, prepared.field.high
    return facts, {"macrocells": macrocells, **prepared.maps.measured}


class ScenePickler(pickle.Pickler):
    """Pickles a scene without its volume."""

    def persistent_id(self, thing: Any) -> str | None:
        """Return the name that stands for a volume; None for everything else."""
        if isinstance(thing, Volume):
            return "volume"
        return None


class SceneUnpickler(pickle.Unpickler):
    """Unpickles a scene, with a ``volume`` that this process has."""

    def __init__(self, packed: bytes, volume: Volume | None, buffers: Sequence[memoryview]) -> None:
        super().__init__(BytesIO(packed), buffers=buffers)
        self._volume = volume

    def persistent_load(self, name: Any) -> Any:
        """Return the volume, whatever its name."""
        return self._volume


def packed(thing: Any) -> list[bytes | memoryview]:
    """Return the contents of a file after its key: the pickle's length, the pickle, and its
    arrays, aligned.
    """
    buffers: list[pickle.PickleBuffer] = []
    body = BytesIO()
    # Protocol 5 leaves the bytes of arrays out of the pickle.
    ScenePickler(body, protocol=5, buffer_callback=buffers.append).dump(thing)
    views = [each.raw() for each in buffers]
    head = pickle.dumps((body.getvalue(), [len(view) for view in views]))
    parts: list[bytes | memoryview] = [len(head).to_bytes(LENGTH_BYTES, "little"), head]
    at = KEY_BYTES + LENGTH_BYTES + len(head)
    for view in views:
        gap = -at % ALIGNMENT
        parts += [bytes(gap), view]
        at += gap + len(view)
    return parts


def unpacked(file: SharedFile, volume: Volume | None = None) -> Any:
    """Read a file that ``packed`` wrote; its arrays are mapped. Raises SharedMemoryError if the
    file is gone.

    Writing to an array takes memory of this process, and changes nothing for others.
    """
    try:
        with Path(file.path).open("rb") as opened:
            mapping = mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_COPY)
    except (OSError, ValueError) as error:
        raise SharedMemoryError(f"A scene that was shared is gone: {error}.") from error
    view = memoryview(mapping)
    # The descriptor may be in use for another file by now.
    if view[:KEY_BYTES] != file.key:
        raise SharedMemoryError("A scene that was shared is gone: another file is in its place.")
    at = KEY_BYTES + LENGTH_BYTES
    length = int.from_bytes(view[KEY_BYTES:at], "little")
    body, sizes = pickle.loads(view[at : at + length])
    at += length
    buffers = []
    for size in sizes:
        at += -at % ALIGNMENT
        buffers.append(view[at : at + size])
        at += size
    return SceneUnpickler(body, volume, buffers).load()


VOLUMES: weakref.WeakValueDictionary[bytes, PreparedScene] = weakref.WeakValueDictionary()
"""For each shared volume, by its key, a scene that this process has open: later scenes share
everything that was computed from the voxels.
"""


def receive_scene(shared: SharedScene, most: int) -> PreparedScene:
    """Open a scene that another process shares, with at most ``most`` bytes of active-cell maps in
    this process.

    Raises SharedMemoryError if it is gone.
    """
    # Map the volume, unless this process has it from another scene.
    known = VOLUMES.get(shared.volume.key)
    if known is None:
        facts, measured = unpacked(shared.volume)
        volume = Volume(**facts)
    else:
        volume = known.scene.volume
    scene = unpacked(shared.scene, volume)
    # Share field and maps if rays leave the surfaces of both scenes alike, else only the measured
    # arrays.
    if known is not None and alike(known.scene, scene):
        prepared = known.beside(scene)
    elif known is not None:
        prepared = PreparedScene(scene, most, known.survey)
    else:
        prepared = PreparedScene(scene, most, lambda name, _: measured[name])
    VOLUMES[shared.volume.key] = prepared
    return prepared


def alike(one: Scene, other: Scene) -> bool:
    """Return True if rays leave the surfaces of two scenes alike, so that one field serves both."""
    return (one.settings.normals, one.settings.offset) == (
        other.settings.normals,
        other.settings.offset,
    )
