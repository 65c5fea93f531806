"""Answers: the documents about a scene, its plan, the coverage of a frame, and the data of a
graphics card.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace
from urllib.parse import urlencode
from weakref import WeakKeyDictionary

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.files.scene_file import write_material_text
from isogi_core.files.vector import Vector, triple
from isogi_core.frame.card.blocks import CHUNKS, raw_scale
from isogi_core.frame.card.colour_codes import ColourCodes
from isogi_core.frame.card.looks import SeenChunk
from isogi_core.frame.card.obstacles import BYTES, Obstacle, find_obstacles
from isogi_core.frame.card.sides import seen_on_sides
from isogi_core.frame.film import COLOURS, SCALE, ground_of, lit
from isogi_core.frame.fitting import Stand, fitted_to_all
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import expected_error
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.frame.several.peeling_renderer import PeelingRenderer
from isogi_core.frame.surface_point import point_at
from isogi_core.frame.view_texels import carries_irradiance_ratios
from isogi_core.kernels.shading.framebuffer import FINAL, TONE_GAIN, TONE_SHOULDER, TONE_TOE
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.colours import hex_of
from isogi_core.model.environment import Lobe
from isogi_core.model.lights import ENVIRONMENTS, Light
from isogi_core.model.material import SHINE_KINDS
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import IDENTITY, TURN_STEP, View
from isogi_core.plan.histograms import shown_histogram
from isogi_core.plan.left_out import S1_BYTES
from isogi_core.plan.materials import material_settings
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import Side, find_materials, surfaces_of
from isogi_core.prepared.isosurface_mesh import surface_size
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_server.card_schemas import (
    CardChunk,
    CardColours,
    CardGrid,
    CardGrounds,
    CardLattice,
    CardLayer,
    CardLight,
    CardLimits,
    CardLinks,
    CardLobe,
    CardModel,
    CardPlan,
    CardScene,
    CardSchema,
    CardSide,
    CardSlab,
    CardSurface,
    CardTerm,
    CardTone,
    CardValues,
    CardVolume,
    Colours,
)
from isogi_server.card_shine import card_shine
from isogi_server.knobs import KNOBS
from isogi_server.schemas import (
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
from isogi_server.values import Span
from isogi_worker.progress import TimeLeft

MATERIALS_OF: WeakKeyDictionary[Scene, list[MaterialSchema]] = WeakKeyDictionary()
"""Materials of the scenes in use whose materials were asked for."""


def scene_schema(scene: Scene) -> SceneSchema:
    """Return the document of one scene."""
    # The scene file gives facts, the plan the rest; environments and notes of the server are added
    # by the route.
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
        albedos=albedo_range(scene),
        colours=colour_scale(scene),
        surfaces=[SurfaceSchema(**each.table) for each in scene.surfaces.pinned],
        clear=scene.surfaces.clear,
        material=write_material_text(material_settings(scene.surfaces.material)),
        transmission=scene.surfaces.transmission,
        materials=material_schemas(scene),
        shines=shines(scene),
        bounces=scene.bounces,
        cuts=scene.volume.orientation.straight,
        solid=scene.solid,
        target_error=scene.target_error,
        environments=[
            EnvironmentSchema(id=number, name=name) for number, name in ENVIRONMENTS.items()
        ],
        rotating=scene.lighting.rotating or scene.lighting.turnable,
        turns=turns(scene),
        turn_step=TURN_STEP if scene.lighting.baked_by_turn else None,
        view=scene.settings.first.given,
        error_scale=ErrorScale(low=SCALE[0], high=SCALE[1], colours=list(COLOURS)),
        plan=plan_schema(scene),
        read_only=False,
    )


def albedo_range(scene: Scene) -> Range | None:
    """Return the albedos that views may ask for; None if they may not choose one."""
    if scene.surfaces.albedos is None:
        return None
    low, high = scene.surfaces.albedos
    return Range(min=low, max=high)


def shines(scene: Scene) -> list[str]:
    """Return the kinds of shine that views may ask for: none if the surface is diffuse, and plastic
    only if it is coloured by data.
    """
    if not scene.surfaces.shine:
        return []
    if scene.surfaces.colours is not None:
        return ["plastic"]
    return list(SHINE_KINDS)


def volume_schema(scene: Scene) -> VolumeSchema:
    """Return the facts about a scene's volume."""
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
    """Return the scale of a surface that is coloured by data; None if it has one albedo."""
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
    """Return all materials. Computed once for a scene, as its probes are read again for each
    material.
    """
    if scene not in MATERIALS_OF:
        MATERIALS_OF[scene] = [
            material_schema(kind, found) for kind, found in find_materials(scene).items()
        ]
    return MATERIALS_OF[scene]


