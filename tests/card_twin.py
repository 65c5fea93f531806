"""A twin of what a graphics card does with the document and the bytes of /card: in NumPy, from
these alone.
"""

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

BURIED = 0x80008001
VOID = 0x80008002
FLAT = 0x80008003
TURNED = 0.1055
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass
class Texel:
    """One record: its word, direct and reflected light, the variance of both's luminance, and
    ``raw_numbers``' last.
    """

    word: int
    direct: np.ndarray
    reflected: np.ndarray
    variance: float = 0.0
    samples: float = 0.0

    @property
    def normal(self) -> np.ndarray:
        """The normal that the word stands for."""
        if self.word == FLAT:
            return np.zeros(3)
        return normal_of(self.word)


def normal_of(word: int) -> np.ndarray:
    """The unit vector of an octahedral word."""
    u, v = (value / 32767.0 for value in struct.unpack("<hh", struct.pack("<I", word)))
    z = 1.0 - abs(u) - abs(v)
    below = max(-z, 0.0)
    n = np.array([u - math.copysign(below, u), v - math.copysign(below, v), z])
    return np.asarray(n / np.linalg.norm(n))


@dataclass
class Block:
    """One block, read as docs/card.md says."""

    at: tuple[int, int, int]
    kind: int
    version: str
    masks: dict[tuple[int, int, int], tuple[int, int]]
    records: np.ndarray
    words: np.ndarray

    def numbers(self) -> Iterable[tuple[tuple[int, int, int], int]]:
        """The place in the chunk of each texel, z, y, x, and the number of its record."""
        for (bz, by, bx), (mask, first) in self.masks.items():
            count = 0
            for bit in range(64):
                if mask >> bit & 1:
                    yield (
                        (4 * bz + (bit >> 4), 4 * by + (bit >> 2 & 3), 4 * bx + (bit & 3)),
                        first + count,
                    )
                    count += 1

    def means(self) -> dict[tuple[int, int, int], int]:
        """The number of each brick's mean."""
        return {place: first + mask.bit_count() for place, (mask, first) in self.masks.items()}


def blocks_in(data: bytes, columns: int = 0) -> list[Block]:
    """The blocks in some bytes; raw ones have so many numbers in a record."""
    found = []
    while data:
        mark, size, z, y, x, kind, bricks, records = struct.unpack_from("<4sIHHHHII", data)
        assert mark == b"ISOB" and size % 8 == 0 and size <= len(data)
        masks = {}
        for i in range(bricks):
            low, high, first, place = struct.unpack_from("<IIII", data, 32 + 16 * i)
            masks[place >> 16, place >> 8 & 255, place & 255] = (high << 32 | low, first)
        body = data[32 + 16 * bricks : size]
        if kind:
            read = read_raw(body, records, columns)
        else:
            read = read_folded(body, records)
        found.append(Block((z, y, x), kind, data[24:32].hex(), masks, *read))
        data = data[size:]
    return found


def read_folded(body: bytes, records: int) -> tuple[np.ndarray, np.ndarray]:
    """Light (records, 6) and words."""
    whole = np.frombuffer(body, "<u4").reshape(records, 4)
    return np.ascontiguousarray(whole[:, :3]).view("<f2").astype(np.float64), whole[:, 3]


