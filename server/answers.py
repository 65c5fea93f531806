"""Answers: the schemas filled for a scene, its plan, and the coverage of a frame."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from urllib.parse import urlencode
from weakref import WeakKeyDictionary

import numpy as np

from isogi_core.files.scene_file import write_material_text
from isogi_core.files.vector import Vector, triple
from isogi_core.frame.card.blocks import CHUNKS, SeenChunk, raw_scale, seen_chunks
from isogi_core.frame.card.obstacles import BYTES, Obstacle, find_obstacles
from isogi_core.frame.film import COLOURS, SCALE, ground_of, lit
from isogi_core.frame.fitting import Stand, fitted_to_all
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import point_at
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import expected_error
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.view_texels import carries_irradiance_ratios
from isogi_core.kernels.shading.framebuffer import FINAL, TONE_GAIN, TONE_SHOULDER, TONE_TOE
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.colours import hex_of
from isogi_core.model.environment import Lobe
from isogi_core.model.lights import ENVIRONMENTS, Light
from isogi_core.model.material import SHINE_KINDS
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import IDENTITY, View
from isogi_core.plan.histograms import shown_histogram
from isogi_core.plan.left_out import S1_BYTES
from isogi_core.plan.scene import Scene
from isogi_core.plan.surfaces import material_settings
from isogi_core.plan.variants import find_materials
from isogi_core.prepared.isosurface_mesh import surface_size
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
from server.knobs import KNOBS
from server.schemas import (
    CameraSchema,
    ChunkCounts,
    ColourScale,
    Coverage,
    EnvironmentSchema,
    ErrorScale,
    Histogram,
    LabelSchema,
    LayerSchema,
    LightSchema,
    LobeSchema,
    MaterialSchema,
    Omission,
    PixelCounts,
    PlanSchema,
    PointSchema,
    PresetSchema,
    Range,
    SceneSchema,
    Shares,
    SizeSchema,
    SurfaceSchema,
    TexelSchema,
    TimeLeftSchema,
    VolumeSchema,
)
from server.values import Span
from worker.progress import TimeLeft

MATERIALS_OF: WeakKeyDictionary[Scene, list[MaterialSchema]] = WeakKeyDictionary()
"""The materials of the scenes in use that were asked."""


def scene_schema(scene: Scene) -> SceneSchema:
    """The document of one scene."""
    shown = shown_histogram(scene.volume)
    return SceneSchema(
        id=scene.id,
        name=scene.name,
        volume=volume_schema(scene),
        histogram=Histogram(
            counts=shown.counts.tolist(),
            edges=shown.edges.tolist(),
            logarithmic=shown.logarithmic,
        ),
        defaults=defaults(scene),
        ranges=ranges(scene),
        presets=[PresetSchema(**asdict(preset)) for preset in scene.presets],
        stops=list(scene.stops.levels),
        stops_note=scene.stops.note,
        shadings=list(VIEW_SHADINGS),
        lights=[light_schema(light) for light in scene.lighting.lights],
        albedo=scene.surfaces.albedo,
        albedos=None
        if scene.surfaces.albedos is None
        else Range(min=scene.surfaces.albedos[0], max=scene.surfaces.albedos[1]),
        colours=colour_scale(scene),
        surfaces=[SurfaceSchema(**each.table) for each in scene.surfaces.pinned],
        clear=scene.surfaces.clear,
        material=write_material_text(material_settings(scene.surfaces.material)),
        transmission=scene.surfaces.transmission,
        materials=material_schemas(scene),
        shines=(list(SHINE_KINDS) if scene.surfaces.colours is None else ["plastic"])
        if scene.surfaces.shine
        else [],
        bounces=scene.bounces,
        cuts=scene.volume.orientation.straight,
        solid=scene.solid,
        target_error=scene.target_error,
        environments=[
            EnvironmentSchema(id=number, name=name) for number, name in ENVIRONMENTS.items()
        ],
        rotating=scene.lighting.rotating,
        turns=scene.lighting.rotating and scene.plan.representation == "transfer",
        view=scene.settings.first.given,
        error_scale=ErrorScale(low=SCALE[0], high=SCALE[1], colours=list(COLOURS)),
        plan=plan_schema(scene),
        read_only=False,
    )


def volume_schema(scene: Scene) -> VolumeSchema:
    """The facts of a scene's volume."""
    volume = scene.volume
    orientation = scene.volume.orientation
    names = ("name", "size", "spacing", "dtype", "value_range", "holes")
    return VolumeSchema(
        **{name: getattr(volume, name) for name in names},
        affine=orientation.affine(volume.spacing).tolist(),
        unit=orientation.unit,
        letters=orientation.letters,
        axes=orientation.axes,
        bounds=volume.world_bounds,
        notes=list(orientation.notes),
        read_as=orientation.read_as,
        time=volume.moment[0],
        times=volume.moment[1],
    )


