"""The page pool: decoded light in a texel table of fixed size.

Kernels read it through an indirection table, which gives the row of each texel of a chunk. So a
view needs memory for the chunks that it reads, and not for the whole volume.
"""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count, pairwise, product
from typing import NamedTuple

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import MIN_LUMINANCE, deviations, least_level, powers, white
from isogi_core.bake.texel_light import SAMPLES_OF, Light
from isogi_core.cache.chunk_record import Chunks
from isogi_core.errors import NoRoomError
from isogi_core.kernels.shading.lattice import UNLIT_ROW, Lattice
from isogi_core.kernels.shading.texel_table import (
    Judge,
    Role,
    Rows,
    Sums,
    add_part,
    find_fewest,
    judge_rows,
)
from isogi_core.model.scene_plan import GLOW_KIND, MIN_SAMPLES, Layer
from isogi_core.prepared.prepared_scene import Index

PAGE_TEXELS = 64
"""Texels of a page, the unit in which memory is given to chunks."""

FEWEST_CHUNKS = 8
"""Least number of chunks in the indirection table, however small the budget."""


UNLIT_VERSION = b"\0" * 8
"""The version of a chunk without light."""


@dataclass(eq=False)
class Entry:
    """A chunk in the pool: its ``slot`` in the indirection table, its ``pages``, and the number of
    frames that hold it.

    It is ``stale`` if the store has newer light, and ``listed`` until it is replaced or dropped.
    """

    slot: int
    pages: np.ndarray
    held: int = 0
    stale: bool = False
    listed: bool = True


class Numbers:
    """Free numbers below ``most``.

    Those given back last are taken first, then new ones in ascending order.
    """

    def __init__(self, most: int) -> None:
        """Begin with all numbers free."""
        self._most = most
        self.taken = 0
        self._back: list[int] = []

    def __len__(self) -> int:
        """Return how many are free."""
        return len(self._back) + self._most - self.taken

    def take(self) -> int:
        """Take a free number. ``taken`` counts the numbers that were ever used."""
        if self._back:
            return self._back.pop()
        self.taken += 1
        return self.taken - 1

    def give_back(self, numbers: Sequence[int]) -> None:
        """Free these numbers; the last of them is taken first."""
        self._back.extend(numbers)


AGES = count(1)
"""Ages of all pools of the process. A pool that is made anew for the same light begins with an age
that the one before it never had: pictures of that one are not taken for its own.
"""


class Held(NamedTuple):
    """Chunks that a frame holds: their ``slots`` (n,) int32, -1 if absent, and the ``age`` of the
    pool.

    At equal age, equal slots lead to the same light.
    """

    slots: np.ndarray
    age: int


