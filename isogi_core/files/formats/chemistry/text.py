"""Text with grids of numbers in it, read block by block, packed or not: lines of headers, patterns,
and numbers.

Numbers become an array a block at a time, so that no more words are in memory than a block has.
Fortran writes some numbers that Python does not read: ``1.5D-03``, ``0.15-103`` without its letter,
and ``-1.5E+00-2.5E+00`` without a blank between two of a fixed width.
"""

import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import Source
from isogi_core.files.grid import Shape, slab_layers
from isogi_core.files.packed_files import PACKING_DAMAGE, Content

BLOCK_BYTES = 1 << 20
"""Bytes of text that are split into words at once: these take some ten times as many."""

MAX_LINE = 1 << 16
"""Most bytes of a line of a header, and of a text that matches a pattern."""

_DIGIT_LETTER = re.compile(rb"(?<=[\d.])[dDqQ](?=[-+\d])")
_WITHOUT_LETTER = re.compile(rb"(?<=[\d.])([-+]\d{3})(?![\d.eE])")
_TOUCHING = re.compile(rb"(?<=[\d.])(?=[-+]\d*\.)")
"""Letters of exponents that Python does not know, exponents of three digits without a letter, and
places between two numbers without a blank.
"""


class Text:
    """The text of a packed or plain file, from its beginning on; ``name`` is for messages.

    Methods raise VolumeError if it is damaged or ends too early.
    """

    def __init__(self, file: Content, name: str) -> None:
        """Begin reading a ``file``."""
        self.name = name
        self._file = file
        self._rest = b""
        self._ended = False

    def _more(self) -> bool:
        """Read a block more; return False at the end."""
        try:
            block = self._file.read(BLOCK_BYTES)
        except PACKING_DAMAGE as error:
            raise VolumeError(f"'{self.name}' is damaged ({error}): copy it again.") from error
        self._rest += block
        self._ended = not block
        return bool(block)

    def line(self) -> str:
        """Return the next line without blanks at its ends. Raises VolumeError if there is none, or
        if it has more than MAX_LINE bytes.
        """
        # Read blocks until one holds the end of the line, or the line is too long.
        while b"\n" not in self._rest[:MAX_LINE] and not self._ended and len(self._rest) < MAX_LINE:
            self._more()
        end = self._rest.find(b"\n", 0, MAX_LINE)
        if end < 0 and len(self._rest) >= MAX_LINE:
            raise VolumeError(
                f"A line of '{self.name}' has more than {MAX_LINE} bytes: write it again."
            )
        if end < 0 and not self._rest:
            raise VolumeError(f"'{self.name}' ends within its header: copy it again.")
        # The last line of a file may have no end.
        found = self._rest[:end] if end >= 0 else self._rest
        self._rest = self._rest[end + 1 :] if end >= 0 else b""
        return found.decode("latin-1").strip()

    def words(self, least: int, what: str) -> list[str]:
        """Return the words of the next line. Raises VolumeError, which says ``what`` is missing, if
        it has fewer than ``least``.
        """
        line = self.line()
        words = line.split()
        if len(words) < least:
            raise VolumeError(f"'{self.name}' has '{line[:60]}' instead of {what}: write it again.")
        return words

    def whole_numbers(self, count: int, what: str) -> list[int]:
        """Return the first ``count`` whole numbers of the next line."""
        words = self.words(count, what)[:count]
        try:
            return [int(word) for word in words]
        except ValueError as error:
            raise self._wrong(words, what) from error

    def reals(self, count: int, what: str) -> list[float]:
        """Return the first ``count`` numbers of the next line, which must be finite."""
        words = self.words(1, what)
        try:
            found, _ = numbers_in(" ".join(words).encode("latin-1"), count, self.name)
        except VolumeError as error:
            raise self._wrong(words, what) from error
        if len(found) != count or not np.isfinite(found).all():
            raise self._wrong(words, what)
        return [float(number) for number in found]

    def _wrong(self, words: list[str], what: str) -> VolumeError:
        return VolumeError(
            f"'{self.name}' has '{' '.join(words)[:60]}' instead of {what}: write it again."
        )

    def put_back(self, line: str) -> None:
        """Have a ``line`` read again."""
        self._rest = line.encode("latin-1") + b"\n" + self._rest

    def binary(self, count: int, dtype: np.dtype[Any]) -> np.ndarray:
        """Return the next ``count`` numbers as bytes of a type, (count,); memory is allocated as
        they are read.
        """
        size = count * dtype.itemsize
        while len(self._rest) < size and self._more():
            pass
        if len(self._rest) < size:
            raise VolumeError(f"'{self.name}' ends before its last voxel: copy it again.")
        return np.frombuffer(self._rest[:size], dtype)

    def find(self, pattern: "re.Pattern[bytes]") -> "re.Match[bytes] | None":
        """Return the next match of a ``pattern``, and go on reading after it; None if there is
        none: all is read then.
        """
        while True:
            found = pattern.search(self._rest)
            # a match that ends with the block may go on in the next one
            if found is not None and (self._ended or found.end() < len(self._rest)):
                self._rest = self._rest[found.end() :]
                return found
            if self._ended:
                self._rest = b""
                return None
            if found is None:
                # what may be the beginning of a match is kept, from the beginning of a line on
                self._rest = self._rest[
                    self._rest.find(b"\n", max(len(self._rest) - MAX_LINE, 0)) :
                ]
            self._more()

    def numbers(self, count: int) -> Iterator[np.ndarray]:
        """Yield the next ``count`` numbers, float64, a block at a time."""
        while count > 0:
            text = self._whole_words()
            if not text.strip() and self._ended:
                raise VolumeError(f"'{self.name}' ends before its last voxel: copy it again.")
            found, rest = numbers_in(text, count, self.name)
            self._rest = rest + self._rest
            count -= len(found)
            yield found

    def slabs(self, shape: Shape) -> Iterator[np.ndarray]:
        """Yield the next numbers as an array of a ``shape``, float64, some layers at a time."""
        layer = math.prod(shape[1:])
        deep = slab_layers(layer * np.dtype(np.float64).itemsize)
        for first in range(0, shape[0], deep):
            layers = min(deep, shape[0] - first)
            yield filled(self.numbers(layers * layer), layers * layer).reshape(-1, *shape[1:])

    def _whole_words(self) -> bytes:
        """Return words of about a block, which ends between two of them; all that is left at the
        end.
        """
        while len(self._rest) < BLOCK_BYTES and not self._ended:
            self._more()
        if self._ended:
            text, self._rest = self._rest, b""
            return text
        end = max(self._rest.rfind(blank) for blank in (b" ", b"\n", b"\t")) + 1
        if end == 0:
            raise VolumeError(f"'{self.name}' has a word of {BLOCK_BYTES} bytes: write it again.")
        text, self._rest = self._rest[:end], self._rest[end:]
        return text


