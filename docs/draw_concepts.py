"""Draw how a picture comes about, in a flat world: ``python docs/draw_concepts.py``.

Everything in the six panels is computed from one formula: the surface, the ray that hits it, the
texels around the hit, their paths, the error of the row of pixels, and its light. Writes
``docs/concepts.svg``.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import contourpy
import numpy as np

PICTURE = Path(__file__).with_name("concepts.svg")

WORLD = (8.0, 6.0)
"""Width and height of the flat world in cells of its lattice: a texel at each whole number."""

ISOVALUE = 0.5
ALBEDO = 0.8
BOUNCES = 3
EYE = np.array((0.25, 5.75))
AIM = np.array((4.6, 2.6))
FIELD_OF_VIEW = math.radians(34)
PIXELS = 24
REPLICAS = 16
TRUE_PATHS = 16384
RUNGS = (16, 32, 64, 128, 256, 512, 1024)
TARGET = 0.05
CHUNK = 3
"""The error at which the picture is final, and texels along a side of a chunk: 16 in isogi."""

PANEL = (330, 248)
MARGIN = 18
HEAD = 74
"""Pixels: a panel's drawing, the space around it, and its heading with two lines of text."""

STYLE = """text { font: 13px system-ui, sans-serif; fill: #4b5563 }
.head { font-size: 15px; font-weight: 700; fill: #1f2937 } .small { font-size: 11px }
path, line, polyline { fill: none }"""
INK = "#1f2937"
SOLID = "#d6d3d1"
EYE_RAY = "#c2410c"
TEXEL = "#1d4ed8"
PATH = "#b45309"

PANELS = """1  Eye ray
A ray through each pixel finds the isosurface.
The G-buffer keeps where, and the normal there.
2  Texel
The lattice points around the hit hold its light.
Each is lit on the isosurface through itself.
3  Chunk
Texels of cells that the surface crosses are baked,
and stored by chunks: here 3 a side, in isogi 16.
4  Bake
Paths leave a texel's point; each hit takes its share,
until they see the light, which may be turned later.
5  Noise
More samples, less noise. Control pixels measure
all error there is; the picture is final at the target.
6  Picture
Pixels interpolate their texels. Until these are lit,
light without shadows stands in, and is marked.""".splitlines()
"""The heading of each panel, and two lines of text."""


def field(points: np.ndarray) -> np.ndarray:
    """The values of the volume at ``points`` (..., 2): two blobs that run into each other."""
    x, y = points[..., 0], points[..., 1]
    large = np.exp(-((x - 3.0) ** 2 + (y - 2.0) ** 2) / 2.4)
    return large + 0.95 * np.exp(-((x - 5.8) ** 2 + (y - 3.4) ** 2) / 1.7)


def normals(points: np.ndarray) -> np.ndarray:
    """Unit normals (..., 2), out of what is solid."""
    steps = 1e-4 * np.eye(2)
    down = np.stack([field(points - step) - field(points + step) for step in steps], axis=-1)
    return down / np.linalg.norm(down, axis=-1, keepdims=True)


def sky(directions: np.ndarray) -> np.ndarray:
    """Radiance from ``directions`` (..., 2): a bright part up on the left, and a dim ground."""
    towards = directions @ (np.array((-0.75, 1.0)) / 1.25)
    return 0.04 + 0.2 * (directions[..., 1] > 0) + 1.1 * np.exp(-((1.0 - towards) / 0.25))


def cast(starts: np.ndarray, directions: np.ndarray, isovalues: np.ndarray) -> np.ndarray:
    """How far rays go (n,) until the field is above ``isovalues`` (n,); infinite where they leave
    the world.
    """
    step = 0.04
    reach = np.full(len(starts), np.inf)
    for far in np.arange(0.06, 10.0, step):
        going = np.isinf(reach)
        points = starts[going] + far * directions[going]
        reach[np.flatnonzero(going)[field(points) > isovalues[going]]] = far - 0.5 * step
    return reach


