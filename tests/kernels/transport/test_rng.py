"""Random numbers: hashes that mix, points that are stratified, the same bits everywhere, and no
stream drawn twice.
"""

import ast
from math import comb
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from scipy.stats import norm, qmc

import isogi_core
from isogi_core.kernels.transport import rng, streams
from tests.kernels.transport.chi2 import ChiSquare
from tests.scale import few

MANY = few(400_000, 20_000)
WORDS = np.random.default_rng(2).integers(0, 2**32, 200, dtype=np.uint64)
SEEDS = [0, 1, 2, 12345, 2**32, 2**63, 2**64 - 1]


def python(function):
    """The Python function behind a kernel, or itself where Numba is switched off."""
    return getattr(function, "py_func", function)


@njit
def prefix(seed, dimension, first, count):
    """Points first … first + count - 1, (count, 2)."""
    points = np.empty((count, 2))
    for i in range(count):
        points[i, 0], points[i, 1] = rng.point_2d(seed, first + i, dimension)
    return points


@njit
def over_seeds(count, index, dimension):
    """The same point of many neighbouring seeds, (count, 2)."""
    points = np.empty((count, 2))
    for seed in range(count):
        points[seed, 0], points[seed, 1] = rng.point_2d(seed, index, dimension)
    return points


@njit
def mixed(a, b):
    """mix over two arrays."""
    out = np.empty(len(a), np.uint64)
    for i in range(len(a)):
        out[i] = rng.mix(a[i], b[i])
    return out


def bits(values, count):
    """Bits of unsigned integers, lowest first, (n, count) of 0 and 1."""
    return (
        np.asarray(values, np.uint64)[:, None] >> np.arange(count, dtype=np.uint64)
    ) & np.uint64(1)


def test_mix_has_no_collision_among_neighbours():
    a, b = np.divmod(np.arange(MANY, dtype=np.uint64), np.uint64(64))
    assert len(np.unique(mixed(a, b))) == MANY
    assert len(np.unique(mixed(a, b) & np.uint64(0xFFFFFFFF))) > MANY - 60 * (MANY / 400_000) ** 2


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("counting", [False, True], ids=["random", "counting"])
def test_mix_avalanches(side, counting):
    """Each input bit flips each output bit with probability 1/2, for counters too."""
    n = few(16384, 512)
    source = np.random.default_rng(3)
    words = source.integers(0, 2**64, (2, n), dtype=np.uint64)
    if counting:
        words = np.stack([np.arange(n, dtype=np.uint64), np.full(n, 5, np.uint64)])
    before = bits(mixed(*words), 64)
    bound = norm.isf(0.5 * (1.0 - 0.99 ** (1.0 / (4 * 64 * 64))))
    for place in range(64):
        flipped = words.copy()
        flipped[side] ^= np.uint64(1 << place)
        share = np.mean(before != bits(mixed(*flipped), 64), axis=0)
        assert np.abs(share - 0.5).max() * 2.0 * np.sqrt(n) < bound


def test_reverse_bits_against_text():
    for word in [0, 1, 2**31, 2**32 - 1, *map(int, WORDS)]:
        assert rng.reverse_bits(np.uint64(word)) == int(f"{word:032b}"[::-1], 2)


def test_pascal_bits_against_binomials():
    matrix = np.array([[comb(j, i) % 2 for j in range(32)] for i in range(32)])
    products = (bits(WORDS, 32) @ matrix.T) % 2
    assert (bits([rng.pascal_bits(w) for w in WORDS], 32) == products).all()


def test_sobol_matches_scipy():
    """SciPy runs through the sequence in Gray-code order."""
    theirs = qmc.Sobol(2, scramble=False, bits=32).random(1024)
    ours = [rng.sobol_2d(i ^ (i >> 1)) for i in range(1024)]
    assert (np.array(ours) * 2.0**-32 == theirs).all()


def test_scramble_keeps_the_tree():
    """Owen: a bit's flip depends on higher bits alone, so words that share k leading bits still
    do.
    """
    for word, seed in zip(WORDS[:100], WORDS[100:], strict=True):
        base = int(rng.nested_uniform_scramble(word, seed))
        for place in range(32):
            other = int(rng.nested_uniform_scramble(word ^ np.uint64(1 << place), seed))
            assert (base ^ other) >> place == 1


def test_scramble_flips_like_coins():
    """Over seeds, every bit of a scrambled word is 0 or 1 equally often, and bits are
    independent.
    """
    n = few(20_000, 2_000)
    seeds = mixed(np.arange(n, dtype=np.uint64), np.zeros(n, np.uint64)) >> np.uint64(32)
    for word in (np.uint64(0), np.uint64(0xFFFFFFFF), np.uint64(0x80000000), WORDS[0]):
        signs = (
            1.0
            - 2.0 * bits([rng.nested_uniform_scramble(word, seed) for seed in seeds], 32)[:, 20:]
        )
        assert np.abs(signs.mean(axis=0)).max() * np.sqrt(n) < 4.5
        pairs = signs.T @ signs / n - np.eye(12)
        assert np.abs(pairs).max() * np.sqrt(n) < 4.5


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("dimension", [0, 1, 7])
def test_prefixes_are_nets(seed, dimension):
    """The first 2ᵏ points have one in every elementary interval; so has each later run of as
    many.
    """
    for k in range(0, 11, few(1, 2)):
        for first in (0, 2**k, 5 * 2**k):
            points = prefix(np.uint64(seed), dimension, first, 2**k)
            assert (points >= 0.0).all() and (points < 1.0).all()
            for a in range(k + 1):
                rows, columns = np.floor(points * [2**a, 2 ** (k - a)]).astype(int).T
                assert len(np.unique(rows * 2 ** (k - a) + columns)) == 2**k


