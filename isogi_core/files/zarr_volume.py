"""Zarr volumes: arrays of Zarr v2 and v3, bare or in an OME-Zarr image, read chunk by chunk from
the place where they are stored.
"""

import hashlib
import math
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import zarr
from zarr.abc.store import Store
from zarr.storage import LocalStore, ObjectStore

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import SPACING_KEY, Along, Place, place_by, unread_spacing
from isogi_core.files.grid import (
    MAX_VOXELS,
    SINGLE_MOMENT,
    Affine,
    Grid,
    LabelName,
    Region,
    Shape,
    slab_layers,
)
from isogi_core.files.mappings import budget
from isogi_core.files.ome import (
    SPACE_AXES,
    Axis,
    Resolution,
    array_axes,
    first_image,
    labels_of,
    odd_units,
    placed_in_space,
    resolutions_of,
)
from isogi_core.files.packed_files import line_of, stamp_of
from isogi_core.files.packing import Packing, climate_packing
from isogi_core.files.scene_file import ZARR_METADATA
from isogi_core.files.zarr_axes import is_in_space, named_axes
from isogi_core.storage.backend import BUCKET_SCHEMES, SECRET_PARTS, StoreUrl
from isogi_core.storage.object_store import call_options, retry_options

CALL_SECONDS = 30.0
"""Seconds for one call to a URL."""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """A hierarchy in a ``store``, the chosen path ``inside`` it, and the display ``name`` of the
    whole.

    ``stamp`` names the state of its objects; see ``Grid``.
    """

    name: str
    inside: str
    store: Store
    stamp: Callable[[], str]


def hierarchy_at(location: Path | str) -> Hierarchy:
    """Return the hierarchy that contains a folder or a URL. Raises VolumeError if there is none,
    for links out of the folder, and for URLs that hold a secret.
    """
    if isinstance(location, str):
        return _remote(location)
    root = root_of(location)
    check_links(root)
    inside = location.relative_to(root).as_posix().removeprefix(".")
    return Hierarchy(
        str(root), inside, LocalStore(root, read_only=True), partial(_stamp_of_folder, root)
    )


def root_of(path: Path) -> Path:
    """Return the outermost folder of the Zarr hierarchy that contains ``path``."""
    if not path.is_dir():
        raise VolumeError(f"There is no Zarr array '{path}': check the volume's path.")
    if not _is_zarr(path):
        raise VolumeError(
            f"'{path}' is a folder that holds no Zarr array: give a .zarr folder, or a NRRD file."
        )
    while _is_zarr(path.parent):
        path = path.parent
    return path


def _is_zarr(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ZARR_METADATA)


def check_links(root: Path) -> None:
    """Raise VolumeError if something below ``root`` is a link out of it."""
    real = root.resolve()
    for folder, folders, files in os.walk(root):
        for name in (*folders, *files):
            path = Path(folder) / name
            if path.is_symlink() and not path.resolve().is_relative_to(real):
                raise VolumeError(
                    f"'{path}' is a link out of the volume's folder: put a copy in its place."
                )


def _remote(url: str) -> Hierarchy:
    """Return the hierarchy at a URL; the part up to ``.zarr`` is its root, if there is one."""
    scheme = url.partition("://")[0].lower()
    if scheme not in BUCKET_SCHEMES or SECRET_PARTS.search(url):
        known = "it must begin with s3://, gs://, az:// or https:// and hold no password or key"
        raise VolumeError(
            f"The volume's URL cannot be used ({known}): put credentials into the environment."
        )
    found = re.match(r"(.+\.zarr)(?:/(.*))?$", url.rstrip("/"))
    if found:
        root = found[1]
        inside = found[2] or ""
    else:
        root = url.rstrip("/")
        inside = ""
    try:
        from obstore import store as stores  # noqa: PLC0415 (an extra)
    except ImportError:
        raise VolumeError(
            f"'{url}' needs a library that is not installed: pip install 'isogi[s3]'."
        ) from None
    connect: Any = getattr(stores, "from_url")  # noqa: B009 (it has a signature for each scheme)
    store_url = StoreUrl(root, seconds=CALL_SECONDS)
    try:
        store = connect(
            root, client_options=call_options(store_url), retry_config=retry_options(store_url)
        )
    except Exception as error:  # of many kinds, for what the environment lacks
        reason = type(error).__name__
        raise VolumeError(
            f"'{url}' cannot be reached ({reason}): check it, and the environment."
        ) from None
    return Hierarchy(
        root, inside, ObjectStore(store, read_only=True), partial(_stamp_of_objects, root, store)
    )


