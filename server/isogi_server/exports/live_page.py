"""A page that draws a scene itself, as static files: HTML, volume, and light of a range of
isovalues; or all of it as one file.
"""

import json
import zlib
from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from isogi_core.bake.noise import Goal
from isogi_core.frame.card.blocks import CHUNKS, coded_chunks
from isogi_core.frame.card.coded_light import join_light, light_file
from isogi_core.frame.card.coded_voxels import voxels_file
from isogi_core.frame.card.coding import Coding
from isogi_core.frame.card.colour_codes import ColourCodes
from isogi_core.frame.card.looks import seen_chunks
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.prepared.active_cell_maps import IdleVoxels
from isogi_core.storage.atomic_file import write_whole
from isogi_server.answers import camera_schema, card_scene, scene_schema
from isogi_server.card_schemas import CardSlab
from isogi_server.exports.page_files import WEB_FOLDER, compressed, joined_modules, shaders
from isogi_server.parameters import FrameParams
from isogi_server.pictures import encode
from isogi_server.schemas import CameraSchema, Histogram, Range, SceneSchema
from isogi_server.settings import Settings
from isogi_server.views import view_of

FIRST_PAGE_MODULE = "published/published.js"
"""The first module of the page."""

FOLDERS = ("light", "volume", "colours")
"""Folders of a page's files: light of texels, voxels, and colours by data."""

COARSE_LIGHT = "light/coarse.bin"
"""The file with the light of bricks, which stands in until that of texels is there."""

PAGE = "index.html"
"""The HTML file in a folder."""

ASPECTS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.4, 1.7, 2.0)
"""Aspect ratios (width over height) for which the first camera is fitted: it also sees the
whole surface in wider windows.
"""

FIT_SIDE = 1000
"""Pixels of the shorter side of the pictures for which the camera is fitted."""

POSTER_SIDE = 512
"""Pixels along each side of the picture that is shown until the card draws."""

START_PARAMETERS = {"distance", "target", "fov", "yaw", "pitch", "roll", "exposure"}
"""Parameters of a view with which the page starts as they are given."""


@dataclass(frozen=True)
class Span:
    """A range of isovalues, in the units of the volume's file."""

    low: float
    high: float


def page_of(
    document: Mapping[str, Any], poster: bytes, enclosed: Mapping[str, bytes] | None = None
) -> bytes:
    """Return the HTML of the page with its script, its shaders, its ``document`` and a
    ``poster``, a WebP picture that is shown until it draws. It loads no other file if all are
    ``enclosed``.
    """
    parts = {
        "page.js": compressed(joined_modules(FIRST_PAGE_MODULE).encode()),
        "shaders.json": compressed(json_file(shaders())),
        "scene.json": compressed(json_file(document)),
        **(enclosed or {}),
    }
    text = (WEB_FOLDER / "published" / "index.html").read_text(encoding="utf-8")
    picture = f"data:image/webp;base64,{b64encode(poster).decode()}"
    return text.replace("{POSTER}", picture).replace("{FILES}", "".join(elements(parts))).encode()


def elements(files: Mapping[str, bytes]) -> Iterator[str]:
    """Yield files as elements of a page, encoded in base64."""
    for name, content in files.items():
        letters = b64encode(content).decode()
        yield f'<script type="text/plain" data-file="{name}">{letters}</script>\n'


def volume_files(renderer: Renderer, span: Span) -> dict[str, bytes]:
    """Return the files of the volume, by name: each slab of its voxels, in few bytes.

    Voxels that no isosurface in the ``span`` needs are made alike, so that they take hardly any
    bytes: all below the span get one value, all above it another, see ``IdleVoxels``.
    """
    codes = renderer.prepared.voxel_codes
    volume = renderer.prepared.scene.volume
    voxels = IdleVoxels(volume.voxels, *volume.normalise_span(span.low, span.high))
    files = {}
    for a, b in codes.slabs:
        layers = voxels.flattened(a, b)
        needed = voxels.needed(a, b) | np.isnan(layers)
        files[slab_name(a, b)] = compressed(
            voxels_file(codes.code(layers), needed), zlib.Z_FILTERED
        )
    return files


