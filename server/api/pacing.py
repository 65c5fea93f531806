"""Pacing of a stream: how large drafts may be to come quickly, and how many pictures are under way."""

import asyncio
from collections import deque


def mixed(newest: float, before: float, fresh: float) -> float:
    """The mean with the ``newest``, which counts by the share ``fresh``, from that ``before``, 0 for unknown."""
    return fresh * newest + (1.0 - fresh) * (before or newest)


SCALES = (0.25, 0.35, 0.5, 0.7, 1.0)
"""Shares of the full width and height: few, so that the renderer's kept surfaces are found again."""

AIM, LONGEST, SHORTEST = 0.06, 0.045, 0.02
"""Seconds within which a draft is to be drawn and on the client's screen; of these it may be drawn and shown for
LONGEST at most, and for SHORTEST where the way is long: smaller pictures would not come sooner."""

MARGIN = 0.8
"""Share of the time to draw in that larger drafts must be expected to stay within before they are tried."""

FRESH_DRAFT = 0.5
"""How much the newest draft counts in what drafts are taken to need, against all before it."""


class Drafts:
    """The scale of one connection's drafts."""

    def __init__(self, crowded: bool = False) -> None:
        """Begin in the middle, or with the smallest where others wait for theirs."""
        self._rung = 0 if crowded else 2
        self._drawn = self._shown = 0.0

    @property
    def scale(self) -> float:
        """The share of the full width and height that the next draft is to have."""
        return SCALES[self._rung]

    def shown(self, seconds: float) -> None:
        """The client took so long to show a draft that it was sent, as it says itself."""
        self._shown = mixed(seconds, self._shown, FRESH_DRAFT)

    def drawn(self, seconds: float, way: float = 0.0) -> None:
        """A draft at ``scale`` was drawn for so long, and pictures are on the ``way`` for so long: size the next."""
        self._drawn = mixed(seconds, self._drawn, FRESH_DRAFT)
        took, left = self._drawn + self._shown, min(max(AIM - way, SHORTEST), LONGEST)
        if took > left:
            self._move(-1)
        elif self._rung + 1 < len(SCALES) and took * self._growth(1) < MARGIN * left:
            self._move(1)

    def _move(self, rungs: int) -> None:
        rung = max(self._rung + rungs, 0)
        self._drawn *= self._growth(rung - self._rung)
        self._shown *= self._growth(rung - self._rung)
        self._rung = rung

    def _growth(self, rungs: int) -> float:
        """How many times as many pixels there are so many rungs up."""
        return (SCALES[self._rung + rungs] / SCALES[self._rung]) ** 2


MOST = 2
"""Pictures that may be under way."""

FRESH_WAY = 0.2
"""How much the newest picture counts in what their way is taken to be, against all before it."""

PATIENCE = 1.0
"""Seconds after which a picture that was not acknowledged is taken for shown."""


class Window:
    """What was sent over one connection. Belongs to its event loop.

    ``way`` are the seconds that a picture takes from when it is sent until the server reads that it is shown, without
    those that the client says it took to show it: 0 as long as nothing was heard.
    """

    def __init__(self) -> None:
        self.way = 0.0
        self._sent: deque[tuple[int, float]] = deque()
        self._moved = asyncio.Event()

    def sent(self, request: int) -> None:
        """A picture for the request of this id was sent."""
        self._sent.append((request, asyncio.get_running_loop().time()))

    def shown(self, request: int, took: float = 0.0) -> None:
        """The client ``took`` so long to show the first picture under way for a request; those before it are done."""
        if any(each == request for each, _ in self._sent):
            while (first := self._sent.popleft())[0] != request:
                pass
            way = max(asyncio.get_running_loop().time() - first[1] - took, 0.0)
            self.way = mixed(way, self.way, FRESH_WAY)
            self._moved.set()

    async def room(self) -> None:
        """Returns when another picture may be sent."""
        while len(self._sent) >= MOST:
            left = self._sent[0][1] + PATIENCE - asyncio.get_running_loop().time()
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
