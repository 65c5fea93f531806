"""What isogi tells about a scene and a frame, as documents: for the API and for ``isogi inspect``."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from isogi_core.frame.error_map import COLOURS, SCALE
from isogi_core.model.lights import Light
from isogi_core.model.lobes import Lobe
from isogi_core.model.plan import Layer
from isogi_core.model.scene import Scene
from isogi_core.model.view import SHADINGS
from isogi_core.plan.savings import S1_BYTES
from server.params import FrameParams
from server.values import Span

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from worker.outlook import TimeLeft

Triple = tuple[float, float, float]
DEFAULTS = (
    *("azimuth", "elevation", "distance", "fov", "yaw", "pitch", "roll"),
    *("width", "height", "shading"),
)


class SceneLink(BaseModel):
    """One scene in the list of scenes; ``volume`` is the address of its volume where that was uploaded."""

    id: str
    name: str
    href: str
    volume: str | None = None


class UploadLimits(BaseModel):
    """What an upload may be: ``limit_bytes`` itself, and ``free_bytes`` of ``quota_bytes`` that all may take."""

    limit_bytes: int
    quota_bytes: int
    free_bytes: int


class SceneList(BaseModel):
    """All scenes that this server shows, and what may be uploaded; null where nothing may."""

    scenes: list[SceneLink]
    uploads: UploadLimits | None


class UploadFacts(BaseModel):
    """An uploaded volume: voxels along x, y, z, bytes on the disk, and the address of the scene that shows it."""

    id: str
    name: str
    href: str
    scene: str
    size: tuple[int, int, int]
    bytes: int


class UploadList(BaseModel):
    """All uploaded volumes, and what may be uploaded; null where nothing may."""

    volumes: list[UploadFacts]
    uploads: UploadLimits | None


class VolumeFacts(BaseModel):
    """A volume: voxels and spacing along x, y, z; holes are voxels that are not finite."""

    name: str
    size: tuple[int, int, int]
    spacing: Triple
    dtype: str
    value_range: tuple[float, float]
    holes: int


class Histogram(BaseModel):
    """Voxels per bin, and the bins' edges in the volume's own units (one more than counts)."""

    counts: list[int]
    edges: list[float]


class Range(BaseModel):
    """What a parameter may be, both ends included."""

    min: float
    max: float


class PresetFacts(BaseModel):
    """An isovalue with a name; ``suggested`` where it was found in the volume, not told by the scene."""

    name: str
    isovalue: float
    suggested: bool


class ErrorScale(BaseModel):
    """The colours of ``overlay=error``: sRGB at equal steps of the logarithm, from the error ``low`` to ``high``."""

    low: float
    high: float
    colours: list[str]


class LightFacts(BaseModel):
    """One light of a scene."""

    type: str
    name: str


class SavingFacts(BaseModel):
    """What was saved: an amount of a unit, measured or else computed."""

    amount: float
    unit: str
    measured: bool


class Omission(BaseModel):
    """Something that this scene does not need, why, and what that saves beside the same plan with it.

    S1's harmonics, where a texel keeps none, are counted beside what S1 keeps for any scene.
    """

    what: str
    why: str
    saves: list[SavingFacts]


class LayerFacts(BaseModel):
    """One kind of light that each texel keeps: order² numbers for each channel, in multiples of the scale.

    Bands from ``coarse`` on are bytes, where it is not null. Where there are ``nodes``, channels are of grey surfaces
    with these albedos, and light of any other is mixed of theirs.
    """

    kind: str
    order: int
    channels: int
    precision: str
    coarse: int | None
    scale: float
    nodes: list[float]
    bytes_per_texel: int


class TexelFacts(BaseModel):
    """Texels and chunks of the lattice, those that some view can show, and shown ones that can hold no light.

    A chunk has ``chunk`` texels along each side.
    """

    total: int
    shown: int
    void: int
    chunks: int
    shown_chunks: int
    chunk: int


class LobeFacts(BaseModel):
    """A small bright part of the unturned light: where it stands and its apparent diameter, in degrees.

    ``irradiance`` is what a surface that faces it receives, linear RGB.
    """

    azimuth: float
    elevation: float
    angle: float
    irradiance: list[float]


class PlanFacts(BaseModel):
    """What is stored per texel for this scene, the errors that are expected of it, and what was left out.

    ``indirect_order`` is that of reflected light, null where that has no harmonics of its own; ``samples``
    are the most that a texel takes; ``lobes`` are lit by shadow rays, beside the harmonics; ``errors`` are relative,
    by what is cut off. ``full_bytes_per_texel`` is what S1 keeps for any scene. ``sharpen`` is whether a view at rest
    has texels of its own on the isosurface that it shows, ``adaptive`` whether every second texel does where light is
    smooth.
    """

    representation: str
    order: int
    indirect_order: int | None
    channels: int
    bounces: int
    bytes_per_texel: int
    full_bytes_per_texel: int
    precision: str
    samples: int
    lobes: list[LobeFacts]
    sharpen: bool
    adaptive: bool
    layers: list[LayerFacts]
    errors: dict[str, float]
    notes: list[str]
    texels: TexelFacts
    left_out: list[Omission]


class SceneFacts(BaseModel):
    """What a client needs to show a scene: facts, histogram, defaults and ranges of every knob, plan.

    ``read_only`` is whether the store can only be read, so that nothing more is baked: a note of the plan says so too.

    ``presets`` are isovalues worth a look: the scene's own, else boundaries between materials in its volume.
    ``rotating`` is whether the light may be turned, ``turns`` whether that shows: not where the light is the
    same from all sides. ``albedos`` are those that a view may ask for, null where it may not.
    """

    id: str
    name: str
    volume: VolumeFacts
    histogram: Histogram
    defaults: dict[str, float | str]
    ranges: dict[str, Range]
    presets: list[PresetFacts]
    shadings: list[str]
    lights: list[LightFacts]
    albedo: Triple
    albedos: Range | None
    bounces: int
    solid: str
    target_error: float
    rotating: bool
    turns: bool
    error_scale: ErrorScale
    plan: PlanFacts
    read_only: bool


class ChunkCounts(BaseModel):
    """Chunks that the view reads, and how many of them are final."""

    needed: int
    final: int


class PixelCounts(BaseModel):
    """Pixels on the surface, by state."""

    surface: int
    final: int
    converging: int
    provisional: int


class Shares(BaseModel):
    """Shares of the surface pixels, by state."""

    final: float
    converging: float
    provisional: float


class TimeLeftFacts(BaseModel):
    """Seconds until all pixels are final: most likely, and the range that they are likely in."""

    low: float
    likely: float
    high: float


class Coverage(BaseModel):
    """How far a view is: chunks, pixels by state, estimated relative RMSE of the frame.

    ``time_left`` is null where it is unknown, or nobody works on the view.
    """

    chunks: ChunkCounts
    pixels: PixelCounts
    coverage: Shares
    error: float
    provisional: bool
    time_left: TimeLeftFacts | None


def scene_facts(scene: Scene) -> SceneFacts:
    """The document of one scene."""
    counts, edges = scene.volume.histogram()
    return SceneFacts(
        id=scene.id,
        name=scene.name,
        volume=volume_facts(scene),
        histogram=Histogram(counts=counts.tolist(), edges=edges.tolist()),
        defaults=defaults(scene),
        ranges=ranges(scene),
        presets=[PresetFacts(**asdict(preset)) for preset in scene.presets],
        shadings=list(SHADINGS),
        lights=[light_facts(light) for light in scene.lights],
        albedo=scene.albedo,
        albedos=None if scene.albedos is None else Range(min=scene.albedos[0], max=scene.albedos[1]),
        bounces=scene.bounces,
        solid=scene.solid,
        target_error=scene.target_error,
        rotating=scene.rotating,
        turns=scene.rotating and scene.plan.representation == "transfer",
        error_scale=ErrorScale(low=SCALE[0], high=SCALE[1], colours=list(COLOURS)),
        plan=plan_facts(scene),
        read_only=False,
    )


def volume_facts(scene: Scene) -> VolumeFacts:
    """The facts of a scene's volume."""
    volume = scene.volume
    names = ("name", "size", "spacing", "dtype", "value_range", "holes")
    return VolumeFacts(**{name: getattr(volume, name) for name in names})


