"""Pacing of a stream: how large drafts may be to come quickly, and how many pictures are under way."""

import asyncio
from collections import deque


def mixed(newest: float, before: float, fresh: float) -> float:
    """The mean with the ``newest``, which counts by the share ``fresh``, from that ``before``, 0 for unknown."""
    return fresh * newest + (1.0 - fresh) * (before or newest)


HALF, QUARTER = 0.5, 0.25
"""Shares of the full width and height that drafts have."""

MAX_DRAFT_SECONDS = 0.045
"""Seconds that a draft may be drawn and shown for."""

PACE_MARGIN = 0.8
"""Share of that time in which larger drafts must be expected to come before they are tried."""

FRESH = 0.5
"""How much the newest draft counts in what drafts are taken to need, against all before it."""


class Drafts:
    """The ``scale`` of a connection's drafts: a half of the full width and height, or a quarter where that is slow."""

    def __init__(self, crowded: bool = False) -> None:
        """Begin with halves, or with quarters where others wait for theirs."""
        self.scale = QUARTER if crowded else HALF
        self._drawn = self._shown = 0.0

    def shown(self, seconds: float) -> None:
        """The client took so long to show a draft that it was sent, as it says itself."""
        self._shown = mixed(seconds, self._shown, FRESH)

    def drawn(self, seconds: float) -> None:
        """A draft at ``scale`` was drawn for so long: size the next."""
        self._drawn = mixed(seconds, self._drawn, FRESH)
        took, pixels = self._drawn + self._shown, (HALF / QUARTER) ** 2
        if self.scale == HALF and took > MAX_DRAFT_SECONDS:
            self._resize(QUARTER, 1.0 / pixels)
        elif self.scale == QUARTER and pixels * took < PACE_MARGIN * MAX_DRAFT_SECONDS:
            self._resize(HALF, pixels)

    def _resize(self, scale: float, pixels: float) -> None:
        self.scale, self._drawn, self._shown = scale, pixels * self._drawn, pixels * self._shown


MAX_PICTURES_AHEAD = 2
"""Pictures that may be under way."""

RECEIPT_SECONDS = 1.0
"""Seconds after which a picture that was not acknowledged is taken for shown."""


class Window:
    """What was sent over one connection. Belongs to its event loop."""

    def __init__(self) -> None:
        self._sent: deque[tuple[int, float]] = deque()
        self._moved = asyncio.Event()

    def sent(self, request: int) -> None:
        """A picture for the request of this id was sent."""
        self._sent.append((request, asyncio.get_running_loop().time()))

    def shown(self, request: int) -> None:
        """The client shows the first picture under way for a request; those before it are done."""
        if any(each == request for each, _ in self._sent):
            while self._sent.popleft()[0] != request:
                pass
            self._moved.set()

    async def room(self) -> None:
        """Returns when another picture may be sent."""
        while len(self._sent) >= MAX_PICTURES_AHEAD:
            left = self._sent[0][1] + RECEIPT_SECONDS - asyncio.get_running_loop().time()
            if left <= 0.0:
                self._sent.popleft()
                continue
            self._moved.clear()
            try:
                await asyncio.wait_for(self._moved.wait(), left)
            except TimeoutError:
                continue


GAP = 1.0
"""Seconds after the last view of a hand that moves for which it is taken to move on."""


class Motion:
    """How well a stream follows: ``drafts`` that were sent, and the ``seconds`` in which its view moved.

    ``since`` is when the newest view came. Belongs to its event loop.
    """

    def __init__(self) -> None:
        self.drafts, self.seconds, self.since = 0, 0.0, 0.0
        self._moving_since: float | None = None

    def took(self, moving: bool) -> None:
        """A view came, and it moves or rests."""
        now = asyncio.get_running_loop().time()
        if self._moving_since is not None:
            self.seconds += min(now - self._moving_since, GAP)
        self._moving_since, self.since = now if moving else None, now

    def sent(self, came: float, draft: bool) -> float:
        """A picture is sent of the view that ``came`` then; how old it is."""
        self.drafts += draft
        return asyncio.get_running_loop().time() - came