def material_schema(kind: str, found: Scene | str) -> MaterialSchema:
    """Return the document of a material by its ``kind``: its numbers in the scene ``found``, or
    the reason why the scene cannot have it. See ``find_materials``.
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
    """Return one light: its type as in a scene file, and a name for people."""
    return LightSchema(type=type(light).__name__.removesuffix("Light").lower(), name=light.name)


def camera_schema(
    renderer: Renderer,
    view: View,
    azimuth: float | None,
    elevation: float | None,
    projection: str | None = None,
) -> CameraSchema:
    """Return the camera that shows the surface of a view whole at every azimuth, as large as that
    allows; the whole volume if no surface is visible.

    A first camera that the scene file places is returned as it is. The ``view`` is in perspective;
    the camera is for a ``projection``, by default the scene's.
    """
    scene = renderer.prepared.scene
    first = scene.settings.first
    front, above = scene.front
    azimuth = front if azimuth is None else azimuth
    elevation = above if elevation is None else elevation
    # A scene file that places its camera is not fitted.
    if first.placed:
        target = first.target or scene.volume.world_centre
        distance = first.distance or KNOBS["distance"].default
    else:
        target, distance = fit(renderer, [Stand(view, azimuth, elevation)], projection)
    return CameraSchema(azimuth=azimuth, elevation=elevation, distance=distance, target=target)


def fit(
    renderer: Renderer, stands: Sequence[Stand], projection: str | None
) -> tuple[Vector, float]:
    """Return the target and the distance, rounded, at which cameras see their surfaces whole: see
    ``fitted_to_all``.

    They see the whole volume if no surface is visible.
    """
    scene = renderer.prepared.scene
    found = fitted_to_all(renderer, stands, projection or scene.settings.projection)
    target, distance = found or (scene.volume.world_centre, KNOBS["distance"].default)
    # Few digits suffice for a camera, and keep addresses short.
    x, y, z = (float(f"{value:.6g}") for value in target)
    return (x, y, z), float(f"{distance:.4g}")


def plan_schema(scene: Scene) -> PlanSchema:
    """Return the scene's plan, and the counts of texels that may be lit."""
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
    """Return a note if the volume was found to be inside out, so that matter below the isovalue
    is solid.
    """
    if scene.solid == "above" or "solid" in scene.source.document:
        return []
    return [
        (
            "Most of the volume's border is above the isovalue, so what is below it is solid; "
            'solid = "above" undoes it.'
        )
    ]


def projected_isovalues(scene: Scene) -> list[tuple[float, float]]:
    """Return the ranges of isovalues whose texels are projected, in the units of the volume's
    file.
    """
    ends = [[scene.volume.file_value(end) for end in span] for span in scene.projection.spans()]
    return sorted((min(pair), max(pair)) for pair in ends)


def lobe_schema(lobe: Lobe) -> LobeSchema:
    """Return one lobe of a light."""
    return LobeSchema(
        azimuth=lobe.azimuth,
        elevation=lobe.elevation,
        angle=lobe.angle,
        irradiance=lobe.irradiance.tolist(),
    )


def layer_schema(layer: Layer) -> LayerSchema:
    """Return one layer of a plan."""
    names = ("kind", "order", "channels", "precision", "coarse", "scale", "bytes_per_texel")
    return LayerSchema(**{name: getattr(layer, name) for name in names}, nodes=list(layer.nodes))


def defaults(scene: Scene) -> dict[str, float | str]:
    """Return the value of each parameter of a view if it is left out; parameters without one
    are left out.
    """
    own = {name: knob.default_of(scene) for name, knob in KNOBS.items()}
    return {name: value for name, value in own.items() if value is not None}


