"""What a page needs to draw a scene on its visitor's graphics card, as JSON: see docs/card.md."""

from pydantic import BaseModel

from isogi_core.prepared.active_cell_maps import CodeType
from server.schemas import Triple

Colours = tuple[list[float], list[float], list[float]]
"""Harmonics of red, green and blue."""


class CardGrid(BaseModel):
    """Voxels along x, y, z, and the world: ``world = rotation · box + origin``, ``box = voxel index
    · spacing``.

    Shadow rays start ``offset`` voxels along the normal, which is that of the B-spline's gradient
    where ``smooth``.
    """

    size: tuple[int, int, int]
    spacing: Triple
    rotation: tuple[Triple, Triple, Triple]
    origin: Triple
    offset: float
    smooth: bool


class CardValues(BaseModel):
    """A value in the units of the volume's file is ``offset + scale · voxel``."""

    offset: float
    scale: float
    core: tuple[float, float]


class CardSlab(BaseModel):
    """Layers of voxels from the ``first`` to before the ``last``, and the address of their
    codes.
    """

    first: int
    last: int
    href: str


class CardVolume(BaseModel):
    """Codes of voxels: ``voxel = base + gain · code``, but for the code ``hole`` where a value is
    missing.
    """

    type: CodeType
    gain: float
    base: float
    hole: float | None
    bytes: int
    slabs: list[CardSlab]


class CardLattice(BaseModel):
    """Texels along x, y, z, texels a voxel, and texels along each side of a chunk."""

    size: tuple[int, int, int]
    density: Triple
    chunk: int


class CardLayer(BaseModel):
    """A layer of light that texels keep, and the order of its harmonics."""

    kind: str
    order: int


class CardPlan(BaseModel):
    """What texels keep: ``columns`` numbers for each channel, from ``straight`` on of reflected
    light alone.

    ``ratios`` is whether light is carried to pixels as irradiance ratios, ``whole`` whether texels
    keep direct and reflected light as one, and ``turns`` whether the light may be turned.
    """

    representation: str
    channels: int
    columns: int
    straight: int
    ratios: bool
    whole: bool
    turns: bool
    layers: list[CardLayer]


class CardTerm(BaseModel):
    """The unturned light that some columns meet: harmonics of an order, linear RGB times the
    albedo, in the unit.

    Those of the square of its luminance say how noisy light is.
    """

    order: int
    light: Colours
    square: list[float]


class CardLobe(BaseModel):
    """An unturned lobe of the light: where it is, two radii of its disc, and what it gives from
    straight above.
    """

    towards: Triple
    edges: tuple[Triple, Triple]
    shine: Triple


class CardLight(BaseModel):
    """The unturned light in a ``unit`` of radiance: the terms, the ``sky`` without shadows, the
    least, the lobes.
    """

    unit: float
    terms: list[CardTerm]
    sky: Colours
    least: Triple
    lobes: list[CardLobe]


class CardLambert(BaseModel):
    """The key light of the request's view: radiance is ``ambient + max(normal · key, 0) · sun``."""

    key: Triple
    sun: Triple
    ambient: Triple


class CardTone(BaseModel):
    """Constants of the tone curve."""

    gain: float
    toe: float
    shoulder: float


class CardGrounds(BaseModel):
    """Linear RGB of the backgrounds that have names."""

    dark: Triple
    light: Triple


class CardLimits(BaseModel):
    """Chunks of one request, and bytes of a volume, at most."""

    chunks: int
    bytes: int


class CardLinks(BaseModel):
    """Addresses beside the document: of the list of chunks, and before the names of chunks."""

    chunks: str
    light: str
    transfer: str


class CardScene(BaseModel):
    """A scene as a graphics card draws it."""

    grid: CardGrid
    values: CardValues
    volume: CardVolume
    lattice: CardLattice
    plan: CardPlan
    light: CardLight
    lambert: CardLambert
    exposure: float
    tone: CardTone
    grounds: CardGrounds
    isovalues: tuple[float, float]
    target: float
    expected: float
    limits: CardLimits
    links: CardLinks


class CardSchema(BaseModel):
    """Whether a page may draw a view by itself, ``because`` of what it may not and the ``reason``,
    else its scene.
    """

    format: int
    drawable: bool
    because: list[str]
    reason: str
    scene: CardScene | None
    version: str


class CardChunk(BaseModel):
    """A chunk of texels by its place ``z.y.x``, how far it is baked, and whether all that the view
    reads is final.
    """

    at: str
    version: str
    final: bool


class CardChunks(BaseModel):
    """The chunks that a view reads, most visible first, and how many of them are going to have more
    light.
    """

    chunks: list[CardChunk]
    coming: int
