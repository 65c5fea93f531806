"""Opening volumes: a demo, a file or a Zarr array, in memory where it is small and as a mapped copy where it is not."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.copies import get_copy
from isogi_core.files.grid import Grid
from isogi_core.files.nrrd import open_nrrd
from isogi_core.files.resident import OWN, budget
from isogi_core.files.voxels import Draft
from isogi_core.model.demo import DEMOS, demo_volume
from isogi_core.model.settings import Settings
from isogi_core.model.source import DEFAULT_DEMO, is_zarr, name_of
from isogi_core.model.survey import Tell, check, checked_spacing, survey, tell_nobody
from isogi_core.model.volume import Volume, make_volume

FORMAT = 1
"""Counts up when the voxels of the same file become others."""

NESTED = {"level": "resolution", "channel": "channel", "time": "time"}
"""Settings of a scene that choose among what a Zarr volume holds."""


def open_volume(settings: Settings, base: Path, tell: Tell = tell_nobody) -> Volume:
    """The volume that the scene names: a demo or a file, with the spacing, solid side and holes that it asks for.

    ``tell`` hears of the progress where a copy is made. Raises VolumeError and SceneError.
    """
    name = settings.text("volume", DEFAULT_DEMO)
    solid = settings.text("solid", "above")
    spacing, missing = settings.numbers("spacing", 3), settings.listed("missing")
    chosen = {key: value for key in NESTED if (value := settings.count(key, 1 << 20)) is not None}
    if not name.startswith("demo:"):
        grid, stem = open_grid(base, name, chosen)
        return volume_of(replace(grid, spacing=spacing or grid.spacing), solid, stem, missing, tell)
    if name.removeprefix("demo:") not in DEMOS:
        raise VolumeError(f"There is no {name}: choose one of {', '.join('demo:' + key for key in DEMOS)}.")
    if spacing or missing or chosen or solid != "above":
        told = "is made with spacing 1, solid above and nothing missing"
        named = ", ".join(f"'{key}'" for key in ("spacing", "solid", "missing", *chosen))
        raise SceneError(f"{name} {told}: leave out {named}.")
    return demo_volume(name.removeprefix("demo:"))


def open_grid(base: Path, name: str, chosen: dict[str, int]) -> tuple[Grid, str]:
    """The grid at a path or a URL, and the name that a person knows it by."""
    place = name if "://" in name else base / name
    if isinstance(place, str) or is_zarr(place):
        from isogi_core.files.zarr_volume import open_zarr  # noqa: PLC0415 (loads Zarr, which NRRD does not need)

        return open_zarr(place, **chosen), name_of(Path(place))
    if chosen:
        raise SceneError(f"'{name}' is no Zarr volume: leave out '{next(iter(chosen))}'.")
    return open_nrrd(base / name), Path(name).stem


def volume_of(grid: Grid, solid: str, name: str, missing: Sequence[float], tell: Tell) -> Volume:
    """The volume of a ``grid``: in memory where its voxels are few beside the budget, else as a copy that is mapped."""
    check(grid, solid)
    size = grid.size * np.dtype(np.float32).itemsize
    if size <= OWN * budget():
        return make_volume(grid.whole(), grid.spacing, solid, name, missing)
    told = [FORMAT, grid.stamp(), checked_spacing(grid.spacing), solid, missing]
    key = hashlib.blake2b(json.dumps(told).encode(), digest_size=16).hexdigest()
    voxels, facts = get_copy(key, size, lambda draft: make_copy(grid, draft, solid, name, missing, tell))
    return Volume(voxels, **{**facts, "name": name})


def make_copy(grid: Grid, draft: Draft, solid: str, name: str, missing: Sequence[float], tell: Tell) -> dict[str, Any]:
    """Write the voxels of a ``grid`` to a ``draft``, and tell the facts of their volume.

    Raises VolumeError as ``survey`` does, and where the source changed while it was read.
    """
    before = grid.stamp()
    found = survey(grid, solid, missing, tell)
    facts = found.facts(name, found.pour(draft.write, tell))
    known = Volume(draft.voxels(grid.shape), **facts).counted(tell=tell)
    facts |= {"counts": known.counts, "span": known.span}
    if grid.stamp() != before:
        raise VolumeError(f"The volume '{name}' changed while it was read: try again once it is written.")
    draft.seal(grid.shape, facts)
    return facts
