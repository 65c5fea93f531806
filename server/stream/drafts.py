"""Drafts: how large the pictures of a moving view may be to come quickly, from what the last ones took.

What they take is to be drawn here and shown there, and both grow with their pixels; the way between does not.
"""

from server.stream.means import mixed

SCALES = (0.25, 0.35, 0.5, 0.7, 1.0)
"""Shares of the full width and height: few, so that the renderer's kept surfaces are found again."""

AIM, LONGEST, SHORTEST = 0.06, 0.045, 0.02
"""Seconds within which a draft is to be drawn and on the client's screen; of these it may be drawn and shown for
LONGEST at most, and for SHORTEST where the way is long: smaller pictures would not come sooner."""

MARGIN = 0.8
"""Share of the time to draw in that larger drafts must be expected to stay within before they are tried."""

FRESH = 0.5
"""How much the newest draft counts in what drafts are taken to need, against all before it."""


class Drafts:
    """The scale of one connection's drafts."""

    def __init__(self) -> None:
        self._rung = 2
        self._drawn = self._shown = 0.0

    @property
    def scale(self) -> float:
        """The share of the full width and height that the next draft is to have."""
        return SCALES[self._rung]

    def shown(self, seconds: float) -> None:
        """The client took so long to show a draft that it was sent, as it says itself."""
        self._shown = mixed(seconds, self._shown, FRESH)

    def drawn(self, seconds: float, way: float = 0.0) -> None:
        """A draft at ``scale`` was drawn for so long, and pictures are on the ``way`` for so long: size the next."""
        self._drawn = mixed(seconds, self._drawn, FRESH)
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
