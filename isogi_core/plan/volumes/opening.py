"""Opening volumes: a demo, a file or a Zarr array, in memory if small, else as a mapped copy."""

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, VolumeError, readable
from isogi_core.files.cells import MOST_REPEATED
from isogi_core.files.coordinates import SPACING_KEY
from isogi_core.files.formats.opening import open_file, split_part
from isogi_core.files.grid import APERIODIC, UNPLACED, Grid, Region
from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.files.packed_files import in_short, reason_of
from isogi_core.files.packing import without_fill
from isogi_core.files.scene_file import DEFAULT_DEMO, Settings, is_zarr, name_of
from isogi_core.files.volume_copies import Draft, get_copy
from isogi_core.model.choices import MOST_SMOOTH
from isogi_core.model.demo import DEMOS, demo_volume
from isogi_core.model.value_survey import Progress, check, checked_spacing, no_progress, survey
from isogi_core.model.volume import Orientation, Volume, make_volume
from isogi_core.plan.volumes.labels import (
    PROPOSED,
    are_labels,
    find_labels,
    look_like_labels,
    solid_of_labels,
)
from isogi_core.plan.volumes.masks import cut_out, place, read_tables
from isogi_core.plan.volumes.periods import closed, read_cells, repeated_beside, trimmed, upright
from isogi_core.plan.volumes.pieces import Least, read_pieces, without_small_pieces
from isogi_core.plan.volumes.smoothing import gaussian_reach, smoothed

COPY_FORMAT = 3
"""Version of the copies: increased if the same file gives other voxels."""

NESTED = ("level", "channel", "time", "series")
"""Settings of a scene that choose a part of a file."""

ZARR_SETTINGS = NESTED[:3]
"""Settings of a scene that choose a part of a Zarr volume."""

AXES_CHOICES = ("world", "raw")
"""Values of a scene's ``axes``: as the volume's file says, or voxel indices times spacing."""


def open_volume(
    settings: Settings, progress: Progress = no_progress, fallback: str = "above"
) -> Volume:
    """Open the volume that the scene names, a demo or a file, with the scene's spacing, solid side
    and missing values, and smoothed if the scene says so.

    Outside of the scene's masks it has no surface. A segmentation becomes a field of its labels.
    ``fallback`` is the solid side if the scene names none. ``progress`` is called while a copy is
    made. Raises VolumeError and SceneError.
    """
    # Read every setting of voxels first, so that all are known even if they are refused later.
    name = settings.text("volume", DEFAULT_DEMO)
    solid = settings.text("solid", fallback)
    raw = is_raw(settings)
    chosen = chosen_part(settings)
    spacing = settings.numbers("spacing", 3)
    missing = settings.listed("missing")
    tables = read_tables(settings)
    labels = find_labels(settings)
    smooth = settings.number("smooth", 0.0, 0.0, MOST_SMOOTH)
    pieces = read_pieces(settings)
    if name.startswith("demo:"):
        repeating = settings.flags("periodic", 3) or settings.counts("repeat", 3, MOST_REPEATED)
        altered = bool(spacing or missing or chosen or raw or tables or pieces or repeating)
        altered = altered or labels is not None or solid != "above"
        return open_demo(name, smooth, altered, chosen)
    grid, stem = open_own(settings)
    moment = grid.moment
    # Take the values as labels, or as values without the file's fill value.
    segmented = labels is not None or are_labels(grid, settings)
    if segmented:
        grid = solid_of_labels(grid, labels or (), settings)
    elif "missing" not in settings.source.document:
        grid = without_fill(grid)
    # Bring the grid to right angles, its cells side by side with a margin if the field repeats;
    # then smooth, drop small pieces and mask: each wraps the grid, and voxels are read once, at the
    # end.
    cells = read_cells(settings, grid)
    if segmented:
        cells = replace(cells, periodic=APERIODIC)
    reach = gaussian_reach(smooth) if smooth else 0
    straight, shown = upright(grid, cells, spacing, reach)
    if tables and spacing and grid.affine is not None:
        raise SceneError(
            "spacing moves the volume away from its masks: leave it out, or add axes = 'raw'."
        )
    if segmented:
        refuse_for_labels(stem, smooth, pieces)
    if smooth:
        straight = smoothed(straight, smooth, missing)
        # Missing values are holes by now.
        missing = ()
    if shown is not None:
        straight, shown = trimmed(straight, shown, reach)
    if pieces:
        straight = without_small_pieces(straight, pieces, solid, missing)
    masks = [place(table, open_beside(settings, table.file), grid, straight) for table in tables]
    if masks:
        straight = cut_out(straight, masks, solid, missing)
    # Read the voxels, and note if values look like labels that nobody declared.
    volume = volume_of(straight, solid, stem, missing, progress)
    if shown is not None:
        volume = closed(volume, shown)
    count = 0 if segmented else look_like_labels(volume)
    if count:
        straight = replace(straight, notes=(*straight.notes, PROPOSED.format(count=count)))
    return replace(
        volume,
        orientation=Orientation.of(straight),
        moment=moment,
        segmented=segmented,
        level=grid.level,
        deviations=grid.deviations,
    )


