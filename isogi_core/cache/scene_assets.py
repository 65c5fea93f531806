"""Scene assets: the volume, light files and other arrays
that workers on other machines need, kept in the store by digest.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from zarr.codecs import Crc32cCodec, ZstdCodec

from isogi_core.errors import ChangedError, DamagedChunkError, LightError, StoreError
from isogi_core.files.scene_file import DEFAULT_DEMO, VOXEL_SETTINGS, SceneSource
from isogi_core.files.volume_copies import Draft, find_copy, get_copy, get_file
from isogi_core.model.colours import Label, Scale, SurfaceColours
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.model.value_survey import begin_digest
from isogi_core.model.volume import PLAIN_ORIENTATION, UNMEASURED_FIELDS, Orientation, Volume
from isogi_core.plan.scene import Scene
from isogi_core.storage.backend import one_line
from isogi_core.storage.store import (
    METADATA_KEY,
    ZSTD_LEVEL,
    Store,
    described_array,
    description,
    unwrap,
    wrap,
)

Shape = tuple[int, ...]


class Asset:
    """An array with its facts, under a ``name`` in a ``store``. Methods raise StoreError."""

    def __init__(self, store: Store, name: str) -> None:
        """Set up without a request to the store."""
        self.store = store
        self.name = name

    def put(self, values: np.ndarray, chunk: Shape, facts: Mapping[str, Any]) -> None:
        """Write ``values`` in objects of at most ``chunk``, and the ``facts``, unless they are
        there.

        Two processes may write the same array at once, as they write the same bytes.
        """
        # The metadata is written last, so if it is there, the chunks are, too.
        if self.store.get(f"{self.name}/{METADATA_KEY}") is not None:
            return
        sides = tuple(min(most, n) for most, n in zip(chunk, values.shape, strict=True))
        for index in product(
            *(range(-(-n // side)) for n, side in zip(values.shape, sides, strict=True))
        ):
            self._put(self._key(index), pack_chunk(values, sides, index))
        compressors = [ZstdCodec(level=ZSTD_LEVEL), Crc32cCodec()]
        form: dict[str, Any] = {"shape": values.shape, "chunks": sides, "dtype": values.dtype}
        metadata = description(
            **form, fill_value=0, compressors=compressors, attributes={"isogi": dict(facts)}
        )
        self._put(f"{self.name}/{METADATA_KEY}", metadata)

    def describe(self) -> tuple[Shape, Shape, np.dtype[Any], dict[str, Any]]:
        """Return the shape of the array, the shape of a chunk, the type, and the facts."""
        found = self.store.get(f"{self.name}/{METADATA_KEY}")
        if found is None:
            raise StoreError(
                f"The workers need {self.name}, which is missing in {self._where}: restart the "
                "server."
            )
        try:
            array = described_array(found.data)
            facts: Any = array.attrs.asdict()["isogi"]
            return array.shape, array.chunks, array.dtype, facts
        except Exception as error:  # what Zarr makes of other documents is of many kinds
            raise self.damaged(one_line(error)) from error

    def slabs(self) -> Iterator[np.ndarray]:
        """Yield the array along its first axis,
        one layer of chunks at a time, so that it need not fit memory.
        """
        shape, chunk, dtype, _ = self.describe()
        for z in range(-(-shape[0] // chunk[0])):
            slab = np.empty((min(chunk[0], shape[0] - z * chunk[0]), *shape[1:]), dtype)
            # Fill the slab chunk by chunk; chunks at the array's end are padded, so cut them to
            # fit.
            for rest in product(
                *(range(-(-n // side)) for n, side in zip(shape[1:], chunk[1:], strict=True))
            ):
                part = slab[
                    (
                        slice(None),
                        *(slice(i * n, (i + 1) * n) for i, n in zip(rest, chunk[1:], strict=True)),
                    )
                ]
                block = self._block((z, *rest), chunk, dtype)
                part[...] = block[tuple(map(slice, part.shape))]
            yield slab

    @contextmanager
    def understood(self) -> Iterator[None]:
        """Raise StoreError if the block finds facts that are missing, unknown or of another kind,
        as other code may have written them.
        """
        try:
            yield
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise self.damaged(f"its facts are of another kind: {one_line(error)}") from error

    def damaged(self, why: str) -> StoreError:
        """Return the error for a damaged array; ``why`` completes the sentence."""
        return StoreError(
            f"{self.name} in {self._where} is damaged ({why}): delete it, and restart the server."
        )

    @property
    def _where(self) -> str:
        """The store, in words for messages."""
        return f"the store at {self.store.url}"

    def _key(self, index: Shape) -> str:
        """Return the key of a chunk's object, as Zarr names it."""
        return "/".join((self.name, "c", *map(str, index)))

    def _put(self, key: str, data: bytes) -> None:
        """Write an object, even in place of a different one."""
        try:
            self.store.put(key, data, None)
        except ChangedError:
            found = self.store.get(key)
            if found is None or found.data != data:
                with suppress(ChangedError):  # another process writes the same
                    self.store.put(key, data, found)

    def _block(self, index: Shape, chunk: Shape, dtype: np.dtype[Any]) -> np.ndarray:
        """Read a chunk in its full shape, padded at the array's end."""
        found = self.store.get_sound(self._key(index))
        if found is None:
            raise self.damaged(f"chunk {index} is missing")
        try:
            return unwrap(found.data, math.prod(chunk) * dtype.itemsize).view(dtype).reshape(chunk)
        except DamagedChunkError as error:
            raise self.damaged(f"chunk {index}: {error}") from error


