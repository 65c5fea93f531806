"""Schemas of the documents about scenes, volumes and frames."""

from pydantic import BaseModel

Triple = tuple[float, float, float]
Row = tuple[float, float, float, float]


class SceneLink(BaseModel):
    """One scene in the list of scenes; ``volume`` is the address of its volume if that was
    uploaded.
    """

    id: str
    name: str
    href: str
    volume: str | None = None


class UploadLimits(BaseModel):
    """Limits of uploads: ``limit_bytes`` of one, ``limit_files`` in an archive, and the
    ``free_bytes`` that are left of ``quota_bytes`` for all.
    """

    limit_bytes: int
    limit_files: int
    quota_bytes: int
    free_bytes: int


class SceneList(BaseModel):
    """All scenes of this server, and the limits of uploads; null if it takes none."""

    scenes: list[SceneLink]
    uploads: UploadLimits | None


class UploadSchema(BaseModel):
    """An uploaded volume: its voxels along x, y, z, its bytes on disk, and the address of the
    scene that shows it.
    """

    id: str
    name: str
    href: str
    scene: str
    size: tuple[int, int, int]
    bytes: int


class UploadList(BaseModel):
    """All uploaded volumes, and the limits of uploads; null if the server takes none."""

    volumes: list[UploadSchema]
    uploads: UploadLimits | None


class VolumeSchema(BaseModel):
    """A volume: voxels and spacing along x, y, z; ``holes`` counts voxels that are not finite.

    ``affine`` (3, 4) maps voxel indices to the world, whose lengths have the ``unit``, empty if
    unknown. ``letters`` are the patient directions of the world's axes, ``axes`` those of the
    voxels'; empty for other volumes. ``bounds`` are the least and the greatest world x, y, z.
    ``notes`` say how the field of the file was changed, and ``read_as`` which format the file was
    taken for, empty without a file. The volume is step ``time`` of a series of ``times``, 0 of 1 if
    it is no series.
    """

    name: str
    size: tuple[int, int, int]
    spacing: Triple
    dtype: str
    value_range: tuple[float, float]
    holes: int
    affine: tuple[Row, Row, Row]
    unit: str
    letters: str
    axes: str
    bounds: tuple[Triple, Triple]
    notes: list[str]
    read_as: str = ""
    time: int
    times: int


class Histogram(BaseModel):
    """Voxels per bin, and the edges of the bins in the volume's units (one more than counts).

    Edges are evenly spaced, or, if ``logarithmic``, have even ratios except for the first.
    """

    counts: list[int]
    edges: list[float]
    logarithmic: bool


class Range(BaseModel):
    """The range of a parameter, both ends included."""

    min: float
    max: float


class PresetSchema(BaseModel):
    """An isovalue with a name; ``suggested`` if it was found in the volume, and not given by
    the scene.
    """

    name: str
    isovalue: float
    suggested: bool


class ErrorScale(BaseModel):
    """The colours of ``overlay=error``: sRGB at equal steps of the logarithm, from the error
    ``low`` to ``high``.
    """

    low: float
    high: float
    colours: list[str]


class LabelSchema(BaseModel):
    """A label of a segmentation: its value, its name, its colour as sRGB, and ``shown`` if it
    is visible.
    """

    value: int
    name: str
    colour: str
    shown: bool


class ColourScale(BaseModel):
    """The colours of a surface by data: the name of the quantity, the name of the map, and sRGB at
    equal steps from ``low`` to ``high``.

    ``outside`` is the colour of places without a value. ``labels`` are those of a segmentation;
    ``colours`` are then those of the visible labels.
    """

    name: str
    map: str
    low: float
    high: float
    colours: list[str]
    outside: str
    labels: list[LabelSchema]


class LightSchema(BaseModel):
    """One light of a scene."""

    type: str
    name: str


class SavingSchema(BaseModel):
    """A saving: an amount of a unit, measured or computed."""

    amount: float
    unit: str
    measured: bool


class Omission(BaseModel):
    """Something that this scene does not need, the reason, and the saving compared with the same
    plan including it.

    If texels keep no harmonics, the saving is compared with the coefficients that S1 keeps for any
    scene.
    """

    what: str
    why: str
    saves: list[SavingSchema]