def gather(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """What ``count`` paths from each of the ``points`` (n, 2) bring on their isosurfaces, (n,
    count).
    """
    at = np.repeat(points, count, axis=0)
    level = field(at)
    throughput = np.ones(len(at))
    light = np.zeros(len(at))
    rows = np.arange(len(at))
    for _ in range(BOUNCES + 1):
        directions = scatter(normals(at), rng)
        reach = cast(at, directions, level[rows])
        out = np.isinf(reach)
        light[rows[out]] = throughput[rows[out]] * sky(directions[out])
        at = (at + np.where(out, 0.0, reach)[:, None] * directions)[~out]
        rows = rows[~out]
        throughput[rows] *= ALBEDO
    return light.reshape(len(points), count)


def scatter(around: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Directions (n, 2) about normals ``around``, by the cosine of their angle."""
    sine = rng.uniform(-1.0, 1.0, len(around))
    side = np.stack([-around[:, 1], around[:, 0]], axis=1)
    return sine[:, None] * side + np.sqrt(1.0 - sine**2)[:, None] * around


def eye_rays() -> np.ndarray:
    """Directions of the rays through PIXELS pixels, (n, 2)."""
    middle = math.atan2(*(AIM - EYE)[::-1])
    angles = middle + FIELD_OF_VIEW * ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def hits() -> tuple[np.ndarray, np.ndarray]:
    """Which pixels show the surface, (PIXELS,), and where, (m, 2): moved onto it by Newton's
    steps.
    """
    rays = eye_rays()
    reach = cast(np.repeat(EYE[None], PIXELS, axis=0), rays, np.full(PIXELS, ISOVALUE))
    seen = np.isfinite(reach)
    return seen, onto(EYE + reach[seen, None] * rays[seen])


def onto(points: np.ndarray) -> np.ndarray:
    """Points (m, 2) moved along the gradient onto the isosurface."""
    for _ in range(8):
        down = normals(points)
        slope = (field(points - 1e-4 * down) - field(points + 1e-4 * down)) / 2e-4
        points = points + ((field(points) - ISOVALUE) / slope)[:, None] * down
    return points


def corners(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four texels around each point, (m, 4, 2), and what they weigh, (m, 4)."""
    low = np.floor(points)
    offsets = np.array(((0, 0), (1, 0), (0, 1), (1, 1)))
    share = (points - low)[:, None]
    return low[:, None] + offsets, np.prod(np.where(offsets == 1, share, 1.0 - share), axis=2)


def unshadowed(points: np.ndarray) -> np.ndarray:
    """The light (m,) that points would have if nothing hid the sky from them."""
    angles = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cosines = np.maximum(normals(points) @ around.T, 0.0)
    return (cosines * sky(around)).sum(axis=1) / cosines.sum(axis=1)


class Light:
    """The light of the row of pixels: the ``truth`` (m,), what it shows after each rung, and what
    stands in before.
    """

    def __init__(self) -> None:
        rng = np.random.default_rng(20)
        self.seen, self.points = hits()
        self.truth = gather(self.points, TRUE_PATHS, rng).mean(axis=1)
        texels, weights = corners(self.points)
        places, inverse = np.unique(texels.reshape(-1, 2), axis=0, return_inverse=True)
        self.texels = places
        paths = gather(places, REPLICAS * RUNGS[-1], rng).reshape(len(places), REPLICAS, -1)
        shown = [
            paths[:, :, :count].mean(axis=2)[inverse].reshape(*weights.shape, REPLICAS)
            for count in RUNGS
        ]
        self.unshadowed = unshadowed(self.points)
        bare = unshadowed(places)[inverse].reshape(weights.shape)
        ratios = self.unshadowed / (weights * bare).sum(axis=1)
        after = [ratios[:, None] * (weights[..., None] * each).sum(axis=1) for each in shown]
        self.after = [each[:, 0] for each in after]
        self.noise = [self.relative(each - each.mean(axis=1, keepdims=True)) for each in after]
        self.errors = [self.relative(each - self.truth[:, None]) for each in after]

    def relative(self, errors: np.ndarray) -> float:
        """The root mean square of ``errors``, over the mean of the truth."""
        return math.sqrt((errors**2).mean()) / float(self.truth.mean())


def at(point: np.ndarray) -> str:
    """A point of the world in a panel, as SVG has it."""
    x = point[0] / WORLD[0] * PANEL[0]
    y = (1.0 - point[1] / WORLD[1]) * PANEL[1]
    return f"{x:.1f},{y:.1f}"


def line(points: list[np.ndarray], colour: str, width: float = 1.5, more: str = "") -> str:
    """A line through points of the world."""
    return (
        f'<polyline points="{" ".join(map(at, points))}" stroke="{colour}" '
        f'stroke-width="{width}" {more}/>'
    )


def dot(point: np.ndarray, colour: str, radius: float = 4.0, more: str = "") -> str:
    """A dot at a point of the world."""
    x, y = at(point).split(",")
    return f'<circle cx="{x}" cy="{y}" r="{radius}" fill="{colour}" {more}/>'


def contour(isovalue: float, fill: str, colour: str, width: float = 1.5) -> str:
    """The isosurface of an ``isovalue``."""
    x, y = np.linspace(0, WORLD[0], 161), np.linspace(0, WORLD[1], 121)
    values = field(np.stack(np.meshgrid(x, y), axis=-1))
    lines = contourpy.contour_generator(x, y, values).lines(isovalue)
    path = " ".join("M" + " L".join(at(point) for point in each) for each in lines)
    return f'<path d="{path}" style="fill:{fill}" stroke="{colour}" stroke-width="{width}"/>'


def lattice() -> Iterator[np.ndarray]:
    """All texels of the world."""
    for y in range(int(WORLD[1]) + 1):
        for x in range(int(WORLD[0]) + 1):
            yield np.array((x, y), float)


def is_needed(texel: np.ndarray) -> bool:
    """Whether a cell at the texel contains the isosurface."""
    cells = [texel + np.array((x, y)) for x in (-1, 0) for y in (-1, 0)]
    solid = [
        [bool(field(cell + np.array((i, j))) > ISOVALUE) for i in (0, 1) for j in (0, 1)]
        for cell in cells
    ]
    return any(any(each) and not all(each) for each in solid)


def draw_eye_ray(light: Light) -> Iterator[str]:
    """A ray through each pixel, one of them with its hit and normal."""
    yield contour(ISOVALUE, SOLID, INK)
    rays = eye_rays()
    chosen = len(light.points) // 2
    ends = EYE + 9.0 * rays
    ends[light.seen] = light.points
    for end in ends[::2]:
        yield line([EYE, end], "#fdba74", 1)
    point = light.points[chosen]
    yield line([EYE, point], EYE_RAY, 2)
    yield line([point, point + 0.9 * normals(point[None])[0]], INK, 2, 'marker-end="url(#arrow)"')
    yield dot(point, EYE_RAY, 5)
    yield dot(EYE, INK, 6)


def draw_texels(light: Light) -> Iterator[str]:
    """The cell around a hit, enlarged: its four texels, each with the isosurface through it."""
    point = light.points[len(light.points) // 2]
    (around,), (weights,) = corners(point[None])
    yield f'<g transform="{zoom_on(around.mean(axis=0), 2.6)}">'
    yield contour(ISOVALUE, SOLID, INK, 0.8)
    for texel in around:
        yield contour(float(field(texel)), "none", "#93c5fd", 0.6)
    low, high = around[0], around[3]
    square = [low, np.array((high[0], low[1])), high, np.array((low[0], high[1])), low]
    yield line(square, "#6b7280", 0.4, 'stroke-dasharray="2 1.5"')
    for texel, weight in zip(around, weights, strict=True):
        yield line([texel, point], TEXEL, 0.3 + 2.4 * float(weight))
        yield dot(texel, TEXEL, 2.2)
    yield dot(point, EYE_RAY, 2.2)
    yield "</g>"


def zoom_on(middle: np.ndarray, factor: float) -> str:
    """The transform that shows the world around ``middle``, so many times as large."""
    x, y = (float(each) for each in at(middle).split(","))
    return (
        f"translate({PANEL[0] / 2 - factor * x:.1f} {PANEL[1] / 2 - factor * y:.1f}) "
        f"scale({factor})"
    )


def draw_chunks(light: Light) -> Iterator[str]:
    """The lattice: texels that views may need, those of this view, and the chunks that hold some of
    these.
    """
    side = CHUNK
    read = {tuple(texel) for texel in light.texels}
    for x0, y0 in sorted({(x // side * side, y // side * side) for x, y in read}):
        low = at(np.array((x0 - 0.5, y0 - 0.5)))
        high = at(np.array((x0 + side - 0.5, y0 + side - 0.5)))
        (x, bottom) = map(float, low.split(","))
        (right, y) = map(float, high.split(","))
        yield (
            f'<rect x="{x}" y="{y}" width="{right - x}" height="{bottom - y}" fill="#dbeafe" '
            'stroke="#60a5fa"/>'
        )
    yield contour(ISOVALUE, "none", INK)
    for texel in lattice():
        if tuple(texel) in read:
            colour = TEXEL
        elif is_needed(texel):
            colour = "#fff"
        else:
            colour = "#d1d5db"
        if is_needed(texel):
            yield dot(texel, colour, 4, f'stroke="{TEXEL}"')
        else:
            yield dot(texel, colour, 2, "")


def draw_bake(light: Light) -> Iterator[str]:
    """Some paths of one texel over the isosurface through it, and where they leave."""
    (around,), _ = corners(light.points[len(light.points) // 2][None])
    texel = around[int(np.argmin(np.abs(field(around) - 0.58)))]
    level = float(field(texel))
    yield contour(level, SOLID, INK)
    rng = np.random.default_rng(5)
    for _ in range(12):
        yield from draw_path(texel, level, rng)
    yield dot(texel, TEXEL, 5)


def draw_path(start: np.ndarray, level: float, rng: np.random.Generator) -> Iterator[str]:
    """One path from a texel, thinner after each hit."""
    points = start[None]
    width = 2.0
    for _ in range(BOUNCES + 1):
        direction = scatter(normals(points), rng)
        reach = cast(points, direction, np.array([level]))[0]
        end = points + min(reach, 1.5) * direction
        leaves = math.isinf(reach)
        yield line([points[0], end[0]], PATH, width, 'marker-end="url(#sun)"' if leaves else "")
        if leaves:
            return
        points = end
        width = width * ALBEDO
        yield dot(points[0], PATH, 2.5)


def draw_noise(light: Light) -> Iterator[str]:
    """Noise of the row's texels and its whole error, over the samples; logarithmic."""
    left = 48
    right = PANEL[0] - 22
    top = 14
    bottom = PANEL[1] - 34

    def place(step: int, error: float) -> str:
        x = left + (right - left) * step / (len(RUNGS) - 1)
        share = (math.log(0.3) - math.log(error)) / math.log(0.3 / 0.004)
        return f"{x:.1f},{top + (bottom - top) * share:.1f}"

    for percent in (0.5, 1, 2, 5, 10, 20):
        _, y = place(0, percent / 100).split(",")
        yield f'<line x1="{left}" y1="{y}" x2="{right}" y2="{y}" stroke="#e5e7eb"/>'
        yield (
            f'<text class="small" x="{left - 6}" y="{float(y) + 4}" '
            f'text-anchor="end">{percent} %</text>'
        )
    for step, rung in enumerate(RUNGS):
        x, _ = place(step, 0.01).split(",")
        yield f'<text class="small" x="{x}" y="{bottom + 16}" text-anchor="middle">{rung}</text>'
    yield (
        f'<text class="small" x="{right}" y="{bottom + 30}" text-anchor="end">samples a '
        "texel</text>"
    )
    _, y = place(0, TARGET).split(",")
    yield (
        f'<line x1="{left}" y1="{y}" x2="{right}" y2="{y}" stroke="#15803d" '
        'stroke-dasharray="5 4"/>'
    )
    yield (
        f'<text class="small" x="{left + 4}" y="{float(y) + 14}" style="fill:#15803d">target</text>'
    )
    for name, errors, colour in (
        ("noise", light.noise, TEXEL),
        ("all error", light.errors, EYE_RAY),
    ):
        points = [place(step, error) for step, error in enumerate(errors)]
        yield f'<polyline points="{" ".join(points)}" stroke="{colour}" stroke-width="2"/>'
        x, y = points[5].split(",")
        yield (
            f'<text class="small" x="{x}" y="{float(y) - 8}" text-anchor="middle" '
            f'style="fill:{colour}">{name}</text>'
        )


def draw_picture(light: Light) -> Iterator[str]:
    """The row of pixels at three times, and as it is by paths from each pixel."""
    rows = (
        ("provisional", light.unshadowed),
        (f"converging, {RUNGS[0]} samples", light.after[0]),
        (f"final, {RUNGS[-1]} samples", light.after[-1]),
        ("by paths from each pixel", light.truth),
    )
    width = (PANEL[0] - 24) / PIXELS
    height = 26
    gap = 30
    white = max(float(shown.max()) for _, shown in rows)
    for step, (name, shown) in enumerate(rows):
        y = 26 + step * (height + gap)
        yield f'<text class="small" x="12" y="{y - 5}">{name}</text>'
        for i, value in zip(np.flatnonzero(light.seen), shown / white, strict=True):
            grey = round(255 * float(value) ** (1 / 2.2))
            box = f'x="{12 + i * width:.1f}" y="{y}" width="{width:.1f}" height="{height}"'
            yield f'<rect {box} fill="rgb({grey},{grey},{grey})"/>'
            if step == 0:
                yield f'<rect {box} fill="url(#marks)"/>'
        yield (
            f'<rect x="12" y="{y}" width="{PANEL[0] - 24}" height="{height}" fill="none" '
            'stroke="#9ca3af"/>'
        )


DEFINITIONS = f"""<defs>
<marker id="arrow" orient="auto" refX="5" refY="3" markerWidth="7" markerHeight="6">
<path d="M0 0 L6 3 L0 6 z" style="fill:{INK}"/></marker>
<marker id="sun" orient="auto" refX="4" refY="3" markerWidth="6" markerHeight="6">
<path d="M0 0 L6 3 L0 6 z" style="fill:{PATH}"/></marker>
<pattern id="marks" width="6" height="6" patternUnits="userSpaceOnUse"
  patternTransform="rotate(45)">
<rect width="2" height="6" fill="#f59e0b"/></pattern>
<clipPath id="panel"><rect width="{PANEL[0]}" height="{PANEL[1]}"/></clipPath>
</defs>"""


def panel(number: int, parts: Iterator[str]) -> Iterator[str]:
    """A panel with its heading, in its place among six."""
    x = MARGIN + number % 3 * (PANEL[0] + MARGIN)
    y = MARGIN + number // 3 * (PANEL[1] + HEAD + MARGIN)
    head, first, second = PANELS[3 * number : 3 * number + 3]
    yield f'<g transform="translate({x} {y})"><text class="head" y="14">{head}</text>'
    yield (
        f'<text y="36">{first}</text><text y="54">{second}</text><g transform="translate(0 '
        f'{HEAD - 8})">'
    )
    yield f'<rect width="{PANEL[0]}" height="{PANEL[1]}" rx="6" fill="#fff" stroke="#9ca3af"/>'
    yield '<g clip-path="url(#panel)">'
    yield from parts
    yield "</g></g></g>"


def picture() -> str:
    """The whole picture as SVG."""
    light = Light()
    drawings = (draw_eye_ray, draw_texels, draw_chunks, draw_bake, draw_noise, draw_picture)
    parts = [part for number, draw in enumerate(drawings) for part in panel(number, draw(light))]
    width = MARGIN + 3 * (PANEL[0] + MARGIN)
    height = MARGIN + 2 * (PANEL[1] + HEAD + MARGIN)
    label = "From an eye ray over texels, a chunk, a bake and its noise to a picture"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{label}">'
    )
    ground = f'<rect width="{width}" height="{height}" fill="#f9fafb"/>'
    return "\n".join([head, f"<style>{STYLE}</style>", DEFINITIONS, ground, *parts, "</svg>\n"])


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