def _stamp_of_folder(root: Path) -> str:
    """Return a digest (hex) of all files below ``root``."""
    return stamp_of(
        sorted(Path(folder) / name for folder, _, names in os.walk(root) for name in names)
    )


def _stamp_of_objects(root: str, store: Any) -> str:
    """Return a digest (hex) of the paths, sizes, tags and times of change of all objects at the URL
    ``root``; ``store`` is obstore's connection to it.

    If objects cannot be listed, as over plain HTTP, only the metadata files of the root count:
    changes of chunks, and of metadata further inside, go unnoticed.
    """
    import obstore  # noqa: PLC0415 (an extra)

    try:
        found = [each for page in obstore.list(store) for each in page]
    except Exception:  # a server that lists nothing
        found = [head for name in ZARR_METADATA if (head := _head(store, name)) is not None]
    facts = sorted(
        f"{each['path']} {each['size']} {each['e_tag']} {each['last_modified']}" for each in found
    )
    return hashlib.blake2b("\0".join([root, *facts]).encode(), digest_size=16).hexdigest()


def _head(store: Any, name: str) -> Any:
    """Return path, size, tag and time of change of an object in obstore's ``store``; None if there
    is no such object.
    """
    import obstore  # noqa: PLC0415 (an extra)

    try:
        return obstore.head(store, name)
    except FileNotFoundError:
        return None


MAX_LAYER_BYTES = 1 << 29
"""Most bytes of a layer of chunks that is read at once; chunks of larger layers are read several
times.
"""

MOST_CHUNKS = 1 << 22
"""Most chunks of a field, or of a region of it: to ask for more takes hours, whatever they hold."""

MAX_CHUNK = 1 << 30
"""Most bytes of one chunk, as it must be in memory as a whole."""

MAX_PICTURE_VOXELS = 4096
"""Voxels along an image's longest side that the largest picture of all of it shows, one a pixel."""

SHIFT_NOTE = (
    "It says no translation: where its voxels are means of finer ones, surfaces lie "
    "up to half a voxel off."
)

CHOSEN_AXES = {"t": "time", "c": "channel"}
"""Settings of a scene that choose along axes that are not spatial."""


@dataclass(frozen=True, eq=False)
class FoundArray:
    """An ``array`` of a hierarchy, with its axes.

    ``given`` is the resolution by which its image describes it, None if it has no image. ``notes``
    say why it was chosen; ``labels`` are those of an image of labels, and ``levels`` its
    resolutions. ``scales`` are coordinates along x, y, z, of an array that no image describes.
    """

    among: Hierarchy
    array: "zarr.Array[Any]"
    axes: tuple[Axis, ...]
    given: Resolution | None = None
    notes: tuple[str, ...] = ()
    labels: tuple[LabelName, ...] | None = None
    levels: int = 1
    scales: tuple[Along | None, ...] = ()


