"""Draws the pictures of docs/gallery.md: eight real volumes from the folder ISOGI_SHARED_DATA,
under the default sky.

    .venv/bin/python docs/draw_gallery.py [NAME …]

The store keeps their light, so that drawing them again is quick.
"""

import os
import sys
from pathlib import Path

from isogi_server.cli.render import render, rendered
from isogi_server.settings import Settings

HERE = Path(__file__).parent
SECONDS = 240.0
"""Longest time that one may take; what is not at its target by then is shown as it is."""

VOLUMES = {
    "engine": ("engine_256x256x128_uint8", {"isovalue": "70"}),
    "tooth": ("tooth_103x94x161_uint16", {"isovalue": "700"}),
    "neghip": ("neghip_66x66x66_uint8", {"isovalue": "60"}),
    "bucky": ("bucky_32x32x32_uint8", {"isovalue": "90"}),
    "brain": ("mni152_t1_197x233x189_uint8", {"isovalue": "140"}),
    "fuel": ("fuel_crop_64x33x32_uint8", {"isovalue": "30"}),
    "hydrogen": ("hydrogen3d_64x64x64_float32", {"isovalue": "0.02"}),
    "storm": ("isabel_t30_wind_125x125x25_float32", {"isovalue": "30"}),
}
"""The file, and what is not as usual in its picture."""

ALWAYS = {"width": "480", "height": "360"}


def main(names: list[str]) -> None:
    """Draw the pictures with these names, or all."""
    data = Path(os.environ["ISOGI_SHARED_DATA"])
    for name in names or VOLUMES:
        file, knobs = VOLUMES[name]
        picture = HERE / "gallery" / f"{name}.webp"
        facts = render(str(data / f"{file}.nhdr"), picture, ALWAYS | knobs, Settings(), SECONDS)
        sys.stdout.write(f"{rendered(facts)}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
