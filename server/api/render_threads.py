"""The threads of a service, by what is done on them: pictures, drafts, large pictures, and asking for light."""

from isogi_core.model.view import View
from server.render.scheduling import Renders

DRAFTS = 2
"""Threads for drafts alone, so that none waits for a full picture to end."""

LARGE_PICTURE_PIXELS = 1 << 21
"""Pixels beyond which pictures are drawn one at a time: each takes some 45 bytes a pixel besides what is kept."""

ASKING = 2
"""Threads that ask for light alone: they wait for each other at the queue of bakes, where no picture shall wait."""


class RenderThreads:
    """Threads for each kind of work, so that none of them waits for another kind."""

    def __init__(self, pictures: int) -> None:
        """So many for ``pictures`` that are neither drafts nor large; one of them while drafts wait for their turn."""
        self.drafts = Renders(DRAFTS, even=True)  # drafts are sized to take about as long
        self.pictures = Renders(pictures, lambda: self.drafts.crowded)
        self.large, self.asking, self.checks = Renders(1), Renders(ASKING), Renders(1)

    def of(self, view: View) -> Renders:
        """The threads on which the picture of a view is drawn, and written as a file."""
        if view.moving:
            return self.drafts
        return self.large if view.width * view.height > LARGE_PICTURE_PIXELS else self.pictures

    def close(self) -> None:
        """Take no more work; what still waits is dropped."""
        for each in (self.pictures, self.drafts, self.large, self.asking, self.checks):
            each.close()
