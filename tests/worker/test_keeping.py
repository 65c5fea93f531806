"""Light that a cut keeps of the whole volume has the bits of light that is baked for the cut
alone.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec, spec_for
from isogi_core.bake.noise import Goal
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import cut_open
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from isogi_worker.tasks import BakeResult, BakeTask, Whole, bake, open_spec

WHOLE = load_scene("demo:orbital", order=2, lattice=0.4, bounces=2, target_error=0.05)
INDEX = (1, 1, 1)
TEXELS = np.arange(3, 4096, 29, dtype=np.int32)


@cache
def cut(axis: str, share: float) -> tuple[Scene, BakeSpec]:
    """The orbital without what lies beyond a share of its box, and the spec of that."""
    low, high = (ends["xyz".index(axis)] for ends in WHOLE.volume.world_bounds)
    scene = cut_open(WHOLE, f"{axis}>{low + share * (high - low):g}", "cut")
    return scene, spec_for(PreparedScene(scene), "gi")


def do(
    root: Path, scene: Scene, spec: BakeSpec, until: int = 1 << 14, whole: Whole | None = None
) -> BakeResult:
    """Bake the chunk for a scene, in a store of its own or one that others use."""
    Store(root).open()
    place = StoreUrl(str(root)), INDEX, TEXELS, np.ones(len(TEXELS), np.float32)
    return bake(
        BakeTask(scene.source, spec.plan, spec.digest, *place, until, Goal(0.05), whole=whole)
    )


def stored(root: Path, scene: Scene, spec: BakeSpec) -> list[bytes | None]:
    """The chunk's object in each layer."""
    return [
        each.read(INDEX)
        for each in open_spec(scene.source, spec.plan, spec.digest, StoreUrl(str(root)))[1].layers
    ]


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("samples", [64, 1 << 14])
def test_what_a_cut_keeps_is_what_it_would_bake(tmp_path: Path, axis: str, samples: int) -> None:
    scene, spec = cut(axis, 0.75)
    do(tmp_path / "kept", WHOLE, spec_for(PreparedScene(WHOLE), "gi"), samples)
    kept = do(tmp_path / "kept", scene, spec, whole=Whole(WHOLE.source))
    bare = do(tmp_path / "bare", scene, spec)
    assert stored(tmp_path / "kept", scene, spec) == stored(tmp_path / "bare", scene, spec)
    assert bare.kept == 0 <= kept.kept < len(TEXELS) and kept.unfinished == bare.unfinished == 0
    assert (kept.kept > 0) == (axis != "z"), "whose isosurface is not in what is gone"
    assert (kept.cost.paths < bare.cost.paths) == (axis != "z")


def test_a_cut_of_other_voxels_keeps_nothing(tmp_path: Path) -> None:
    scene, spec = cut("x", 0.75)
    other = load_scene("demo:casting", order=2, lattice=0.4, bounces=2, target_error=0.05)
    do(tmp_path, other, spec_for(PreparedScene(other), "gi"))
    assert do(tmp_path, scene, spec, whole=Whole(other.source)).kept == 0
