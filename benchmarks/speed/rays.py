"""Rays per second of the lanes, of the scalar kernel and of Embree on the mesh of the same
isosurface.

    python -m benchmarks.speed rays [TARGET[@ISOVALUE] ...] [--four] [--size 512] [--repeats 9]
    [--json]

Primary rays of the benchmarks' view, cosine rays from what they hit, cosine rays from what those
hit, on one thread; `--four` takes the engine block, a bonsai, a heptane jet and a head. All
candidates take the same rays in turn in one process; figures are ratios of medians. Embree traces
the marching-cubes mesh: by the Python calls of `embreex` ("embree") and by its C interface ("embree
C", rays one by one or 16 together, whichever is faster). Memory is all that is kept for the
isosurface besides the volume, in megabytes. What a processor without AVX-512 gets is told where
`NUMBA_CPU_NAME=haswell` is set.
"""

import tracemalloc
from collections.abc import Callable, Iterator
from functools import cached_property, partial
from typing import Any

import click
import numpy as np

from benchmarks.common import mesh
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import benchmark_scene, shared_data
from benchmarks.common.suite import part
from benchmarks.speed import embree
from isogi_core.kernels.simd.types import RAY_WIDTH, REGISTER_LANES
from isogi_core.kernels.tracing.cast import cast_one_by_one
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.speed import Candidate, Rays, bounce, cast, medians, primary_rays, timed

FOUR = (
    "engine_256x256x128_uint8.nhdr@70",
    "bonsai_256x256x256_uint8.nhdr@40.5",
    "heptane_302x302x302_uint8.nhdr@100.5",
    "ct_head_208x256x225_uint8.nhdr@85.5",
)
"""The volumes of ``--four``, in the folder of shared data, and an isovalue of each."""


class Casts:
    """The candidates, for one isosurface; ``bytes`` is what ours keeps besides the volume."""

    def __init__(self, scene: Scene) -> None:
        """Build the map, a first time to have the kernels loaded."""
        self.prepared = PreparedScene(scene)
        self.level = scene.volume.normalise_isovalue(scene.isovalue)
        assert PreparedScene(scene).surface(scene.isovalue).cells()
        tracemalloc.start()
        assert self.prepared.surface(scene.isovalue).cells()
        self.bytes, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()

    @cached_property
    def mesh(self) -> mesh.Mesh:
        """The mesh of the isosurface."""
        return mesh.make_mesh(self.prepared.scene.volume, self.level)

    @cached_property
    def tree(self) -> embree.Tree:
        """Embree's tree over it, by the C interface."""
        return embree.Tree(embree.Device(1), *self.mesh)

    @cached_property
    def embreex(self) -> Any:
        """Embree's tree over it, by the Python calls."""
        from embreex import rtcore_scene  # noqa: PLC0415
        from embreex.mesh_construction import TriangleMesh  # noqa: PLC0415

        scene = rtcore_scene.EmbreeScene()
        TriangleMesh(scene, self.mesh[0], self.mesh[1].astype(np.int32))
        return scene

    def candidates(self, rays: Rays) -> dict[str, Candidate]:
        """What to time on ``rays``."""
        found: dict[str, Callable[[], Any]] = {
            "lanes": partial(cast, self.prepared, rays),
            "scalar": partial(cast, self.prepared, rays, cast_one_by_one),
        }
        if embree.installed() and mesh.installed():
            origins, directions = (v.astype(np.float32) for v in (rays.origins, rays.directions))
            pairs = [np.ascontiguousarray(v.T) for v in (origins, directions)]
            device = self.tree.device
            found["embree"] = partial(self.embreex.run, *pairs)
            found["embree one"] = partial(self.tree.trace, device.one, origins, directions)
            found["embree sixteen"] = partial(self.tree.trace, device.sixteen, origins, directions)
        return {name: timed(work) for name, work in found.items()}

    def memory(self) -> dict[str, float]:
        """Megabytes for the isosurface."""
        figures = {"memory, MB": self.bytes / 1e6}
        if embree.installed() and mesh.installed():
            figures["memory of mesh + embree, MB"] = (
                sum(a.nbytes for a in self.mesh) + self.tree.bytes
            ) / 1e6
            figures["memory / mesh + embree"] = (
                figures["memory, MB"] / figures["memory of mesh + embree, MB"]
            )
        return figures


def measure(casts: Casts, rays: Rays, repeats: int) -> dict[str, float]:
    """Mrays/s of the lanes on ``rays``, and how many times faster they are than each other
    candidate.
    """
    taken = medians(casts.candidates(rays), repeats)
    if "embree one" in taken:
        taken["embree C"] = min(taken.pop("embree one"), taken.pop("embree sixteen"))
    lanes = taken.pop("lanes")
    return {
        "Mrays/s": len(rays) / lanes / 1e6,
        **{f"lanes / {name}": other / lanes for name, other in taken.items()},
    }


def figures_of(scene: Scene, size: int, repeats: int) -> dict[str, Any]:
    """The figures of one isosurface."""
    casts = Casts(scene)
    figures: dict[str, Any] = {"lanes at once": RAY_WIDTH if REGISTER_LANES else 0}
    going = primary_rays(casts.prepared, size)
    rng = np.random.default_rng(1)
    for kind in ("primary", "bounce1", "bounce2"):
        figures[f"{kind}: rays"] = len(going)
        figures |= {
            f"{kind}: {name}": value for name, value in measure(casts, going, repeats).items()
        }
        going = bounce(casts.prepared, going, rng)
    if not (embree.installed() and mesh.installed()):
        figures["embree"] = "not installed"
    return figures | casts.memory()


def scenes(targets: tuple[str, ...], four: bool) -> Iterator[Scene]:
    """The isosurfaces that are asked for; the benchmarks' own where none is."""
    data = shared_data()
    if four and data is None:
        raise click.UsageError(
            "The four volumes are not at hand: set ISOGI_SHARED_DATA to the folder of them."
        )
    names = [*targets, *(f"{data}/{name}" for name in FOUR if four)]
    if not names:
        yield benchmark_scene(None)
    for name in names:
        target, at, isovalue = name.partition("@")
        overrides: dict[str, Any] = {"isovalue": float(isovalue)} if at else {}
        yield benchmark_scene(target, **overrides)


@part(size=512, repeats=9)
@click.argument("targets", nargs=-1)
@click.option("--four", is_flag=True, help="Take the four volumes.")
def rays(targets: tuple[str, ...], four: bool, size: int, repeats: int) -> Iterator[Measurement]:
    """Rays a second: lanes, the scalar kernel and Embree; as JSON, each isosurface on a line."""
    for scene in scenes(targets, four):
        title = f"{scene.name} at {scene.isovalue:g}"
        yield Measurement(
            title, {"isosurface": title, **figures_of(scene, size, repeats)}, variant="four" * four
        )
