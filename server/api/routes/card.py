"""What a page needs to draw by itself, on its visitor's graphics card: the scene, voxels, and light
of chunks.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from fastapi import APIRouter, Request, Response

from isogi_core.frame.card.blocks import known_light, known_transfer
from isogi_core.frame.card.looks import Look, SeenChunk, look_at
from isogi_core.frame.known_blocks import Packed, Part
from isogi_core.frame.renderer import Renderer
from isogi_core.plan.scene import Scene
from server.answers import card_schema, chunk_list, voxel_version
from server.api.headers import FOR_EVER, matches, tag_of, takes_gzip
from server.api.service import PictureRequest, SceneDep, Service, ServiceDep
from server.bearers import client_of
from server.card_schemas import CardChunks, CardSchema
from server.errors import ForbiddenError, ParameterError
from server.parameters import (
    ChunkName,
    FoldParams,
    FoldParamsDep,
    TransferParams,
    TransferParamsDep,
    VariantParams,
    ViewParams,
    ViewParamsDep,
    VoxelParams,
    VoxelParamsDep,
    chunk_names,
    documented,
    layers_of,
)
from server.problems import documented_problems
from server.render.bakes import request_viewer

MEDIA_TYPE = "application/octet-stream"
BINARY: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The bytes, little-endian; docs/card.md has their layout.",
        "content": {MEDIA_TYPE: {}},
    },
    304: {"description": "The bytes are those that If-None-Match names."},
}

GZIP = b"\x1f\x8b\x08" + bytes(5) + b"\x04\xff"
"""What data in gzip begin with (RFC 1952): compressed fast, at no time, by nobody in particular."""

END = b"\x03\x00"
"""An empty last block of DEFLATE."""


def binary_answer(request: Request, parts: Sequence[Part], lasting: bool) -> Response:
    """The answer of some ``parts``: at the address of the request it is the same for ever where it
    is ``lasting``.
    """
    packs = takes_gzip(request.headers.get("accept-encoding", ""))
    tag = tag_of(hashlib.blake2b(b"".join(each.digest for each in parts)).digest(), packs)
    headers = {
        "ETag": tag,
        "Cache-Control": FOR_EVER if lasting else "no-cache",
        "Vary": "Accept-Encoding",
    }
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    if not packs:
        return Response(b"".join(each.data for each in parts), 200, headers, MEDIA_TYPE)
    return Response(gzipped(parts), 200, headers | {"Content-Encoding": "gzip"}, MEDIA_TYPE)


def gzipped(parts: Sequence[Part]) -> bytes:
    """The ``parts`` as one member of gzip; each is compressed once, for all answers that it is
    in.
    """
    check = 0
    size = sum(len(each.data) for each in parts)
    for each in parts:
        check = zlib.crc32(each.data, check)
    ends = (number.to_bytes(4, "little") for number in (check, size & 0xFFFFFFFF))
    return b"".join((GZIP, *(each.deflated for each in parts), END, *ends))


router = APIRouter(prefix="/v1/scenes/{scene}/card", tags=["card"])
PROBLEMS = documented_problems(403, 404, 422, 429, 503)
DOCUMENT: dict[int | str, dict[str, Any]] = {
    200: {"model": CardSchema},
    304: {"description": "The document is the one that If-None-Match names."},
}
PARTS = BINARY | PROBLEMS
VOXELS_WITHHELD = (
    "This server hands out no voxels, and no light of chunks: ask for pictures, "
    "or have hand_out_voxels set."
)


@router.get(
    "", response_class=Response, openapi_extra=documented(ViewParams), responses=DOCUMENT | PROBLEMS
)
async def read_card(
    request: Request, scene: SceneDep, params: ViewParamsDep, service: ServiceDep
) -> Response:
    """Whether a page may draw a view by itself, and all that this takes besides voxels and texels.

    Nothing in it changes with the light's turn, but ``lambert``; nor with the camera.
    """
    lit = await service.variant(scene, params, client_of(request.scope))
    picture = service.picture_of(lit, params)
    query = [
        pair for pair in request.query_params.multi_items() if pair[0] in VariantParams.model_fields
    ]

    def work() -> CardSchema:
        return card_schema(
            service.engine.renderer(lit.id), picture.view, query, service.settings.hands_out_voxels
        )

    document = await service.compute(request, work)
    tag = tag_of(document.model_dump_json())
    headers = {"ETag": tag, "Cache-Control": "no-cache"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    named = document.model_copy(update={"version": tag.strip('"')})
    return Response(named.model_dump_json(), 200, headers, "application/json")


@router.get(
    "/volume/{layers}",
    response_class=Response,
    openapi_extra=documented(VoxelParams),
    responses=PARTS,
)
async def read_voxels(
    request: Request, scene: SceneDep, layers: str, params: VoxelParamsDep, service: ServiceDep
) -> Response:
    """Codes of voxels in some layers along z, x fastest; the document says what they stand for."""
    shown = await open_scene(request, service, scene, params)

    def work() -> Response:
        prepared = service.engine.renderer(shown.id).prepared
        codes = prepared.voxel_codes
        first, last = layers_of(layers, codes.shape[0], max(b - a for a, b in codes.slabs))
        body = codes.code(shown.volume.voxels[first:last]).tobytes()
        return binary_answer(request, [Part(body)], params.version == voxel_version(shown))

    return await service.compute(request, work)


@router.get(
    "/chunks", response_model=CardChunks, openapi_extra=documented(ViewParams), responses=PROBLEMS
)
async def read_chunks(
    request: Request, scene: SceneDep, params: ViewParamsDep, service: ServiceDep
) -> Response:
    """The chunks of texels that a view reads, most visible first; the light that it lacks is
    requested.

    Nothing is drawn: the size of the picture is how finely the view is looked at, by a million rays
    at most.
    """
    if "wait_ms" in params.model_fields_set:
        raise ParameterError(
            "wait_ms is for pictures, a list comes at once: leave it out.", "wait_ms"
        )
    lit = await service.variant(scene, params, client_of(request.scope))
    picture = looked_at(service.picture_of(lit, params))
    viewer = request_viewer(request)
    if picture.view.shading != "gi" or not service.startup.lit.is_set():
        return listed((), 0)

    def work() -> Look:
        renderer = service.engine.renderer(lit.id)
        renderer.prepared.scene.require_texels()
        return look_at(renderer, picture.view, picture.target, renderer.tiles)

    look = await service.compute(request, work)
    coming = await service.request_light(picture, look.frame, viewer) if look.frame else ()
    return listed(look.seen, len(coming))


MAX_LOOK_RAYS = 1 << 20
"""Rays that a view is looked at by, at most: what they miss is smaller than a screen's pixel."""