def colour_scale(scene: Scene) -> ColourScale | None:
    """The colours of the surface by data, None where it has one albedo."""
    if scene.surfaces.colours is None:
        return None
    scale = scene.surfaces.colours.scale
    (low, high) = scale.span
    outside = hex_of(scale.outside)
    return ColourScale(
        name=scale.name,
        map=scale.map,
        low=low,
        high=high,
        colours=scale.anchors,
        outside=outside,
        labels=[
            LabelSchema(
                value=label.value, name=label.name, colour=hex_of(label.colour), shown=label.shown
            )
            for label in scale.labels
        ],
    )


def material_schemas(scene: Scene) -> list[MaterialSchema]:
    """All materials; a scene is asked once, as its probes are read again for each."""
    if scene not in MATERIALS_OF:
        MATERIALS_OF[scene] = [
            material_schema(kind, found) for kind, found in find_materials(scene).items()
        ]
    return MATERIALS_OF[scene]


def material_schema(kind: str, found: Scene | str) -> MaterialSchema:
    """A material by its ``kind``, as a scene would have it, or why it cannot: see
    ``find_materials``.
    """
    if isinstance(found, str):
        return MaterialSchema(kind=kind, refused=found)
    numbers = {
        name: given
        for name, given in material_settings(found.surfaces.material).items()
        if name != "material"
    }
    return MaterialSchema(kind=kind, numbers=numbers)


def light_schema(light: Light) -> LightSchema:
    """One light: its type as in a scene file, and its name for a person."""
    return LightSchema(type=type(light).__name__.removesuffix("Light").lower(), name=light.name)


def camera_schema(
    renderer: Renderer,
    view: View,
    azimuth: float | None,
    elevation: float | None,
    projection: str | None = None,
) -> CameraSchema:
    """The camera that shows a view's surface whole at every azimuth, and large; the whole volume,
    where none is to be seen of it. A scene that says where its first camera is has that one.

    The ``view`` is in perspective; the camera is for a ``projection``, the scene's own by default.
    """
    scene = renderer.prepared.scene
    first = scene.settings.first
    front, above = scene.front
    azimuth = front if azimuth is None else azimuth
    elevation = above if elevation is None else elevation
    if first.placed:
        target = first.target or scene.volume.world_centre
        distance = first.distance or KNOBS["distance"].default
    else:
        target, distance = fit(renderer, [Stand(view, azimuth, elevation)], projection)
    return CameraSchema(azimuth=azimuth, elevation=elevation, distance=distance, target=target)


def fit(
    renderer: Renderer, stands: Sequence[Stand], projection: str | None
) -> tuple[Vector, float]:
    """The target and the distance, rounded, at which cameras see their surfaces whole: see
    ``fitted_to_all``.

    They see the whole volume where none is to be seen.
    """
    scene = renderer.prepared.scene
    found = fitted_to_all(renderer, stands, projection or scene.settings.projection)
    target, distance = found or (scene.volume.world_centre, KNOBS["distance"].default)
    x, y, z = (float(f"{value:.6g}") for value in target)
    return (x, y, z), float(f"{distance:.4g}")


def plan_schema(scene: Scene) -> PlanSchema:
    """The scene's plan, and which of its texels are ever lit."""
    plan = scene.plan
    return PlanSchema(
        representation=plan.representation,
        order=plan.order,
        indirect_order=plan.indirect_order,
        channels=plan.channels,
        bounces=plan.bounces,
        branches=plan.branches,
        bytes_per_texel=plan.bytes_per_texel,
        full_bytes_per_texel=S1_BYTES,
        precision=plan.precision,
        samples=plan.samples,
        lobes=[lobe_schema(lobe) for lobe in scene.inputs.lobes[: plan.lobes]],
        projected=projected_isovalues(scene),
        layers=[layer_schema(layer) for layer in plan.layers],
        errors=dict(plan.errors),
        notes=[*plan.notes, *turned_out(scene)],
        texels=TexelSchema(**asdict(scene.texels)),
        left_out=[Omission(**asdict(each)) for each in scene.left_out],
    )


