"""All that a page needs to draw a scene on its visitor's graphics card: a document, voxels, and
light of chunks.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from fastapi import APIRouter, Request, Response

from isogi_core.bake.noise import Goal
from isogi_core.frame.card.blocks import known_transfer
from isogi_core.frame.card.colour_codes import ColourCodes
from isogi_core.frame.card.looks import Look, SeenChunk
from isogi_core.frame.card.sides import chunks_of_sides, known_light_of_sides, look_at_sides
from isogi_core.frame.known_blocks import Packed, Part
from isogi_core.frame.renderer import Renderer
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_server.answers import card_schema, chunk_list, voxel_version
from isogi_server.api.dependencies import (
    FoldParamsDep,
    TransferParamsDep,
    ViewParamsDep,
    VoxelParamsDep,
)
from isogi_server.api.headers import FOR_EVER, matches, tag_of, takes_gzip
from isogi_server.api.service import PictureRequest, SceneDep, Service, ServiceDep
from isogi_server.bearers import client_of
from isogi_server.card_schemas import CardChunks, CardSchema
from isogi_server.errors import ForbiddenError, ParameterError, UnknownPartError
from isogi_server.parameters import (
    ChunkName,
    FoldParams,
    TransferParams,
    VariantParams,
    ViewParams,
    VoxelParams,
    chunk_names,
    documented,
    layers_of,
)
from isogi_server.problems import documented_problems
from isogi_server.render.viewers import request_viewer
from isogi_server.views import goal_of

MEDIA_TYPE = "application/octet-stream"
BINARY: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The bytes, little-endian; docs/card.md has their layout.",
        "content": {MEDIA_TYPE: {}},
    },
    304: {"description": "The bytes are those that If-None-Match names."},
}

GZIP = b"\x1f\x8b\x08" + bytes(5) + b"\x04\xff"
"""The header of gzip data (RFC 1952): fastest compression, no time, unknown system. Fixed bytes
give equal ETags.
"""

END = b"\x03\x00"
"""An empty last block of DEFLATE."""


def binary_answer(request: Request, parts: Sequence[Part], lasting: bool) -> Response:
    """Answer with the bytes of some ``parts``. If ``lasting``, the bytes at this address never
    change.
    """
    packs = takes_gzip(request.headers.get("accept-encoding", ""))
    # Digests of parts are computed once; the encoding belongs to the tag, as ETags are strong.
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
    """Return the ``parts`` as one gzip member. Each part is compressed once, for all answers
    that contain it.
    """
    check = 0
    size = sum(len(each.data) for each in parts)
    for each in parts:
        check = zlib.crc32(each.data, check)
    # A member ends with the checksum and the size of all data.
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
    """Say if the visitor's graphics card can draw a view, and return all that it needs besides
    voxels and texels.

    Nothing in the document depends on the camera or on the rotation of the light.
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
    # The version of the document is a digest of all else in it.
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
    """Return codes of the voxels in some layers along z, x fastest. The layers are named as
    first-last, without the last. The document of the card says what codes stand for.
    """
    variant = await open_scene(request, service, scene, params)

    def work() -> Response:
        prepared = service.engine.renderer(variant.id).prepared
        codes = prepared.voxel_codes
        # An answer holds at most as many layers as a slab, so that its memory is bounded.
        most = max(b - a for a, b in codes.slabs)
        first, last = layers_of(layers, codes.shape[0], most)
        body = codes.code(variant.volume.voxels[first:last]).tobytes()
        return binary_answer(request, [Part(body)], params.version == voxel_version(variant))

    return await service.compute(request, work)


@router.get(
    "/colours/{layers}",
    response_class=Response,
    openapi_extra=documented(VoxelParams),
    responses=PARTS,
)
async def read_colours(
    request: Request, scene: SceneDep, layers: str, params: VoxelParamsDep, service: ServiceDep
) -> Response:
    """Return the codes of colours by data in some layers along z, place by place, x fastest: a byte
    for each place, or three if the colours are of labels. The layers are named as first-last,
    without the last. The document of the card says what codes stand for.
    """
    variant = await open_scene(request, service, scene, params)

    def work() -> Response:
        found = ColourCodes.of(variant)
        if found is None:
            raise UnknownPartError("This scene has no colours by data.")
        # The codes of all places: (nz, ny, nx), or (nz, ny, nx, 3) for labels.
        depth = len(found.colours.places)
        most = max(b - a for a, b in found.slabs)
        first, last = layers_of(layers, depth, most)
        body = found.layers(first, last).tobytes()
        return binary_answer(request, [Part(body)], params.version == found.version)

    return await service.compute(request, work)