def pack_chunk(values: np.ndarray, chunk: Shape, index: Shape) -> bytes:
    """Return the object of a chunk: its values in little-endian order,
    padded with zeros at the array's end, compressed, with a checksum.
    """
    part = values[tuple(slice(i * n, (i + 1) * n) for i, n in zip(index, chunk, strict=True))]
    block = np.zeros(chunk, values.dtype.newbyteorder("<"))
    block[tuple(map(slice, part.shape))] = part
    return wrap(block.reshape(-1).view(np.uint8))


VOLUME_OBJECT_VOXELS = (32, 256, 256)
"""Voxels of a volume in one object, 8 MiB of float32 before compression."""

FILE_OBJECT_BYTES = 1 << 23
"""Bytes of a file in one object."""


@dataclass(frozen=True)
class SceneAssets:
    """The digests of a scene's assets, by which another machine finds them in the store.

    ``volume`` is empty for a demo. ``files`` are pairs of the name of a light's file in the scene
    and its digest. ``colours`` and ``glow_bits`` are of the surface's colours and of the masks of
    glowing parts, empty if there are none. The ``orientation`` is the volume's: it is not in the
    digest of the volume, as equal voxels may lie differently in two scenes.
    """

    volume: str
    files: tuple[tuple[str, str], ...]
    orientation: Orientation = PLAIN_ORIENTATION
    colours: str = ""
    glow_bits: str = ""


def send_assets(scene: Scene, store: Store) -> SceneAssets:
    """Write the assets of a ``scene`` to the ``store``, unless they are there, and return their
    digests.

    Raises StoreError, and LightError if the file of a light cannot be read.
    """
    source = scene.source
    volume = scene.volume
    files = []
    # The files of lights.
    for name in files_of(source.document):
        data = read_file(source.base / name)
        files.append((name, digest_of_file(data)))
        Asset(store, f"files/{files[-1][1]}").put(
            np.frombuffer(data, np.uint8), (FILE_OBJECT_BYTES,), {}
        )
    if scene.surfaces.colours:
        colours = send_colours(scene.surfaces.colours, store)
    else:
        colours = ""
    if scene.lighting.glowing.bits.size:
        bits = send_glow_bits(scene.lighting.glowing.bits, store)
    else:
        bits = ""
    # A demo is computed on each machine, so its voxels are not sent.
    if str(source.document.get("volume", DEFAULT_DEMO)).startswith("demo:"):
        return SceneAssets("", tuple(files), colours=colours, glow_bits=bits)
    facts = {
        name: value
        for name, value in vars(volume.counted()).items()
        if name not in UNMEASURED_FIELDS
    }
    Asset(store, f"volumes/{volume.digest}").put(volume.voxels, VOLUME_OBJECT_VOXELS, facts)
    return SceneAssets(volume.digest, tuple(files), volume.orientation, colours, bits)


def send_colours(colours: SurfaceColours, store: Store) -> str:
    """Write the colours of a surface to the ``store``, unless they are there; return their digest.

    Raises StoreError.
    """
    scale = {**asdict(colours.scale), "table": colours.scale.table.tolist()}
    places = colours.places
    chunk = VOLUME_OBJECT_VOXELS + places.shape[len(VOLUME_OBJECT_VOXELS) :]
    Asset(store, f"colours/{colours.digest}").put(
        places, chunk, {"step": colours.step, "scale": scale}
    )
    return colours.digest


def receive_colours(assets: SceneAssets, store: Store) -> SurfaceColours | None:
    """Read the colours of a surface from the ``store``, as ``send_colours`` has written them; None
    if the scene has none.

    Raises StoreError if they are missing or damaged.
    """
    if not assets.colours:
        return None
    asset = Asset(store, f"colours/{assets.colours}")
    _, _, _, facts = asset.describe()
    # Read the codes of the colours, (nz, ny, nx) or (nz, ny, nx, 3) uint8: see ``SurfaceColours``.
    places = np.concatenate(list(asset.slabs()))
    # Build the colour scale from the facts; JSON has made lists of its tuples.
    with asset.understood():
        scale = facts["scale"]
        pairs = {key: tuple(scale[key]) for key in ("span", "outside")}
        labels = tuple(
            Label(**{**each, "colour": tuple(each["colour"])}) for each in scale.get("labels", ())
        )
        found = Scale(
            scale["name"], map=scale["map"], table=np.array(scale["table"]), labels=labels, **pairs
        )
        colours = SurfaceColours(places, tuple(facts["step"]), found)
    if colours.digest != assets.colours:
        raise asset.damaged("it holds other colours")
    return colours


