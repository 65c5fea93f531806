"""Schemas: the documents that isogi answers about scenes, volumes and frames."""

from pydantic import BaseModel

Triple = tuple[float, float, float]
Row = tuple[float, float, float, float]


class SceneLink(BaseModel):
    """One scene in the list of scenes; ``volume`` is the address of its volume where that was
    uploaded.
    """

    id: str
    name: str
    href: str
    volume: str | None = None


class UploadLimits(BaseModel):
    """What an upload may be: ``limit_bytes`` itself, and ``limit_files`` in an archive; and
    ``free_bytes`` of ``quota_bytes`` that all may take.
    """

    limit_bytes: int
    limit_files: int
    quota_bytes: int
    free_bytes: int


class SceneList(BaseModel):
    """All scenes that this server shows, and what may be uploaded; null where nothing may."""

    scenes: list[SceneLink]
    uploads: UploadLimits | None


class UploadSchema(BaseModel):
    """An uploaded volume: voxels along x, y, z, bytes on the disk, and the address of the scene
    that shows it.
    """

    id: str
    name: str
    href: str
    scene: str
    size: tuple[int, int, int]
    bytes: int


class UploadList(BaseModel):
    """All uploaded volumes, and what may be uploaded; null where nothing may."""

    volumes: list[UploadSchema]
    uploads: UploadLimits | None


class VolumeSchema(BaseModel):
    """A volume: voxels and spacing along x, y, z; holes are voxels that are not finite.

    ``affine`` brings voxel indices to the world, (3, 4), whose lengths have the ``unit``, empty
    where unknown. ``letters`` say where the world's axes point in a patient, and ``axes`` where the
    voxels' do; empty elsewhere. ``bounds`` are the least and the greatest world x, y, z. ``notes``
    tell what was done to the file's field, and ``read_as`` what the file was taken for, empty where
    it is of no file. It is step ``time`` of a series of ``times``, 0 of 1 where it is none.
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
    """Voxels per bin, and the bins' edges in the volume's own units (one more than counts).

    Edges are even, or, where the axis is ``logarithmic``, at even ratios but for the first.
    """

    counts: list[int]
    edges: list[float]
    logarithmic: bool


class Range(BaseModel):
    """What a parameter may be, both ends included."""

    min: float
    max: float


class PresetSchema(BaseModel):
    """An isovalue with a name; ``suggested`` where it was found in the volume, not given by the
    scene.
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
    """A label of a segmentation: its value, its name, its colour as sRGB, and whether it is
    shown.
    """

    value: int
    name: str
    colour: str
    shown: bool


class ColourScale(BaseModel):
    """The surface's colours by data: what of, the name of the map, and sRGB at equal steps from
    ``low`` to ``high``.

    ``outside`` is where there is no value. ``labels`` are those of a segmentation; the ``colours``
    are then those of the labels that are shown.
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
    """What was saved: an amount of a unit, measured or else computed."""

    amount: float
    unit: str
    measured: bool


class Omission(BaseModel):
    """Something that this scene does not need, why, and what that saves beside the same plan with
    it.

    S1's harmonics, where a texel keeps none, are counted beside what S1 keeps for any scene.
    """

    what: str
    why: str
    saves: list[SavingSchema]


class LayerSchema(BaseModel):
    """One kind of light that each texel keeps: order² numbers for each channel, in multiples of the
    scale.

    Bands from ``coarse`` on are bytes, where it is not null. Where there are ``nodes``, channels
    are of grey surfaces with these albedos, and light of any other is mixed of theirs.
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
    """Texels and chunks of the lattice, those that some view can show, and shown ones that can hold
    no light.

    A chunk has ``chunk`` texels along each side.
    """

    total: int
    shown: int
    void: int
    chunks: int
    shown_chunks: int
    chunk: int


class LobeSchema(BaseModel):
    """A small bright part of the unturned light: where it stands and its apparent diameter, in
    degrees.

    ``irradiance`` is what a surface that faces it receives, linear RGB.
    """

    azimuth: float
    elevation: float
    angle: float
    irradiance: list[float]