def colour_files(renderer: Renderer, span: Span) -> dict[str, bytes]:
    """Return the codes of colours by data that isosurfaces in the ``span`` show, slab by slab; none
    if the scene has no colours.
    """
    found = ColourCodes.of(renderer.prepared.scene, (span.low, span.high))
    if found is None:
        return {}
    return {
        slab_name(a, b, "colours"): compressed(found.layers(a, b).tobytes()) for a, b in found.slabs
    }


def slab_name(first: int, last: int, folder: str = "volume") -> str:
    """Return the file name of a range of layers."""
    return f"{folder}/{first}-{last}.bin"


def light_files(
    renderer: Renderer, span: Span, codings: tuple[Coding, Coding], goal: Goal, first: View
) -> dict[str, bytes]:
    """Return the transfer of all texels that isosurfaces in the ``span`` read, in few bits by the
    first of two ``codings``, and before it COARSE_LIGHT, the means of their bricks by the second.

    Texels of the ``first`` view come in the first files. Transfer is filtered if its noise exceeds
    the error of the ``goal``. Raises StoreError and Cancelled.
    """
    prepared = renderer.prepared
    volume = renderer.prepared.scene.volume
    ends = volume.normalise_span(span.low, span.high)
    texels = surface_texels(volume.voxels, prepared.shape, prepared.lattice.chunk, [ends])
    # Order chunks by their visibility in the first view, so that the page is lit soon.
    seen = [each.at for each in seen_chunks(renderer, first, goal, renderer.tiles)]
    places = {at: place for place, at in enumerate(seen)}
    chunks = sorted((index for index, _ in texels), key=lambda at: places.get(at, len(seen)))
    files = {}
    means = []
    for number, start in enumerate(range(0, len(chunks), CHUNKS)):
        some = chunks[start : start + CHUNKS]
        fine, coarse = coded_chunks(renderer, some, goal, codings, renderer.tiles)
        means.append(coarse)
        files[f"light/{number}.bin"] = compressed(light_file(fine), zlib.Z_FILTERED)
    coarse_light = compressed(light_file(join_light(means)), zlib.Z_FILTERED)
    return {COARSE_LIGHT: coarse_light, **files}


def first_view(
    renderer: Renderer, params: FrameParams, start: Mapping[str, Any], settings: Settings
) -> View:
    """Return the view with which a page starts, as a square picture."""
    camera = {name: start[name] for name in ("azimuth", "elevation", "distance")}
    camera["target"] = tuple(start["target"])
    size = {"width": POSTER_SIDE, "height": POSTER_SIDE, "antialias": "on"}
    return view_of(renderer.prepared.scene, params.model_copy(update={**camera, **size}), settings)


def poster_of(renderer: Renderer, params: FrameParams, view: View, goal: Goal) -> bytes:
    """Return a WebP picture of the first ``view`` with a transparent background and this ``goal``,
    by the light that the page has. Raises StoreError and Cancelled.
    """
    frame = renderer.render(view, goal)
    exposure = params.exposure or renderer.prepared.scene.default_exposure
    return encode(frame, "webp", exposure, params.model_copy(update={"background": "transparent"}))


def document_of(renderer: Renderer, params: FrameParams, view: View, span: Span) -> dict[str, Any]:
    """Return the document of a page without its key ``light``, which the caller adds: the scene,
    and what the card needs besides voxels and texels.

    Voxels are named by their files; links and limits of a server are left out. The ``span`` is in
    the file's units.
    """
    # Links carry no query, as there is no server.
    card = card_scene(renderer, view, ())
    slabs = [
        CardSlab(first=a, last=b, href=slab_name(a, b))
        for a, b in renderer.prepared.voxel_codes.slabs
    ]
    # Pages of scenes that show shine are refused, and no slider of a page makes others shine.
    parts: dict[str, BaseModel | None] = {
        "volume": card.volume.model_copy(update={"slabs": slabs}),
        "shine": None,
    }
    if colours := card.colours:
        named = [
            each.model_copy(update={"href": slab_name(each.first, each.last, "colours")})
            for each in colours.slabs
        ]
        parts["colours"] = colours.model_copy(update={"slabs": named})
    own = card.model_copy(update=parts).model_dump(mode="json", exclude={"links", "limits"})
    return {"scene": scene_of(renderer, params, view, span), "card": own}


