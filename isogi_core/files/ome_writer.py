"""OME-Zarr images (NGFF 0.5) of grids: in chunks, with coarser levels, where the grid lies in the world."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid
from isogi_core.files.ome import AXIS_ORIENTATIONS, UNIT_SIGNS
from isogi_core.files.right_angles import on_right_angles

CHUNK_VOXELS = 64
"""Voxels along each side of a chunk; levels are added until one fits into a chunk."""

MIN_HALVED_SIDE = 8
"""Voxels of a side, at least, that is halved in the next level."""

TURNED_AXES_NOTE = "OME-Zarr keeps no turned axes: voxels are written as they lie, without their place in the world."

Progress = Callable[[int, int], object]
"""Is called with the layers that are written, of all."""


def write_image(grid: Grid, path: Path, progress: Progress) -> tuple[str, ...]:
    """Write a ``grid`` as an image in the folder ``path``, and return notes on what is lost. VolumeError where there is
    something already; nothing is left of a failed one.
    """
    if path.exists():
        raise VolumeError(f"There is something at '{path}' already: remove it, or choose another name.")
    grid = on_right_angles(grid)
    partial = path.with_name(f"{path.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        lies = Lying(grid)
        _write(grid, lies, partial, progress)
        partial.rename(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return (TURNED_AXES_NOTE,) if lies.turned else ()


class Lying:
    """How the axes z, y, x of a ``grid`` on right angles lie along those of the world: their ``names`` there, and
    whether each is read the other way round, so that it ascends. ``turned`` ones lie along none.
    """

    def __init__(self, grid: Grid) -> None:
        """Look at where the grid lies."""
        rows = np.eye(3) if grid.affine is None else np.array(grid.affine.matrix) / np.array(grid.spacing)
        whole = np.round(rows)
        self.turned = not np.allclose(rows, whole, atol=1e-6)
        whole = np.eye(3) if self.turned else whole
        along = [int(np.argmax(np.abs(whole[:, axis]))) for axis in (2, 1, 0)]
        self.names = ["xyz"[n] for n in along]
        self.flips = tuple(whole[n, axis] < 0.0 for n, axis in zip(along, (2, 1, 0), strict=True))
        self.steps = [float(step) for step in list(grid.spacing)[::-1]]
        origin = np.zeros(3) if grid.affine is None or self.turned else np.array(grid.affine.origin)
        ends = [n - 1 if flip else 0 for n, flip in zip(grid.shape, self.flips, strict=True)]
        self.origin = [float(origin[n] - end * step) for n, end, step in zip(along, ends, self.steps, strict=True)]
        self.letters = "" if grid.affine is None or self.turned else grid.affine.letters

    def axes(self, unit: str) -> list[dict[str, Any]]:
        """The axes as NGFF has them."""
        words = {sign: word for word, sign in UNIT_SIGNS.items()}
        unit_of = {"unit": words.get(unit, unit)} if unit else {}
        return [{"name": name, "type": "space", **unit_of, **self._towards(name)} for name in self.names]

    def _towards(self, name: str) -> dict[str, Any]:
        """Where an axis of a patient points."""
        value = next(word for word, place in AXIS_ORIENTATIONS.items() if place == ("xyz".index(name), 1.0))
        return {"orientation": {"type": "anatomical", "value": value}} if self.letters else {}


def _write(grid: Grid, lies: Lying, path: Path, progress: Progress) -> None:
    """Write all levels and their description."""
    shapes = [np.array(grid.shape)]
    while shapes[-1].max() > CHUNK_VOXELS:
        shapes.append(np.where(shapes[-1] >= MIN_HALVED_SIDE, -(-shapes[-1] // 2), shapes[-1]))
    total, done, datasets = sum(int(shape[0]) for shape in shapes), 0, []
    group, before = zarr.open_group(path, mode="w"), None
    factor, labelled = np.ones(3), grid.labels is not None
    for level, shape in enumerate(shapes):
        sides = tuple(int(n) for n in shape)
        array = zarr.create_array(
            path / str(level), shape=sides, chunks=(CHUNK_VOXELS,) * 3, dtype=grid.dtype, fill_value=0
        )
        if before is None:
            blocks = _flipped(_blocks(grid), sides[0], lies.flips)
        else:
            halves = np.array(before.shape) > shape
            factor = factor * np.where(halves, 2.0, 1.0)
            blocks = _coarser(before, halves.tolist(), labelled)
        for z, block in blocks:
            array[z : z + len(block)] = block
            done += len(block)
            progress(done, total)
        datasets.append(_dataset(level, lies, factor, labelled))
        before = array
    images: Any = [{"name": path.stem, "axes": lies.axes(grid.unit), "datasets": datasets}]
    group.attrs["ome"] = {"version": "0.5", "multiscales": images, **_labels(grid)}


def _dataset(level: int, lies: Lying, factor: np.ndarray, labelled: bool) -> dict[str, Any]:
    """Where a level lies: the middle of its first voxel is that of the voxels which it is the mean of."""
    steps = [step * each for step, each in zip(lies.steps, factor.tolist(), strict=True)]
    shift = [0.0 if labelled else 0.5 * (far - near) for far, near in zip(steps, lies.steps, strict=True)]
    place = [origin + each for origin, each in zip(lies.origin, shift, strict=True)]
    placed = [{"type": "scale", "scale": steps}, {"type": "translation", "translation": place}]
    return {"path": str(level), "coordinateTransformations": placed if any(place) else placed[:1]}


def _blocks(grid: Grid) -> Iterator[tuple[int, np.ndarray]]:
    """The grid's layers, as many as a chunk has at once, each with the place of its first."""
    held: list[np.ndarray] = []
    z = 0
    for slab in grid.slabs():
        for layer in slab:
            held.append(layer)
            if len(held) == CHUNK_VOXELS:
                yield z, np.stack(held)
                z, held = z + CHUNK_VOXELS, []
    if held:
        yield z, np.stack(held)


