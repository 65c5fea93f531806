"""Parcels of a scene: what a worker on another machine needs of it, kept in the store by its digest.

These are the volume's voxels, under ``volumes``, and the bytes of files that lights name, under ``files``. They are
written once, by the server that has the scene's files, and fetched once a machine.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.cache.parcel import Parcel
from isogi_core.cache.root import Root
from isogi_core.errors import LightError
from isogi_core.files.copies import find_copy, get_copy, get_file
from isogi_core.files.voxels import Draft
from isogi_core.model.scene import Scene
from isogi_core.model.source import DEFAULT_DEMO, SceneSource
from isogi_core.model.survey import begin_digest
from isogi_core.model.volume import Volume

CHUNK = (32, 256, 256)
"""Voxels of a volume in one object: 8 MiB before they are packed."""

BYTES = 1 << 23
"""Bytes of a file in one object."""

FOLLOWED = ("solid", "spacing", "missing", "level", "channel", "time")
"""Settings of a scene that the voxels of its volume follow already."""


@dataclass(frozen=True)
class Parcels:
    """The digests of a scene's ``volume``, empty for a demo, and of its lights' ``files``, by their names there."""

    volume: str
    files: tuple[tuple[str, str], ...]


def send_parcels(scene: Scene, root: Root) -> Parcels:
    """Write what a scene was made of to the store at ``root``, unless it is there.

    Raises StoreError, and LightError where a file of a light is gone.
    """
    source, volume, files = scene.source, scene.volume, []
    for name in [str(light["file"]) for light in source.document.get("lights", ()) if "file" in light]:
        data = read_file(source.base / name)
        files.append((name, digest_of_file(data)))
        Parcel(root, f"files/{files[-1][1]}").put(np.frombuffer(data, np.uint8), (BYTES,), {})
    if str(source.document.get("volume", DEFAULT_DEMO)).startswith("demo:"):
        return Parcels("", tuple(files))
    facts = {name: value for name, value in vars(volume.counted()).items() if name != "voxels"}
    Parcel(root, f"volumes/{volume.digest}").put(volume.voxels, CHUNK, facts)
    return Parcels(volume.digest, tuple(files))


def receive_parcels(source: SceneSource, parcels: Parcels, root: Root) -> tuple[SceneSource, Volume | None]:
    """The scene as this machine can open it, with copies of its parcels, which are fetched where there are none yet.

    That is its source, and the volume where that is no demo. Raises StoreError, and VolumeError where there is no room.
    """
    files = {name: str(fetch_file(digest, Path(name).name, root)) for name, digest in parcels.files}
    document = dict(source.document)
    if "lights" in document:
        document["lights"] = [moved(light, files) for light in document["lights"]]
    if not parcels.volume:
        return replace(source, document=document), None
    kept = {key: value for key, value in document.items() if key not in FOLLOWED}
    return replace(source, document=kept), fetch_volume(parcels.volume, root)


def moved(light: Mapping[str, Any], files: Mapping[str, str]) -> Mapping[str, Any]:
    """A light's table with the place that its file has here."""
    return {**light, "file": files[str(light["file"])]} if "file" in light else light


def fetch_volume(digest: str, root: Root) -> Volume:
    """The volume of a digest, mapped from this machine's copy of it."""
    found = find_copy(digest)
    if found is None:
        parcel = Parcel(root, f"volumes/{digest}")
        nz, ny, nx = parcel.describe()[0]
        found = get_copy(digest, 4 * nz * ny * nx, lambda draft: unpack(parcel, draft, digest))
    return Volume(found[0], **found[1])


def unpack(parcel: Parcel, draft: Draft, digest: str) -> dict[str, Any]:
    """Write the voxels in the store to a ``draft``; their facts. StoreError where they are not those of the digest."""
    shape, _, _, facts = parcel.describe()
    seen = begin_digest(shape, facts["spacing"], facts["offset"], facts["scale"])
    for slab in parcel.slabs():
        for plane in slab.astype(np.float32, copy=False):
            draft.write(plane)
            seen.update(plane.data)
    if seen.hexdigest() != digest:
        raise parcel.damaged("it holds another volume")
    draft.seal(shape, facts)
    return facts


def fetch_file(digest: str, name: str, root: Root) -> Path:
    """This machine's copy of a file."""

    def fetch() -> bytes:
        parcel = Parcel(root, f"files/{digest}")
        data = b"".join(part.tobytes() for part in parcel.slabs())
        if digest_of_file(data) != digest:
            raise parcel.damaged("it holds another file")
        return data

    return get_file(digest, name, fetch)


def read_file(path: Path) -> bytes:
    """The bytes of a light's file; LightError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise LightError(f"The light '{path}' cannot be read ({error.strerror}): check its path.") from error


def digest_of_file(data: bytes) -> str:
    """Hex name of a file's bytes."""
    return hashlib.blake2b(data, digest_size=16).hexdigest()