@router.get(
    "/chunks", response_model=CardChunks, openapi_extra=documented(ViewParams), responses=PROBLEMS
)
async def read_chunks(
    request: Request, scene: SceneDep, params: ViewParamsDep, service: ServiceDep
) -> Response:
    """Return the chunks of texels that a view reads, most visible first, and request the light that
    it lacks.

    No picture is sent. The size of the picture sets the number of rays that find the chunks, up to
    a million.
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
        return look_at_sides(renderer, picture.view, picture.goal, renderer.tiles)

    look = await service.compute(request, work)
    # Looking has found the texels that are missing; request them for this client.
    coming: frozenset[Index] = frozenset()
    if look.frame:
        coming = await service.request_light(picture, look.frame, viewer)
    return listed(look.seen, len(coming))


MAX_LOOK_RAYS = 1 << 20
"""Rays that find the chunks of a view, at most: details that they miss are smaller than a pixel
of the screen.
"""


def looked_at(picture: PictureRequest) -> PictureRequest:
    """Return the request of the same view with at most MAX_LOOK_RAYS pixels."""
    view = picture.view
    scale = math.sqrt(MAX_LOOK_RAYS / (view.width * view.height))
    if scale >= 1.0:
        return picture
    width, height = math.floor(scale * view.width), math.floor(scale * view.height)
    return replace(picture, view=replace(view, width=width, height=height))


def listed(seen: Sequence[SeenChunk], coming: int) -> Response:
    """Answer with the list of the chunks ``seen``, and the number of chunks whose light is
    ``coming``.
    """
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
    """Return records of the texels of some chunks under the light of the request, filtered if
    they are noisy.
    """
    lit = await open_scene(request, service, scene, params)
    picture = service.picture_of(lit, params.view)

    def pack(renderer: Renderer, named: list[ChunkName], goal: Goal) -> Packed:
        return known_light_of_sides(
            renderer, picture.view, [each.at for each in named], goal, renderer.tiles
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
    """Return the transfer coefficients of the texels of some chunks, for a page that rotates
    the light itself.
    """
    lit = await open_scene(request, service, scene, params)
    if lit.surfaces.several:
        raise UnknownPartError("Light among several surfaces has no transfer: ask for card/light.")

    def pack(renderer: Renderer, named: list[ChunkName], goal: Goal) -> Packed:
        return known_transfer(renderer, [each.at for each in named], goal, renderer.tiles)

    return await packed(request, service, lit, chunks, params, pack)


async def open_scene(
    request: Request, service: Service, scene: Scene, params: VariantParams
) -> Scene:
    """Return the variant that is asked for. Raises ForbiddenError if this server hands out no
    voxels, and as ``Service.variant``.
    """
    if not service.settings.hands_out_voxels:
        raise ForbiddenError(VOXELS_WITHHELD)
    service.startup.check()
    return await service.variant(scene, params, client_of(request.scope))


Pack = Callable[[Renderer, list[ChunkName], Goal], Packed]


async def packed(
    request: Request,
    service: Service,
    scene: Scene,
    chunks: str,
    params: TransferParams,
    pack: Pack,
) -> Response:
    """Answer with the blocks of the named chunks. Caches may keep them for ever if the address
    names their present versions, and the blocks depend on nothing else: filtered blocks depend on
    the chunks around them.
    """
    # Until then the kernels that read light are being compiled.
    await service.startup.lit.wait()

    def work() -> Response:
        renderer = service.engine.renderer(scene.id)
        renderer.prepared.scene.require_texels()
        named = chunk_names(
            chunks, chunks_of_sides(renderer.prepared.scene, renderer.prepared.chunks)
        )
        found = pack(renderer, named, goal_of(scene, params.max_error))
        # The address names versions: the answer lasts only if these are the present ones.
        current = tuple(each.version for each in named) == found.versions
        return binary_answer(request, found.blocks, current and found.alone)

    return await service.compute(request, work)
