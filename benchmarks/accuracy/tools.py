"""Exports in other tools: what independent readers make of them, and ParaView's picture beside
isogi's.

    python -m benchmarks.accuracy tools [SCENE.toml] [--size 384] [--error 0.03] [--gltf DIR]

`isogi export` writes an isosurface as .glb, .ply and .usdz, and the volume as .vti and .zarr.
trimesh, the validator of glTF (npm's gltf-validator, below DIR), the validators of OpenUSD,
napari's layers (no window) and ParaView's pvpython read them; what is not installed is named.
ParaView contours the volume by `value`, coloured by `colour`; its picture is compared with isogi's
of the same camera as sRGB, in pixels where both show the surface.
"""

import importlib.util
import io
import json
import os
import shutil
import subprocess
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np
from PIL import Image

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import shared_data
from benchmarks.common.suite import part
from benchmarks.speed.film import isogi
from isogi_core.files.grid import srgb_bytes
from isogi_core.plan.assembly import load_scene
from isogi_server.cli.setting_options import settings_from
from isogi_server.parameters import FrameParams, read
from isogi_server.views import view_of

VIEW = {"azimuth": "30", "elevation": "20", "distance": "3", "fov": "30"}
KINDS = ("glb", "ply", "usdz", "vti", "zarr")
VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then(({ issues }) => console.log(JSON.stringify(issues)));
"""


def small_scene(folder: Path) -> str:
    """A small volume of the shared data in the light of a street, which stays where it is; a demo
    without them.
    """
    data = shared_data()
    if data is None:
        return "demo:orbital"
    light = f'[[lights]]\ntype = "probe"\nfile = "{data / "probe_uffizi_256x128.hdr"}"\n'
    volume = f'volume = "{data / "neghip_66x66x66_uint8.nhdr"}"\nisovalue = 60\nrotating = false\n'
    (folder / "neghip.toml").write_text(volume + light, encoding="utf-8")
    return str(folder / "neghip.toml")


def exported(scene: str, folder: Path, error: float) -> dict[str, Any]:
    """Write a file of each kind; how long that takes, and what is in them."""
    figures: dict[str, Any] = {}
    for kind in KINDS:
        output = folder / f"lit.{kind}"
        seconds, facts = isogi(
            "export",
            scene,
            "-o",
            output,
            "--store",
            folder / "light",
            "--target-error",
            error,
            "--workers",
            2,
        )
        figures |= {f"{kind}: seconds": seconds, f"{kind}: MB": facts["bytes"] / 1e6}
    return figures | {"final light": facts["final"]}


def meshes(folder: Path, gltf: Path | None) -> dict[str, Any]:
    """What trimesh and the validators find."""
    figures: dict[str, Any] = {}
    if importlib.util.find_spec("trimesh"):
        trimesh = import_module("trimesh")
        glb, ply = (
            trimesh.load(folder / f"lit.{kind}", process=False, force="mesh")
            for kind in ("glb", "ply")
        )
        figures["trimesh: vertices of .glb"] = len(glb.vertices)
        figures["trimesh: .ply encloses, voxels"] = float(ply.volume)
        place = np.abs(glb.vertices[:, [0, 2, 1]] * (1, -1, 1) - ply.vertices).max()
        figures["trimesh: .glb and .ply apart at most, voxels"] = float(place)
        figures["trimesh: colours of .ply"] = len(
            np.unique(np.asarray(ply.visual.vertex_colors), axis=0)
        )
    if gltf is not None and shutil.which("node"):
        command = ["node", "-e", VALIDATE, str(folder / "lit.glb")]
        told = subprocess.run(command, cwd=gltf, capture_output=True, text=True, check=True).stdout
        counts = {"numErrors": "errors", "numWarnings": "warnings"}
        figures |= {
            f"gltf-validator: {what}": json.loads(told)[key] for key, what in counts.items()
        }
    if importlib.util.find_spec("pxr"):
        validation = import_module("pxr.UsdValidation")
        usd = import_module("pxr.Usd")
        every = validation.ValidationRegistry().GetOrLoadAllValidators()
        found = validation.ValidationContext(every).Validate(
            usd.Stage.Open(str(folder / "lit.usdz"))
        )
        figures |= {"OpenUSD: validators": len(every), "OpenUSD: findings": len(found)}
    return figures


def layers(folder: Path) -> dict[str, Any]:
    """What napari's layers hold, without a window."""
    if not (importlib.util.find_spec("napari") and importlib.util.find_spec("trimesh")):
        return {"napari": "not installed"}
    model, trimesh, zarr = (
        import_module(name) for name in ("napari.components", "trimesh", "zarr")
    )
    viewer = model.ViewerModel()
    mesh = trimesh.load(folder / "lit.ply", process=False)
    colours = np.asarray(mesh.visual.vertex_colors) / 255.0
    surface = viewer.add_surface((mesh.vertices, mesh.faces), vertex_colors=colours)
    image = viewer.add_image(zarr.open_array(folder / "lit.zarr" / "0", mode="r"), channel_axis=0)
    return {
        "napari: vertices of the surface": len(surface.vertices),
        "napari: channels of the volume": len(image),
        "napari: voxels of a channel": " × ".join(map(str, image[0].data.shape)),
    }