class PlanSchema(BaseModel):
    """What is stored per texel for this scene, the errors that are expected of it, and what was
    left out.

    ``indirect_order`` is that of reflected light, null where that has no harmonics; paths go on in
    ``branches`` ways from their first hit; ``samples`` are a texel's most; ``lobes`` are lit by
    shadow rays; ``errors`` are relative. ``full_bytes_per_texel`` is what S1 keeps. ``projected``
    are isovalues, from one to another, whose views project.
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
    """Light that a scene may be shown in: what views call it, its name, and its address where it
    was uploaded.
    """

    id: str
    name: str
    href: str | None = None


class EnvironmentList(BaseModel):
    """Light that scenes may be shown in, and what may be uploaded; null where nothing may."""

    environments: list[EnvironmentSchema]
    uploads: UploadLimits | None


class SurfaceSchema(BaseModel):
    """A pinned isosurface: its ``name``, empty where it has none, the ``albedo`` of both its sides,
    linear RGB, and the share of rays that passes straight through it, ``clear``. Its
    ``transmission``, linear RGB, is what gets through diffuse.
    """

    isovalue: float
    name: str
    albedo: Triple
    transmission: Triple = (0.0, 0.0, 0.0)
    clear: float


class MaterialSchema(BaseModel):
    """A material that views may ask for by its ``kind``: its ``numbers`` where they give none, each
    one or linear RGB.

    Where this scene cannot be of it ``refused`` says why; it is null elsewhere.
    """

    kind: str
    numbers: dict[str, float | Triple] = {}
    refused: str | None = None


class SceneSchema(BaseModel):
    """What a client needs to show a scene: facts, histogram, defaults and ranges of every knob,
    plan.

    ``environment`` is the id of the light that this is about, null for the scene's own;
    ``environments`` are those that views may name.

    ``read_only`` is whether the store can only be read, so that nothing more is baked: a note of
    the plan says so too.

    ``presets`` are isovalues worth a look: the scene's own, else boundaries between materials in
    its volume. ``stops`` ascend through the range, and the surface moves about equally far from one
    to the next; ``stops_note`` says where they are even instead, and is empty where that is
    nowhere. ``rotating`` is whether the light may be turned, ``turns`` whether that shows: not
    where the light is the same from all sides. ``albedos`` are those that a view may ask for, null
    where it may not. ``shines`` are the kinds of shine that it may ask for, none where the surface
    is diffuse. ``cuts`` is whether planes across the world's axes may cut it: its voxels lie along
    them. ``colours`` are those of a surface whose albedo comes from data, null where it has one
    ``albedo``; that is then the most that colours reflect. ``surfaces`` are pinned beside the one
    that slides, which lets the share ``clear`` of rays pass, and of other light its
    ``transmission`` through, diffuse. ``material`` is what this is about, as views spell it, and
    ``materials`` are all, with why some of them are refused. ``view`` is what the scene says of its
    first view, by the names of parameters.
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
    view: dict[str, float | str | Triple]
    error_scale: ErrorScale
    plan: PlanSchema
    read_only: bool


class CameraSchema(BaseModel):
    """A camera on its orbit: angles in degrees, and the distance from the world's target in radii
    of the volume.
    """

    azimuth: float
    elevation: float
    distance: float
    target: Triple


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


class TimeLeftSchema(BaseModel):
    """Seconds until all pixels are final: most likely, and the range that they are likely in."""

    low: float
    likely: float
    high: float


class Coverage(BaseModel):
    """How far a view is: chunks, pixels by state, and the ``error`` of the frame: the total
    relative RMSE.

    Control pixels, ``controls`` of them, measured it, with a 95 % ``interval``; of none it is a
    prediction, and the interval null. ``noise`` is the noise in it. 99 % of the pixels have an
    error below ``p99``, with a 95 % ``p99_interval``; both are null where that is not measured.
    ``time_left`` is null where it is unknown, or no worker is at the view; it is ``overdue`` once
    the work takes longer than was said before.
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
    """What one pixel shows; all but ``hit`` and ``unit`` is null where it shows no surface.

    ``position`` and the outward unit ``normal`` are in the world, whose lengths have the ``unit``,
    empty where unknown; ``sides`` are the sides of a patient on which the coordinates lie, "LAS",
    empty elsewhere. ``voxel`` are voxel indices, x first. ``value`` is the volume's there, null on
    the ``wall`` with that number. ``light`` is linear RGB, ``displayed`` the same as a picture
    shows it, sRGB; ``state`` is final, converging or provisional, and ``error`` the relative error
    of this pixel.
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
    """Area of a surface, and volume of the solid, in squares and cubes of the ``unit``, which is
    empty where unknown.

    ``area`` is 0 where there is no surface. ``area_error`` and ``volume_error`` are what the
    voxels' size leaves open, in the same units. ``is_open`` is whether the solid reaches a side of
    the volume, where it is taken to end.
    """

    isovalue: float
    unit: str
    area: float
    area_error: float
    volume: float
    volume_error: float
    is_open: bool
