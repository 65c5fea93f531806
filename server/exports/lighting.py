"""Isosurfaces and volumes with their light, as files of other tools take them."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from isogi_core.errors import SceneError, ViewError
from isogi_core.files.light_files import LitMesh
from isogi_core.files.light_volumes import LitVolume
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.plan.scene import Scene
from isogi_core.prepared.isosurface_mesh import Mesh, isosurface_mesh
from server.exports.coefficients import coefficients_at, environments

POINTS = 1 << 17
"""Points that are lit together."""

Report = Callable[[int, int], None]
"""Takes how many points are lit, of how many."""


def surface_mesh(renderer: Renderer, isovalue: float) -> Mesh:
    """The mesh of an isosurface, in the volume's units; ViewError where there is none."""
    surface = renderer.prepared.surface(isovalue)
    mesh = isosurface_mesh(renderer.prepared.scene.volume.voxels, surface.isovalue)
    if not len(mesh.quads):
        raise no_surface(isovalue)
    return mesh


def no_surface(isovalue: float) -> ViewError:
    """What to raise where no surface is."""
    return ViewError(f"No surface passes any cell at {isovalue:g}: choose another isovalue.")


def lit_mesh(renderer: Renderer, view: View, mesh: Mesh, exposure: float, report: Report) -> LitMesh:
    """A mesh in the world, with the light of a view at its vertices."""
    scene = renderer.prepared.scene
    colours, normals = (np.empty_like(mesh.vertices) for _ in range(2))
    for rows, frame, towards in lit_pieces(renderer, view, mesh.vertices, report):
        colours[rows], normals[rows] = frame.radiance[0], towards
    place = scene.volume.orientation
    points = place.to_world(mesh.vertices.astype(np.float64) * np.array(scene.volume.spacing))
    return LitMesh(points, normals @ place.matrix.T, exposure * colours, mesh.quads, place.unit)


def check_lattice(scene: Scene) -> None:
    """Raise SceneError where texels are not voxels, so that a volume cannot hold their light."""
    if scene.lattice_shape != scene.volume.shape:
        raise SceneError("A volume with light has a texel at each voxel: set lattice = 1 in the scene.")


def lit_voxels(renderer: Renderer, spans: Sequence[tuple[float, float]]) -> np.ndarray:
    """Indices z, y, x (m, 3) of the voxels whose light isosurfaces read that are in the ``spans`` of isovalues."""
    prepared = renderer.prepared
    volume, lattice = prepared.scene.volume, prepared.lattice
    ranges = [volume.normalise_span(*span) for span in spans]
    texels = surface_texels(volume.voxels, prepared.shape, lattice.chunk, ranges)
    return np.concatenate([lattice.positions(index, offsets) for index, offsets in texels] or [np.zeros((0, 3), int)])


def lit_volume(
    renderer: Renderer, view: View, voxels: np.ndarray, exposure: float, report: Report, coefficients: bool = False
) -> LitVolume:
    """Values and light at all voxels; light is zero but in ``voxels``: see ``lit_voxels``.

    With ``coefficients``, the harmonics that make it up too, and what comes straight from lobes beside them.
    """
    volume = renderer.prepared.scene.volume
    light, lobes = np.zeros((*volume.shape, 3), np.float32), {}
    if coefficients and renderer.caches.spec(view.shading).lobes:
        lobes["lobes"] = np.zeros_like(light)
    for rows, frame, _ in lit_pieces(renderer, view, voxels[:, ::-1].astype(np.float32), report):
        light[tuple(voxels[rows].T)] = exposure * frame.radiance[0]
        for array in lobes.values():
            array[tuple(voxels[rows].T)] = exposure * renderer.lobe_radiance(frame)
    values = np.empty(volume.shape, np.float32)
    for z, layer in enumerate(volume.voxels):
        values[z] = volume.offset + volume.scale * layer.astype(np.float64)
    place = volume.orientation
    arrays, fields = {"value": values, "light": light, **lobes}, {}
    if coefficients:
        arrays |= coefficients_at(renderer, view, voxels)
        fields = environments(renderer, view, exposure)
    return LitVolume(arrays, place.affine(volume.spacing), place.unit, bool(place.letters), fields)


def lit_pieces(
    renderer: Renderer, view: View, points: np.ndarray, report: Report
) -> Iterator[tuple[slice, Frame, np.ndarray]]:
    """Frames of one row, and normals, of ``points`` (m, 3), some rows at a time."""
    for start in range(0, len(points), POINTS):
        rows = slice(start, min(start + POINTS, len(points)))
        frame, normals = renderer.light_points(view, points[rows])
        report(rows.stop, len(points))
        yield rows, frame, normals