def read_raw(body: bytes, records: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (records, columns) and words."""
    words = np.frombuffer(body, "<u4", records)
    halves = np.frombuffer(body, "<f2", offset=4 * (records + records % 2)).reshape(
        -(-columns // 4), records, 4
    )
    numbers = halves.transpose(1, 0, 2).reshape(records, 4 * len(halves))
    assert not numbers[:, columns:].any()
    return numbers[:, :columns].astype(np.float64), words


def harmonics(order: int, n: np.ndarray) -> np.ndarray:
    """Real harmonics at unit vectors (m, 3) by explicit Legendre sums; (m, order²)."""
    x, y, z = n.T
    found = np.empty((len(n), order**2))
    angle = np.arctan2(y, x)
    sine = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    for l in range(order):
        for m in range(l + 1):
            legendre = sum(
                (-1) ** k
                * math.factorial(2 * l - 2 * k)
                / (2**l * math.factorial(k) * math.factorial(l - k) * math.factorial(l - 2 * k - m))
                * z ** (l - 2 * k - m)
                for k in range((l - m) // 2 + 1)
            )
            scale = math.sqrt(
                (2 * l + 1) / (4 * math.pi) * math.factorial(l - m) / math.factorial(l + m)
            )
            value = scale * sine**m * legendre * (math.sqrt(2.0) if m else 1.0)
            found[:, l * (l + 1) + m] = value * np.cos(m * angle)
            if m:
                found[:, l * (l + 1) - m] = value * np.sin(m * angle)
    return found


def turned(light: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Harmonics (3, n²) of a light that is turned, found by its values in many directions."""
    order = math.isqrt(light.shape[1])
    n = np.random.default_rng(5).normal(size=(8 * order**2, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    values = harmonics(order, n @ matrix) @ light.T
    return np.asarray(np.linalg.lstsq(harmonics(order, n), values, rcond=None)[0].T)


@dataclass
class Twin:
    """A scene as ``document["scene"]`` has it, the texels of some blocks, and a light turned by a
    ``matrix``.
    """

    scene: dict[str, Any]
    matrix: np.ndarray = field(default_factory=lambda: np.eye(3))
    texels: dict[tuple[int, int, int], Texel] = field(default_factory=dict)

    def __post_init__(self) -> None:
        light = self.scene["light"]
        self.columns = np.concatenate(
            [turned(np.array(t["light"]), self.matrix) for t in light["terms"]], axis=1
        )
        squares = [turned(np.array([t["square"]] * 3), self.matrix)[0] for t in light["terms"]]
        self.squares = np.concatenate(squares)
        sky = turned(np.array(light["sky"]), self.matrix)
        self.sky = np.zeros((3, 9))
        self.sky[:, : sky.shape[1]] = sky

    def under(self, normals: np.ndarray, least: bool = True) -> np.ndarray:
        """Unshadowed light about normals (m, 3), by the polynomial of docs/card.md."""
        quadric = self.sky.copy()
        quadric[:, 0] -= math.sqrt(5.0 / 4.0) * quadric[:, 6]
        quadric *= np.sqrt(
            np.array([1.0, 3.0, 3.0, 3.0, 15.0, 15.0, 45.0 / 4.0, 15.0, 15.0 / 4.0])
            / (4.0 * math.pi)
        )
        x, y, z = np.atleast_2d(normals).T
        over = np.stack(
            [np.ones_like(x), y, z, x, x * y, y * z, z * z, x * z, x * x - y * y], axis=1
        )
        return np.maximum(over @ quadric.T, self.scene["light"]["least"] if least else 0.0)

    def take(self, data: bytes) -> None:
        """Put the texels of some blocks into the lattice; raw ones are folded."""
        plan = self.scene["plan"]
        chunk = self.scene["lattice"]["chunk"]
        for block in blocks_in(data, plan["channels"] * plan["columns"] + 2):
            for place, number in block.numbers():
                z, y, x = (chunk * a + b for a, b in zip(block.at, place, strict=True))
                word = int(block.words[number])
                record = block.records[number]
                if block.kind:
                    self.texels[z, y, x] = self.fold(record, word)
                else:
                    self.texels[z, y, x] = Texel(word, record[:3], record[3:])
        if any(each.samples > 0.0 for each in self.texels.values()):
            for apart in (1, 2):
                self.texels = {at: self.filtered(at, apart) for at in self.texels}

    def fold(self, numbers: np.ndarray, word: int) -> Texel:
        """The texel of raw transfer."""
        plan = self.scene["plan"]
        direct = np.zeros(3)
        reflected = np.zeros(3)
        if word in (BURIED, VOID):
            return Texel(word, direct, reflected)
        channels = numbers[:-2].reshape(plan["channels"], plan["columns"])
        for c in range(3):
            each = channels[min(c, plan["channels"] - 1)] * self.columns[c]
            both = max(each.sum(), 0.0)
            reflected[c] = min(max(each[plan["straight"] :].sum(), 0.0), both)
            direct[c] = both
        if plan["whole"]:
            if word == FLAT:
                normal = np.zeros(3)
            else:
                normal = normal_of(word)
            reflected = np.maximum(reflected, direct - self.under(normal)[0])
        variance = 4.0 ** numbers[-2] * self.spread(channels)
        return Texel(word, direct - reflected, reflected, variance, float(numbers[-1]))

    def spread(self, channels: np.ndarray) -> float:
        """The variance of one path's luminance, by the transfer of a texel."""
        mean = LUMINANCE @ [channels[min(c, len(channels) - 1)] @ self.columns[c] for c in range(3)]
        squares = channels[min(1, len(channels) - 1)] * self.squares
        firsts = np.cumsum([0, *(term["order"] ** 2 for term in self.scene["light"]["terms"])])[:-1]
        return float(
            max(squares.sum() - mean**2, 0.0) + 0.2 * np.maximum(squares[firsts], 0.0).sum()
        )

    def filtered(self, at: tuple[int, int, int], apart: int) -> Texel:
        """A texel by its neighbours, as far as they agree."""
        own = self.texels[at]
        if own.samples <= 0.0:
            return own
        ways = [np.array(way) for way in product((-1, 0, 1), repeat=3)]
        around = [
            (way @ way, self.texels.get(tuple((np.array(at) + apart * way).tolist())))
            for way in ways
        ]
        found = [(square, each) for square, each in around if each and each.samples]
        some = [each for _, each in found]
        normals = np.array([each.normal for each in some])
        weights = (
            np.exp([-0.5 * square for square, _ in found])
            * np.maximum(normals @ own.normal, 0.0) ** 16
        )
        if (weights > 0.0).sum() < 2:
            return own
        direct, reflected = (
            np.array([getattr(each, name) for each in some]) for name in ("direct", "reflected")
        )
        variances = np.array([each.variance for each in some])
        bare = self.under(normals)
        here = self.under(own.normal)
        by_paths = weights * 2.0 ** np.abs([each.samples for each in some])
        ratio = by_paths @ direct / np.maximum(by_paths @ bare, 1e-30)
        mean = by_paths @ reflected / by_paths.sum()
        apart_from = (direct + reflected - ratio * bare - mean) @ LUMINANCE
        noise = weights @ variances
        total = weights.sum()
        signal = max(weights @ apart_from**2 - noise, 0.0)
        keeps = signal / max(signal + noise, 1e-30)
        left = (
            keeps * noise / total
            + (1.0 - keeps) ** 2 * (by_paths**2 @ variances) / by_paths.sum() ** 2
        )
        straight = keeps * own.direct + (1.0 - keeps) * ratio * here[0]
        return Texel(
            own.word, straight, keeps * own.reflected + (1.0 - keeps) * mean, left, own.samples
        )

    def shade(self, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Radiance, before lobes, at a point in index space with this normal, where all of its
        texels are known.
        """
        lattice = self.scene["lattice"]
        ratios = self.scene["plan"]["ratios"]
        q = point * np.array(lattice["density"])
        t = np.clip(np.floor(q), 0, np.array(lattice["size"]) - 2).astype(int)
        f = np.clip(q - t, 0.0, 1.0)
        total = 0.0
        direct = 0.0
        over = 0.0
        reflected = 0.0
        buried = False
        for c in range(8):
            k = np.array([c & 1, c >> 1 & 1, c >> 2])
            x, y, z = (t + k).tolist()
            texel = self.texels[z, y, x]
            w = float(np.prod(np.where(k, f, 1.0 - f)))
            buried |= texel.word == BURIED
            if texel.word in (BURIED, VOID):
                continue
            cosine = float(texel.normal @ normal)
            if ratios:
                w *= (max(cosine, 1e-3) / (1.0 + (1.0 - cosine) / TURNED)) ** 2
            else:
                w *= 1.0
            total = total + w
            direct = direct + w * texel.direct
            reflected = reflected + w * texel.reflected
            over = over + w * self.under(texel.normal)[0]
        here = self.under(normal, ratios)[0]
        if not total:
            light = np.zeros(3) if buried else here
        elif ratios:
            light = direct / np.maximum(over, 1e-30) * here + reflected / total
        else:
            light = (direct + reflected) / total
        return np.asarray(self.scene["light"]["unit"] * light)

    def develop(self, radiance: np.ndarray) -> np.ndarray:
        """sRGB codes of radiance (m, 3) by the document's exposure and tone curve."""
        gain, toe, shoulder = (self.scene["tone"][name] for name in ("gain", "toe", "shoulder"))
        light = radiance * self.scene["exposure"]
        peak = np.maximum(light.max(axis=1, keepdims=True), 1e-12)
        y = gain * peak * peak / (peak + toe)
        bent = 1.0 - (1.0 - shoulder) * np.exp((shoulder - y) / (1.0 - shoulder))
        shown = light * np.where(y <= shoulder, y, bent) / peak
        coded = np.where(
            shown <= 0.0031308, 12.92 * shown, 1.055 * np.maximum(shown, 1e-9) ** (1 / 2.4) - 0.055
        )
        return np.rint(255.0 * coded)


def voxels_of(scene: dict[str, Any], data: bytes) -> np.ndarray:
    """The voxels (nz, ny, nx) that the codes of all layers stand for, float64."""
    nx, ny, nz = scene["grid"]["size"]
    volume = scene["volume"]
    codes = np.frombuffer(data, np.dtype(volume["type"]).newbyteorder("<")).reshape(nz, ny, nx)
    return np.asarray(volume["base"] + volume["gain"] * codes.astype(np.float64))