def open_zarr(
    path: Path | str,
    level: int | None = None,
    channel: int | None = None,
    time: int | None = None,
    region: Region | None = None,
) -> Grid:
    """Open a Zarr array, or a resolution of an OME-Zarr image, as a grid; only metadata is read
    now.

    ``path``, a folder or a URL, is the array or the image, or an array inside one
    (``brain.zarr/2``). ``level`` 0 is the finest resolution; the default is the finest that memory
    and pictures have room for. ``channel`` and ``time`` choose along these axes; the default is the
    first time step. If a ``region`` is given, only chunks in it are read. Spacing is the scale of
    the image, in the unit of x; without an image it follows from the coordinates of the axes, and
    is 1 if there are none.

    Raises VolumeError if there is no such array, if none of several channels is chosen, if another
    axis that is neither in space nor time has more than one element, if its codecs are not
    installed, and for links that lead out of the folder. The slabs raise it for damaged chunks.
    """
    found = find_array(path, level)
    if level is None and region is None:
        found = _fitting(path, found)
    array = found.array
    chosen = {"c": channel, "t": time}
    picks = [
        slice(None) if axis.name in SPACE_AXES else _pick(path, found, n, chosen)
        for n, axis in enumerate(found.axes)
    ]
    _check(path, found, region)
    packing = _packing(array)
    order = _order(found.axes)
    shape = tuple(array.shape[n] for n in order)
    slabs = partial(_slabs, path, array, (tuple(picks), order), shape, packing)
    read = [array.path, *(pick for pick in picks if isinstance(pick, int))]
    place = _placed(found)
    times = dict(zip((axis.name for axis in found.axes), array.shape, strict=True)).get("t", 1)
    if times > 1:
        moment = (time or 0, times)
    else:
        moment = SINGLE_MOMENT
    unchosen = time is None and times > 1
    stamp = partial(_stamp, found.among, read)
    notes = (*found.notes, *packing.notes, *place.notes)
    if found.given:
        kind = ("OME-Zarr", "its transformations")
    elif place.said and not place.notes:
        kind = ("Zarr", "the coordinates of its axes")
    else:
        kind = ("Zarr", "")
    grid = Grid(shape, packing.dtype, place.spacing, slabs, stamp, place.affine, place.unit, notes)
    grid = replace(
        grid, moment=moment, unchosen=unchosen, labels=found.labels, read_as=packing.read_as(*kind)
    )
    if region is None:
        return grid
    part = grid.cropped(region)
    picked = (within(picks, order, region), order)
    return replace(part, slabs=partial(_slabs, path, array, picked, part.shape, packing))


def within(picks: list[Any], order: tuple[int, ...], region: Region) -> tuple[Any, ...]:
    """Return the key of a ``region``: its range along each axis in space, and the ``picks`` along
    the others.
    """
    inside = dict(zip(order, region[::-1], strict=True))
    return tuple(slice(*inside[n]) if n in inside else pick for n, pick in enumerate(picks))


def _fitting(path: Path | str, found: FoundArray) -> FoundArray:
    """Return the finest resolution of an image that fits into the memory budget and that a picture
    can show, with a note if it is not the finest of all; the coarsest if none fits.
    """
    level = 0
    while level + 1 < found.levels and (
        _too_large(found) or max(_sides(found)) >= MAX_PICTURE_VOXELS
    ):
        coarser = find_array(path, level + 1)
        if not _too_large(found) and max(_sides(coarser)) < MAX_PICTURE_VOXELS:
            break
        level = level + 1
        found = coarser
    if not level:
        return found
    if found.given is None or found.given.shifted:
        lies = ""
    else:
        lies = SHIFT_NOTE
    more = f"level = {level - 1} in the scene shows a finer one, or region a part of it"
    note = (
        f"Level {level} of 0 to {found.levels - 1} is shown, as fine as memory and pictures "
        f"have room for: {more}."
    )
    return replace(found, notes=(*found.notes, note, *((lies,) if lies else ())))


def _too_large(found: FoundArray) -> bool:
    """Return True if the voxels of an array take more than the memory budget."""
    return _voxels(found, None) * np.dtype(np.float32).itemsize > budget()


def _sides(found: FoundArray) -> list[int]:
    """Return the numbers of voxels of the field along its axes in space."""
    return [
        n for axis, n in zip(found.axes, found.array.shape, strict=True) if axis.name in SPACE_AXES
    ]


def _voxels(found: FoundArray, region: Region | None) -> int:
    """Return the number of voxels of the field in an array, or of a region of it."""
    if region is not None:
        return math.prod(high - low for low, high in region)
    return math.prod(_sides(found))


