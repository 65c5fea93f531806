"""Draws docs/gallery/beside.webp: the volumes of the gallery by isogi, VTK (shadow map; SSAO) and
Mitsuba.

    .venv/bin/python docs/draw_comparison.py [NAME …] [--samples 64] [--variant scalar_rgb]

Needs VTK and Mitsuba (`pip install '.[bench]'`), the folder ISOGI_SHARED_DATA, and a graphics
library that VTK can draw with off the screen. All four have one mesh or field, one camera, one
albedo and one ground. isogi and Mitsuba have the default sky; VTK has a lamp where its sun is, and
ambient light. VTK's and Mitsuba's pictures are drawn without further settings, Mitsuba's at so many
samples a pixel.
"""

import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from PIL import Image, ImageDraw

from benchmarks.common.mitsuba import PathTracer
from benchmarks.speed.vtk import Edges, Window, image, use_threads
from isogi_core.frame.film import LEVELS, ground_of, tone_table
from isogi_core.model.environment import sun_direction
from isogi_core.model.lights import SkyLight
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_report.speed import make_renderer
from isogi_server.answers import camera_schema
from isogi_server.cli.render import render, rendered
from isogi_server.parameters import FrameParams, read
from isogi_server.settings import Settings
from isogi_server.views import view_of

sys.path.insert(0, str(Path(__file__).parent))

from draw_gallery import SECONDS, VOLUMES

WIDTH = 300
HEIGHT = 225
HEADS = ("isogi", "VTK, shadow map", "VTK, SSAO", "Mitsuba, {samples} samples a pixel")
MARGIN = 22
"""Pixels of the line of words above the pictures."""

GROUND = "light"


def camera_of(scene: Scene, knobs: dict[str, str]) -> View:
    """The view of a gallery's picture: the camera that fits its surface."""
    size = {"width": str(WIDTH), "height": str(HEIGHT)}
    params = read(FrameParams, {**size, **knobs}.items())
    with tempfile.TemporaryDirectory() as store:
        fit = camera_schema(
            make_renderer(scene, store), view_of(scene, params, Settings()), None, None
        )
    return view_of(scene, params.model_copy(update=fit.model_dump()), Settings())


def by_isogi(target: str, knobs: dict[str, str]) -> np.ndarray:
    """isogi's picture at its target error."""
    size = {"width": str(WIDTH), "height": str(HEIGHT), "background": GROUND}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "picture.png"
        click.echo(rendered(render(target, place, {**size, **knobs}, Settings(), SECONDS)))
        return np.asarray(Image.open(place).convert("RGB"))


def by_vtk(scene: Scene, view: View, by: str) -> np.ndarray:
    """VTK's picture by one of its passes, on the same ground."""
    sun = SkyLight()
    x, y, z = sun_direction(sun).tolist()
    window = Window(image(scene.volume), view, (x, y, z), by)
    window.renderer.SetBackground(*(int(GREY[i : i + 2], 16) / 255.0 for i in (0, 2, 4)))
    return window.picture(view.isovalue).copy()


GREY = "cbced1"
"""The light ground, sRGB."""


def by_mitsuba(scene: Scene, view: View, samples: int, variant: str) -> np.ndarray:
    """Mitsuba's picture of the mesh of flying edges in the scene's sky."""
    mesh = Edges(image(scene.volume), normals=False).mesh(view.isovalue)
    sky = scene.lighting.environment.constant + scene.lighting.environment.image
    tracer = PathTracer(
        variant, mesh, view, scene.surfaces.albedo[0], scene.bounces + 2, sky, "multijitter"
    )
    picture = tracer.picture(samples, os.cpu_count() or 1)
    light = picture[..., :3] * scene.default_exposure
    cover = picture[..., 3:]
    shown = np.clip(light, 0.0, 1.0) + (1.0 - np.clip(cover, 0.0, 1.0)) * np.array(
        ground_of(GROUND)
    )
    return tone_table()[(np.clip(shown, 0.0, 1.0) * (LEVELS - 1) + 0.5).astype(np.intp)]


def row(name: str, samples: int, variant: str) -> np.ndarray:
    """The four pictures of one volume, side by side."""
    file, knobs = VOLUMES[name]
    target = str(Path(os.environ["ISOGI_SHARED_DATA"]) / f"{file}.nhdr")
    scene = load_scene(target)
    view = replace(camera_of(scene, knobs))
    mine = by_isogi(target, knobs)
    others = [by_vtk(scene, view, by) for by in ("shadow map", "ssao")]
    return np.concatenate([mine, *others, by_mitsuba(scene, view, samples, variant)], axis=1)


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(list(VOLUMES)))
@click.option("--samples", default=64, help="Mitsuba's paths of each pixel.")
@click.option(
    "--variant",
    default="scalar_rgb",
    help="Of Mitsuba; llvm_ad_rgb is faster, and needs LLVM's library.",
)
@click.option(
    "-o", "--output", default=Path(__file__).parent / "gallery" / "beside.webp", type=Path
)
def main(names: tuple[str, ...], samples: int, variant: str, output: Path) -> None:
    """Draw the contact sheet of these volumes, or of all."""
    use_threads(os.cpu_count() or 1)
    sheet = Image.fromarray(
        np.concatenate([row(name, samples, variant) for name in names or VOLUMES])
    )
    whole = Image.new("RGB", (sheet.width, sheet.height + MARGIN), "#ffffff")
    whole.paste(sheet, (0, MARGIN))
    for column, head in enumerate(HEADS):
        ImageDraw.Draw(whole).text((column * WIDTH + 8, 5), head.format(samples=samples), "#333333")
    whole.save(output, quality=86, method=6)


if __name__ == "__main__":
    main()
