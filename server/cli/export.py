"""``isogi export``: an isosurface or a whole volume with its light, for the tools that people already use."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import ViewError
from isogi_core.files.light_volumes import WRITERS, check_zarr
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.atomic_file import write_whole
from server.cli.prewarm import order_of, prewarm_scene
from server.exports.kinds import MESHES, checked_suffix, suffix_of
from server.exports.lighting import check_lattice, lit_mesh, lit_volume, lit_voxels, surface_mesh, with_colour
from server.parameters import ViewParams, read, view_of
from server.prewarm.order import Levels, levels_of
from server.progress import Progress, open_scene
from server.render.resources import root_of
from server.settings import Settings


@dataclass(frozen=True)
class Wishes:
    """What is to be written: the file, isovalues as for a prewarm, and when light is good enough."""

    output: Path
    isovalues: tuple[str, ...]
    target_error: str | None
    exposure: float | None


def export(target: str, wishes: Wishes, knobs: Mapping[str, str], settings: Settings) -> dict[str, Any]:
    """Bake what is lacking, write light to a file, and say what is in it and how good it is.

    Raises SceneError, VolumeError, LightError and ViewError before anything is begun, StoreError, WorkersError and
    OSError later.
    """
    suffix = checked_suffix(wishes.output)
    scene = open_scene(target, settings, **({"rotating": False} if suffix in WRITERS else {}))
    check_levels(scene, wishes, suffix)
    isovalues = wishes.isovalues or (f"{scene.isovalue!r}",)
    levels = levels_of(isovalues).found_in(scene)
    view = view_of(scene, read(ViewParams, [*knobs.items(), ("isovalue", levels.spans[0][0])]), settings)
    order = {"isovalues": isovalues, "all_directions": True, "target_error": wishes.target_error}
    summary = prewarm_scene(scene, order_of({name: given for name, given in order.items() if given}), settings)
    renderer = Renderer(Caches(PreparedScene(scene), root_of(settings), settings.memory_mb << 20), Tiles())
    exposure = scene.default_exposure if wishes.exposure is None else wishes.exposure
    write = write_mesh if suffix in MESHES else write_volume
    facts = write(renderer, view, levels, exposure, wishes.output)
    baked = {"final": summary.final, "error": summary.error, "target_error": summary.target_error}
    return {"file": str(wishes.output), "scene": scene.name, **facts, **baked, "bytes": size_of(wishes.output)}


def check_levels(scene: Scene, wishes: Wishes, suffix: str) -> None:
    """Raise ViewError, SceneError or VolumeError where isovalues, lattice or place do not suit the kind of file."""
    if suffix in MESHES and (len(wishes.isovalues) > 1 or any(":" in text for text in wishes.isovalues)):
        raise ViewError(f"A mesh is of one isovalue: give --isovalue once, or write a volume: {', '.join(WRITERS)}.")
    if suffix in WRITERS:
        check_lattice(scene)
    if suffix == ".zarr":
        check_zarr(wishes.output, scene.volume.orientation.affine(scene.volume.spacing))


def write_mesh(renderer: Renderer, view: View, _: Levels, exposure: float, output: Path) -> dict[str, Any]:
    """Write the isosurface of a view with the light at its vertices."""
    mesh = surface_mesh(renderer, view)
    with Progress("lighting", "point") as bar:
        lit = lit_mesh(renderer, view, mesh, exposure, bar.show)
    write_whole(output, MESHES[suffix_of(output)](lit))
    return {"isovalue": view.isovalue, "vertices": len(mesh.vertices), "triangles": 2 * len(mesh.quads)}


def write_volume(renderer: Renderer, view: View, levels: Levels, exposure: float, output: Path) -> dict[str, Any]:
    """Write values and light at all voxels; light is zero where no isosurface of the ``levels`` reads it."""
    voxels = lit_voxels(renderer, levels.spans)
    with Progress("lighting", "point") as bar:
        lit = lit_volume(renderer, view, voxels, exposure, bar.show)
    suffix = suffix_of(output)
    WRITERS[suffix](output, with_colour(lit) if suffix == ".vti" else lit)
    return {"isovalues": [list(span) for span in levels.spans], "texels": len(voxels)}


def size_of(output: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = [output] if output.is_file() else [path for path in output.rglob("*") if path.is_file()]
    return sum(path.stat().st_size for path in files)


def exported(facts: Mapping[str, Any]) -> str:
    """What ``export`` did, for a person."""
    if "triangles" in facts:
        what = f"{facts['vertices']:,} vertices and {facts['triangles']:,} triangles at {facts['isovalue']:g}"
    else:
        what = f"light at {facts['texels']:,} voxels"
    good = f"{facts['final']:.0%} final at a relative error of {facts['target_error']:g}"
    return f"{facts['file']}: {what}, {good}, {facts['bytes'] / 1e6:.1f} MB"