def refuse_for_labels(stem: str, smooth: float, pieces: Least) -> None:
    """Raise SceneError if labels of the volume ``stem`` are to be smoothed, or to lose pieces."""
    if smooth:
        raise SceneError(
            f"The volume '{stem}' shows labels, which are not smoothed: leave smooth out."
        )
    if pieces:
        raise SceneError(f"The volume '{stem}' shows labels: hide labels, and leave pieces out.")


def open_demo(name: str, smooth: float, altered: bool, chosen: Iterable[str]) -> Volume:
    """Return the demo ``name``, smoothed by a Gaussian of ``smooth`` voxels.

    Raises VolumeError if there is none of this name, and SceneError if the scene has ``altered`` it
    by settings of files, or ``chosen`` a part of it.
    """
    key = name.removeprefix("demo:")
    if key not in DEMOS:
        raise VolumeError(
            f"There is no {name}: choose one of {', '.join('demo:' + demo for demo in DEMOS)}."
        )
    if altered:
        made = "is made with spacing 1, solid above and nothing missing"
        keys = (
            *("spacing", "solid", "missing", "axes", "volumes", "labels", "pieces"),
            *("periodic", "repeat"),
            *chosen,
        )
        named = ", ".join(f"'{each}'" for each in keys)
        raise SceneError(f"{name} {made}: leave out {named}.")
    if smooth:
        return make_volume(smoothed(Grid.of(DEMOS[key].build()), smooth).whole(), name=key)
    return demo_volume(key)


def chosen_part(settings: Settings) -> dict[str, Any]:
    """Return the settings of a scene that choose a part of its volume's file. Raises SceneError."""
    numbers = {key: value for key in NESTED if (value := settings.count(key, 1 << 20)) is not None}
    others = {"raw": settings.text("raw", ""), "region": settings.spans("region", 3)}
    return {**numbers, **{key: value for key, value in others.items() if value}}


FIRST_STEP_NOTE = (
    "The file holds {steps} steps in time: the first is shown, and time = 0 to "
    "{last} chooses another."
)


CUBES_NOTE = f"Voxels are taken as cubes: {SPACING_KEY}."
"""The note on volumes whose spacing is assumed."""


def says_spacing(grid: Grid, settings: Settings) -> bool:
    """Tell whether the scene, the file or a note on it says how far voxels lie apart."""
    noted = any(SPACING_KEY in note for note in grid.notes)
    return noted or "spacing" in settings.source.document or UNPLACED not in grid.read_as


def is_raw(settings: Settings) -> bool:
    """Return True if volumes of a scene lie in the world as their voxels do, whatever their
    files say. Raises SceneError.
    """
    return settings.choice("axes", AXES_CHOICES) == "raw"


def open_own(settings: Settings) -> tuple[Grid, str]:
    """Open the file of the volume that a scene names; return its grid and display name.

    Of a series in time of which no step is chosen it is the first, with a note. Raises VolumeError
    and SceneError.
    """
    chosen = chosen_part(settings)
    grid, stem = _open_placed(settings.source.base, settings.text("volume", DEFAULT_DEMO), chosen)
    steps = grid.moment[1]
    notes = (FIRST_STEP_NOTE.format(steps=steps, last=steps - 1),) if grid.unchosen else ()
    if grid.affine is None and set(grid.spacing) == {1.0} and not says_spacing(grid, settings):
        notes = (*notes, CUBES_NOTE)
    grid = replace(grid, notes=(*grid.notes, *notes))
    return grid.raw(chosen.get("region")) if is_raw(settings) else grid, stem


def open_beside(settings: Settings, name: str) -> Grid:
    """Open another volume of a scene, at a path or a URL; text after a # in its ``name`` chooses a
    part.

    Raises SceneError and VolumeError, the latter also for a series in time of which no step is
    chosen.
    """
    grid, _ = _open_placed(settings.source.base, name, {})
    if grid.unchosen:
        raise VolumeError(
            f"'{name}' has {grid.moment[1]} time steps: choose one, such as '{name}#time=0'."
        )
    if is_raw(settings):
        return repeated_beside(settings, grid.raw(None), 0).raw(None)
    return repeated_beside(settings, grid, 1)