def light_facts(light: Light) -> LightFacts:
    """One light: its type as in a scene file, and its name for a person."""
    return LightFacts(type=type(light).__name__.removesuffix("Light").lower(), name=light.name)


def plan_facts(scene: Scene) -> PlanFacts:
    """The scene's plan, and which of its texels are ever lit."""
    plan = scene.plan
    return PlanFacts(
        representation=plan.representation,
        order=plan.order,
        indirect_order=plan.indirect_order,
        channels=plan.channels,
        bounces=plan.bounces,
        bytes_per_texel=plan.bytes_per_texel,
        full_bytes_per_texel=S1_BYTES,
        precision=plan.precision,
        samples=plan.samples,
        lobes=[lobe_facts(lobe) for lobe in scene.needs.lobes[: plan.lobes]],
        sharpen=scene.sharpen,
        adaptive=scene.adaptive,
        layers=[layer_facts(layer) for layer in plan.layers],
        errors=dict(plan.errors),
        notes=list(plan.notes),
        texels=TexelFacts(**asdict(scene.texels)),
        left_out=[Omission(**asdict(each)) for each in scene.left_out],
    )


def lobe_facts(lobe: Lobe) -> LobeFacts:
    """One lobe of a light."""
    return LobeFacts(
        azimuth=lobe.azimuth, elevation=lobe.elevation, angle=lobe.angle, irradiance=lobe.irradiance.tolist()
    )


