"""Draws docs/labels.webp: a segmentation by formula, a shell of four parts around a core, one of
them hidden.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import nrrd
import numpy as np

PICTURE = Path(__file__).with_name("labels.webp")

SIDE = 72

SCENE = """volume = "segmentation.nrrd"
environment = "gallery"
[[labels]]
value = 1
name = "front"
hidden = true
[[labels]]
value = 2
name = "left"
colour = "#e0673d"
[[labels]]
value = 3
name = "right"
colour = "#4fbf78"
[[labels]]
value = 4
name = "foot"
colour = "#6f9be6"
[[labels]]
value = 5
name = "core"
colour = "#e8e2d4"
[[labels]]
value = 6
name = "vessel"
colour = "#d9a93a"
"""
"""The scene; the core is nearly white, so that it shows the light that its shell reflects."""


def segmentation() -> np.ndarray:
    """The labels, (SIDE, SIDE, SIDE) uint8."""
    z, y, x = np.indices((SIDE, SIDE, SIDE)) - 0.5 * (SIDE - 1)
    far = np.sqrt(x**2 + y**2 + z**2)
    part = np.where(z < -14, 4, np.where(x + y > 12, 1, np.where(x > y, 2, 3)))
    labels = np.where((far > 26) & (far < 32), part, 0)
    vessel = np.hypot(np.hypot(x, y) - 19, z) < 2.5
    return np.where(far < 13, 5, np.where(vessel, 6, labels)).astype(np.uint8)


def draw(picture: Path) -> None:
    """Render the scene to a file."""
    with tempfile.TemporaryDirectory() as folder:
        nrrd.write(f"{folder}/segmentation.nrrd", segmentation(), index_order="C")
        scene = Path(folder, "labels.toml")
        scene.write_text(SCENE, encoding="utf-8")
        view = [
            "--azimuth",
            "45",
            "--elevation",
            "22",
            "--distance",
            "2.4",
            "--width",
            "480",
            "--height",
            "360",
        ]
        command = [
            sys.executable,
            "-m",
            "isogi_server",
            "render",
            str(scene),
            "-o",
            str(picture),
            *view,
        ]
        subprocess.run(
            [*command, "--target-error", "0.02", "--store", f"{folder}/store"], check=True
        )


if __name__ == "__main__":
    draw(PICTURE)