class PagePool:
    """Light in memory, at most ``budget`` bytes. Safe to use from many threads.

    A row has the ``transfer`` (channels, columns of all terms), the ``scatter``, the relative
    ``error`` and the ``stamp``: see ``fill_rows``. If light is kept for several albedos, a row also
    has the share of its variance that is ``reflected``.
    """

    def __init__(self, spec: BakeSpec, budget: int) -> None:
        """Allocate the arrays that frames of ``spec`` read, in ``budget`` bytes.

        The system gives memory as they fill.
        """
        texels = spec.prepared.lattice.texels
        # The indirection table has a slot for each chunk, of 4 bytes for each texel, and at least
        # FEWEST_CHUNKS slots. Divide the budget by the bytes of a page: its rows and its part of
        # the table. If the budget is so small that FEWEST_CHUNKS slots take more than the parts of
        # all these pages, fewer pages fit: take those slots off, and divide the rest by the bytes
        # of a page's rows alone. The lesser number is right in both cases.
        least_table = FEWEST_CHUNKS * 4 * texels
        with_table = budget // page_bytes(spec)
        rows_alone = (budget - least_table) // (PAGE_TEXELS * row_bytes(spec))
        pages = max(min(with_table, rows_alone), 1)
        slots = max(pages // pages_of_sheet(spec.prepared.lattice), FEWEST_CHUNKS)
        self.spec = spec
        self.rows = new_rows(spec, pages * PAGE_TEXELS)
        self.transfer, self.scatter, self.error, self.stamp = self.rows
        self.reflected = np.empty(pages * PAGE_TEXELS if spec.plan.nodes else 0, np.float32)
        self.table = np.empty((slots, texels), np.int32)
        self._free_pages = Numbers(pages)
        self._free_slots = Numbers(slots)
        # The chunks in the pool, the longest unused first; the versions by slot, computed when they
        # are asked for; and the age.
        self._entries: OrderedDict[Index, Entry] = OrderedDict()
        self._versions: dict[int, bytes] = {}
        self._age = next(AGES)
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes of memory that were ever filled."""
        return self._free_pages.taken * page_bytes(self.spec)

    @property
    def age(self) -> int:
        """A number that each insertion makes larger. As long as it stays the same, so does all
        light of chunks that stay in the pool; no other pool ever has it.
        """
        return self._age

    def missing(self, indices: Sequence[Index]) -> list[Index]:
        """Return the chunks of ``indices`` that are not in the pool, or stale there."""
        with self._lock:
            found = map(self._entries.get, indices)
            return [
                index
                for index, entry in zip(indices, found, strict=True)
                if entry is None or entry.stale
            ]

    def outdate(self, index: Index) -> None:
        """Note that the store has newer light of a chunk.

        The old light may be shown until that is read.
        """
        with self._lock:
            if index in self._entries:
                self._entries[index].stale = True

    def insert(self, chunks: Chunks, keep: Collection[Index] = ()) -> None:
        """Put decoded chunks into the pool, and replace their older light.

        If room is needed, drop the longest unused chunks that no frame holds; those in ``keep``
        stay, unless ``chunks`` has newer light of them. Raises NoRoomError, and drops none, if that
        is not enough.
        """
        counts = np.diff(chunks.bounds)
        with self._lock:
            self._age = next(AGES)
            # New light goes to other pages than the old: frames that hold the chunk read on from
            # the old ones. Each chunk takes whole pages, so round up. Older light of these very
            # chunks need not be kept: it is replaced below, and may make room before.
            entries = self._allocate(-(-counts // PAGE_TEXELS), {*keep} - {*chunks.indices})
            numbers = rows_in([entry.pages for entry in entries], counts)
            slots = np.array([entry.slot for entry in entries], np.int32)
            # Forget the versions of the chunks that had these slots before.
            for slot in slots.tolist():
                self._versions.pop(slot, None)
            # Texels that the chunk lacks are not baked; the others find their rows.
            self.table[slots] = UNLIT_ROW
            self.table[np.repeat(slots, counts), chunks.offsets] = fill_rows(
                self.rows, numbers, chunks.light, self.spec
            )
            if self.spec.plan.nodes:
                self.reflected[numbers] = reflected_share(chunks.light, self.spec)
            # From here on, frames that ask for the chunk get the new entry. The old one is freed
            # when no frame holds it.
            for index, entry in zip(chunks.indices, entries, strict=True):
                former = self._entries.pop(index, None)
                self._entries[index] = entry
                if former is not None:
                    self._release(former)

    @contextmanager
    def hold(self, indices: Sequence[Index]) -> Iterator[Held]:
        """Hold the chunks ``indices`` while the block runs: their rows are not reused.

        Yields their slots. Chunks count as used now, so that others are dropped before them.
        """
        with self._lock:
            age = self._age
            found = [self._entries.get(index) for index in indices]
            for index, entry in zip(indices, found, strict=True):
                if entry is not None:
                    # Entries are in the order of their last use: held ones move to the end.
                    entry.held += 1
                    self._entries.move_to_end(index)
        try:
            yield Held(
                np.array([-1 if entry is None else entry.slot for entry in found], np.int32), age
            )
        finally:
            # ``_give_back`` frees entries that were replaced meanwhile and are held by no other
            # frame, and leaves the rest as they are.
            with self._lock:
                for entry in found:
                    if entry is not None:
                        entry.held -= 1
                        self._give_back(entry)

    def version(self, slot: int) -> bytes:
        """Return a digest of how far the held chunk in a ``slot`` is baked, and by which plan;
        UNLIT_VERSION if it has no light.

        Equal versions are equal light: that of a texel depends on plan and sample levels only.
        """
        if slot < 0:
            return UNLIT_VERSION
        if slot not in self._versions:
            # Stamps tell how far texels are baked; entries of texels without a row, which are
            # negative, stand for themselves.
            rows = self.table[slot]
            stamps = np.where(rows >= 0, self.stamp[rows], rows.astype(np.float32))
            named = hashlib.blake2b(
                self.spec.digest.encode() + stamps.tobytes(), digest_size=8
            ).digest()
            if (rows != UNLIT_ROW).any():
                self._versions[slot] = named
            else:
                self._versions[slot] = UNLIT_VERSION
        return self._versions[slot]

    def versions(self, indices: Sequence[Index]) -> tuple[bytes, ...]:
        """Return the ``version`` of each chunk as it is in the pool now."""
        with self.hold(indices) as held:
            return tuple(map(self.version, held.slots.tolist()))

    def transfer_at(self, slot: int, offsets: np.ndarray) -> np.ndarray:
        """Return the transfer of a held chunk's texels at ``offsets`` (m,), 0 if unlit;
        (m, channels, columns) float32.
        """
        found = np.zeros((len(offsets), *self.transfer.shape[1:]), np.float32)
        if slot >= 0:
            rows = self.table[slot, offsets]
            found[rows >= 0] = self.transfer[rows[rows >= 0]]
        return found

    def _allocate(self, pages: np.ndarray, keep: Collection[Index]) -> list[Entry]:
        """Reserve memory for several chunks, and return a new entry for each. The caller holds the
        lock, and puts the entries into the pool.

        ``pages`` (chunks,) are the numbers of pages that the chunks need. If too few pages or slots
        are free, drop the longest unused chunks, but none that a frame holds and none in ``keep``.
        Raises NoRoomError, and drops none, if that is not enough.
        """
        total = int(pages.sum())
        if not self._has_room(total, len(pages)):
            self._make_room(
                total,
                len(pages),
                [i for i, e in self._entries.items() if not e.held and i not in keep],
            )
        taken = np.array([self._free_pages.take() for _ in range(total)], np.int32)
        bounds = [0, *np.cumsum(pages).tolist()]
        return [Entry(self._free_slots.take(), taken[a:b]) for a, b in pairwise(bounds)]

    def _has_room(self, pages: int, slots: int) -> bool:
        """Return True if this many pages and slots are free."""
        return len(self._free_pages) >= pages and len(self._free_slots) >= slots

    def _make_room(self, pages: int, slots: int, spare: Sequence[Index]) -> None:
        """Drop chunks of ``spare``, in this order, until ``pages`` pages and ``slots`` slots are
        free.

        Raises NoRoomError, and drops none, if dropping all of them is not enough.
        """
        # Check first that it is possible: a view that does not fit must not empty the pool.
        most = len(self._free_pages) + sum(len(self._entries[index].pages) for index in spare)
        if most < pages or len(self._free_slots) + len(spare) < slots:
            raise NoRoomError(
                f"The light of this view does not fit the memory for {len(self.scatter)} texels:"
                " ask for a closer view or fewer pixels, or give light more memory."
            )
        for index in spare:
            if self._has_room(pages, slots):
                return
            self._release(self._entries.pop(index))

    def _release(self, entry: Entry) -> None:
        """Take an entry off the list; its pages are freed as soon as no frame holds it."""
        entry.listed = False
        self._give_back(entry)

    def _give_back(self, entry: Entry) -> None:
        """Free the slot and the pages of an entry, if it is neither held nor listed and they are
        not free yet.

        The last page is given back first, so that pages are then taken in ascending order, the
        fastest to read.
        """
        if entry.held == 0 and not entry.listed and entry.slot >= 0:
            self._free_pages.give_back(entry.pages[::-1].tolist())
            self._free_slots.give_back([entry.slot])
            entry.slot = -1


def pages_of_sheet(lattice: Lattice) -> int:
    """Return the number of pages that a chunk takes at least if one surface crosses it: it then has
    a texel with light in about each of its rows along x, see ``Lattice.rows``.

    The indirection table has a slot for each such chunk that may be in the pool.
    """
    return lattice.rows // PAGE_TEXELS


def page_bytes(spec: BakeSpec) -> int:
    """Return the bytes that a page of a ``spec`` takes,
    its part of the indirection table among them.
    """
    lattice = spec.prepared.lattice
    return PAGE_TEXELS * row_bytes(spec) + lattice.texels * 4 // pages_of_sheet(lattice)


def row_bytes(spec: BakeSpec) -> int:
    """Return the bytes of a row of the texel table."""
    return 4 * (spec.channels * spec.columns + (4 if spec.plan.nodes else 3))


def rows_in(pages: Sequence[np.ndarray], counts: np.ndarray) -> np.ndarray:
    """Return the rows of the texels of chunks, chunk by chunk, (texels,) int32.

    ``pages[i]``, of any length, int32, are the numbers of a chunk's pages, in the order in which
    its ``counts[i]`` texels fill them. Page k has the PAGE_TEXELS rows from k · PAGE_TEXELS on.
    """
    # All rows of the pages of each chunk; its last page may have more than it has texels.
    rows_of_chunks = [
        (numbers[:, None] * PAGE_TEXELS + np.arange(PAGE_TEXELS, dtype=np.int32)).ravel()
        for numbers in pages
    ]
    used = [rows[:count] for rows, count in zip(rows_of_chunks, counts, strict=True)]
    # The empty array gives the result its type if there are no chunks.
    return np.concatenate([np.empty(0, np.int32), *used])


MAX_SAMPLE_LEVELS = 32
"""Number of codes for a part's sample level in a stamp; there are fewer levels."""

SHOWN_CHECKSUMS = 509
"""Number of checksums of light that is shown without samples. Times MAX_SAMPLE_LEVELS³,
for three parts, it stays below 2^24: single floats hold all stamps exactly.
"""


def new_rows(spec: BakeSpec, count: int) -> Rows:
    """Allocate a texel table of ``count`` rows for frames of a ``spec``.

    The system gives memory as it fills.
    """
    columns = (np.empty(count, np.float32) for _ in range(3))
    return Rows(np.empty((count, spec.channels, spec.columns), np.float32), *columns)


def fill_rows(rows: Rows, numbers: np.ndarray, light: Light, spec: BakeSpec) -> np.ndarray:
    """Write texels' ``light`` into the rows ``numbers`` (m,) int32, and return their entries in the
    indirection table, (m,) int32.

    An entry is the row; BURIED_ROW if no path of any part left the volume; VOID_ROW; or UNLIT_ROW
    if there is no direct light to show, as reflected light alone is not shown. Scatter is defined
    in ``bake.noise``. A stamp encodes the sample levels of a texel: the sum over parts p of the
    level times MAX_SAMPLE_LEVELS^p, and above these a checksum of light that is shown without
    samples. That light is an earlier plan's, which may change too.
    """
    sums = Sums(
        *(
            np.zeros(len(numbers), kind)
            for kind in (np.float64, np.float64, np.int64, np.int64, np.uint8)
        )
    )
    # Add up the parts of each term, in the columns of the term.
    for at, term in enumerate(spec.terms):
        for number in term.layers:
            if term.node is None:
                part = light.parts[number]
            else:
                part = light.parts[number].channel(term.node)
            coefficients = np.ascontiguousarray(part.coefficients)
            bits = coefficients.view(np.int32)
            role = role_of(number, part.layer, at, spec)
            add_part(part.samples, part.noise, coefficients, bits, role, numbers, rows, sums)
    places = np.empty_like(numbers)
    # When all parts of a row are added, derive scatter, error and stamp from the sums.
    judge_rows(numbers, rows, sums, judge_of(len(light.parts), spec), places)
    return places


def reflected_share(light: Light, spec: BakeSpec) -> np.ndarray:
    """Return the share of reflected light in texels' variance; (m,) float32."""
    variances = deviations(light, spec) ** 2
    reflected = variances[[part.layer.kind == "indirect" for part in light.parts]].sum(axis=0)
    return np.asarray(reflected / np.maximum(variances.sum(axis=0), 1e-30), np.float32)


def role_of(number: int, layer: Layer, at: int, spec: BakeSpec) -> Role:
    """Return the role of a ``layer`` in a bake spec: how its texels, part ``number`` of the light,
    count in the rows of the texel table as a summand of the term number ``at``.

    Reflected light and glow are not shown before direct light is there, so their layers are not
    ``straight``. A texel that no path leaves is buried. Transfer shows this, but irradiance may be
    0 because of the lights alone, so it is not ``telling``.
    """
    term = spec.terms[at]
    # A layer kept for several albedos, or of several glows, has a term for each of its channels:
    # the term's node.
    weights = white(layer, spec)
    if term.node is not None:
        weights = weights[term.node : term.node + 1]
    # The channels come from the same paths: only the last one adds their noise and sample level to
    # the sums of a row, so that both count once.
    last = term.node in (None, layer.channels - 1)
    return Role(
        gains=spec.gains(layer) if last else np.zeros(layer.noises),
        weights=weights,
        column=int(spec.firsts[at]),
        width=term.order**2,
        first=number == min(term.layers),
        rung=MAX_SAMPLE_LEVELS**number if last else 0,
        straight=layer.kind not in ("indirect", GLOW_KIND),
        telling=layer.kind != "irradiance",
        fewest=MIN_SAMPLES,
    )


def judge_of(parts: int, spec: BakeSpec) -> Judge:
    """Return the numbers of a bake spec by which texels of ``parts`` parts are judged."""
    return Judge(
        firsts=spec.firsts,
        widths=np.array([term.order**2 for term in spec.terms]),
        squares=np.array([term.square[0] for term in spec.terms]),
        powers=powers_of(spec),
        unit=spec.unit,
        level=least_level(spec),
        darkest=MIN_LUMINANCE * spec.unit,
        beyond=MAX_SAMPLE_LEVELS**parts,
        checksums=SHOWN_CHECKSUMS,
    )


def powers_of(spec: BakeSpec) -> np.ndarray:
    """Return ``bake.noise.powers`` of the lights of each pair of terms, in the unit of the
    ``spec``; (terms, terms, channels, channels, most n²) float64.

    They weigh the products of two coefficients of a texel's transfer: the sum is the square of the
    texel's luminance, a mean over all turns of the light, see ``mean_square``. Weights above the
    lower order of a pair are 0, as the light of one of its terms has no such bands.
    """
    most = max(term.order for term in spec.terms) ** 2
    count = len(spec.terms)
    found = np.zeros((count, count, spec.channels, spec.channels, most))
    for (a, one), (b, other) in product(enumerate(spec.terms), repeat=2):
        each = powers(one.luminance / spec.unit, other.luminance / spec.unit)
        found[a, b, :, :, : each.shape[2]] = each
    return found


def fewest_samples(stamps: np.ndarray, parts: int) -> np.ndarray:
    """Return the fewest samples of any part of texels with these ``stamps``,
    0 if a part is not baked; (texels,) int32.
    """
    fewest = np.empty(len(stamps), np.int32)
    find_fewest(stamps, parts, MAX_SAMPLE_LEVELS, SAMPLES_OF, fewest)
    return fewest