def send_glow_bits(bits: np.ndarray, store: Store) -> str:
    """Write the masks of glowing parts to the ``store``, unless they are there;
    return their digest. Raises StoreError.
    """
    digest = digest_of_file(bits.tobytes())
    Asset(store, f"glow/{digest}").put(bits, VOLUME_OBJECT_VOXELS, {})
    return digest


def receive_glow_bits(assets: SceneAssets, store: Store) -> np.ndarray | None:
    """Read the masks of glowing parts among a scene's assets; None if it has none.

    Raises StoreError if they are missing or damaged.
    """
    if not assets.glow_bits:
        return None
    asset = Asset(store, f"glow/{assets.glow_bits}")
    bits = np.concatenate(list(asset.slabs()))
    if digest_of_file(bits.tobytes()) != assets.glow_bits:
        raise asset.damaged("it holds other masks")
    return bits


def receive_assets(
    source: SceneSource, assets: SceneAssets, store: Store
) -> tuple[SceneSource, Volume | None]:
    """Fetch a scene's volume and light files to this machine, unless there are copies already.

    Return the source with the paths of the copies, and the volume, None for a demo. Raises
    StoreError, and VolumeError if there is no room for the volume.
    """
    # Name the copies of files in the document, in place of the other machine's paths.
    files = {name: str(fetch_file(digest, Path(name).name, store)) for name, digest in assets.files}
    document = dict(source.document)
    if "lights" in document and "environment" not in document:
        document["lights"] = [with_copied_file(light, files) for light in document["lights"]]
    if "environment" in document:
        document["environment"] = files.get(document["environment"], document["environment"])
    if not assets.volume:
        return replace(source, document=document), None
    # The settings of voxels have been applied before the volume was sent.
    kept = {key: value for key, value in document.items() if key not in VOXEL_SETTINGS}
    volume = fetch_volume(assets.volume, store)
    return replace(source, document=kept), replace(volume, orientation=assets.orientation)


def files_of(document: Mapping[str, Any]) -> list[str]:
    """Return the names of the files of a scene's lights, as its ``document`` gives them."""
    if "environment" in document:
        if document["environment"] not in ENVIRONMENTS:
            return [str(document["environment"])]
        return []
    return [str(light["file"]) for light in document.get("lights", ()) if "file" in light]


def with_copied_file(light: Mapping[str, Any], files: Mapping[str, str]) -> Mapping[str, Any]:
    """Return the table of a light with the path of its file's copy."""
    if "file" in light:
        return {**light, "file": files[str(light["file"])]}
    return light


def fetch_volume(digest: str, store: Store) -> Volume:
    """Return the volume of a ``digest``,
    mapped from this machine's copy, which is made if there is none.
    """
    found = find_copy(digest)
    if found is None:
        asset = Asset(store, f"volumes/{digest}")
        size = 4 * math.prod(asset.describe()[0])
        found = get_copy(digest, size, lambda draft: download(asset, draft, digest))
    return Volume(found[0], **found[1])


def download(asset: Asset, draft: Draft, digest: str) -> dict[str, Any]:
    """Copy a volume's voxels from the store to a ``draft``, write its header, and return the
    volume's facts.

    Raises StoreError if the volume is missing or damaged, or has another ``digest``: the ``draft``
    has no header then, and is never read.
    """
    shape, _, _, facts = asset.describe()
    if len(shape) != 3:
        raise asset.damaged(f"it has {len(shape)} axes")
    # Compute the digest along the way, as voxels pass by only once.
    with asset.understood():
        seen = begin_digest(shape, facts["spacing"], facts["offset"], facts["scale"])
        # See that these facts make a volume, before voxels are fetched for it.
        Volume(np.empty((0, 0, 0), np.float32), **facts)
    for slab in asset.slabs():
        # Voxels are stored as float32, as draft and digest need them: this copies nothing.
        for plane in slab.astype(np.float32, copy=False):
            draft.write(plane)
            seen.update(plane.data)
    # A copy is found by the digest among its facts, too.
    if not seen.hexdigest() == facts["digest"] == digest:
        raise asset.damaged("it holds another volume")
    draft.seal(shape, facts)
    return facts


def fetch_file(digest: str, name: str, store: Store) -> Path:
    """Return the path of this machine's copy of a light's file, which is fetched from the ``store``
    if there is none.

    The file is in the store under its ``digest``; the path ends in ``name``, its name in the scene.
    Raises StoreError if the file is missing or damaged in the store, and VolumeError if the copy
    cannot be written.
    """

    def fetch() -> bytes:
        """Read the file from the store, and check its digest."""
        asset = Asset(store, f"files/{digest}")
        data = b"".join(part.tobytes() for part in asset.slabs())
        if digest_of_file(data) != digest:
            raise asset.damaged("it holds another file")
        return data

    return get_file(digest, name, fetch)


def read_file(path: Path) -> bytes:
    """Return the bytes of a light's file. Raises LightError if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise LightError(
            f"The light '{path}' cannot be read ({error.strerror}): check its path."
        ) from error


def digest_of_file(data: bytes) -> str:
    """Return the digest of a file's bytes, in hexadecimal."""
    return hashlib.blake2b(data, digest_size=16).hexdigest()