def scene_of(renderer: Renderer, params: FrameParams, view: View, span: Span) -> dict[str, Any]:
    """Return the document of the scene, reduced to what the page can draw: one albedo and one
    shading.

    ``start`` holds the parameters that the page starts with: a camera that sees the whole surface,
    and given parameters.
    """
    schema: SceneSchema = scene_schema(renderer.prepared.scene)
    schema.ranges["isovalue"] = Range(min=span.low, max=span.high)
    schema.histogram = histogram_between(schema.histogram, span)
    schema.shadings = ["gi"]
    schema.environments = []
    schema.albedos = None
    schema.cuts = False
    schema.stops = [stop for stop in schema.stops if span.low <= stop <= span.high]
    # A camera that is placed is not fitted.
    placed = params.model_fields_set
    azimuth, elevation = (
        getattr(params, name) if name in placed else None for name in ("azimuth", "elevation")
    )
    camera = camera_schema(renderer, view, azimuth, elevation, params.projection)
    if params.projection:
        schema.defaults |= {"projection": params.projection}
    given = params.model_dump(mode="json", include=placed & START_PARAMETERS, exclude_none=True)
    start = {**camera.model_dump(mode="json"), "isovalue": view.isovalue, **given}
    if placed & {"distance", "target"}:
        fits = []
    else:
        fits = fits_of(renderer, params, view, camera)
    return {**schema.model_dump(mode="json"), "start": start, "fits": fits}


def histogram_between(histogram: Histogram, span: Span) -> Histogram:
    """Return a histogram in which each bin that is not wholly within ``span`` has the count 0: on
    the page, most voxels beyond the span have one value on each side, see ``volume_files``.
    """
    edges = histogram.edges
    counts = [
        count if span.low <= low and high <= span.high else 0
        for count, low, high in zip(histogram.counts, edges[:-1], edges[1:], strict=True)
    ]
    return Histogram(counts=counts, edges=edges, logarithmic=histogram.logarithmic)


def fits_of(
    renderer: Renderer, params: FrameParams, view: View, first: CameraSchema
) -> list[dict[str, Any]]:
    """Return distance and target of the ``first`` camera for each of ASPECTS, narrow windows
    first.
    """
    fits = []
    for aspect in ASPECTS:
        # The shorter side has FIT_SIDE pixels.
        width, height = round(FIT_SIDE * max(aspect, 1.0)), round(FIT_SIDE / min(aspect, 1.0))
        camera = camera_schema(
            renderer,
            replace(view, width=width, height=height),
            first.azimuth,
            first.elevation,
            params.projection,
        )
        place = camera.model_dump(mode="json", include={"distance", "target"})
        fits.append({"aspect": aspect, **place})
    return fits


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the ``files`` of a page, by their relative names, into a ``folder``; then delete each
    ``.bin`` file in its FOLDERS that the page does not name, as it is of a former page.

    Raises OSError.
    """
    # Write the page last: all files that it names are there as soon as it can be read. A former
    # page that is still loading may read new files of the same names.
    for name in sorted(files, key=lambda each: each == PAGE):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / name, files[name])
    # Delete old files after the page that named them was replaced.
    for old in (path for part in FOLDERS for path in (folder / part).glob("*.bin")):
        if old.relative_to(folder).as_posix() not in files:
            old.unlink()


def json_file(document: Mapping[str, Any]) -> bytes:
    """Encode a document as JSON."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