class LayerSchema(BaseModel):
    """One kind of light that each texel keeps: order² numbers for each channel, in multiples of the
    scale.

    Bands from ``coarse`` on are single bytes; null if there are none. If there are ``nodes``,
    channels belong to grey surfaces with these albedos, and light for other albedos is
    interpolated.
    """

    kind: str
    order: int
    channels: int
    precision: str
    coarse: int | None
    scale: float
    nodes: list[float]
    bytes_per_texel: int


class TexelSchema(BaseModel):
    """Counts of texels and chunks of the lattice, of those that some view can show, and of shown
    texels that can hold no light (``void``).

    A chunk has ``chunk`` texels along each side.
    """

    total: int
    shown: int
    void: int
    chunks: int
    shown_chunks: int
    chunk: int


class LobeSchema(BaseModel):
    """A small bright part of the unturned light: its direction and apparent diameter, in degrees.

    ``irradiance`` is the irradiance of a surface that faces it, linear RGB.
    """

    azimuth: float
    elevation: float
    angle: float
    irradiance: list[float]


class PlanSchema(BaseModel):
    """The light that is stored per texel for this scene, the expected errors, and the omissions.

    ``indirect_order`` is the order of reflected light, null if that has no harmonics; paths
    continue in ``branches`` ways from their first hit; ``samples`` is the largest number for a
    texel; ``lobes`` are lit by shadow rays; ``errors`` are relative. ``full_bytes_per_texel`` is
    the amount that S1 keeps. ``projected`` are ranges of isovalues in which texels are projected.
    """

    representation: str
    order: int
    indirect_order: int | None
    channels: int
    bounces: int
    branches: int
    bytes_per_texel: int
    full_bytes_per_texel: int
    precision: str
    samples: int
    lobes: list[LobeSchema]
    projected: list[tuple[float, float]]
    layers: list[LayerSchema]
    errors: dict[str, float]
    notes: list[str]
    texels: TexelSchema
    left_out: list[Omission]


class EnvironmentSchema(BaseModel):
    """Light in which a scene may be shown: its id for views, its name, and its address if it
    was uploaded.
    """

    id: str
    name: str
    href: str | None = None


class EnvironmentList(BaseModel):
    """All environments that views may name, and the limits of uploads; null if the server takes
    none.
    """

    environments: list[EnvironmentSchema]
    uploads: UploadLimits | None


class SurfaceSchema(BaseModel):
    """A pinned isosurface: its ``name``, empty if it has none, the ``albedo`` of both sides,
    linear RGB, the share of rays that pass straight through it, ``clear``, and the share of
    light that it transmits diffusely, ``transmission``, linear RGB.
    """

    isovalue: float
    name: str
    albedo: Triple
    transmission: Triple = (0.0, 0.0, 0.0)
    clear: float


class MaterialSchema(BaseModel):
    """A material that views may ask for by its ``kind``, with its default ``numbers``, each one
    number or linear RGB.

    ``refused`` is the reason why this scene cannot have it, null if it can.
    """

    kind: str
    numbers: dict[str, float | Triple] = {}
    refused: str | None = None


class SceneSchema(BaseModel):
    """All that a client needs to show a scene: facts, histogram, defaults and ranges of all
    parameters, and the plan.

    ``environment`` is the id of the light that the document is about, null for the scene's;
    ``environments`` are those that views may name.

    ``read_only`` is true if the store can only be read, so that nothing more is baked; a note of
    the plan says so too.

    ``presets`` are interesting isovalues: the scene's, else boundaries between materials in the
    volume. ``stops`` are ascending isovalues between which the surface moves about equally far;
    ``stops_note`` says where they are evenly spaced instead, empty if nowhere. ``rotating`` is true
    if the light may be rotated, ``turns`` if a rotation is visible: it is not if the light is the
    same from all sides. ``turn_step`` is the step in degrees to which yaw, pitch and roll are
    rounded if light is baked for each turn, null if all turns share the light that is kept.
    ``albedos`` is the range that views may ask for, null if they may not. ``shines`` are the kinds
    of shine that views may ask for, none if the surface is diffuse. ``cuts`` is true if the voxels
    lie along the world's axes, so that planes across these may cut the volume. ``colours`` is the
    scale of a surface whose albedo comes from data; ``albedo`` is then the most that it reflects.
    ``surfaces`` are pinned isosurfaces; the sliding one lets the share ``clear`` of rays pass, and
    transmits ``transmission`` diffusely. ``material`` is the present material as views spell it,
    and ``materials`` are all, with reasons why some are refused. ``view`` holds the parameters of
    the first view that the scene file gives.
    """

    id: str
    name: str
    volume: VolumeSchema
    histogram: Histogram
    defaults: dict[str, float | str]
    ranges: dict[str, Range]
    presets: list[PresetSchema]
    stops: list[float]
    stops_note: str
    shadings: list[str]
    lights: list[LightSchema]
    albedo: Triple
    albedos: Range | None
    colours: ColourScale | None
    surfaces: list[SurfaceSchema]
    clear: float
    transmission: Triple
    material: str
    materials: list[MaterialSchema]
    shines: list[str]
    bounces: int
    cuts: bool
    solid: str
    target_error: float
    environment: str | None = None
    environments: list[EnvironmentSchema] = []
    rotating: bool
    turns: bool
    turn_step: float | None
    view: dict[str, float | str | Triple]
    error_scale: ErrorScale
    plan: PlanSchema
    read_only: bool