def _open_placed(base: Path, name: str, chosen: dict[str, Any]) -> tuple[Grid, str]:
    """Open the grid at a path or a URL; return it and its display name. Raises VolumeError if
    the system cannot read it.
    """
    try:
        return _open_any(base, name, chosen)
    except OSError as error:
        raise VolumeError(
            f"The volume {in_short(name)} cannot be read ({reason_of(error)}): check its path."
        ) from error


def _open_any(base: Path, name: str, chosen: dict[str, Any]) -> tuple[Grid, str]:
    """Open a Zarr array or a file; return its grid and display name."""
    region: Region | None = chosen.get("region")
    chosen = {key: value for key, value in chosen.items() if key != "region"}
    # A name that exists as it is may hold a #; else the text after it chooses a part.
    (named, inside) = (name, {}) if (base / name).exists() else split_part(name)
    place = named if "://" in named else base / named
    if isinstance(place, Path) and not os.path.abspath(place).strip("/"):
        raise VolumeError("'/' is the root of all folders: name a file or a folder in it.")
    if isinstance(place, str) or is_zarr(place):
        from isogi_core.files.zarr_volume import open_zarr  # noqa: PLC0415 (loads Zarr, which NRRD does not need)

        wanted = {key: str(value) for key, value in {**inside, **chosen}.items()}
        place = _below(place, wanted.pop("part", ""))
        # A Zarr volume has no parts but these.
        wrong = next(
            (
                key
                for key, value in wanted.items()
                if key not in ZARR_SETTINGS or not value.isdecimal()
            ),
            None,
        )
        if wrong is not None:
            raise SceneError(
                f"{wrong} = {wanted[wrong]} chooses nothing in '{named}': give "
                f"{' or '.join(ZARR_SETTINGS)}."
            )
        facts = {key: int(value) for key, value in wanted.items()}
        return open_zarr(place, region=region, **facts), name_of(Path(place))
    grid = open_file(place, {**inside, **chosen})
    return grid.cropped(region) if region else grid, stem_of(place, inside)


def _below(place: Path | str, part: str) -> Path | str:
    """Return the place of a ``part`` of a Zarr hierarchy. Raises VolumeError if it leads out of
    it.
    """
    if ".." in PurePath(part).parts or PurePath(part).is_absolute():
        raise VolumeError(f"'{part}' leads out of '{place}': name an image in it, such as #A/1/0.")
    if isinstance(place, str):
        return f"{place}/{part}".rstrip("/")
    return place / part


def stem_of(path: Path, inside: dict[str, str]) -> str:
    """Return the display name of a file and the part chosen in it."""
    stem = path.name.removesuffix(".gz").removesuffix(".bz2")
    if path.suffix:
        stem = Path(stem).stem
    return readable("-".join([stem, *(value.strip("/") for value in inside.values())]))


def volume_of(
    grid: Grid, solid: str, name: str, missing: Sequence[float], progress: Progress
) -> Volume:
    """Make the volume of a ``grid``: in memory if it takes a small share of the memory budget,
    else as a mapped copy.
    """
    check(grid, solid)
    size = grid.size * np.dtype(np.float32).itemsize
    if size <= UNMAPPED_SHARE * budget():
        return make_volume(grid.whole(), grid.spacing, solid, name, missing)
    # The grid may be mirrored or resampled.
    lying = [] if grid.affine is None else [grid.affine.array.tolist(), grid.shape]
    parts = [COPY_FORMAT, grid.stamp(), checked_spacing(grid.spacing), solid, missing, *lying]
    key = hashlib.blake2b(json.dumps(parts).encode(), digest_size=16).hexdigest()
    voxels, facts = get_copy(
        key, size, lambda draft: make_copy(grid, draft, solid, name, missing, progress)
    )
    return Volume(voxels, **{**facts, "name": name})


def make_copy(
    grid: Grid, draft: Draft, solid: str, name: str, missing: Sequence[float], progress: Progress
) -> dict[str, Any]:
    """Write the voxels of a ``grid`` to a ``draft``, and return the facts of their volume.

    Raises VolumeError as ``survey`` does, and if the source changed while it was read.
    """
    before = grid.stamp()
    found = survey(grid, solid, missing, progress)
    facts = found.facts(name, found.pour(draft.write, progress))
    known = Volume(draft.voxels(grid.shape), **facts).counted(
        progress=progress, tally=found.tallied()
    )
    facts |= {"counts": known.counts, "span": known.span}
    # Discard the copy of a file that was written to meanwhile.
    if grid.stamp() != before:
        raise VolumeError(
            f"The volume '{name}' changed while it was read: try again once it is written."
        )
    draft.seal(grid.shape, facts)
    return facts