@pytest.mark.parametrize("index", [0, 1, 2, 1000])
@pytest.mark.parametrize("dimension", [0, 5])
def test_each_point_is_uniform_over_seeds(index, dimension):
    ChiSquare(over_seeds(MANY, index, dimension)).check(tests=8)


@pytest.mark.parametrize("axis", [0, 1])
def test_marginals_are_uniform_over_seeds(axis):
    points = over_seeds(MANY, 3, 2)[:, [axis, axis]]
    points[:, 1] = (points[:, 1] * 2.0**12) % 1.0
    ChiSquare(points, cells=(1024, 1)).check(tests=4)
    ChiSquare(points, cells=(32, 32)).check(tests=4)


@pytest.mark.parametrize("axis", [0, 1])
def test_neighbouring_dimensions_and_seeds_are_independent(axis):
    """One coordinate in two dimensions of a seed, and in two neighbouring seeds."""
    first = over_seeds(MANY, 0, 0)[:, axis]
    second = over_seeds(MANY, 0, 1)[:, axis]
    for pair in ((first, second), (first[:-1], first[1:])):
        ChiSquare(np.stack(pair, axis=1), cells=(16, 16)).check(tests=4)


def test_dimensions_of_one_seed_are_uncorrelated():
    """Pearson's r of two independent nets of n points.

    The j-th bits, of weight 4⁻ʲ in the variance, agree or differ alike for runs of 2ʲ points, so
    the variance of r is (9 Σ 8⁻ʲ)/n = 9/7n, not 1/n.
    """
    n, count = few((4096, 24), (256, 8))
    columns = [prefix(np.uint64(s), d, 0, n) for s in (1, 2) for d in range(count // 2)]
    table = np.concatenate(columns, axis=1)
    r = np.corrcoef(table, rowvar=False)
    across = r[np.triu_indices(len(r), 1)]
    bound = norm.isf(0.5 * (1.0 - 0.99 ** (1.0 / len(across))))
    assert np.abs(across).max() < bound * np.sqrt(9.0 / 7.0 / n)


def test_same_bits_compiled_and_not():
    for seed in SEEDS:
        for index in (0, 1, 77, 2**32 - 1):
            assert rng.point_2d(np.uint64(seed), index, 3) == python(rng.point_2d)(seed, index, 3)
            assert rng.mix(np.uint64(seed), index) == python(rng.mix)(seed, index)


def test_bits_never_change():
    """Stored bakes continue these sequences: another version must draw the same points."""
    assert hex(rng.mix(3, np.uint64(2**63))) == "0xb11cc5d3d4b19cc0"
    assert rng.point_2d(7, 0, 0) == (0.7686002785339952, 0.930833769030869)
    assert rng.point_2d(7, 1, 0) == (0.41148134833201766, 0.42537907022051513)


TABLE = Path(streams.__file__)
WORD = 1 << 32


def test_no_two_purposes_of_a_path_draw_the_same_pair() -> None:
    last = 0
    for first, count in streams.PURPOSES:
        assert first >= last and count >= streams.PAIRS_PER_PURPOSE
        last = first + count
    assert last <= WORD


def test_streams_lie_apart_by_all_their_replicas() -> None:
    """A control's halves, a wall's sides and a reference's replicas are numbered from the stream's
    number on.
    """
    gaps = [b - a for a, b in zip(streams.STREAMS, streams.STREAMS[1:], strict=False)]
    assert min(gaps) >= 1 << 16 and max(streams.STREAMS) < WORD


def test_every_stream_and_purpose_is_in_its_list() -> None:
    """What a new line of the table forgets to list is not checked by the tests above."""
    sizes = {"PAIRS_PER_PURPOSE", "MAX_CROSSINGS", "MAX_STEPS"}
    given = {
        name: number
        for name, number in vars(streams).items()
        if isinstance(number, int) and name not in sizes
    }
    purposes = {first for first, _ in streams.PURPOSES}
    shine = {name for name in given if name.startswith("SHINE_") and name != "SHINE_STREAM"}
    assert {number for name, number in given.items() if name not in shine} == purposes | {
        *streams.STREAMS
    }


def test_numbers_that_stored_light_was_drawn_by_never_change() -> None:
    assert streams.STREAMS == (0, 1 << 16, 1 << 17, 1 << 18, 1 << 19, 1 << 20, 1 << 21, 1 << 24)
    firsts = [0, 1, 0x7FFF - 65, 0x7FFF - 64, 0x7FFF, 0x8000]
    assert [first / (1 << 16) for first, _ in streams.PURPOSES] == firsts


def test_streams_are_numbered_in_one_file() -> None:
    """No module gives a number to a stream: who adds one sees all others."""
    found = []
    for path in Path(isogi_core.__file__).parent.rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            names = [each.id for each in getattr(node, "targets", []) if isinstance(each, ast.Name)]
            found += [(path.name, name) for name in names if "STREAM" in name and path != TABLE]
    assert not found
