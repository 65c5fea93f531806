"""Sources of volumes: a file by its path, or an open and untrusted one; and the functions that all
readers share.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial, wraps
from importlib import import_module
from pathlib import Path
from typing import IO, Any

import numpy as np

from isogi_core.errors import IsogiError, VolumeError
from isogi_core.files.formats.archive import Archive
from isogi_core.files.grid import MAX_VOXELS, SINGLE_MOMENT, Grid, Shape, slab_layers
from isogi_core.files.packed_files import (
    PACKING_DAMAGE,
    READ_BYTES,
    Content,
    content_of,
    cut_notes,
    line_of,
    open_regular,
    read_end,
    stamp_of,
)

FILE_CHOICES = ("level", "channel", "time", "series", "raw", "part")
"""Choices that a file may offer; ``part`` is a path inside it, and ``raw`` gives the sizes and type
of bare voxels.
"""


@dataclass(frozen=True, eq=False)
class Source:
    """A file, or a folder of slices, at a ``path``; or an open ``file`` that has none. ``name`` is
    for messages.

    ``chosen`` says which part of it is meant, by FILE_CHOICES. At most so many ``voxels`` are read.
    The files of an ``archive`` are read as those of a folder, or one of them, its ``member``: these
    have no path, as no library can open them by one.
    """

    name: str
    path: Path | None = None
    file: IO[bytes] | None = None
    chosen: Mapping[str, str] = field(default_factory=dict)
    voxels: int = MAX_VOXELS
    archive: Archive | None = None
    member: Path | None = None

    @property
    def is_folder(self) -> bool:
        """True if it holds files: a folder, or an archive."""
        if self.archive is not None:
            return self.member is None
        return self.path is not None and self.path.is_dir()

    @property
    def paths(self) -> list[Path]:
        """The paths of the files of a folder or an archive, in their order."""
        if self.archive is not None:
            return self.archive.paths
        assert self.path is not None, "a folder has a path"
        return sorted(path for path in self.path.iterdir() if path.is_file())

    @property
    def stored(self) -> list[Path]:
        """The path of the file on the disk, that of the ZIP file for its members; none for an
        upload.
        """
        path = self.archive.path if self.archive is not None else self.path
        return [] if path is None else [path]

    def at(self, path: Path) -> "Source":
        """Return the file at one of its ``paths``."""
        if self.archive is not None:
            return replace(self, name=str(path), member=path)
        return Source(str(path), path)

    def unpacked_archive(self) -> "Source":
        """Return this ZIP file as a folder of its members. Raises VolumeError, also if it is a
        member of another one.
        """
        if self.member is not None:
            raise VolumeError(f"'{self.name}' is a ZIP file in another one: unpack that one.")
        if self.path is None:
            assert self.file is not None, "a source has a path or a file"
            file = self.file
        else:
            file = open_regular(self.path)
        with reading(self.name, "ZIP"):
            archive = Archive(file, self.name, self.voxels, self.path)
        return replace(self, path=None, file=file, archive=archive)

    @contextmanager
    def open(self) -> Iterator[IO[bytes]]:
        """Yield the file at its beginning, as it is on the disk. Raises VolumeError if it cannot be
        read.
        """
        if self.archive is not None and self.member is not None:
            with self.archive.opened(self.member) as member:
                yield member
            return
        if self.path is None:
            assert self.file is not None, "a source has a path or a file"
            self.file.seek(0)
            yield self.file
            return
        try:
            file = open_regular(self.path)
        except FileNotFoundError as error:
            raise VolumeError(
                f"There is no file '{self.path}': check the volume's path."
            ) from error
        except OSError as error:
            raise VolumeError(
                f"The volume '{self.path}' cannot be read ({error}): check the file."
            ) from error
        with file:
            yield file

    @contextmanager
    def unpacked(self) -> Iterator[Any]:
        """Yield the file's content: gzip and bzip2 files are unpacked while they are read."""
        with self.open() as file:
            yield content_of(file)

    def cut_notes(self, size: int) -> tuple[str, ...]:
        """Return a note if the file is cut off, though its content of ``size`` bytes is whole; see
        ``packed_files.cut_notes``.
        """
        with self.open() as file:
            return cut_notes(file, size)

    def stamp(self, *others: Path) -> str:
        """Return a name of the state of the file, of ``others`` that belong to it, and of the
        choices; see ``Grid``.
        """
        return f"{stamp_of([*self.stored, *others])} {sorted(self.chosen.items())}"

    def refuse_others(self, *keys: str) -> None:
        """Raise VolumeError if something is chosen that this kind of file does not offer: all but
        ``keys``.
        """
        other = next((key for key in self.chosen if key not in keys), None)
        if other is not None:
            raise VolumeError(f"'{self.name}' has no '{other}' to choose: leave it out.")

    def count(self, key: str) -> int | None:
        """Return a number that is chosen; None if none is. Raises VolumeError if it is no whole
        number.
        """
        given = self.chosen.get(key)
        if given is None:
            return None
        if not given.isdecimal():
            raise VolumeError(f"{key} = '{given}' of '{self.name}' is no whole number from 0 on.")
        return int(given)

    def check(self, shape: Shape) -> None:
        """Raise VolumeError if a field of ``shape`` has more voxels than may be read. Call it
        before memory is allocated.
        """
        if min(shape, default=0) < 1:
            raise VolumeError(
                f"'{self.name}' claims sizes {shape[::-1]}, which cannot be: write it again."
            )
        voxels = math.prod(shape)
        if voxels > self.voxels:
            most = f"{self.voxels} are the most that may be"
            raise VolumeError(
                f"'{self.name}' has {voxels} voxels, and {most}: save a smaller part."
            )