def paraview(asked: str) -> int:
    """Have ParaView draw a picture, on a screen that nobody sees and by its own Python; the
    contour's points.
    """
    script = str(Path(__file__).with_name("paraview_view.py"))
    command = ["xvfb-run", "-a", "pvpython", "--force-offscreen-rendering", script, asked]
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, env=own, capture_output=True, text=True, check=False)
    if done.returncode:
        raise click.ClickException(
            f"pvpython ended with {done.returncode}: {done.stderr.strip()[-200:]}"
        )
    return int(done.stdout.split()[-1])


def beside_paraview(
    scene: str, folder: Path, size: int, error: float
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """ParaView's picture of the volume beside isogi's: figures, and both pictures as one."""
    if shutil.which("pvpython") is None or shutil.which("xvfb-run") is None:
        return {"ParaView": "pvpython or xvfb-run is not installed"}, {}
    loaded = load_scene(scene, rotating=False)
    side = {"width": str(size), "height": str(size)}
    camera = view_of(loaded, read(FrameParams, {**VIEW, **side}.items()), settings_from()).camera
    knobs = [text for name, value in {**VIEW, **side}.items() for text in (f"--{name}", value)]
    common = ("--store", folder / "light", "--target-error", error, "--workers", 2)
    isogi("render", scene, "-o", folder / "own.npy", *knobs, *common)
    own = np.load(folder / "own.npy")
    place = {"eye": camera.eye, "target": camera.target, "up": camera.up, "fov": camera.fov}
    asked = {"file": str(folder / "lit.vti"), "isovalue": loaded.isovalue, **place, "size": size}
    points = paraview(json.dumps({**asked, "out": str(folder / "pv.png")}))
    theirs = np.asarray(Image.open(folder / "pv.png").convert("RGB"))
    ours = srgb_bytes(loaded.default_exposure * own[..., :3])
    both = (own[..., 3] > 0) & (theirs.max(axis=-1) > 0)
    apart = (ours[both].astype(float) - theirs[both]) / 255.0
    outline = ((own[..., 3] > 0) != (theirs.max(axis=-1) > 0)).mean()
    figures = {
        "ParaView: points of the contour": points,
        "ParaView: sRGB RMSE, of 1": float(np.sqrt((apart**2).mean())),
        "ParaView: mean difference, of 1": float(apart.mean()),
        "ParaView: pixels of the picture that one alone shows": float(outline),
    }
    picture = io.BytesIO()
    Image.fromarray(np.concatenate([np.where(own[..., 3:4] > 0, ours, 0), theirs], axis=1)).save(
        picture, "png"
    )
    return figures, {"beside.png": picture.getvalue()}


@part(size=384)
@click.argument("target", required=False)
@click.option(
    "--error", default=0.03, show_default=True, help="Relative error at which light is final."
)
@click.option(
    "--gltf",
    type=click.Path(path_type=Path, exists=True),
    help="Folder with node_modules/gltf-validator.",
)
def tools(target: str | None, size: int, error: float, gltf: Path | None) -> Measurement:
    """Exports in other tools: what their readers find, and ParaView's picture beside isogi's."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = target or small_scene(folder)
        figures = exported(scene, folder, error) | meshes(folder, gltf) | layers(folder)
        pictures, drawn = beside_paraview(scene, folder, size, error)
    title = f"Exports of {Path(scene).stem} in other tools"
    found = Measurement(title, figures | pictures)
    if not drawn:
        return found
    text = (
        f"{found.body}\n\n![isogi's picture, and ParaView's of the exported "
        "volume](accuracy-tools/beside.png)"
    )
    return Measurement(title, figures | pictures, text, drawn)
