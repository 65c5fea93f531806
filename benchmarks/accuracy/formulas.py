"""Volumes by formula and by seed, as unlike each other as real ones are: nothing may be tuned to a
list of them.

Each kind takes a random generator, and gives voxels (z, y, x), their spacing, and an isovalue of
its surface.
"""

from collections.abc import Callable

import numpy as np

from isogi_core.model.volume import Volume, make_volume

SIZE = 56
"""Voxels along the longest side."""

Made = tuple[np.ndarray, tuple[float, float, float], float]
Kind = Callable[[np.random.Generator], Made]
CUBE = (1.0, 1.0, 1.0)


def grid(*shape: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates z, y, x from -1 to 1 of each voxel of a grid (z, y, x)."""
    z, y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    return z, y, x


def cloud(rng: np.random.Generator, shape: tuple[int, ...], finest: float) -> np.ndarray:
    """Smooth noise of mean 0 and deviation 1, whose finest waves are so many voxels long."""
    waves = np.sqrt(
        sum(np.square(f) for f in np.meshgrid(*map(np.fft.fftfreq, shape), indexing="ij"))
    )
    spectrum = np.fft.fftn(rng.normal(size=shape)) * np.exp(-((waves * finest) ** 2) * 4.0)
    found = np.fft.ifftn(spectrum).real
    return np.asarray((found - found.mean()) / found.std())


def coarse_shell(rng: np.random.Generator) -> Made:
    """A skull: a thin porous shell in slices three times as thick as their pixels."""
    z, y, x = grid(SIZE // 3, SIZE, SIZE)
    radius = np.sqrt(x**2 + (y * rng.uniform(1.0, 1.3)) ** 2 + z**2)
    wall = np.exp(-(((radius - 0.7) * SIZE / rng.uniform(2.0, 4.0)) ** 2))
    return wall * (1.0 + 0.3 * cloud(rng, z.shape, 6.0)), (1.0, 1.0, 3.0), 0.35


def foam(rng: np.random.Generator) -> Made:
    """Walls between bubbles."""
    seeds = rng.uniform(-1.0, 1.0, (60, 3))
    places = np.stack(grid(SIZE, SIZE, SIZE), axis=-1)
    away = np.sort(np.linalg.norm(places[..., None, :] - seeds, axis=-1), axis=-1)[..., :2]
    return 0.2 - (away[..., 1] - away[..., 0]), CUBE, 0.2 - rng.uniform(0.06, 0.12)


def gyroid(rng: np.random.Generator) -> Made:
    """A minimal surface that repeats every few voxels."""
    z, y, x = (each * np.pi * SIZE / rng.uniform(6.0, 14.0) for each in grid(SIZE, SIZE, SIZE))
    return (
        np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x),
        CUBE,
        rng.uniform(-0.6, 0.6),
    )


def vessels(rng: np.random.Generator) -> Made:
    """Winding tubes, some thinner than two voxels."""
    found = np.zeros((SIZE, SIZE, SIZE))
    places = np.stack(grid(SIZE, SIZE, SIZE), axis=-1)
    for _ in range(6):
        line = np.cumsum(
            np.cumsum(rng.normal(0.0, 0.004, (60, 3)), axis=0) + rng.normal(0.0, 0.02, 3), axis=0
        )
        line += rng.uniform(-0.6, 0.6, 3)
        away = np.min([np.linalg.norm(places - point, axis=-1) for point in line[::2]], axis=0)
        found = np.maximum(found, np.exp(-((away * SIZE / rng.uniform(2.0, 7.0)) ** 2)))
    return found, CUBE, 0.4


def fractures(rng: np.random.Generator) -> Made:
    """A rock with cracks."""
    shape = (SIZE, SIZE, SIZE)
    cracks = np.abs(cloud(rng, shape, 10.0)) * SIZE / 12.0
    inside = 1.0 - np.max(np.abs(grid(*shape)), axis=0)
    return np.minimum(np.clip(cracks, 0.0, 1.0), np.clip(inside * 12.0, 0.0, 1.0)), CUBE, 0.5


def noisy_ball(rng: np.random.Generator) -> Made:
    """A ball in noise of any strength."""
    z, y, x = grid(SIZE, SIZE, SIZE)
    noise = 10.0 ** rng.uniform(-2.5, -0.7) * rng.normal(size=x.shape)
    return np.clip((0.7 - np.sqrt(x**2 + y**2 + z**2)) * 4.0 + 0.5, 0.0, 1.0) + noise, CUBE, 0.5


def plateaus(rng: np.random.Generator) -> Made:
    """Steps: whole regions of one value, with jumps between them."""
    return (
        np.floor(cloud(rng, (SIZE, SIZE, SIZE), 14.0) * 2.0) / 2.0,
        CUBE,
        float(rng.choice([0.25, 0.5, 0.75])),
    )


def plates(rng: np.random.Generator) -> Made:
    """Thin plates at all angles."""
    places = np.stack(grid(SIZE, SIZE, SIZE), axis=-1)
    found = np.zeros((SIZE, SIZE, SIZE))
    for _ in range(5):
        normal = rng.normal(size=3)
        away = (places @ (normal / np.linalg.norm(normal)) - rng.uniform(-0.5, 0.5)) * SIZE / 2
        inside = np.linalg.norm(places, axis=-1) < rng.uniform(0.5, 0.9)
        found = np.maximum(found, np.exp(-((away / rng.uniform(0.7, 2.0)) ** 2)) * inside)
    return found, CUBE, 0.4


def particles(rng: np.random.Generator) -> Made:
    """A density of many particles."""
    places = np.stack(grid(SIZE, SIZE, SIZE), axis=-1)
    found = np.zeros((SIZE, SIZE, SIZE))
    for point in rng.normal(0.0, 0.4, (150, 3)):
        found += np.exp(
            -((np.linalg.norm(places - point, axis=-1) * SIZE / rng.uniform(4.0, 8.0)) ** 2)
        )
    return found, CUBE, 0.6


def lattice(rng: np.random.Generator) -> Made:
    """A metal lattice of thin struts, as binary as a CT of it."""
    z, y, x = (
        np.abs(np.mod(each * rng.uniform(2.0, 3.0), 1.0) - 0.5) for each in grid(SIZE, SIZE, SIZE)
    )
    wide = rng.uniform(0.1, 0.2)
    struts = ((x < wide) & (y < wide)) | ((y < wide) & (z < wide)) | ((x < wide) & (z < wide))
    return np.where(struts, 1.0, 0.0), CUBE, 0.5


def turbulence(rng: np.random.Generator) -> Made:
    """A field of a simulation, in floats, of any scale and offset."""
    scale = 10.0 ** rng.uniform(-6.0, 6.0)
    shape = (SIZE // 2, SIZE, SIZE)
    field = cloud(rng, shape, 12.0) + 0.3 * cloud(rng, shape, 5.0)
    return (field + rng.uniform(-100.0, 100.0)) * scale, (1.0, 1.0, 2.0), float("nan")


def nested(rng: np.random.Generator) -> Made:
    """Closed shells within each other, one of them open."""
    z, y, x = grid(SIZE, SIZE, SIZE)
    radius = np.sqrt(x**2 + y**2 + z**2)
    found = np.zeros_like(radius)
    for own in (0.35, 0.55, 0.75):
        wall = np.exp(-(((radius - own) * SIZE / rng.uniform(2.0, 5.0)) ** 2))
        found = np.maximum(found, wall * (1.0 if own < 0.7 else (z < 0.3)))
    return found, CUBE, 0.5


def noisy_field(rng: np.random.Generator) -> Made:
    """A smooth field of any scale and offset in noise: its surface is rough, with thin bright
    rims.
    """
    scale = 10.0 ** rng.uniform(-4.0, 4.0)
    shape = (SIZE, SIZE, SIZE)
    noise = rng.uniform(0.02, 0.12) * rng.normal(size=shape)
    return (cloud(rng, shape, 14.0) + noise + rng.uniform(-10.0, 10.0)) * scale, CUBE, float("nan")


KINDS: dict[str, Kind] = {
    "coarse shell": coarse_shell,
    "foam": foam,
    "gyroid": gyroid,
    "vessels": vessels,
    "fractures": fractures,
    "noisy ball": noisy_ball,
    "plateaus": plateaus,
    "plates": plates,
    "particles": particles,
    "lattice": lattice,
    "turbulence": turbulence,
    "nested shells": nested,
    "noisy field": noisy_field,
}


def made(kind: str, seed: int) -> tuple[Volume, float]:
    """A volume of a ``kind``, and the isovalue of its surface; of a ``seed``, the same on every
    machine.
    """
    voxels, spacing, isovalue = KINDS[kind](np.random.default_rng((seed, list(KINDS).index(kind))))
    single = voxels.astype(np.float32)
    if np.isnan(isovalue):
        level = float(np.quantile(single, 0.6))
    else:
        level = isovalue
    return make_volume(single, spacing, name=f"{kind} {seed}"), level
