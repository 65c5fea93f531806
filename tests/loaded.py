"""Scenes of demos that all tests of a process share, as loading one takes longer than most tests of it."""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from isogi_core.plan import assembly
from isogi_core.plan.scene import Scene


def load_scene(target: str | Path, **settings: Any) -> Scene:
    """What the core's ``load_scene`` gives; of a demo under the same settings, one scene. Files are read each time."""
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
