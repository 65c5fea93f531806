"""Scenes that processes of this machine share: one has read and measured them, the others map its
memory.

What is shared lies in a file without a name, which is gone with the process that made it. Others
open it through /proc, as the same user; on a system without either they open scenes themselves.
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
"""Bytes at the start of a file by which it is known: its number may be another file's by now."""

LENGTH_BYTES = 8
"""Bytes that hold the length of a file's pickle."""

ALIGNMENT = 64
"""Bytes that arrays in a file are aligned to."""


@dataclass(frozen=True)
class SharedFile:
    """A file that a process of this machine keeps: its ``path``, and the ``key`` at its start."""

    path: str
    key: bytes


@dataclass(frozen=True)
class SharedScene:
    """A scene in a file, of a ``volume`` in another, which several scenes may have."""

    scene: SharedFile
    volume: SharedFile


class SharedScenes:
    """The scenes that this process shares, each for as long as its volume. Safe to use from many
    threads.
    """

    def __init__(self) -> None:
        """Share nothing yet."""
        self._files: weakref.WeakKeyDictionary[Volume | Scene, SharedFile] = (
            weakref.WeakKeyDictionary()
        )
        self._lock = threading.Lock()

    def share(self, prepared: PreparedScene) -> SharedScene | None:
        """Share a scene with its volume and all that was measured of its voxels; None if it cannot
        be shared.

        Volumes that are large beside the budget lie in files already, which each process maps.
        """
        scene = prepared.scene
        if scene.volume.voxels.nbytes > UNMAPPED_SHARE * budget():
            return None
        with self._lock, suppress(OSError, AttributeError, pickle.PicklingError, TypeError):
            volume = self._shared(scene.volume, lambda: parts_of(prepared))
            return SharedScene(self._shared(scene, lambda: scene), volume)
        return None

    def _shared(self, owner: Volume | Scene, content: Callable[[], Any]) -> SharedFile:
        """The file of an ``owner``, written once, and closed when the owner is gone."""
        if owner not in self._files:
            number = os.memfd_create("isogi", os.MFD_CLOEXEC)
            weakref.finalize(owner, os.close, number)
            key = secrets.token_bytes(KEY_BYTES)
            with open(number, "wb", closefd=False) as file:
                file.write(key)
                file.writelines(packed(content()))
            self._files[owner] = SharedFile(f"/proc/{os.getpid()}/fd/{number}", key)
        return self._files[owner]


def parts_of(prepared: PreparedScene) -> tuple[dict[str, Any], dict[str, Any]]:
    """The fields of a scene's volume, and what was measured of its voxels, by name."""
    volume = prepared.scene.volume
    facts = {each.name: getattr(volume, each.name) for each in fields(volume)}
    macrocells = prepared.field.low, prepared.field.high
    return facts, {"macrocells": macrocells, **prepared.maps.measured}


class ScenePickler(pickle.Pickler):
    """Pickles a scene without its volume."""

    def persistent_id(self, thing: Any) -> str | None:
        """Name the volume in its place."""
        if isinstance(thing, Volume):
            return "volume"
        return None


class SceneUnpickler(pickle.Unpickler):
    """Reads a scene, with a ``volume`` that is here."""

    def __init__(self, packed: bytes, volume: Volume | None, buffers: Sequence[memoryview]) -> None:
        super().__init__(BytesIO(packed), buffers=buffers)
        self._volume = volume

    def persistent_load(self, name: Any) -> Any:
        """The volume, by its name."""
        return self._volume


def packed(thing: Any) -> list[bytes | memoryview]:
    """What a file holds after its key: the pickle's length, the pickle, and its arrays, aligned."""
    buffers: list[pickle.PickleBuffer] = []
    body = BytesIO()
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
    """What a file holds; its arrays are mapped. Raises SharedMemoryError if it is gone.

    Writing to an array would take memory of this process, and change nothing for others.
    """
    try:
        with Path(file.path).open("rb") as opened:
            mapping = mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_COPY)
    except (OSError, ValueError) as error:
        raise SharedMemoryError(f"A scene that was shared is gone: {error}.") from error
    view = memoryview(mapping)
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
"""A scene that this process has open of each shared volume, by the volume's key: what was worked
out of the voxels serves the others.
"""


def receive_scene(shared: SharedScene, most: int) -> PreparedScene:
    """A scene that another process shares, with at most ``most`` bytes of active-cell maps of its
    own.

    Raises SharedMemoryError if it is gone.
    """
    known = VOLUMES.get(shared.volume.key)
    if known is None:
        facts, measured = unpacked(shared.volume)
        volume = Volume(**facts)
    else:
        volume = known.scene.volume
    scene = unpacked(shared.scene, volume)
    if known is not None and alike(known.scene, scene):
        prepared = known.beside(scene)
    elif known is not None:
        prepared = PreparedScene(scene, most, known.survey)
    else:
        prepared = PreparedScene(scene, most, lambda name, _: measured[name])
    VOLUMES[shared.volume.key] = prepared
    return prepared


def alike(one: Scene, other: Scene) -> bool:
    """Whether rays leave the surfaces of two scenes alike, so that one field serves both."""
    return (one.settings.normals, one.settings.offset) == (
        other.settings.normals,
        other.settings.offset,
    )
