"""Draws docs/front.webp, the first picture of the README: one scan by isogi and by VTK.

    .venv/bin/python docs/draw_front.py

Needs VTK (`pip install '.[bench]'`) and the folder ISOGI_SHARED_DATA. Both show the engine block's
CT scan at one isovalue by one camera on one ground: isogi under the default sky, VTK with Phong
shading and a lamp at the place of the sky's sun, as ParaView and K3D draw surfaces.
"""

import os
import sys
import tempfile
from pathlib import Path

import click
import numpy as np
from PIL import Image

from benchmarks.speed.vtk import use_threads
from isogi_core.plan.assembly import load_scene
from isogi_server.cli.render import render, rendered
from isogi_server.settings import Settings

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from draw_comparison import GROUND, by_vtk, camera_of  # noqa: E402 (beside this file)

VOLUME = "engine_256x256x128_uint8"
KNOBS = {"isovalue": "70", "width": "560", "height": "420"}
SECONDS = 300.0
"""Longest time that isogi's picture may take."""


def main() -> None:
    """Draw both pictures, side by side."""
    target = str(Path(os.environ["ISOGI_SHARED_DATA"]) / f"{VOLUME}.nhdr")
    scene = load_scene(target)
    use_threads(os.cpu_count() or 1)
    phong = by_vtk(scene, camera_of(scene, KNOBS), "phong")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "picture.png"
        facts = render(target, place, {**KNOBS, "background": GROUND}, Settings(), SECONDS)
        click.echo(rendered(facts))
        lit = np.asarray(Image.open(place).convert("RGB"))
    sheet = Image.fromarray(np.concatenate([lit, phong], axis=1))
    sheet.save(HERE / "front.webp", quality=88, method=6)


if __name__ == "__main__":
    main()
