"""Scenes of demos that all tests of a process share, as loading one takes longer than most tests;
and NRRD files.
"""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.files.formats.nrrd import open_nrrd
from isogi_core.files.formats.source import Source
from isogi_core.plan import assembly
from isogi_core.plan.scene import Scene


def load_scene(target: str | Path, **settings: Any) -> Scene:
    """What the core's ``load_scene`` gives; of a demo under the same settings, one scene. Files are
    read each time.
    """
    try:
        told = json.dumps(settings)
    except TypeError:
        return assembly.load_scene(target, **settings)
    if not str(target).startswith("demo:") or '"file"' in told:
        return assembly.load_scene(target, **settings)
    return _demo(str(target), told)


@lru_cache(maxsize=24)
def _demo(target: str, told: str) -> Scene:
    return assembly.load_scene(target, **json.loads(told))


def read_nrrd(path: Path) -> tuple[np.ndarray, tuple[float, ...]]:
    """The array (z, y, x) of a NRRD file in its own type, and its spacing (x, y, z)."""
    grid = open_nrrd(Source(str(path), path))
    return np.concatenate(list(grid.slabs())), tuple(grid.spacing)