def _flipped(
    blocks: Iterator[tuple[int, np.ndarray]], depth: int, flips: tuple[bool, ...]
) -> Iterator[tuple[int, np.ndarray]]:
    """Blocks with their axes the other way round."""
    turn = tuple(slice(None, None, -1 if flip else 1) for flip in flips)
    for z, block in blocks:
        yield (depth - z - len(block) if flips[0] else z), block[turn]


def _coarser(array: Any, halves: list[bool], labelled: bool) -> Iterator[tuple[int, np.ndarray]]:
    """Blocks of half as many voxels along the axes that are ``halves``: means, or, of labels, every second one."""
    deep = 2 if halves[0] else 1
    for z in range(0, array.shape[0], deep * CHUNK_VOXELS):
        block = np.asarray(array[z : z + deep * CHUNK_VOXELS])
        yield z // deep, halved(block, halves, labelled)


def halved(block: np.ndarray, halves: list[bool], labelled: bool = False) -> np.ndarray:
    """A block whose neighbours along the axes that are ``halves`` are joined: their mean without holes, in the block's
    type, or the first of them where it is ``labelled``. The last voxel of an odd side stands alone.
    """
    if labelled:
        return block[tuple(slice(None, None, 2 if half else 1) for half in halves)]
    values = block.astype(np.float64)
    there = ~np.isnan(values)
    total, count = np.where(there, values, 0.0), there.astype(np.float64)
    for axis, half in enumerate(halves):
        if half:
            places = np.arange(0, total.shape[axis], 2)
            total, count = (np.add.reduceat(each, places, axis) for each in (total, count))
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return (np.rint(mean) if block.dtype.kind in "iub" else mean).astype(block.dtype)


def _labels(grid: Grid) -> dict[str, Any]:
    """What the labels of a segmentation are called."""
    if grid.labels is None:
        return {}
    colours = [
        {"label-value": each.value, "rgba": [*bytes.fromhex(each.colour[1:]), 255]}
        for each in grid.labels
        if each.colour
    ]
    names = [{"label-value": each.value, "name": each.name} for each in grid.labels if each.name]
    return {"image-label": {"version": "0.5", "colors": colours, "properties": names}}


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = [path] if path.is_file() else path.rglob("*")
    return sum(each.stat().st_size for each in files if each.is_file())
