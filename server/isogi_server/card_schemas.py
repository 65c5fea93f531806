"""Schemas of the data with which a page draws a scene on its visitor's graphics card: see
docs/card.md.
"""

from typing import Literal

from pydantic import BaseModel

from isogi_core.prepared.active_cell_maps import CodeType
from isogi_server.schemas import Triple

Colours = tuple[list[float], list[float], list[float]]
"""Harmonics of red, green and blue."""


class CardGrid(BaseModel):
    """Voxels along x, y, z, and their place in the world: ``world = rotation · box + origin``,
    ``box = voxel index · spacing``.

    Shadow rays start ``offset`` voxels along the normal, which is the gradient of the B-spline if
    ``smooth``.
    """

    size: tuple[int, int, int]
    spacing: Triple
    rotation: tuple[Triple, Triple, Triple]
    origin: Triple
    offset: float
    smooth: bool


class CardValues(BaseModel):
    """Units of voxels: a value in the units of the volume's file is ``offset + scale · voxel``."""

    offset: float
    scale: float
    core: tuple[float, float]


class CardSlab(BaseModel):
    """Layers of voxels, from the ``first`` to the one before the ``last``, and the address of
    their codes.
    """

    first: int
    last: int
    href: str


class CardVolume(BaseModel):
    """Codes of voxels: ``voxel = base + gain · code``; the code ``hole`` marks missing values."""

    type: CodeType
    gain: float
    base: float
    hole: float | None
    bytes: int
    slabs: list[CardSlab]


class CardColours(BaseModel):
    """Colours by data at places ``step`` voxels apart, ``size`` along x, y, z: codes of values, or
    two labels and the share of the second in units of 1/510.

    The ``table`` has the albedo of each code, linear RGB; code 0 stands for no value, and codes
    beyond the table have its albedo. Light of texels is of the ``brightest`` albedo.
    """

    kind: Literal["values", "labels"]
    size: tuple[int, int, int]
    step: Triple
    table: list[Triple]
    brightest: Triple
    bytes: int
    slabs: list[CardSlab]


class CardSurroundings(BaseModel):
    """The light from far away as lat-long images in its own axes, ``rows`` × 2 rows at first and
    half of that at each further level, and the address of all: halves of linear RGB, in units of
    ``brightness``.
    """

    rows: int
    levels: int
    brightness: float
    bytes: int
    href: str


class CardShine(BaseModel):
    """The shine of a surface: ``kind``, ``roughness`` and ``strength`` of its lobe, as the view
    asks for them; others need no other document.

    Head on, metal mirrors its ``albedo``, and plastic the share ``plastic``.
    """

    kind: str
    roughness: float
    strength: float
    plastic: float
    albedo: Triple
    surroundings: CardSurroundings


class CardLattice(BaseModel):
    """The lattice: texels along x, y, z, texels per voxel, and texels along each side of a
    chunk.
    """

    size: tuple[int, int, int]
    density: Triple
    chunk: int


class CardLayer(BaseModel):
    """A layer of light that texels keep, and the order of its harmonics."""

    kind: str
    order: int


class CardPlan(BaseModel):
    """The light that texels keep: ``columns`` numbers for each channel, of reflected light only
    from ``straight`` on.

    ``ratios`` is true if pixels interpolate irradiance ratios, ``whole`` if texels keep direct and
    reflected light as one, ``turns`` if the light may be rotated: the document then has it in the
    axes of the world, else in those of the volume's box.
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
    """The unturned light that some columns are multiplied by: harmonics of an order, linear RGB
    times the albedo, in the unit.

    ``square`` are the harmonics of its squared luminance, from which noise is estimated.
    """

    order: int
    light: Colours
    square: list[float]


class CardLobe(BaseModel):
    """An unturned lobe of the light: its direction, two radii of its disc, and its radiance on
    a surface that faces it.
    """

    towards: Triple
    edges: tuple[Triple, Triple]
    shine: Triple


class CardLight(BaseModel):
    """The unturned light in a ``unit`` of radiance: terms, the ``sky`` without shadows, the
    least light, and lobes.
    """

    unit: float
    terms: list[CardTerm]
    sky: Colours
    least: Triple
    lobes: list[CardLobe]


class CardModel(BaseModel):
    """Constants of the local models: the direction to the key light, its light and that of all
    other light on the albedo, and strength and exponent of Phong's highlight.

    The key is unturned, and ``follows`` the light's rotation, nothing, or the camera. In the last
    case ``key`` has no meaning.
    """

    key: Triple
    follows: Literal["nothing", "light", "camera"]
    sun: Triple
    ambient: Triple
    gloss: float
    exponent: float


class CardSide(BaseModel):
    """The light on one side of a surface without shadows, unturned: the ``sky``, and the least
    light.
    """

    sky: Colours
    least: Triple


class CardSurface(BaseModel):
    """One of several surfaces: its ``isovalue`` in the units of the file, null for the one that
    slides; the share ``clear`` of rays that pass it; and its ``albedo`` over that of local models.

    Its outer side is towards lower values, its inner side towards higher ones.
    """

    isovalue: float | None
    clear: float
    albedo: Triple
    outer: CardSide
    inner: CardSide


class CardTone(BaseModel):
    """Constants of the tone curve."""

    gain: float
    toe: float
    shoulder: float


class CardGrounds(BaseModel):
    """Linear RGB of the named backgrounds."""

    dark: Triple
    light: Triple


class CardLimits(BaseModel):
    """Chunks of one request, and bytes of a volume, at most."""

    chunks: int
    bytes: int


class CardLinks(BaseModel):
    """Addresses relative to the document: of the list of chunks, and of light and transfer
    before the names of chunks.
    """

    chunks: str
    light: str
    transfer: str


class CardScene(BaseModel):
    """A scene as a graphics card draws it."""

    grid: CardGrid
    values: CardValues
    volume: CardVolume
    colours: CardColours | None
    shine: CardShine | None
    lattice: CardLattice
    plan: CardPlan
    light: CardLight
    surfaces: list[CardSurface] | None
    model: CardModel
    exposure: float
    tone: CardTone
    grounds: CardGrounds
    isovalues: tuple[float, float]
    target: float
    expected: float
    limits: CardLimits
    links: CardLinks


class CardSchema(BaseModel):
    """If ``drawable``, a page may draw the view itself, by its ``scene``; else ``because``
    names the obstacles, and ``reason`` describes them.
    """

    format: int
    drawable: bool
    because: list[str]
    reason: str
    scene: CardScene | None
    version: str


class CardChunk(BaseModel):
    """A chunk of texels: its index ``z.y.x``, the version of its light, and ``final`` if all
    that the view reads of it is final.
    """

    at: str
    version: str
    final: bool


class CardChunks(BaseModel):
    """The chunks that a view reads, most visible first, and the number of those that will get
    more light.
    """

    chunks: list[CardChunk]
    coming: int