def _chunks(found: FoundArray, region: Region | None) -> int:
    """Return the number of chunks that hold the field in an array, or a region of it."""
    spans = dict(zip(SPACE_AXES, region or (), strict=False))
    sizes = zip(found.axes, found.array.shape, found.array.chunks, strict=True)
    spatial = [
        (*spans.get(axis.name, (0, n)), step) for axis, n, step in sizes if axis.name in SPACE_AXES
    ]
    return math.prod((end - 1) // step - first // step + 1 for first, end, step in spatial)


def _order(axes: tuple[Axis, ...]) -> tuple[int, ...]:
    """Return the places of z, y and x among the axes of an array."""
    names = [axis.name for axis in axes]
    return tuple(names.index(name) for name in SPACE_AXES[::-1])


def _placed(found: FoundArray) -> Place:
    """Place an array by its image, with an affine if that says more than the length of each axis;
    else by the coordinates of its axes.
    """
    if found.given is None or found.given.matrix is None:
        place = place_by(found.scales)
        notes = () if place.said else unread_spacing(found.array.attrs.asdict())
        return replace(place, notes=(*place.notes, *notes))
    matrix, unit, letters = placed_in_space(found.given)
    x, y, z = (math.hypot(*column) for column in matrix[:, :3].T.tolist())
    alone = np.column_stack([np.diag([x, y, z]), np.zeros(3)])
    lies = bool(letters) or not np.array_equal(matrix, alone)
    affine = Affine.of(matrix, letters) if lies and np.isfinite(matrix).all() else None
    odd = odd_units(found.given)
    notes = (f"Its axes are in {odd}, taken as one unit: {SPACING_KEY}.",) if odd else ()
    return Place((x, y, z), affine, unit, notes, said=True)


def _stamp(among: Hierarchy, part: list[Any]) -> str:
    return f"{among.stamp()} {part}"


def _packing(array: "zarr.Array[Any]") -> Packing:
    """Return the packing of an array, by CF's attributes. Xarray writes the mark of holes as the
    fill value of Zarr's second version; other programs fill with zero.
    """
    attributes: dict[str, Any] = array.attrs.asdict()
    if array.metadata.zarr_format == 2:
        filled = getattr(array.metadata, "fill_value", None)
    else:
        filled = None
    if "_ARRAY_DIMENSIONS" in attributes and filled:
        attributes = {"_FillValue": filled, **attributes}
    return climate_packing(attributes, array.dtype)


def find_array(path: Path | str, level: int | None) -> FoundArray:
    """Return the array at ``path``, or that of ``level`` of the image there; of several images the
    first, with a note.
    """
    among = hierarchy_at(path)
    notes = list[str]()
    inside = among.inside
    node = _open(path, among, among.inside)
    while (
        isinstance(node, zarr.Group)
        and (first := first_image(node.attrs.asdict(), str(path), inside))[0]
    ):
        inside = f"{inside}/{first[0]}".strip("/")
        notes = [*notes, first[1]]
        node = _open(path, among, inside)
    if isinstance(node, zarr.Group):
        image = _resolutions(node, path)
        if (level or 0) < len(image):
            chosen = image[level or 0].path
        else:
            chosen = None
        if chosen is None and not image and level is None:
            fields = _fields(path, among, node, inside)
            only = _only_field(path, among, fields)
            if only is not None:
                return replace(only, notes=(*notes, *only.notes))
            if fields:
                raise VolumeError(_several_fields(path, fields))
        if chosen is None:
            raise VolumeError(_no_array(path, node, image, level))
        array = _open(path, among, f"{inside}/{chosen}".strip("/"))
        if isinstance(array, zarr.Group):
            raise VolumeError(
                f"'{path}' names a resolution '{chosen}' that is no array: write it again."
            )
        found = _with_axes(path, among, array, image[level or 0])
        labels = labels_of(node.attrs.asdict(), str(path))
        return replace(found, notes=tuple(notes), labels=labels, levels=len(image))
    if level is not None:
        raise VolumeError(
            f"'{path}' is one array, without levels: leave out 'level', or name the image."
        )
    return _with_axes(path, among, node, _resolution_above(path, among))


def _open(path: Path | str, among: Hierarchy, inside: str) -> "zarr.Array[Any] | zarr.Group":
    """Return an array or a group of a hierarchy."""
    try:
        return zarr.open(store=among.store, path=inside, mode="r")
    except FileNotFoundError as error:
        raise VolumeError(
            f"'{among.name}' has no array '{inside}': write it again, or choose another."
        ) from error
    except Exception as error:  # of many kinds, for damaged metadata and missing codecs
        raise VolumeError(
            f"'{path}' cannot be read as Zarr ({line_of(error)}): write it again."
        ) from error


def _resolutions(group: zarr.Group, path: Path | str) -> list[Resolution]:
    return resolutions_of(group.attrs.asdict(), str(path))


def _no_array(
    path: Path | str, group: zarr.Group, image: list[Resolution], level: int | None
) -> str:
    """Return the message for a group without the array that is asked for."""
    if image:
        return f"level = {level} of '{path}' is not there: it has levels 0 to {len(image) - 1}."
    names = (
        ", ".join(f"'{PurePath(path).name}/{name}'" for name in _members(group))
        or "nothing that it lists"
    )
    held = f"'{path}' is a Zarr group and no image: it holds {names}"
    return f"{held}; give an array of three axes or more, or an image."


MOST_NAMED = 8
"""Members of a group that a message names."""


def _members(group: zarr.Group, most: int = MOST_NAMED) -> list[str]:
    """Name some members of a group; none if it cannot be listed, as over plain HTTP."""
    try:
        return sorted(group.keys())[:most]
    except Exception:  # of many kinds, for stores that cannot list
        return []


def _resolution_above(path: Path | str, among: Hierarchy) -> Resolution | None:
    """Return the resolution that the nearest image above an array gives for it."""
    if among.inside:
        parts = among.inside.split("/")
    else:
        parts = []
    for n in range(len(parts) - 1, -1, -1):
        try:
            group = _open(path, among, "/".join(parts[:n]))
        except VolumeError:  # no group is there
            continue
        for each in _resolutions(group, path) if isinstance(group, zarr.Group) else ():
            if each.path.strip("/") == "/".join(parts[n:]):
                return each
    return None


def _with_axes(
    path: Path | str, among: Hierarchy, array: "zarr.Array[Any]", given: Resolution | None
) -> FoundArray:
    """Return the array with its axes: those of the image, else by their names, else by their
    number.
    """
    placed = given is not None and given.matrix is not None
    scales: tuple[Along | None, ...] = ()
    notes: tuple[str, ...] = ()
    if given is not None and placed:
        axes = array_axes(given)
    else:
        names, scales, notes = named_axes(array, partial(_open, path, among))
        axes = tuple(map(Axis, names))
    if len(axes) != array.ndim:
        raise VolumeError(
            f"'{path}' has {array.ndim} dimensions and {len(axes)} axes: choose one scalar "
            "field of it."
        )
    return FoundArray(among, array, axes, given if placed else None, notes=notes, scales=scales)


def _fields(
    path: Path | str, among: Hierarchy, group: zarr.Group, inside: str
) -> list["zarr.Array[Any]"]:
    """Find the arrays of three dimensions or more in a group."""
    members = [
        _open(path, among, f"{inside}/{name}".strip("/")) for name in _members(group, MOST_FIELDS)
    ]
    return [each for each in members if isinstance(each, zarr.Array) and each.ndim >= 3]


def _only_field(
    path: Path | str, among: Hierarchy, fields: Sequence["zarr.Array[Any]"]
) -> FoundArray | None:
    """Find the array that a group without an image means: the only one of its ``fields``, else the
    only one whose axes are x, y and z; None if there is no such one.
    """
    if len(fields) > 1:
        fields = [each for each in fields if is_in_space(each, partial(_open, path, among))]
    if len(fields) != 1:
        return None
    note = f"The only field of the group is shown: '{PurePath(fields[0].path).name}'."
    found = _with_axes(path, among, fields[0], None)
    return replace(found, notes=(note, *found.notes))


def _several_fields(path: Path | str, fields: Sequence["zarr.Array[Any]"]) -> str:
    """Return the message for a group of which no field is chosen."""
    names = [f"'{path}/{PurePath(each.path).name}'" for each in fields[:MOST_NAMED]]
    return f"'{path}' holds several fields: choose of {', '.join(names)}."


MOST_FIELDS = 64
"""Members of a group that are looked at for its only field."""


def _pick(path: Path | str, found: FoundArray, place: int, chosen: dict[str, int | None]) -> int:
    """Return the number of the element that is read along an axis that is not spatial."""
    name = found.axes[place].name
    length = found.array.shape[place]
    key = CHOSEN_AXES.get(name)
    pick = chosen.get(name)
    if pick is None and length > 1 and key != "time":
        if key:
            wanted = f"set {key} in the scene, from 0 to {length - 1}"
        else:
            wanted = "save one element of it"
        raise VolumeError(f"'{path}' has {length} elements along its axis '{name}': {wanted}.")
    if not 0 <= (pick or 0) < length:
        raise VolumeError(f"{key} = {pick} is not in '{path}', which has 0 to {length - 1}.")
    return pick or 0


def _check(path: Path | str, found: FoundArray, region: Region | None) -> None:
    """Raise VolumeError if the array is no 3-D field, or of an impossible size."""
    array = found.array
    space = [axis.name for axis in found.axes if axis.name in SPACE_AXES]
    if sorted(space) != list(SPACE_AXES):
        raise VolumeError(
            f"'{path}' has the axes {', '.join(space) or 'none'} in space: they must be z, y and x."
        )
    if min(array.chunks, default=0) < 1:
        raise VolumeError(
            f"'{path}' claims chunks of {array.chunks} voxels, which cannot be: mend its metadata."
        )
    if _voxels(found, region) > MAX_VOXELS:
        part = "choose a coarser level, or a region in the scene"
        raise VolumeError(
            f"'{path}' claims a shape {array.shape}, of which no more than {MAX_VOXELS} voxels "
            f"can be shown: {part}."
        )
    if int(np.prod([float(n) for n in array.chunks])) * array.dtype.itemsize > MAX_CHUNK:
        raise VolumeError(
            f"The chunks of '{path}' have {array.chunks} voxels: write it in chunks of 1 GiB "
            "or less."
        )
    if _chunks(found, region) > MOST_CHUNKS:
        raise VolumeError(
            f"The chunks of '{path}' have {array.chunks} voxels, and are too many: write "
            "larger ones."
        )


def _slabs(
    path: Path | str,
    array: "zarr.Array[Any]",
    picks: tuple[tuple[Any, ...], tuple[int, ...]],
    shape: Shape,
    packing: Packing,
) -> Iterator[np.ndarray]:
    """Yield the array, a layer of chunks or less at a time. ``picks`` are the elements or ranges
    that are read along each axis, and the places of z, y, x among the axes.
    """
    chosen, order = picks
    inside = chosen[order[0]]
    begin = inside.start or 0
    end = (inside.start or 0) + shape[0]
    layer = shape[1] * shape[2] * array.dtype.itemsize
    deep = array.chunks[order[0]]
    if deep * layer <= MAX_LAYER_BYTES:
        step = deep * max(slab_layers(layer) // deep, 1)
    else:
        step = slab_layers(layer)
    if sorted(order) != list(order):
        turned = np.argsort(np.argsort(order))
    else:
        turned = None
    for z in range(begin // deep * deep, end, step):
        layers = slice(max(z, begin), min(z + step, end))
        place = (*chosen[: order[0]], layers, *chosen[order[0] + 1 :])
        try:
            slab = packing.apply(np.asarray(array[place]))
        except Exception as error:  # of many kinds, from codecs on damage
            raise VolumeError(
                f"The chunks of '{path}' are damaged ({line_of(error)}): copy it again."
            ) from error
        yield slab if turned is None else slab.transpose(turned)