GROWTH_NUMBERS = 1 << 20
"""Numbers for which memory is taken at first; it doubles as they are read."""


def filled(blocks: Iterable[np.ndarray], count: int) -> np.ndarray:
    """Return the ``count`` numbers of ``blocks``, (count,) float64; memory grows with those that
    were read.
    """
    found = np.empty(min(count, GROWTH_NUMBERS))
    end = 0
    for block in blocks:
        if end + len(block) > len(found):
            larger = np.empty(min(max(2 * len(found), end + len(block)), count))
            larger[:end] = found[:end]
            found = larger
        found[end : end + len(block)] = block
        end += len(block)
    return found


def numbers_in(text: bytes, count: int, name: str) -> tuple[np.ndarray, bytes]:
    """Return the first ``count`` numbers of a ``text``, or all, float64, and the text that follows
    them.

    Raises VolumeError if a word is no number.
    """
    found = scientific_numbers(text)
    if found is not None and len(found) <= count:
        return found, b""
    words, rest = first_words(text, count)
    try:
        return np.array(words, np.float64), rest
    except ValueError:
        words, rest = first_words(mended(text), count)
    try:
        return np.array(words, np.float64), rest
    except ValueError as error:
        wrong = next(word for word in words if not is_number(word))
        raise VolumeError(
            f"'{name}' holds '{wrong[:40].decode('latin-1')}' instead of a number: write it again."
        ) from error