def layer_facts(layer: Layer) -> LayerFacts:
    """One layer of a plan."""
    names = ("kind", "order", "channels", "precision", "coarse", "scale", "bytes_per_texel")
    return LayerFacts(**{name: getattr(layer, name) for name in names}, nodes=list(layer.nodes))


def defaults(scene: Scene) -> dict[str, float | str]:
    """What each parameter is where it is left out."""
    fixed: dict[str, Any] = {name: FrameParams.model_fields[name].default for name in DEFAULTS}
    albedo = {} if scene.albedos is None else {"albedo": albedo_told(scene)}
    return {"isovalue": scene.isovalue, **fixed, **albedo, "exposure": scene.default_exposure}


def albedo_told(scene: Scene) -> float | str:
    """The scene's albedo as a query has it: one number where it is grey."""
    grey = len({*scene.albedo}) == 1
    return scene.albedo[0] if grey else ",".join(f"{share:.6g}" for share in scene.albedo)


def ranges(scene: Scene) -> dict[str, Range]:
    """What each number may be."""
    spans = {
        name: Range(min=span.low, max=span.high)
        for name, field in FrameParams.model_fields.items()
        for span in field.metadata
        if isinstance(span, Span)
    }
    told = {"isovalue": scene.isovalues} | ({} if scene.albedos is None else {"albedo": scene.albedos})
    return {**{name: Range(min=low, max=high) for name, (low, high) in told.items()}, **spans}


def coverage_facts(frame: Frame, time_left: TimeLeft | None) -> Coverage:
    """How far the frame is."""
    return Coverage(
        chunks=ChunkCounts(needed=frame.chunks_needed, final=frame.chunks_final),
        pixels=PixelCounts(surface=frame.surface, **frame.counts),
        coverage=Shares(**frame.coverage),
        error=frame.estimated_error,
        provisional=frame.provisional,
        time_left=None if time_left is None else TimeLeftFacts(**asdict(time_left)),
    )
