"""A page that draws a scene by itself, as static files: its modules, the volume, and light of a
range of isovalues.
"""

import gzip
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from isogi_core.frame.card.blocks import CHUNKS, Coding, coded_chunks
from isogi_core.frame.renderer import Renderer
from isogi_core.model.view import View
from isogi_core.plan.reachable_texels import surface_texels
from isogi_core.prepared.active_cell_maps import IdleVoxels
from isogi_core.storage.atomic_file import write_whole
from server.answers import camera_schema, card_scene, scene_schema
from server.card_schemas import CardSlab
from server.parameters import FrameParams
from server.schemas import Histogram, Range, SceneSchema

WEB_FOLDER = Path(__file__).resolve().parents[2] / "web"
FIRST_PAGE_MODULE = "published/published.js"
"""The page's first module."""

START_PARAMETERS = {"distance", "target", "fov", "yaw", "pitch", "roll", "exposure"}
"""Parameters of a view that the page starts with as they are given."""

MODULE_IMPORT = re.compile(r'^(?:import|export) [^;]*?from "(\.[^"]+)";$', re.MULTILINE)
"""What a module imports, as the page's modules write it."""


@dataclass(frozen=True)
class Span:
    """A range of isovalues, in the units of the volume's file."""

    low: float
    high: float


def page_files() -> dict[str, bytes]:
    """The page and all its modules, by their places in the folder."""
    names = {FIRST_PAGE_MODULE}
    waiting = [FIRST_PAGE_MODULE]
    while waiting:
        name = waiting.pop()
        found = {
            (WEB_FOLDER / name).parent.joinpath(path).resolve().relative_to(WEB_FOLDER).as_posix()
            for path in imports(name)
        }
        waiting += found - names
        names |= found
    names |= {f"card/shaders/{path.name}" for path in (WEB_FOLDER / "card" / "shaders").iterdir()}
    page = {"index.html": (WEB_FOLDER / "published" / "index.html").read_bytes()}
    return page | {f"web/{name}": (WEB_FOLDER / name).read_bytes() for name in sorted(names)}


def imports(name: str) -> list[str]:
    """The modules that a module of the page imports, as it names them."""
    return MODULE_IMPORT.findall((WEB_FOLDER / name).read_text(encoding="utf-8"))


def compressed(content: bytes) -> bytes:
    """A file in gzip's form, which pages unpack themselves: plain servers hand it out as it is."""
    return gzip.compress(content, 9, mtime=0)


def volume_files(renderer: Renderer, span: Span) -> dict[str, bytes]:
    """The codes of the volume's voxels, slab by slab, those alike that no isosurface of the
    ``span`` is drawn by.
    """
    codes = renderer.prepared.voxel_codes
    volume = renderer.prepared.scene.volume
    voxels = IdleVoxels(volume.voxels, *volume.normalise_span(span.low, span.high))
    slabs = (
        (slab_name(a, b), codes.code(voxels.flattened(a, b)).tobytes()) for a, b in codes.slabs
    )
    return {name: compressed(content) for name, content in slabs}


def slab_name(first: int, last: int) -> str:
    """The file of some layers of voxels."""
    return f"volume/{first}-{last}.bin"


def light_files(renderer: Renderer, span: Span, coding: Coding, target: float) -> dict[str, bytes]:
    """The transfer of all texels of isosurfaces in the ``span``, in few bits.

    It is filtered where it is noisier than a ``target`` error. Raises StoreError.
    """
    prepared = renderer.prepared
    volume = renderer.prepared.scene.volume
    ends = volume.normalise_span(span.low, span.high)
    texels = surface_texels(volume.voxels, prepared.shape, prepared.lattice.chunk, [ends])
    chunks = [index for index, _ in texels]
    files = {}
    for first in range(0, len(chunks), CHUNKS):
        blocks = coded_chunks(
            renderer, chunks[first : first + CHUNKS], target, coding, renderer.tiles
        )
        files[f"light/{first // CHUNKS}.bin"] = compressed(b"".join(blocks))
    return files


def document_of(renderer: Renderer, params: FrameParams, view: View, span: Span) -> dict[str, Any]:
    """What the page draws by besides light: the scene, and what its card needs."""
    card = card_scene(renderer, view, ())
    slabs = [
        CardSlab(first=a, last=b, href=slab_name(a, b))
        for a, b in renderer.prepared.voxel_codes.slabs
    ]
    volume = card.volume.model_copy(update={"slabs": slabs})
    own = card.model_copy(update={"volume": volume}).model_dump(
        mode="json", exclude={"links", "limits"}
    )
    return {"scene": scene_of(renderer, params, view, span), "card": own}


def scene_of(renderer: Renderer, params: FrameParams, view: View, span: Span) -> dict[str, Any]:
    """The scene as its document has it on a server, for what the page can draw: one albedo, and one
    shading.

    Its ``start`` has the knobs that the page starts with: a camera that sees the surface whole, and
    what was given.
    """
    schema: SceneSchema = scene_schema(renderer.prepared.scene)
    schema.ranges["isovalue"] = Range(min=span.low, max=span.high)
    schema.histogram = histogram_between(schema.histogram, span)
    schema.shadings = ["gi"]
    schema.environments = []
    schema.albedos = None
    schema.cuts = False
    schema.stops = [stop for stop in schema.stops if span.low <= stop <= span.high]
    placed = params.model_fields_set
    azimuth, elevation = (
        getattr(params, name) if name in placed else None for name in ("azimuth", "elevation")
    )
    camera = camera_schema(renderer, view, azimuth, elevation, params.projection)
    if params.projection:
        schema.defaults |= {"projection": params.projection}
    given = params.model_dump(mode="json", include=placed & START_PARAMETERS, exclude_none=True)
    start = {**camera.model_dump(mode="json"), "isovalue": view.isovalue, **given}
    return {**schema.model_dump(mode="json"), "start": start}


def histogram_between(histogram: Histogram, span: Span) -> Histogram:
    """A histogram with the bins alone that lie in a ``span``: voxels of the page beyond are
    alike.
    """
    edges = histogram.edges
    counts = [
        count if span.low <= low and high <= span.high else 0
        for count, low, high in zip(histogram.counts, edges[:-1], edges[1:], strict=True)
    ]
    return Histogram(counts=counts, edges=edges)


def write_files(folder: Path, files: Mapping[str, bytes]) -> int:
    """Write files into a folder, the page last; their bytes. Light and voxels of a page before go.
    Raises OSError.
    """
    for name in sorted(files, key=lambda each: each == "index.html"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / name, files[name])
    for old in (path for room in ("light", "volume") for path in (folder / room).glob("*.bin")):
        if old.relative_to(folder).as_posix() not in files:
            old.unlink()
    return sum(map(len, files.values()))


def json_file(document: Mapping[str, Any]) -> bytes:
    """A document as a file."""
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
