"""``isogi export`` and ``isogi convert``: files for other tools.

``export`` writes an isosurface or a volume with its light; ``convert`` writes a volume as an
OME-Zarr image, which opens quickly.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import ViewError
from isogi_core.files.light_files import check_zarr
from isogi_core.files.ome import size_of, write_image
from isogi_core.files.scene_file import Settings as SceneSettings
from isogi_core.files.scene_file import Target, find_source
from isogi_core.files.spelling import shortest
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.value_survey import check
from isogi_core.plan.scene import Scene
from isogi_core.plan.volumes.opening import open_own
from isogi_core.prepared.isosurface_mesh import Mesh
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.atomic_file import check_writable
from isogi_server.cli.prewarm import order_of, prewarm_scene
from isogi_server.cli.publish import values_in
from isogi_server.errors import ParameterError
from isogi_server.exports.lit_files import (
    Lit,
    check_coefficients,
    check_lattice,
    checked_suffix,
    is_of_volume,
    places_to_light,
    suffix_of,
    write_lit,
    writers,
)
from isogi_server.parameters import ANGLES, ViewParams, read
from isogi_server.prewarm.order import Levels, levels_of
from isogi_server.progress import Progress, open_scene
from isogi_server.render.stores import root_of
from isogi_server.settings import Settings
from isogi_server.views import in_turned_light, turn_baked, view_of

MOST_TURNS = 1000
"""Rotations of the light that are written by one command, at most."""


@dataclass(frozen=True)
class ExportRequest:
    """A file with light that a command asks for: its isovalues, the error at which light is
    good enough, and ``coefficients`` if these are exported too.
    """

    output: Path
    isovalues: tuple[str, ...]
    target_error: str | None
    exposure: float | None
    coefficients: bool = False


def export(
    target: Target, request: ExportRequest, knobs: Mapping[str, str], settings: Settings
) -> dict[str, Any]:
    """Bake missing light, and write a file with it; return facts about its content and quality.

    Raises SceneError, VolumeError, LightError and ViewError before any work, and StoreError,
    WorkersError and OSError later.
    """
    suffix = checked_suffix(request.output)
    # Light that is not rotated needs one number per texel instead of harmonics.
    turned = knobs.keys() & {*ANGLES, "light"}
    still = is_of_volume(suffix) and not turned and not request.coefficients
    scene = open_scene(target, settings, **({"rotating": False} if still else {}))
    files = files_of(request.output, knobs)
    check_levels(scene, request, files)
    if request.coefficients:
        check_coefficients(scene, suffix)
    isovalues = request.isovalues or (f"{scene.isovalue!r}",)
    levels = levels_of(isovalues).found_in(scene)
    params = {
        path: read(ViewParams, {**turn, "isovalue": levels.spans[0][0]}.items())
        for path, turn in files.items()
    }
    # Light that is baked for each turn is that of one file.
    turns = {turn_baked(scene, each) for each in params.values()}
    if len(turns) > 1:
        raise ParameterError(
            "yaw has several turns, and this scene's light is baked for each: export one by one.",
            "yaw",
        )
    scene = in_turned_light(scene, next(iter(params.values())))
    views = {path: view_of(scene, each, settings) for path, each in params.items()}
    for path in files:
        check_writable(path)
    order = {"isovalues": isovalues, "all_directions": True, "target_error": request.target_error}
    if request.coefficients:
        rung = MAX_SAMPLES
    else:
        rung = FIRST_LEVEL
    given = order_of({name: value for name, value in order.items() if value})
    # Bake whole isosurfaces; coefficients with all samples.
    summary = prewarm_scene(scene, given, settings, rung=rung)
    renderer = Renderer(
        Caches(PreparedScene(scene), root_of(settings), settings.memory_mb << 20), Tiles()
    )
    if request.exposure is None:
        exposure = scene.default_exposure
    else:
        exposure = request.exposure
    # One list of places serves all rotations of the light.
    places = places_to_light(renderer, suffix, levels.spans)
    for path, view in views.items():
        with Progress(f"lighting {path.name}", "point") as bar:
            write_lit(renderer, path, view, places, exposure, bar.show, request.coefficients)
    baked = {"final": summary.final, "error": summary.error, "target_error": summary.target_error}
    trouble = summary.failures[0].reason if summary.failures else ""
    about = {
        "file": str(request.output),
        "files": [str(path) for path in views],
        "scene": scene.name,
    }
    facts = {**about, **size_facts(places, levels), **baked, "trouble": trouble}
    return {**facts, "bytes": sum(map(size_of, views))}


def files_of(output: Path, knobs: Mapping[str, str]) -> dict[Path, dict[str, str]]:
    """Return the parameters of each file: one file, or numbered ones for a yaw such as 0:330:30.

    Raises ParameterError.
    """
    yaw = knobs.get("yaw", "")
    if ":" not in yaw:
        return {output: dict(knobs)}
    turns = values_in("yaw", yaw)
    suffix = suffix_of(output)
    if len(turns) > MOST_TURNS:
        raise ParameterError(
            f"yaw {yaw} are {len(turns):,} turns: ask for {MOST_TURNS:,} at most.", "yaw"
        )
    stem = output.name[: -len(suffix)]
    # Leading zeros keep files in order.
    digits = len(str(len(turns)))
    names = (
        f"{stem}-{number:0{digits}}{output.name[-len(suffix) :]}"
        for number in range(1, len(turns) + 1)
    )
    return {
        output.with_name(name): {**knobs, "yaw": repr(turn)}
        for name, turn in zip(names, turns, strict=True)
    }


def check_levels(scene: Scene, request: ExportRequest, files: Iterable[Path]) -> None:
    """Raise ViewError, SceneError or VolumeError if isovalues, lattice or orientation do not
    suit the file format.
    """
    scene.require_texels()
    suffix = suffix_of(request.output)
    if is_of_volume(suffix):
        check_lattice(scene)
    elif len(request.isovalues) > 1 or any(":" in text for text in request.isovalues):
        volumes = ", ".join(suffix for suffix in writers() if is_of_volume(suffix))
        raise ViewError(
            f"A mesh is of one isovalue: give --isovalue once, or write a volume: {volumes}."
        )
    # OME-Zarr holds no rotation, and a folder that exists is not overwritten.
    if suffix == ".zarr":
        for path in files:
            check_zarr(path, scene.volume.orientation.affine(scene.volume.spacing))


def size_facts(places: Lit, levels: Levels) -> dict[str, Any]:
    """Return the isovalues of a file, and the number of places with light."""
    if isinstance(places, Mesh):
        isovalue = levels.spans[0][0]
        return {
            "isovalue": isovalue,
            "vertices": len(places.vertices),
            "triangles": 2 * len(places.quads),
        }
    return {"isovalues": [list(span) for span in levels.spans], "texels": len(places)}


def exported(facts: Mapping[str, Any]) -> str:
    """Return the facts of ``export`` as text for a person."""
    if "triangles" in facts:
        what = (
            f"{facts['vertices']:,} vertices and {facts['triangles']:,} triangles at "
            f"{shortest(facts['isovalue'])}"
        )
    else:
        what = f"light at {facts['texels']:,} voxels"
    good = f"{facts['final']:.0%} final at a relative error of {facts['target_error']:g}"
    files = facts["files"]
    if len(files) == 1:
        named = files[0]
    else:
        named = f"{len(files)} files, {files[0]} to {files[-1]}"
    return f"{named}: {what}, {good}, {facts['bytes'] / 1e6:.1f} MB"


def convert(target: str, output: Path) -> dict[str, Any]:
    """Write the volume of a ``target`` to the folder ``output``, and return facts about it.

    Raises SceneError and VolumeError, and ParameterError if the target is no volume of a file, or
    the output has another suffix.
    """
    if output.suffix != ".zarr":
        raise ParameterError(
            f"'{output}' is no name of an OME-Zarr image: give one that ends in .ome.zarr."
        )
    # Open the volume of a file without the scene around it.
    settings = SceneSettings(find_source(target, {}))
    name = settings.text("volume", "")
    if not name or name.startswith("demo:"):
        raise ParameterError(f"'{target}' is no volume of a file: give one.")
    grid, _ = open_own(settings)
    # Refuse values that isogi could not show. An image has no isovalue, so either side may be named
    # as the solid one.
    check(grid, "above")
    with Progress("converting", "layer") as bar:
        lost = write_image(grid, output, bar.count)
    facts = {
        "file": str(output),
        "size": grid.shape[::-1],
        "dtype": grid.dtype.name,
        "bytes": size_of(output),
    }
    return {**facts, "read_as": grid.read_as, "notes": [*grid.notes, *lost]}


def converted(facts: dict[str, Any]) -> str:
    """Return the facts of ``convert`` as text for a person."""
    size = " × ".join(map(str, facts["size"]))
    first = f"{facts['file']}: {size} voxels of {facts['dtype']}, {facts['bytes'] / 1e6:,.1f} MB"
    return "\n".join([first, f"read as {facts['read_as']}", *facts["notes"]])