def turned_out(scene: Scene) -> list[str]:
    """What was decided about a volume that is inside out, in a sentence."""
    if scene.solid == "above" or "solid" in scene.source.document:
        return []
    return [
        (
            "Most of the volume's border is above the isovalue, so what is below it is solid; "
            'solid = "above" undoes it.'
        )
    ]


def projected_isovalues(scene: Scene) -> list[tuple[float, float]]:
    """The isovalues, from one to another, where texels are projected, in the units of the volume's
    file.
    """
    ends = [[scene.volume.file_value(end) for end in span] for span in scene.projection.spans()]
    return sorted((min(pair), max(pair)) for pair in ends)


def lobe_schema(lobe: Lobe) -> LobeSchema:
    """One lobe of a light."""
    return LobeSchema(
        azimuth=lobe.azimuth,
        elevation=lobe.elevation,
        angle=lobe.angle,
        irradiance=lobe.irradiance.tolist(),
    )


def layer_schema(layer: Layer) -> LayerSchema:
    """One layer of a plan."""
    names = ("kind", "order", "channels", "precision", "coarse", "scale", "bytes_per_texel")
    return LayerSchema(**{name: getattr(layer, name) for name in names}, nodes=list(layer.nodes))


def defaults(scene: Scene) -> dict[str, float | str]:
    """What each knob of a scene is where it is left out."""
    own = {name: knob.default_of(scene) for name, knob in KNOBS.items()}
    return {name: value for name, value in own.items() if value is not None}


def ranges(scene: Scene) -> dict[str, Range]:
    """What each number may be."""
    spans = {
        name: (knob.kind.low, knob.kind.high)
        for name, knob in KNOBS.items()
        if isinstance(knob.kind, Span)
    }
    spans |= {"isovalue": scene.isovalues, "time": (0, scene.volume.moment[1] - 1)}
    if scene.surfaces.albedos is None:
        spans |= {}
    else:
        spans |= {"albedo": scene.surfaces.albedos}
    return {name: Range(min=low, max=high) for name, (low, high) in spans.items()}


def point_schema(
    scene: Scene, frame: Frame, pixel: tuple[int, int], exposure: float
) -> PointSchema:
    """What a pixel, by column and row, of a frame shows."""
    orientation = scene.volume.orientation
    point = point_at(frame, *pixel, scene)
    if point is None:
        return PointSchema(hit=False, unit=orientation.unit)
    shown = lit(
        np.array([[point.radiance]], np.float32),
        np.full((1, 1), FINAL, np.uint8),
        exposure,
        marked=False,
    )
    return PointSchema(
        hit=True,
        unit=orientation.unit,
        position=point.position,
        sides=orientation.sides(point.position),
        voxel=point.voxel,
        value=point.value,
        wall=point.wall,
        normal=point.normal,
        light=point.radiance,
        displayed=f"#{shown.tobytes().hex()}",
        state=point.state,
        error=point.error,
    )


def size_schema(renderer: Renderer, isovalue: float) -> SizeSchema:
    """The size of a scene's surface, in the world, in one cell of a field that repeats; an area of
    0 where there is none.
    """
    prepared = renderer.prepared
    volume = prepared.scene.volume
    place = prepared.scene.volume.orientation
    steps = place.affine(volume.spacing)[:, :3]
    level = prepared.surface(isovalue).isovalue
    if volume.cell is None or prepared.scene.source.document.get("cut"):
        size = surface_size(volume.voxels, level, steps)
    else:
        # a field that repeats has as much in each cell, and faces of the cell are none of its own
        cell = volume.cell
        size = surface_size(cell.of(volume.voxels), level, steps, cell.periodic)
    return SizeSchema(isovalue=isovalue, unit=place.unit, **asdict(size))


def coverage_schema(frame: Frame, time_left: TimeLeft | None) -> Coverage:
    """How far the frame is."""
    return Coverage(
        chunks=ChunkCounts(needed=frame.chunks_needed, final=frame.chunks_final),
        pixels=PixelCounts(surface=frame.surface, **frame.counts),
        coverage=Shares(**frame.coverage),
        error=frame.total.likely,
        noise=frame.noise,
        interval=None if frame.total.predicted else (frame.total.low, frame.total.high),
        controls=frame.total.controls,
        p99=None if frame.tail is None else frame.tail.likely,
        p99_interval=None if frame.tail is None else (frame.tail.low, frame.tail.high),
        provisional=not frame.final,
        time_left=None if time_left is None else TimeLeftSchema(**asdict(time_left)),
        overdue=time_left is not None and time_left.overdue,
    )


