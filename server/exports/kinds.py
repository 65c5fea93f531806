"""The kinds of files that light goes into, by the ending of their names."""

from collections.abc import Callable
from pathlib import Path

from isogi_core.errors import ViewError
from isogi_core.files.light_files import LitMesh, glb_bytes, obj_bytes, ply_bytes
from isogi_core.files.light_volumes import WRITERS, nibabel
from isogi_core.files.usd_files import light_texture, usd_layer, usdz_package
from server.pictures import compress

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
