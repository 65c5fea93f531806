"""``isogi inspect``: a scene's facts as text or JSON, and a picture of its stiffness."""

import importlib.util
from pathlib import Path

from server.errors import LibraryError, ParameterError
from server.inspect.document import inspection_facts
from server.inspect.text import report
from server.opening import open_scene


def inspect(target: str, picture: Path | None = None, as_json: bool = False) -> str:
    """What is to be told of ``target``, a volume or a scene; draws the ``picture`` where one is asked for.

    Raises SceneError, VolumeError, LightError, and ParameterError or LibraryError where no picture can be drawn.
    """
    if picture is not None:
        check_picture(picture)
    scene = open_scene(target)
    facts = inspection_facts(scene)
    if picture is not None:
        from server.inspect.picture import save_picture  # noqa: PLC0415 (matplotlib is an extra)

        save_picture(picture, facts)
    return facts.model_dump_json(indent=2) if as_json else report(scene, facts)


def check_picture(path: Path) -> None:
    """LibraryError where matplotlib is missing, ParameterError where ``path`` is no place for a PNG file."""
    if importlib.util.find_spec("matplotlib") is None:
        raise LibraryError("A picture of the stiffness is drawn with matplotlib: pip install 'isogi[report]'.")
    if path.suffix.lower() != ".png" or not path.parent.is_dir():
        raise ParameterError(
            f"{path} is no place for a picture: give a name that ends in .png, in a folder that is there."
        )
