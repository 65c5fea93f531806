"""isogi: isosurfaces of scientific volumes with global illumination, from Python.

    import isogi

    scene = isogi.open("engine.nhdr", light="studio")
    picture = scene.render(isovalue=70, azimuth=40, error=0.05)
    picture.save("engine.png")

``open`` takes a file, a scene, a NumPy array or an xarray and returns a `Scene`. A scene draws a
`Picture` with its error, exports its surface with its light, writes a page and starts a server.
Light is kept in the store that the command line uses. `isogi.client` talks to a server that runs
elsewhere, and `isogi.widget` shows a view to drag in a notebook. Names that are not listed here or
in docs/python.md are internal.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isogi_core.errors import IsogiError

if TYPE_CHECKING:
    from isogi.scenes import Picture, Scene

__all__ = ["IsogiError", "Picture", "Scene", "open"]


def open(
    source: Any,
    *,
    light: str | Path | Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
    spacing: Sequence[float] | None = None,
    store: str | Path | None = None,
    workers: int | None = None,
    **keys: Any,
) -> "Scene":
    """Open a volume or a scene.

    ``source`` is one of

    - the path or URL of a volume, of any format that ``isogi inspect`` reads;
    - the path of a scene file (``.toml``), or a built-in volume such as ``"demo:casting"``;
    - a NumPy array (depth, height, width), whose voxels lie ``spacing`` (x, y, z) apart;
    - an ``xarray.DataArray`` of three dimensions (z, y, x), whose coordinates give the spacing.

    ``light`` is the name of a light (``"overcast"``, ``"studio"``, ``"noon"``, ``"evening"``,
    ``"gallery"``), the path of a probe (``.hdr``, ``.exr``), or the ``lights`` of a scene file: a
    table or a list of tables. Further ``keys`` are those of a scene file, such as ``isovalue=70``,
    ``albedo=0.6`` or ``smooth=1``, and replace those of a scene.

    Light is kept in ``store``, a folder or URL (default: the folder of the command line), and
    computed by so many ``workers`` (default: one for each core).

    Raises IsogiError with a sentence that says what is wrong and what to do: SceneError for the
    scene and its keys, VolumeError for the volume, LightError for the light.
    """
    from isogi.scenes import open_scene  # noqa: PLC0415 (importing isogi takes no second)

    return open_scene(source, light, spacing, store, workers, keys)


def __getattr__(name: str) -> Any:
    """Load the classes when they are asked for: they bring NumPy, Numba and Zarr."""
    if name in ("Picture", "Scene"):
        from isogi import scenes  # noqa: PLC0415

        return getattr(scenes, name)
    raise AttributeError(f"isogi has no {name}: it has {', '.join(__all__)}.")
