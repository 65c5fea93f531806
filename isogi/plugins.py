"""The names that plug-ins use: readers and writers of files in other packages. See docs/plugins.md.

All names in ``__all__`` keep their meaning from version to version. Importing this module loads
NumPy, but no kernels and no renderer.
"""

from typing import TYPE_CHECKING, Any

from isogi_core.errors import VolumeError
from isogi_core.files.formats.kinds import Kind, marked, matching
from isogi_core.files.formats.source import Source, library, raw_slabs, reader
from isogi_core.files.grid import Affine, Grid
from isogi_core.files.plugins import Writer

if TYPE_CHECKING:
    from isogi_core.files.light_files import LitMesh, LitVolume

__all__ = [
    "Affine",
    "Grid",
    "Kind",
    "LitMesh",
    "LitVolume",
    "Source",
    "VolumeError",
    "Writer",
    "library",
    "marked",
    "matching",
    "raw_slabs",
    "reader",
]


def __getattr__(name: str) -> Any:
    """Load the classes of light when they are first used, as they import Zarr."""
    if name in ("LitMesh", "LitVolume"):
        from isogi_core.files import light_files  # noqa: PLC0415 (see above)

        return getattr(light_files, name)
    raise AttributeError(f"isogi.plugins has no {name}")
