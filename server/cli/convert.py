"""``isogi convert``: a volume as an OME-Zarr image, which opens quickly however it was packed."""

from pathlib import Path
from typing import Any

from isogi_core.files.ome import size_of, write_image
from isogi_core.files.scene_file import Settings, find_source
from isogi_core.model.value_survey import check
from isogi_core.plan.volumes.opening import open_own
from server.errors import ParameterError
from server.progress import Progress


def convert(target: str, output: Path) -> dict[str, Any]:
    """Write the volume of a ``target`` to the folder ``output``, and say what is in it.

    Raises SceneError and VolumeError, and ParameterError where the target or the output cannot be.
    """
    if output.suffix != ".zarr":
        raise ParameterError(f"'{output}' is no name of an OME-Zarr image: give one that ends in .ome.zarr.")
    settings = Settings(find_source(target, {}))
    name = settings.text("volume", "")
    if not name or name.startswith("demo:"):
        raise ParameterError(f"'{target}' is no volume of a file: give one.")
    grid, _ = open_own(settings)
    check(grid, "above")
    with Progress("converting", "layer") as bar:
        lost = write_image(grid, output, bar.count)
    facts = {"file": str(output), "size": grid.shape[::-1], "dtype": grid.dtype.name, "bytes": size_of(output)}
    return {**facts, "read_as": grid.read_as, "notes": [*grid.notes, *lost]}


def converted(facts: dict[str, Any]) -> str:
    """The facts for a person."""
    size = " × ".join(map(str, facts["size"]))
    first = f"{facts['file']}: {size} voxels of {facts['dtype']}, {facts['bytes'] / 1e6:,.1f} MB"
    return "\n".join([first, f"read as {facts['read_as']}", *facts["notes"]])
