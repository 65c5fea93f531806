"""The window: pictures under way that the client has not shown yet."""

import asyncio
from collections import deque

from server.stream.means import mixed

MOST = 2
"""Pictures that may be under way."""

FRESH = 0.2
"""How much the newest picture counts in what their way is taken to be, against all before it."""

PATIENCE = 1.0
"""Seconds after which a picture that was not acknowledged is taken for shown."""


class Window:
    """What was sent over one connection. Belongs to its event loop.

    ``way`` are the seconds that a picture takes from when it is sent until the server hears that it is shown, without
    those that the client says it took to show it: 0 as long as nothing was heard.
    """

    def __init__(self) -> None:
        self.way = 0.0
        self._sent: deque[tuple[int, float]] = deque()
        self._moved = asyncio.Event()

    def sent(self, wish: int) -> None:
        """A picture for the wish of this id was sent."""
        self._sent.append((wish, asyncio.get_running_loop().time()))

    def shown(self, wish: int, took: float = 0.0) -> None:
        """The client ``took`` so long to show the first picture under way for this wish; those before it are done."""
        if any(each == wish for each, _ in self._sent):
            while (first := self._sent.popleft())[0] != wish:
                pass
            way = max(asyncio.get_running_loop().time() - first[1] - took, 0.0)
            self.way = mixed(way, self.way, FRESH)
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