def library(name: str, kind: str, install: str = "'isogi[formats]'") -> Any:
    """Import and return the library ``name``, which reads files of a ``kind``.

    Raises VolumeError, with the command that installs it, if it is missing.
    """
    try:
        return import_module(name)
    except ImportError as error:
        needed = f"{kind} is read by {name.partition('.')[0]}, which is not installed"
        raise VolumeError(f"{needed}: pip install {install}.") from error


MISSING_PACKAGE = re.compile(r"requires the '([\w-]+)' package")
"""How tifffile names a library that it lacks."""

LAYERED = "Its planes are {what}: they are shown as layers."
"""The note on a field of two dimensions and time, which is no volume otherwise."""

TIME_STEPS = "steps in time"


Reader = Callable[[Source], Grid]


def reader(kind: str, *choices: str) -> Callable[[Reader], Reader]:
    """Return a decorator of functions that open sources of a ``kind`` as grids; ``choices`` are
    those that such files offer.

    The function then raises VolumeError for all errors of libraries that read a damaged file, and
    so do the slabs of its grids.
    """

    def decorate(read: Reader) -> Reader:
        @wraps(read)
        def open_source(source: Source) -> Grid:
            source.refuse_others(*choices)
            with reading(source.name, kind):
                grid = read(source)
            return replace(grid, slabs=partial(_read_slabs, source.name, kind, grid.slabs))

        return open_source

    return decorate


def _read_slabs(
    name: str, kind: str, slabs: Callable[[], Iterator[np.ndarray]]
) -> Iterator[np.ndarray]:
    with reading(name, kind):
        yield from slabs()


@contextmanager
def reading(name: str, kind: str) -> Iterator[None]:
    """Raise VolumeError for whatever a library makes of a damaged file."""
    try:
        yield
    except (IsogiError, MemoryError, GeneratorExit):
        raise
    except Exception as error:  # of many kinds, from libraries on damage
        if lacking := MISSING_PACKAGE.search(str(error)):
            needed = f"'{name}' is packed in a way that {lacking[1]} reads, which is not installed"
            raise VolumeError(f"{needed}: pip install {lacking[1]}.") from error
        raise VolumeError(
            f"'{name}' cannot be read as {kind} ({line_of(error)}): copy or write it again."
        ) from error


