"""The tally of baking: what waits, what was done, and what was lost."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Tally:
    """What a baker has to do and has done so far.

    Chunks ``waiting`` and ``given_up``, and seconds since the oldest was first asked for; tasks ``flying``, ``done``
    and ``failed``, those of the done whose light was there already (``duplicate``) or was damaged and is baked again
    (``healed``), and the ``paths`` that they baked; ``workers`` that there are, and their ``deaths``.
    """

    waiting: int
    given_up: int
    age: float
    flying: int
    done: int
    failed: int
    duplicate: int
    healed: int
    paths: int
    workers: int
    deaths: int