ZERO, NINE, DOT, MINUS, BLANK = b"09.- "

MOST_DIGITS = 15
EXACT_POWERS = np.array([float(f"1e{power}") for power in range(23)])
"""Digits of a whole number, and powers of ten, that float64 holds exactly: their product or
quotient is then the nearest number, as of any correct parser (Clinger 1990).
"""


def scientific_numbers(text: bytes) -> np.ndarray | None:
    """Return all numbers of a ``text``, float64, if all are written with one digit, equally many
    decimals and an exponent of two digits, ``-1.23456E-05``; None if any is not.

    Most programs write all numbers so. They are read at once, by the places of their letters E.
    """
    letters = np.frombuffer(text, np.uint8)
    at = np.flatnonzero((letters == ord("E")) | (letters == ord("e")))
    decimals = text.find(b"E") - text.find(b".") - 1
    if not len(at) or not 1 <= decimals < MOST_DIGITS or at[0] < decimals + 2:
        return None
    blank = letters <= BLANK
    starts = np.count_nonzero(blank[:-1] & ~blank[1:]) + int(not blank[0])
    # The last number may end with the text: blanks stand for what follows it.
    letters = np.append(letters, np.full(4, BLANK, np.uint8))
    sign = np.where(at > decimals + 2, letters[at - decimals - 3], BLANK)
    places = [at - decimals - 2, *(at - n for n in range(decimals, 0, -1)), at + 2, at + 3]
    digits = [letters[each] for each in places]
    alike = (letters[at - decimals - 1] == DOT) & (letters[at + 4] <= BLANK)
    alike &= (sign == MINUS) | (sign <= BLANK)
    alike &= (letters[at + 1] == MINUS) | (letters[at + 1] == ord("+"))
    for each in digits:
        alike &= (each >= ZERO) & (each <= NINE)
    if starts != len(at) or not alike.all():
        return None
    whole = np.zeros(len(at), np.int64)
    for each in digits[:-2]:
        whole = 10 * whole + (each - ZERO)
    power = 10 * (digits[-2] - ZERO).astype(np.int64) + (digits[-1] - ZERO)
    power = np.where(letters[at + 1] == MINUS, -power, power) - decimals
    last = len(EXACT_POWERS) - 1
    exact = EXACT_POWERS[np.minimum(np.abs(power), last)]
    found = np.where(power < 0, whole / exact, whole * exact)
    found = np.where(sign == MINUS, -found, found)
    far = np.flatnonzero(np.abs(power) > last)
    begins = at[far] - decimals - 3
    found[far] = [
        float(text[max(begin, 0) : end]) for begin, end in zip(begins, at[far] + 4, strict=True)
    ]
    return found


def first_words(text: bytes, count: int) -> tuple[list[bytes], bytes]:
    """Return the first ``count`` words of a ``text``, or all, and the text that follows them."""
    words = text.split(None, count)
    if len(words) > count:
        return words[:count], words[count]
    return words, b""


def is_number(word: bytes) -> bool:
    """Return True if Python reads a ``word`` as a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def mended(text: bytes) -> bytes:
    """Return a ``text`` with numbers of Fortran written as Python reads them."""
    text = _TOUCHING.sub(b" ", text)
    return _WITHOUT_LETTER.sub(rb"E\1", _DIGIT_LETTER.sub(b"E", text))


@contextmanager
def text_of(source: Source) -> Iterator[Text]:
    """Yield the text of a ``source`` at its beginning."""
    with source.unpacked() as file:
        yield Text(file, source.name)