def raw_slabs(
    source: Source, start: int, shape: Shape, dtype: np.dtype[Any], exact: bool = False
) -> Iterator[np.ndarray]:
    """Yield the voxels (z, y, x) that follow each other from byte ``start`` of the content on, some
    layers at a time.

    Raises VolumeError if the file ends before the last voxel, or if it is to be ``exact`` and goes
    on after it. Memory is allocated only for voxels that are there, whatever a header says.
    """
    with source.unpacked() as file:
        try:
            skip(file, start)
            yield from slabs_in(file, source.name, shape, dtype)
            if read_end(file) and exact:
                raise VolumeError(
                    f"'{source.name}' goes on after its last voxel: check its sizes and its type."
                )
        except PACKING_DAMAGE as error:
            raise VolumeError(
                f"The voxels of '{source.name}' are damaged ({error}): copy it again."
            ) from error


def skip(file: Content, count: int) -> None:
    """Read over so many bytes."""
    while count > 0 and (data := file.read(min(count, READ_BYTES))):
        count -= len(data)


def slabs_in(file: Content, name: str, shape: Shape, dtype: np.dtype[Any]) -> Iterator[np.ndarray]:
    """Yield the next numbers of a file as an array of a ``shape``, some layers at a time. Raises as
    ``read_numbers``.
    """
    layer = math.prod(shape[1:])
    deep = slab_layers(layer * dtype.itemsize)
    for z in range(0, shape[0], deep):
        yield read_numbers(file, name, min(deep, shape[0] - z) * layer, dtype).reshape(
            -1, *shape[1:]
        )


def read_numbers(file: Content, name: str, count: int, dtype: np.dtype[Any]) -> np.ndarray:
    """Return the next numbers of a file, (count,). Raises VolumeError, which names the volume, if
    there are fewer. Memory is allocated as they are read.
    """
    data = bytearray()
    size = count * dtype.itemsize
    while len(data) < size:
        block = file.read(min(size - len(data), READ_BYTES))
        if not block:
            raise VolumeError(f"'{name}' ends before its last voxel: copy it again.")
        data += block
    return np.frombuffer(data, dtype)


LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue (Rec. 709)."""

LUMINANCE_NOTE = "The voxels are colours: their luminance is shown."


def luminance_of_colours(colours: np.ndarray) -> np.ndarray:
    """Return the luminance of colours (..., 3 or 4), float32; opacity is left out."""
    return np.asarray(colours[..., :3].astype(np.float32) @ np.array(LUMINANCE_WEIGHTS, np.float32))


def pick(source: Source, key: str, length: int, steps: str) -> int:
    """Return the number of the element that is chosen by ``key`` of ``length`` elements, 0 if there
    is only one. ``steps`` names the elements in messages.

    Raises VolumeError if none of several is chosen, or one that does not exist.
    """
    chosen = source.count(key)
    if chosen is None and length > 1:
        one = f"choose one by {key} = 0 to {length - 1} in the scene, or as '{source.name}#{key}=0'"
        raise VolumeError(f"'{source.name}' has {length} {steps}: {one}.")
    if not 0 <= (chosen or 0) < length:
        raise VolumeError(
            f"{key} = {chosen} is not in '{source.name}', which has 0 to {length - 1}."
        )
    return chosen or 0


def pick_step(source: Source, length: int) -> tuple[int, bool]:
    """Return the number of the chosen one of ``length`` steps in time, the first by default, and
    True if there are several and none was chosen.

    It is for files that say that an axis is time. Raises VolumeError for a step that does not
    exist.
    """
    unchosen = length > 1 and source.count("time") is None
    return 0 if unchosen else pick(source, "time", length, "time steps"), unchosen


def pick_axes(
    source: Source, shape: Shape, in_time: bool = False
) -> tuple[tuple[int, ...], tuple[int, int], bool]:
    """Return the elements that are chosen along the axes before the last three of an array, the
    moment, and True if none of several steps was chosen; see ``Grid``.

    Two such axes are time and then channel. A single one is chosen by either key. If the first is
    known to be ``in_time``, its first step is taken by default. Raises VolumeError if there are
    more axes.
    """
    extra = shape[:-3]
    if len(extra) > 2:
        raise VolumeError(
            f"'{source.name}' has {len(shape)} dimensions: save one scalar field of it."
        )
    if not extra:
        return (), SINGLE_MOMENT, False
    if in_time:
        step, unchosen = pick_step(source, extra[0])
        rest = [pick(source, "channel", n, "elements of channel") for n in extra[1:]]
        return (step, *rest), (step, extra[0]), unchosen
    if len(extra) == 1:
        if "channel" in source.chosen:
            key = "channel"
        else:
            key = "time"
        picked = pick(source, key, extra[0], "fields")
        return (picked,), SINGLE_MOMENT if key == "channel" else (picked, extra[0]), False
    time, channel = (
        pick(source, key, n, f"elements of {key}")
        for key, n in zip(("time", "channel"), extra, strict=True)
    )
    return (time, channel), (time, extra[0]), False


WHOLE_SLAB_BYTES = 1 << 28
"""Bytes of a slab that is read across the order in which an array lies."""


@dataclass(frozen=True)
class Picked:
    """The part of an array that is read: an element or a range along each axis, the ``key``, and
    the places of z, y and x among the axes, their ``order``.
    """

    key: tuple[Any, ...]
    order: tuple[int, int, int]
    shape: Shape

    def cropped(self, shape: Shape) -> "Picked":
        """Keep the first voxels along z, y, x, as many as a ``shape`` has; all if that is empty."""
        if not shape:
            return self
        key = list(self.key)
        for place, n in zip(self.order, shape, strict=True):
            key[place] = slice(0, n)
        return replace(self, key=tuple(key), shape=shape)

    def blocks(self, deep: int, itemsize: int) -> Iterator[tuple[int, int]]:
        """Divide the layers along z into blocks of whole chunks, ``deep`` layers each: small ones,
        or large ones if layers lie across the order of the array.
        """
        layer = self.shape[1] * self.shape[2] * itemsize
        if self.order[0] == min(self.order):
            most = slab_layers(layer)
        else:
            most = max(WHOLE_SLAB_BYTES // layer, 1)
        step = max(most // deep, 1) * deep
        for z in range(0, self.shape[0], step):
            yield z, min(z + step, self.shape[0])

    def layers(self, first: int, end: int) -> tuple[Any, ...]:
        """Return the key of some layers along z."""
        key = list(self.key)
        key[self.order[0]] = slice(first, end)
        return tuple(key)

    def turned(self, block: np.ndarray) -> np.ndarray:
        """Return a ``block`` that was read by a key of layers in the order z, y, x."""
        return block.transpose(np.argsort(np.argsort(self.order)))


def pick_roles(
    source: Source, shape: Shape, roles: Sequence[str]
) -> tuple[Picked, tuple[int, int], bool]:
    """Pick the field of an array whose axes have ``roles``: x, y, z, t and c; without roles, as
    ``pick_axes`` does. Return the moment, too, and True if none of several steps was chosen. Raises
    VolumeError.
    """
    if not roles:
        ahead, moment, first = pick_axes(source, shape)
        n = len(shape)
        whole = (*ahead, slice(None), slice(None), slice(None))
        return Picked(whole, (n - 3, n - 2, n - 1), shape[-3:]), moment, first
    key: list[Any] = [slice(None)] * len(shape)
    moment = SINGLE_MOMENT
    first = False
    for place, (role, length) in enumerate(zip(roles, shape, strict=True)):
        if role in ("x", "y", "z"):
            continue
        if role == "t":
            step, first = pick_step(source, length)
            key[place] = step
            moment = (step, length) if length > 1 else moment
        else:
            key[place] = pick(source, "channel", length, "channels")
    z, y, x = (list(roles).index(name) for name in "zyx")
    return Picked(tuple(key), (z, y, x), (shape[z], shape[y], shape[x])), moment, first