CARD_FORMAT = 1
"""Version of what is sent: counts up when an older page cannot read it."""

VOXELS_KEPT = Obstacle(
    "voxels kept",
    "This server hands out no voxels: it draws all pictures itself (hand_out_voxels).",
)
"""What keeps cards from drawing anything that this server shows."""

LINKS = CardLinks(chunks="card/chunks", light="card/light/", transfer="card/transfer/")
TONE = CardTone(gain=TONE_GAIN, toe=TONE_TOE, shoulder=TONE_SHOULDER)


def card_obstacles(prepared: PreparedScene, view: View, hands_out: bool) -> list[Obstacle]:
    """What keeps a card from drawing a view; whether the server ``hands_out`` voxels. Raises
    ViewError.
    """
    own = [] if hands_out else [VOXELS_KEPT]
    return own + find_obstacles(prepared.scene, view, prepared.voxel_codes.nbytes)


def card_schema(
    renderer: Renderer, view: View, query: Sequence[tuple[str, str]], hands_out: bool
) -> CardSchema:
    """The document of a ``view``; addresses of voxels go on with a ``query``. Its version is not
    filled in yet.
    """
    found = card_obstacles(renderer.prepared, view, hands_out)
    if found:
        scene = None
    else:
        scene = card_scene(renderer, view, query)
    because = [each.name for each in found]
    reason = " ".join(each.why for each in found)
    return CardSchema(
        format=CARD_FORMAT,
        drawable=not found,
        because=because,
        reason=reason,
        scene=scene,
        version="",
    )


def card_scene(renderer: Renderer, view: View, query: Sequence[tuple[str, str]]) -> CardScene:
    """All that drawing a view takes besides voxels and texels."""
    prepared = renderer.prepared
    spec = renderer.caches.spec("gi")
    scene = prepared.scene
    volume = prepared.scene.volume
    model = RotatedLight(spec, view).local_model("lambert", (0.0, 0.0))
    return CardScene(
        grid=grid_of(scene),
        values=CardValues(offset=volume.offset, scale=volume.scale, core=volume.core),
        volume=volume_of(prepared, query),
        lattice=CardLattice(
            size=prepared.shape[::-1],
            density=prepared.lattice.density,
            chunk=prepared.lattice.chunk,
        ),
        plan=plan_of(renderer),
        light=card_light(RotatedLight(spec, replace(view, light=IDENTITY))),
        lambert=CardLambert(key=model.key, sun=model.sun, ambient=model.ambient),
        exposure=scene.default_exposure,
        tone=TONE,
        grounds=CardGrounds(
            dark=triple(np.array(ground_of("dark"))), light=triple(np.array(ground_of("light")))
        ),
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
        type=codes.kind,
        gain=codes.gain,
        base=codes.base,
        hole=codes.hole,
        bytes=codes.nbytes,
        slabs=slabs,
    )


def voxel_version(scene: Scene) -> str:
    """What names the codes of a scene's voxels; 32 hexadecimal digits."""
    return scene.volume.digest[:30] + f"{CARD_FORMAT:02x}"


def plan_of(renderer: Renderer) -> CardPlan:
    """What texels keep."""
    scene = renderer.prepared.scene
    spec = renderer.caches.spec("gi")
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
    columns = light.reflected / light.spec.unit * scale
    squares = light.square * scale
    firsts = light.spec.firsts.tolist()
    terms = light.seen.terms
    parts = [
        (term.order, slice(a, a + term.order**2)) for a, term in zip(firsts, terms, strict=True)
    ]
    lobes = light.lobes
    tint = light.tint
    shine = (triple(colour) for colour in lobes.colours * tint)
    return CardLight(
        unit=light.spec.unit,
        terms=[
            CardTerm(
                order=order, light=colour_rows(columns[:, part]), square=squares[part].tolist()
            )
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
    return [
        CardChunk(at=".".join(map(str, each.at)), version=each.version.hex(), final=each.final)
        for each in seen
    ]


def chunks_in(renderer: Renderer, frame: Frame) -> list[CardChunk]:
    """The chunks that the view of a ``frame`` reads, most visible first; none where it is drawn
    without texels.

    Raises what ``seen_chunks`` does.
    """
    if frame.quality.lacking is None or frame.view.shading != "gi":
        return []
    return chunk_list(
        seen_chunks(renderer, frame.view, frame.quality.lacking.reading.target, renderer.tiles)
    )