class CameraSchema(BaseModel):
    """A camera on its orbit: angles in degrees, the distance from the target in radii of the
    volume, and the target in the world.
    """

    azimuth: float
    elevation: float
    distance: float
    target: Triple


class ChunkCounts(BaseModel):
    """The number of chunks that the view reads, and of those that are final."""

    needed: int
    final: int


class PixelCounts(BaseModel):
    """Numbers of surface pixels, by state."""

    surface: int
    final: int
    converging: int
    provisional: int


class Shares(BaseModel):
    """Shares of surface pixels, by state."""

    final: float
    converging: float
    provisional: float


class TimeLeftSchema(BaseModel):
    """Seconds until all pixels are final: the most likely number, and the likely range."""

    low: float
    likely: float
    high: float


class Coverage(BaseModel):
    """The state of a view: chunks, pixels by state, and the ``error`` of the frame, its total
    relative RMSE.

    The error is measured by ``controls`` control pixels, with a 95 % ``interval``; without any it
    is a prediction, and the interval is null. ``noise`` is the part of it that is noise. 99 % of
    the pixels have an error below ``p99``, with a 95 % ``p99_interval``; both are null if that is
    not measured. ``time_left`` is null if it is unknown, or if no worker is at the view;
    ``overdue`` is true once the work takes longer than was predicted.
    """

    chunks: ChunkCounts
    pixels: PixelCounts
    coverage: Shares
    error: float
    noise: float
    interval: tuple[float, float] | None
    controls: int
    p99: float | None
    p99_interval: tuple[float, float] | None
    provisional: bool
    time_left: TimeLeftSchema | None
    overdue: bool


class PointSchema(BaseModel):
    """The surface point of one pixel; all members but ``hit`` and ``unit`` are null if it shows no
    surface.

    ``position`` and the outward unit ``normal`` are in the world, whose lengths have the ``unit``,
    empty if unknown; ``sides`` are the sides of a patient on which the coordinates lie, such as
    "LAS", empty for other volumes. ``voxel`` are voxel indices, x first. ``value`` is the value of
    the volume, null on the ``wall`` with that number. ``light`` is linear RGB, ``displayed`` the
    same as a picture shows it, sRGB. ``state`` is final, converging or provisional, and ``error``
    the relative error of this pixel.
    """

    hit: bool
    unit: str
    position: Triple | None = None
    sides: str | None = None
    voxel: Triple | None = None
    value: float | None = None
    wall: int | None = None
    normal: Triple | None = None
    light: Triple | None = None
    displayed: str | None = None
    state: str | None = None
    error: float | None = None


class SizeSchema(BaseModel):
    """Area of a surface and volume of the solid, in squares and cubes of the ``unit``, which is
    empty if unknown.

    ``area`` is 0 if there is no surface. ``area_error`` and ``volume_error`` are the uncertainties
    due to the size of voxels, in the same units. ``is_open`` is true if the solid reaches a side of
    the volume, where it is taken to end.
    """

    isovalue: float
    unit: str
    area: float
    area_error: float
    volume: float
    volume_error: float
    is_open: bool
