"""``isogi export``: an isosurface or a whole volume with its light, for the tools that people already use."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import SceneError, ViewError
from isogi_core.files.light_files import LitMesh, glb_bytes, obj_bytes, ply_bytes, srgb_bytes
from isogi_core.files.light_volumes import WRITERS, LitVolume, check_zarr, nibabel
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import View
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.plan.scene import Scene
from isogi_core.prepared.isosurface_mesh import isosurface_mesh
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.atomic_file import write_whole
from server.cli.prewarm import order_of, prewarm_scene
from server.parameters import ViewParams, read, view_of
from server.prewarm.order import levels_of
from server.progress import Progress, open_scene
from server.render.resources import root_of
from server.settings import Settings

MESHES = {".ply": ply_bytes, ".glb": glb_bytes, ".obj": obj_bytes}

POINTS = 1 << 17
"""Points that are lit together."""


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
    lit = write_mesh if suffix in MESHES else write_volume
    facts = lit(renderer, view, levels.spans, exposure, wishes.output)
    baked = {"final": summary.final, "error": summary.error, "target_error": summary.target_error}
    return {"file": str(wishes.output), "scene": scene.name, **facts, **baked, "bytes": size_of(wishes.output)}


def checked_suffix(output: Path) -> str:
    """The suffix of a file that can be written; ViewError for others, and where its folder is missing."""
    suffix = suffix_of(output)
    if not suffix:
        known = ", ".join((*MESHES, *WRITERS))
        raise ViewError(f"{output} names no kind of file that light goes into: end it in {known}.")
    if not output.parent.is_dir():
        raise ViewError(f"There is no folder {output.parent} for {output.name}: make it first.")
    if suffix == ".nii.gz":
        nibabel()
    return suffix


def suffix_of(output: Path) -> str:
    """The ending of a file's name that says its kind; empty for others."""
    return next((suffix for suffix in (*MESHES, *WRITERS) if output.name.lower().endswith(suffix)), "")


def check_levels(scene: Scene, wishes: Wishes, suffix: str) -> None:
    """Raise ViewError, SceneError or VolumeError where isovalues, lattice or place do not suit the kind of file."""
    if suffix in MESHES and (len(wishes.isovalues) > 1 or any(":" in text for text in wishes.isovalues)):
        raise ViewError(f"A mesh is of one isovalue: give --isovalue once, or write a volume: {', '.join(WRITERS)}.")
    if suffix in WRITERS and scene.lattice_shape != scene.volume.shape:
        raise SceneError("A volume with light has a texel at each voxel: set lattice = 1 in the scene.")
    if suffix == ".zarr":
        check_zarr(wishes.output, scene.volume.orientation.affine(scene.volume.spacing))


def write_mesh(renderer: Renderer, view: View, _: Any, exposure: float, output: Path) -> dict[str, Any]:
    """Write the isosurface of a view with the light at its vertices."""
    scene = renderer.prepared.scene
    surface = renderer.prepared.surface(view.isovalue)
    mesh = isosurface_mesh(scene.volume.voxels, surface.isovalue)
    if not len(mesh.triangles):
        raise ViewError(f"No surface passes any cell at {view.isovalue:g}: choose another isovalue.")
    colours, normals = (np.empty_like(mesh.vertices) for _ in range(2))
    for rows, light, towards in lit_pieces(renderer, view, mesh.vertices):
        colours[rows], normals[rows] = light, towards
    orientation = scene.volume.orientation
    places = orientation.to_world(mesh.vertices.astype(np.float64) * np.array(scene.volume.spacing))
    lit = LitMesh(places, normals @ orientation.matrix.T, exposure * colours, mesh.triangles)
    write_whole(output, MESHES[suffix_of(output)](lit))
    return {"isovalue": view.isovalue, "vertices": len(places), "triangles": len(mesh.triangles)}


def write_volume(renderer: Renderer, view: View, spans: Any, exposure: float, output: Path) -> dict[str, Any]:
    """Write values and light at all voxels; light is zero where no isosurface in the ``spans`` reads it."""
    prepared, scene = renderer.prepared, renderer.prepared.scene
    volume, lattice = scene.volume, prepared.lattice
    ranges = [(min(pair), max(pair)) for pair in (tuple(map(volume.normalise_isovalue, span)) for span in spans)]
    texels = surface_texels(volume.voxels, prepared.shape, lattice.chunk, ranges)
    places = np.concatenate([lattice.positions(index, offsets) for index, offsets in texels] or [np.zeros((0, 3), int)])
    light = np.zeros((*volume.shape, 3), np.float32)
    for rows, found, _ in lit_pieces(renderer, view, places[:, ::-1].astype(np.float32)):
        light[tuple(places[rows].T)] = exposure * found
    values = volume.offset + volume.scale * volume.voxels.astype(np.float64)
    arrays: dict[str, np.ndarray] = {"value": values, "light": light}
    if suffix_of(output) == ".vti":
        arrays["colour"] = srgb_bytes(light)
    place = volume.orientation
    lit = LitVolume(arrays, place.affine(volume.spacing), place.unit, bool(place.letters))
    WRITERS[suffix_of(output)](output, lit)
    return {"isovalues": [list(span) for span in spans], "texels": len(places)}


def lit_pieces(renderer: Renderer, view: View, points: np.ndarray) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Linear RGB and normals of ``points`` (m, 3), some rows at a time."""
    with Progress("lighting", "point") as bar:
        for start in range(0, len(points), POINTS):
            rows = slice(start, min(start + POINTS, len(points)))
            frame, normals = renderer.light_points(view, points[rows])
            bar.show(rows.stop, len(points), None)
            yield rows, frame.radiance[0], normals


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