def looked_at(picture: PictureRequest) -> PictureRequest:
    """The picture with MAX_LOOK_RAYS pixels at most, of the same view."""
    view = picture.view
    scale = math.sqrt(MAX_LOOK_RAYS / (view.width * view.height))
    if scale >= 1.0:
        return picture
    width, height = math.floor(scale * view.width), math.floor(scale * view.height)
    return replace(picture, view=replace(view, width=width, height=height))


def listed(seen: Sequence[SeenChunk], coming: int) -> Response:
    """The answer that lists the chunks ``seen``, to some of which light is ``coming``."""
    found = CardChunks(chunks=chunk_list(seen), coming=coming)
    return Response(found.model_dump_json(), 200, {"Cache-Control": "no-cache"}, "application/json")


@router.get(
    "/light/{chunks}",
    response_class=Response,
    openapi_extra=documented(FoldParams),
    responses=PARTS,
)
async def read_light(
    request: Request, scene: SceneDep, chunks: str, params: FoldParamsDep, service: ServiceDep
) -> Response:
    """Records of the texels of some chunks under the light of the request, filtered where they are
    noisy.
    """
    lit = await open_scene(request, service, scene, params)
    picture = service.picture_of(lit, params.view)

    def pack(renderer: Renderer, named: list[ChunkName], target: float) -> Packed:
        return known_light(
            renderer, picture.view, [each.at for each in named], target, renderer.tiles
        )

    return await packed(request, service, lit, chunks, params, pack)


@router.get(
    "/transfer/{chunks}",
    response_class=Response,
    openapi_extra=documented(TransferParams),
    responses=PARTS,
)
async def read_transfer(
    request: Request, scene: SceneDep, chunks: str, params: TransferParamsDep, service: ServiceDep
) -> Response:
    """What the texels of some chunks keep, for a page that turns the light by itself."""
    lit = await open_scene(request, service, scene, params)

    def pack(renderer: Renderer, named: list[ChunkName], target: float) -> Packed:
        return known_transfer(renderer, [each.at for each in named], target, renderer.tiles)

    return await packed(request, service, lit, chunks, params, pack)


async def open_scene(
    request: Request, service: Service, scene: Scene, params: VariantParams
) -> Scene:
    """The scene that is asked for, once the engine is up. Raises ForbiddenError where voxels are
    kept, and as ``Service.variant``.
    """
    if not service.settings.hands_out_voxels:
        raise ForbiddenError(VOXELS_WITHHELD)
    service.startup.check()
    return await service.variant(scene, params, client_of(request.scope))


Pack = Callable[[Renderer, list[ChunkName], float], Packed]


async def packed(
    request: Request,
    service: Service,
    scene: Scene,
    chunks: str,
    params: TransferParams,
    pack: Pack,
) -> Response:
    """The blocks of the named chunks; to be kept for ever where their versions are named, and stand
    for them alone.
    """
    await service.startup.lit.wait()

    def work() -> Response:
        renderer = service.engine.renderer(scene.id)
        renderer.prepared.scene.require_texels()
        named = chunk_names(chunks, renderer.prepared.chunks)
        found = pack(renderer, named, params.max_error or scene.target_error)
        current = tuple(each.version for each in named) == found.versions
        return binary_answer(request, found.blocks, current and found.alone)

    return await service.compute(request, work)