def turns(scene: Scene) -> bool:
    """Return True if a turn of the scene's light is visible."""
    kept = scene.lighting.rotating and scene.plan.representation == "transfer"
    return kept or scene.lighting.baked_by_turn


def ranges(scene: Scene) -> dict[str, Range]:
    """Return the range of each numeric parameter."""
    spans = {
        name: (knob.kind.low, knob.kind.high)
        for name, knob in KNOBS.items()
        if isinstance(knob.kind, Span)
    }
    # Ranges that depend on the scene replace the general ones.
    spans |= {"isovalue": scene.isovalues, "time": (0, scene.volume.moment[1] - 1)}
    if scene.surfaces.albedos is not None:
        spans |= {"albedo": scene.surfaces.albedos}
    return {name: Range(min=low, max=high) for name, (low, high) in spans.items()}


def point_schema(
    scene: Scene, frame: Frame, pixel: tuple[int, int], exposure: float
) -> PointSchema:
    """Return the document of one ``pixel`` (column, row) of a frame: its surface point, its
    light and its error.
    """
    orientation = scene.volume.orientation
    point = point_at(frame, *pixel, scene)
    if point is None:
        return PointSchema(hit=False, unit=orientation.unit)
    # Develop the one pixel as a picture would show it.
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
    """Return the area and the enclosed volume of a scene's surface, in world units, of one cell if
    the field repeats; an area of 0 if there is none.
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
    """Return the coverage and the error of a frame."""
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


CARD_FORMAT = 3
"""Version of the format of card data; raised if older pages cannot read it."""

VOXELS_KEPT = Obstacle(
    "voxels kept",
    "This server hands out no voxels: it draws all pictures itself (hand_out_voxels).",
)
"""The obstacle that keeps graphics cards from drawing anything of this server."""

LINKS = CardLinks(chunks="card/chunks", light="card/light/", transfer="card/transfer/")
TONE = CardTone(gain=TONE_GAIN, toe=TONE_TOE, shoulder=TONE_SHOULDER)


def card_obstacles(prepared: PreparedScene, view: View, hands_out: bool) -> list[Obstacle]:
    """Return the reasons why a card cannot draw a view; ``hands_out`` says if the server hands
    out voxels. Raises ViewError.
    """
    own = [] if hands_out else [VOXELS_KEPT]
    colours = ColourCodes.of(prepared.scene)
    nbytes = prepared.voxel_codes.nbytes + (colours.nbytes if colours else 0)
    return own + find_obstacles(prepared.scene, view, nbytes)


def card_schema(
    renderer: Renderer, view: View, query: Sequence[tuple[str, str]], hands_out: bool
) -> CardSchema:
    """Return the card document of a ``view``. Addresses of voxels carry the ``query``. The
    caller fills in the version.
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
    """Return all that drawing a view needs besides voxels and texels."""
    prepared = renderer.prepared
    spec = renderer.caches.spec("gi")
    scene = prepared.scene
    volume = prepared.scene.volume
    unturned = RotatedLight(spec, replace(view, light=IDENTITY))
    return CardScene(
        grid=grid_of(scene),
        values=CardValues(offset=volume.offset, scale=volume.scale, core=volume.core),
        volume=volume_of(prepared, query),
        colours=colours_of(scene, triple(np.array(spec.albedo)), query),
        shine=card_shine(unturned, query),
        lattice=CardLattice(
            size=prepared.shape[::-1],
            density=prepared.lattice.density,
            chunk=prepared.lattice.chunk,
        ),
        plan=plan_of(renderer),
        light=card_light(unturned),
        surfaces=surfaces_on_card(renderer, unturned),
        model=card_model(unturned),
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
    """Return the grid of a scene's volume."""
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
    """Return the coding of a volume's voxels, and the addresses of its slabs."""
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


def colours_of(
    scene: Scene, brightest: tuple[float, float, float], query: Sequence[tuple[str, str]]
) -> CardColours | None:
    """Return the colours by data of a scene whose texels hold light of the ``brightest`` albedo,
    and the addresses of their slabs; None if it has none.
    """
    found = ColourCodes.of(scene)
    if found is None:
        return None
    more = urlencode([*query, ("version", found.version)])
    colours = found.colours
    # The table ends with the last code that differs from code 0.
    table = colours.table
    last = int(np.flatnonzero((table != table[0]).any(axis=1)).max(initial=0))
    return CardColours(
        kind="labels" if colours.places.ndim == 4 else "values",
        size=colours.places.shape[2::-1],
        step=colours.step,
        table=[triple(albedo) for albedo in table[: last + 1]],
        brightest=brightest,
        bytes=found.nbytes,
        slabs=[
            CardSlab(first=a, last=b, href=f"card/colours/{a}-{b}?{more}") for a, b in found.slabs
        ],
    )


def voxel_version(scene: Scene) -> str:
    """Return the version of the codes of a scene's voxels: 32 hexadecimal digits."""
    return scene.volume.digest[:30] + f"{CARD_FORMAT:02x}"


def plan_of(renderer: Renderer) -> CardPlan:
    """Return the layout of the light that texels keep."""
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
    """Return the unturned light, in units of its bake spec."""
    scale = raw_scale(light.spec)
    columns = light.reflected / light.spec.unit * scale
    squares = light.square * scale
    firsts = light.spec.firsts.tolist()
    terms = light.seen.terms
    # Each term of the light meets its own range of coefficients.
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


def surfaces_on_card(renderer: Renderer, light: RotatedLight) -> list[CardSurface] | None:
    """Return the surfaces of a scene with several, that which slides first, under the unturned
    ``light`` of its outer side; None if the scene has one.
    """
    peeling = renderer.peeling
    if peeling is None:
        return None
    found = []
    for number, each in enumerate(surfaces_of(renderer.prepared.scene, light.view.isovalue)):
        outer, inner = (
            side_on_card(peeling, Side(number, is_inner), light) for is_inner in (False, True)
        )
        found.append(
            CardSurface(
                isovalue=each.isovalue if number else None,
                clear=each.clear,
                albedo=triple(np.array(each.leaving) / np.maximum(light.albedo, 1e-30)),
                outer=outer,
                inner=inner,
            )
        )
    return found


def side_on_card(peeling: PeelingRenderer, which: Side, light: RotatedLight) -> CardSide:
    """Return the unshadowed light on a side of a surface, in the unit of the ``light`` of the
    scene.
    """
    spec = peeling.renderer_of(which, light.view.isovalue).caches.spec("gi")
    side = RotatedLight(spec, replace(light.view, albedo=None))
    scale = spec.unit / light.spec.unit
    return CardSide(
        sky=colour_rows(scale * side.sky.lobe * side.sky.light),
        least=triple(scale * side.unshadowed.least),
    )


def card_model(light: RotatedLight) -> CardModel:
    """Return the constants of the local models under the unturned ``light``."""
    model = light.local_model("phong", (0.0, 0.0))
    return CardModel(
        key=model.key,
        follows=light.key_follows,
        sun=model.sun,
        ambient=model.ambient,
        gloss=model.shine,
        exponent=model.exponent,
    )


def colour_rows(rows: np.ndarray) -> Colours:
    """Return a (3, n) array as three lists."""
    red, green, blue = rows.tolist()
    return red, green, blue


def chunk_list(seen: Sequence[SeenChunk]) -> list[CardChunk]:
    """Return the documents of chunks that a view reads."""
    return [
        CardChunk(at=".".join(map(str, each.at)), version=each.version.hex(), final=each.final)
        for each in seen
    ]


def chunks_in(renderer: Renderer, frame: Frame) -> list[CardChunk]:
    """Return the chunks that the view of a ``frame`` reads, most visible first; none if it is drawn
    without texels.

    Raises as ``seen_on_sides`` does.
    """
    if frame.view.shading != "gi":
        return []
    if parts_of(frame):
        error = frame.target
    elif frame.quality.lacking is not None:
        error = frame.quality.lacking.reading.goal.error
    else:
        error = None
    if error is None:
        return []
    seen = seen_on_sides(renderer, frame.view, Goal.checked(error), renderer.tiles)
    return chunk_list(seen)
