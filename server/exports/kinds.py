"""The kinds of files that light goes into, by the ending of their names."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from isogi_core.errors import SceneError, ViewError
from isogi_core.files.light_files import LitMesh, glb_bytes, obj_bytes, ply_bytes, srgb_bytes
from isogi_core.files.light_volumes import WRITERS, LitVolume, nibabel
from isogi_core.files.usd_files import light_texture, usd_layer, usdz_package
from isogi_core.plan.scene import Scene
from isogi_core.prepared.isosurface_mesh import vertex_count
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.atomic_file import write_whole
from server.pictures import compress

VTI = ".vti"
"""The kind of file that can hold coefficients."""

TEXTURE = "light.png"
"""The file of the texture in a package of USD."""


def usdz_bytes(mesh: LitMesh) -> bytes:
    """A package of USD: the mesh, and its light as a texture. Raises VolumeError where that is too large."""
    texture = compress(light_texture(mesh), "png")
    return usdz_package({"isosurface.usda": usd_layer(mesh, TEXTURE), TEXTURE: texture})


MESHES: dict[str, Callable[[LitMesh], bytes]] = {
    ".ply": ply_bytes,
    ".glb": glb_bytes,
    ".obj": obj_bytes,
    ".usdz": usdz_bytes,
}
"""What makes a file of a mesh."""


def suffix_of(output: Path) -> str:
    """The ending of a file's name that says its kind; empty for others."""
    return next((suffix for suffix in (*MESHES, *WRITERS) if output.name.lower().endswith(suffix)), "")


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


def check_coefficients(scene: Scene, suffix: str) -> None:
    """Raise ViewError where files of this kind hold no coefficients, SceneError where a scene's light is no such."""
    if suffix != VTI:
        raise ViewError(f"Coefficients go into {VTI} alone: export to such a file, or leave them out.")
    if scene.surfaces.colours is not None:
        raise SceneError("Coefficients are of one albedo, and this scene has colours by data: export without them.")


def write_mesh(output: Path, lit: LitMesh) -> None:
    """Write a mesh with its light to a file of the kind that its name says."""
    write_whole(output, MESHES[suffix_of(output)](lit))


def write_volume(output: Path, lit: LitVolume) -> None:
    """Write a volume with its light to a file of the kind that its name says."""
    suffix = suffix_of(output)
    WRITERS[suffix](output, with_colour(lit) if suffix == VTI else lit)


def with_colour(lit: LitVolume) -> LitVolume:
    """The volume with light as sRGB bytes, too, for tools that show no floats as colours."""
    colour = np.stack([srgb_bytes(layer) for layer in lit.arrays["light"]])
    return replace(lit, arrays={**lit.arrays, "colour": colour})


SIZES = {".ply": 53, ".glb": 60, ".usdz": 130, ".obj": 190}
"""Bytes of a mesh's file for each vertex and its face, about."""

VOXEL, FLOAT = 19, 4
"""Bytes of a volume's file for each voxel, at most: value, light and colour; and of each number besides."""


def expected_bytes(prepared: PreparedScene, isovalue: float, suffix: str, numbers: int = 0) -> int:
    """How large the file of an isosurface, or of the volume around it, will be; with ``numbers`` more a voxel."""
    volume = prepared.scene.volume
    if suffix in WRITERS:
        return (VOXEL + FLOAT * numbers) * volume.voxels.size
    return SIZES[suffix] * vertex_count(volume.voxels, prepared.surface(isovalue).isovalue)
