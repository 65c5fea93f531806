"""What a page's graphics card draws from, filled for a scene and a view."""

from collections.abc import Sequence
from dataclasses import replace
from urllib.parse import urlencode

import numpy as np

from isogi_core.frame.card.chunk_light import CHUNKS, SeenChunk, raw_scale, seen_chunks
from isogi_core.frame.card.obstacles import BYTES, Obstacle, find_obstacles
from isogi_core.frame.film import ground_of
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight, triple
from isogi_core.frame.rays.control_pixels import expected_error
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.view_texels import carries_irradiance_ratios
from isogi_core.kernels.shading.framebuffer import TONE_GAIN, TONE_SHOULDER, TONE_TOE
from isogi_core.model.view import IDENTITY, View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from server.card_schemas import (
    CardChunk,
    CardGrid,
    CardGrounds,
    CardLambert,
    CardLattice,
    CardLayer,
    CardLight,
    CardLimits,
    CardLinks,
    CardLobe,
    CardPlan,
    CardScene,
    CardSchema,
    CardSlab,
    CardTerm,
    CardTone,
    CardValues,
    CardVolume,
    Colours,
)

CARD_FORMAT = 1
"""Version of what is sent: counts up when an older page cannot read it."""

VOXELS_KEPT = Obstacle(
    "voxels kept", "This server hands out no voxels: it draws all pictures itself (hand_out_voxels)."
)
"""What keeps cards from drawing anything that this server shows."""

LINKS = CardLinks(chunks="card/chunks", light="card/light/", transfer="card/transfer/")
TONE = CardTone(gain=TONE_GAIN, toe=TONE_TOE, shoulder=TONE_SHOULDER)


def card_obstacles(prepared: PreparedScene, view: View, hands_out: bool) -> list[Obstacle]:
    """What keeps a card from drawing a view; whether the server ``hands_out`` voxels. Raises ViewError."""
    own = [] if hands_out else [VOXELS_KEPT]
    return own + find_obstacles(prepared.scene, view, prepared.voxel_codes.nbytes)


def card_schema(renderer: Renderer, view: View, query: Sequence[tuple[str, str]], hands_out: bool) -> CardSchema:
    """The document of a ``view``; addresses of voxels go on with a ``query``. Its version is not filled in yet."""
    found = card_obstacles(renderer.prepared, view, hands_out)
    scene = None if found else card_scene(renderer, view, query)
    because, reason = [each.name for each in found], " ".join(each.why for each in found)
    return CardSchema(format=CARD_FORMAT, drawable=not found, because=because, reason=reason, scene=scene, version="")


def card_scene(renderer: Renderer, view: View, query: Sequence[tuple[str, str]]) -> CardScene:
    """All that drawing a view takes besides voxels and texels."""
    prepared, spec = renderer.prepared, renderer.caches.spec("gi")
    scene, volume = prepared.scene, prepared.scene.volume
    model = RotatedLight(spec, view).local_model("lambert", (0.0, 0.0))
    return CardScene(
        grid=grid_of(scene),
        values=CardValues(offset=volume.offset, scale=volume.scale, core=volume.core),
        volume=volume_of(prepared, query),
        lattice=CardLattice(size=prepared.shape[::-1], density=prepared.lattice.density, chunk=prepared.lattice.chunk),
        plan=plan_of(renderer),
        light=card_light(RotatedLight(spec, replace(view, light=IDENTITY))),
        lambert=CardLambert(key=model.key, sun=model.sun, ambient=model.ambient),
        exposure=scene.default_exposure,
        tone=TONE,
        grounds=CardGrounds(dark=triple(np.array(ground_of("dark"))), light=triple(np.array(ground_of("light")))),
        isovalues=scene.isovalues,
        target=scene.target_error,
        expected=expected_error(scene, volume.normalise_isovalue(view.isovalue)),
        limits=CardLimits(chunks=CHUNKS, bytes=BYTES),
        links=LINKS,
    )


def grid_of(scene: Scene) -> CardGrid:
    """The grid of a scene's volume."""
    placed = scene.volume.orientation
    return CardGrid(
        size=scene.volume.size,
        spacing=scene.volume.spacing,
        rotation=placed.rotation,
        origin=placed.origin,
        offset=scene.settings.offset,
        smooth=scene.settings.normals == "bspline",
    )


def volume_of(prepared: PreparedScene, query: Sequence[tuple[str, str]]) -> CardVolume:
    """The codes of a volume, and the addresses of their slabs."""
    codes = prepared.voxel_codes
    more = urlencode([*query, ("version", voxel_version(prepared.scene))])
    slabs = [CardSlab(first=a, last=b, href=f"card/volume/{a}-{b}?{more}") for a, b in codes.slabs]
    return CardVolume(
        type=codes.kind, gain=codes.gain, base=codes.base, hole=codes.hole, bytes=codes.nbytes, slabs=slabs
    )


def voxel_version(scene: Scene) -> str:
    """What names the codes of a scene's voxels; 32 hexadecimal digits."""
    return scene.volume.digest[:30] + f"{CARD_FORMAT:02x}"


def plan_of(renderer: Renderer) -> CardPlan:
    """What texels keep."""
    scene, spec = renderer.prepared.scene, renderer.caches.spec("gi")
    return CardPlan(
        representation=spec.plan.representation,
        channels=spec.channels,
        columns=spec.columns,
        straight=spec.straight,
        ratios=carries_irradiance_ratios(scene, "gi", False),
        whole=spec.plan.representation == "irradiance",
        turns=scene.lighting.rotating,
        layers=[CardLayer(kind=layer.kind, order=layer.order) for layer in spec.plan.layers],
    )


def card_light(light: RotatedLight) -> CardLight:
    """A light that is not turned, in the unit of its bake spec."""
    scale = raw_scale(light.spec)
    columns, squares = light.reflected / light.spec.unit * scale, light.square * scale
    firsts, terms = light.spec.firsts.tolist(), light.seen.terms
    parts = [(term.order, slice(a, a + term.order**2)) for a, term in zip(firsts, terms, strict=True)]
    lobes, tint = light.lobes, light.tint
    shine = (triple(colour) for colour in lobes.colours * tint)
    return CardLight(
        unit=light.spec.unit,
        terms=[
            CardTerm(order=order, light=colour_rows(columns[:, part]), square=squares[part].tolist())
            for order, part in parts
        ],
        sky=colour_rows(light.sky.lobe * light.sky.light),
        least=triple(light.unshadowed.least),
        lobes=[
            CardLobe(towards=triple(place), edges=(triple(one), triple(other)), shine=colour)
            for place, (one, other), colour in zip(lobes.places, lobes.edges, shine, strict=True)
        ],
    )


def colour_rows(rows: np.ndarray) -> Colours:
    """Three rows of numbers."""
    red, green, blue = rows.tolist()
    return red, green, blue


def chunk_list(seen: Sequence[SeenChunk]) -> list[CardChunk]:
    """The chunks that a view reads."""
    return [CardChunk(at=".".join(map(str, each.at)), version=each.version.hex(), final=each.final) for each in seen]


def chunks_in(renderer: Renderer, frame: Frame) -> list[CardChunk]:
    """The chunks that the view of a ``frame`` reads, most visible first; none where it is drawn without texels.

    Raises what ``seen_chunks`` does.
    """
    if frame.quality.lacking is None or frame.view.shading != "gi":
        return []
    return chunk_list(seen_chunks(renderer, frame.view, frame.quality.lacking.reading.target, renderer.tiles))
