"""Draws the pictures of docs/scenes.md: scenes on real volumes from the folder ISOGI_SHARED_DATA.

    .venv/bin/python docs/draw_scenes.py [NAME …]

The store keeps their light, so that drawing them again is quick.
"""

import os
import sys
import tempfile
import tomllib
from pathlib import Path

from isogi_server.cli.render import render, rendered
from isogi_server.settings import Settings

HERE = Path(__file__).parent / "scenes"
SECONDS = 240.0
"""Longest time that one may take; what is not at its target by then is shown as it is."""

SCENES = ("medical", "molecular", "microscopy", "nuclear")

ALWAYS = {"width": "360", "height": "320", "max_error": "0.05"}


def find_volume(data: Path, scene: Path) -> Path:
    """The volume of a ``scene``, which its file names without a folder, somewhere in the folder
    ``data``.
    """
    return next(data.rglob(tomllib.loads(scene.read_text())["volume"]))


def main(names: list[str]) -> None:
    """Draw the pictures with these names, or all."""
    data = Path(os.environ["ISOGI_SHARED_DATA"]).resolve()
    for name in names or SCENES:
        scene = HERE / f"{name}.toml"
        volume = find_volume(data, scene)
        with tempfile.TemporaryDirectory() as folder:
            beside = Path(folder) / scene.name
            beside.write_text(scene.read_text().replace(f'"{volume.name}"', f'"{volume}"'))
            facts = render(str(beside), HERE / f"{name}.webp", ALWAYS, Settings(), SECONDS)
        sys.stdout.write(f"{rendered(facts)}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
