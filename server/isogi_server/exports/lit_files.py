"""Files of isosurfaces and volumes with their light, in formats of other tools, chosen by the
suffix from a table that plug-ins add to.

A volume may also hold the factors of its light: transfer coefficients, and those of the rotated
environment.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import SceneError, ViewError
from isogi_core.files.grid import srgb_bytes
from isogi_core.files.light_files import (
    LitMesh,
    LitVolume,
    light_texture,
    nibabel,
    usd_layer,
    usdz_package,
)
from isogi_core.files.plugins import (
    WRITER_GROUP,
    Plugins,
    Writer,
    blame_plugin,
    failure_of,
    plugins,
)
from isogi_core.files.spelling import shortest
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.plan.scene import Scene
from isogi_core.prepared.isosurface_mesh import Mesh, isosurface_mesh, vertex_count
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.atomic_file import check_folder, write_whole
from isogi_server.pictures import compress

VTI = ".vti"
"""The suffix of the format that can hold coefficients."""

TEXTURE = "light.png"
"""The file of the texture in a USD package."""


def usdz_bytes(mesh: LitMesh) -> bytes:
    """Return a USD package of the mesh, with its light as a texture. Raises VolumeError if that
    is too large.
    """
    texture = compress(light_texture(mesh), "png")
    return usdz_package({"isosurface.usda": usd_layer(mesh, TEXTURE), TEXTURE: texture})


LIGHT_FILES = "isogi_core.files.light_files"

WRITERS: tuple[Writer, ...] = (
    Writer(".ply", f"{LIGHT_FILES}:ply_bytes", vertex_bytes=53),
    Writer(".glb", f"{LIGHT_FILES}:glb_bytes", vertex_bytes=60),
    Writer(".obj", f"{LIGHT_FILES}:obj_bytes", vertex_bytes=190),
    Writer(".usdz", "isogi_server.exports.lit_files:usdz_bytes", vertex_bytes=130),
    Writer(VTI, f"{LIGHT_FILES}:vti_bytes", of_volume=True),
    Writer(".nrrd", f"{LIGHT_FILES}:nrrd_bytes", of_volume=True),
    Writer(".nii.gz", f"{LIGHT_FILES}:nifti_bytes", of_volume=True),
    Writer(".zarr", f"{LIGHT_FILES}:write_zarr", of_volume=True, is_folder=True),
)
"""Kinds of files that isogi writes."""


def writer_plugins() -> Plugins:
    """Find the kinds of files that other packages write."""
    return plugins(WRITER_GROUP, Writer)


@cache
def writers() -> dict[str, Writer]:
    """Return all kinds of files that can be written, by suffix: isogi's, then those of plug-ins
    for other suffixes.
    """
    found = {each.suffix: each for each in WRITERS}
    for plugin in writer_plugins().found:
        found.setdefault(plugin.record.suffix, replace(plugin.record, package=plugin.package))
    return found


def suffix_of(output: Path) -> str:
    """Return the suffix of a known file format; empty for others."""
    return next((suffix for suffix in writers() if output.name.lower().endswith(suffix)), "")


def is_of_volume(suffix: str) -> bool:
    """Return True if files of a known format hold the values of all voxels, and no mesh."""
    return writers()[suffix].of_volume


def checked_suffix(output: Path) -> str:
    """Return the suffix of a file that can be written. Raises ViewError for other files, or if
    the folder is missing.
    """
    suffix = suffix_of(output)
    if not suffix:
        known = f"end it in {', '.join(writers())}."
        said = f"{output} names no kind of file that light goes into: {known}"
        raise ViewError(" ".join([said, *writer_plugins().faults]))
    check_folder(output)
    if suffix == ".nii.gz":
        nibabel()
    return suffix


def write_file(output: Path, lit: LitMesh | LitVolume) -> None:
    """Write a mesh or a volume with its light, as a file of the kind that its suffix names. Raises
    ViewError, which names the package, for whatever goes wrong in a plug-in.
    """
    writer = writers()[suffix_of(output)]
    unwritten = f"{output} cannot be written"
    with blame_plugin(writer.package, unwritten, ViewError):
        if writer.is_folder:
            writer.open()(output, lit)
            return
        written = writer.open()(lit)
    if not isinstance(written, bytes):
        wrong = f"it gives {type(written).__name__}, not bytes"
        raise ViewError(failure_of(writer.package, unwritten, wrong))
    write_whole(output, written)


def check_coefficients(scene: Scene, suffix: str) -> None:
    """Raise ViewError if the format holds no coefficients, and SceneError if the scene's
    surface is coloured by data, as coefficients belong to one albedo.
    """
    if suffix != VTI:
        raise ViewError(
            f"Coefficients go into {VTI} alone: export to such a file, or leave them out."
        )
    if scene.surfaces.colours is not None:
        raise SceneError(
            "Coefficients are of one albedo, and this scene has colours by data: export "
            "without them."
        )


def with_colour(lit: LitVolume) -> LitVolume:
    """Return the volume with its light as sRGB bytes too, for tools that show no floats as
    colours.
    """
    colour = np.stack([srgb_bytes(layer) for layer in lit.arrays["light"]])
    return replace(lit, arrays={**lit.arrays, "colour": colour})


POINTS_PER_BATCH = 1 << 17
"""Points that are lit together."""

Report = Callable[[int, int], None]
"""Takes the number of points that are lit, and of all."""

Spans = Sequence[tuple[float, float]]
"""Ranges of isovalues, each from low to high."""

Lit = Mesh | np.ndarray
"""Places whose light a file holds: the vertices of a mesh, or voxels (m, 3; z, y, x)."""


def places_to_light(renderer: Renderer, suffix: str, spans: Spans) -> Lit:
    """Return the places whose light a file of this format holds, for isovalues in ``spans``.
    Raises ViewError if a mesh is empty.
    """
    if is_of_volume(suffix):
        return lit_voxels(renderer, spans)
    return surface_mesh(renderer, spans[0][0])


def write_lit(
    renderer: Renderer,
    output: Path,
    view: View,
    places: Lit,
    exposure: float,
    report: Report,
    coefficients: bool = False,
) -> None:
    """Write an isosurface, or the values of all voxels, with the light of a view at ``places``;
    light is multiplied by ``exposure``.

    A volume also gets the ``coefficients`` of its light if that is set. Raises VolumeError and
    OSError.
    """
    if isinstance(places, Mesh):
        write_file(output, lit_mesh(renderer, view, places, exposure, report))
        return
    lit = lit_volume(renderer, view, places, exposure, report, coefficients)
    write_file(output, with_colour(lit) if suffix_of(output) == VTI else lit)


def surface_mesh(renderer: Renderer, isovalue: float) -> Mesh:
    """Return the mesh of an isosurface in voxel indices; ``isovalue`` is in the units of the
    volume's file. Raises ViewError if it is empty.
    """
    surface = renderer.prepared.surface(isovalue)
    mesh = isosurface_mesh(renderer.prepared.scene.volume.voxels, surface.isovalue)
    if not len(mesh.quads):
        raise no_surface(isovalue)
    return mesh


def no_surface(isovalue: float) -> ViewError:
    """Return the error for an isovalue without a surface."""
    return ViewError(
        f"No surface passes any cell at {shortest(isovalue)}: choose another isovalue."
    )


def lit_mesh(
    renderer: Renderer, view: View, mesh: Mesh, exposure: float, report: Report
) -> LitMesh:
    """Return a mesh in the world, with the light of a view at its vertices."""
    scene = renderer.prepared.scene
    colours, normals = (np.empty_like(mesh.vertices) for _ in range(2))
    for rows, frame, towards in lit_pieces(renderer, view, mesh.vertices, report):
        colours[rows] = frame.radiance[0]
        normals[rows] = towards
    place = scene.volume.orientation
    points = place.to_world(mesh.vertices.astype(np.float64) * np.array(scene.volume.spacing))
    return LitMesh(points, normals @ place.matrix.T, exposure * colours, mesh.quads, place.unit)


def check_lattice(scene: Scene) -> None:
    """Raise SceneError if texels are not voxels, so that a volume cannot hold their light."""
    if scene.lattice_shape != scene.volume.shape:
        raise SceneError(
            "A volume with light has a texel at each voxel: set lattice = 1 in the scene."
        )


def lit_voxels(renderer: Renderer, spans: Spans) -> np.ndarray:
    """Return indices z, y, x (m, 3) of the voxels whose texels isosurfaces in the ``spans`` of
    isovalues read.
    """
    prepared = renderer.prepared
    volume = prepared.scene.volume
    lattice = prepared.lattice
    ranges = [volume.normalise_span(*span) for span in spans]
    texels = surface_texels(volume.voxels, prepared.shape, lattice.chunk, ranges)
    return np.concatenate(
        [lattice.positions(index, offsets) for index, offsets in texels] or [np.zeros((0, 3), int)]
    )


def lit_volume(
    renderer: Renderer,
    view: View,
    voxels: np.ndarray,
    exposure: float,
    report: Report,
    coefficients: bool = False,
) -> LitVolume:
    """Return values and light at all voxels; light is zero except at ``voxels``: see
    ``lit_voxels``.

    With ``coefficients``, also the harmonics that make up the light, and the direct light of lobes,
    which these do not contain.
    """
    volume = renderer.prepared.scene.volume
    light = np.zeros((*volume.shape, 3), np.float32)
    lobes = {}
    if coefficients and renderer.caches.spec(view.shading).lobes:
        lobes["lobes"] = np.zeros_like(light)
    for rows, frame, _ in lit_pieces(renderer, view, voxels[:, ::-1].astype(np.float32), report):
        light[tuple(voxels[rows].T)] = exposure * frame.radiance[0]
        for array in lobes.values():
            array[tuple(voxels[rows].T)] = exposure * renderer.surface.lobe_radiance(frame)
    values = np.empty(volume.shape, np.float32)
    # Convert layer by layer: the float64 copy of one layer is small.
    for z, layer in enumerate(volume.voxels):
        values[z] = volume.offset + volume.scale * layer.astype(np.float64)
    place = volume.orientation
    arrays = {"value": values, "light": light, **lobes}
    fields = {}
    if coefficients:
        arrays |= coefficients_at(renderer, view, voxels)
        fields = environments(renderer, view, exposure)
    return LitVolume(arrays, place.affine(volume.spacing), place.unit, bool(place.letters), fields)


def lit_pieces(
    renderer: Renderer, view: View, points: np.ndarray, report: Report
) -> Iterator[tuple[slice, Frame, np.ndarray]]:
    """Yield frames of one row, and normals, of ``points`` (m, 3), a batch of rows at a time."""
    for start in range(0, len(points), POINTS_PER_BATCH):
        rows = slice(start, min(start + POINTS_PER_BATCH, len(points)))
        frame, normals = renderer.surface.light_points(view, points[rows])
        report(rows.stop, len(points))
        yield rows, frame, normals


FILE_BYTES_PER_VOXEL = 19
FILE_BYTES_PER_NUMBER = 4
"""Bytes of a volume's file for each voxel, at most: value, light and colour; and for each
further number.
"""


def expected_bytes(prepared: PreparedScene, isovalue: float, suffix: str, numbers: int = 0) -> int:
    """Return the expected size of the file of an isosurface, or of its volume; with ``numbers``
    further numbers per voxel.
    """
    volume = prepared.scene.volume
    if is_of_volume(suffix):
        return (FILE_BYTES_PER_VOXEL + FILE_BYTES_PER_NUMBER * numbers) * volume.voxels.size
    vertices = vertex_count(volume.voxels, prepared.surface(isovalue).isovalue)
    return writers()[suffix].vertex_bytes * vertices


LIGHT_KIND_WORDS = {"direct": "direct", "indirect": "reflected"}
"""Names of kinds of light in files; other kinds keep their names."""

COLOUR_CHANNELS = ("red", "green", "blue")


def term_names(spec: BakeSpec) -> list[str]:
    """Return a name for each term of a bake spec: direct or reflected light, numbered if it is
    kept for several albedos.
    """
    kinds = [spec.plan.layers[term.layers[0]].kind for term in spec.terms]
    return [
        LIGHT_KIND_WORDS.get(kind, kind) + ("" if term.node is None else str(term.node + 1))
        for kind, term in zip(kinds, spec.terms, strict=True)
    ]


def columns_of(spec: BakeSpec) -> dict[str, slice]:
    """Return the columns of each band of each term in the transfer of a spec's texels, by name
    of the array.
    """
    return {
        f"{name}_band{band}": slice(int(first) + band**2, int(first) + (band + 1) ** 2)
        for name, term, first in zip(term_names(spec), spec.terms, spec.firsts, strict=True)
        for band in range(term.order)
    }


def coefficient_count(spec: BakeSpec) -> int:
    """Return the numbers per voxel in addition to its light: coefficients, and the light of
    lobes.
    """
    return spec.channels * spec.columns + (len(COLOUR_CHANNELS) if spec.lobes else 0)


def environments(renderer: Renderer, view: View, exposure: float) -> dict[str, np.ndarray]:
    """Return the factors of each term's coefficients for red, green and blue, (3, n²): see
    ``coefficients_at``.
    """
    spec = renderer.caches.spec(view.shading)
    reflected = exposure * RotatedLight(spec, view).reflected
    return {
        f"environment_{name}": reflected[:, first : first + term.order**2].astype(np.float32)
        for name, term, first in zip(term_names(spec), spec.terms, spec.firsts, strict=True)
    }


def coefficients_at(renderer: Renderer, view: View, voxels: np.ndarray) -> dict[str, np.ndarray]:
    """Return arrays of the transfer of texels at ``voxels`` (m, 3; z, y, x), zero elsewhere: (nz,
    ny, nx, 2 l + 1) for band l.

    There is one array for each band, and for each colour if these differ. Radiance without lobes is
    the sum over terms and bands of coefficients times those of ``environments``.
    """
    caches = renderer.caches
    shape = renderer.prepared.scene.volume.shape
    spec = caches.spec(view.shading)
    if spec.channels == len(COLOUR_CHANNELS):
        colours = [f"_{colour}" for colour in COLOUR_CHANNELS]
    else:
        colours = [""]
    columns = columns_of(spec)
    # Grey transfer has one array per band, coloured transfer one per colour.
    arrays = {
        f"{name}{colour}": np.zeros((*shape, own.stop - own.start), np.float32)
        for name, own in columns.items()
        for colour in colours
    }
    # Scatter the coefficients of texels into the arrays, chunk by chunk.
    for rows, transfer in transfers(caches, view.shading, voxels):
        places = tuple(voxels[rows].T)
        for name, own in columns.items():
            for channel, colour in enumerate(colours):
                arrays[f"{name}{colour}"][places] = transfer[:, channel, own]
    return arrays


def transfers(
    caches: Caches, shading: str, voxels: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield batches of ``voxels``, by their numbers, with the transfer of their texels (k,
    channels, columns).
    """
    loader = caches.of(shading)
    lattice = caches.prepared.lattice
    chunks = voxels // lattice.chunk
    bits = lattice.bits
    # An offset in a chunk holds the bits of z, then those of y, then those of x.
    z, y, x = (voxels % lattice.chunk).T
    offsets = (z << 2 * bits) + (y << bits) + x
    found, groups = np.unique(chunks, axis=0, return_inverse=True)
    # Visit one chunk at a time, and hold it in the page pool only meanwhile.
    for number, (k, j, i) in enumerate(found.tolist()):
        rows = np.flatnonzero(groups.ravel() == number)
        loader.ensure([(k, j, i)])
        with loader.pool.hold([(k, j, i)]) as held:
            yield rows, loader.pool.transfer_at(int(held.slots[0]), offsets[rows])
