"""Bake the first light of texels of pictures that paths of their pixels lit, once nobody waits for
a picture.

Such a picture is final without texels. Views that move and other isovalues read texels, so that
they are baked afterwards, while the processors have nothing else to do.
"""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from isogi_core.errors import IsogiError
from isogi_server.render.bakes import BackgroundBake
from isogi_server.render.picture_checks import Picture
from isogi_worker.bake_requests import Viewer

log = logging.getLogger("isogi.render")

IDLE_VIEWER = Viewer("idle", patient=True)
"""The viewer of bakes while nobody waits: they yield to all others."""

QUIET_SECONDS = 1.0
"""Time without a request for light after which nobody seems to wait for a picture."""

RENEWAL_SECONDS = 1.0
"""Time between two looks at a bake that is under way, which renew its request."""

MOST_PICTURES = 8
MOST_DONE = 256
"""Pictures whose texels wait to be baked, at most: the newest ones; and pictures that are
remembered to need nothing more.
"""


class IdleBakes:
    """Has texels of pictures baked while nobody waits for one. Safe to use from many threads."""

    def __init__(
        self,
        begin: Callable[[Picture], BackgroundBake | None],
        leave: Callable[[Viewer], object],
    ) -> None:
        """Set the functions that begin a bake and end it.

        ``begin`` requests the texels that a picture lacks for IDLE_VIEWER, those of one stage, and
        returns None if it lacks none that can be baked; ``leave`` drops the requests of a viewer.
        """
        self._begin = begin
        self._leave = leave
        self._pictures: OrderedDict[Picture, None] = OrderedDict()
        self._done: OrderedDict[Picture, None] = OrderedDict()
        self._disturbed = time.monotonic()
        self._waiting = 0
        self._changed = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None

    def add(self, picture: Picture) -> None:
        """Have the texels of a ``picture`` baked when nobody waits, unless that was done."""
        with self._changed:
            if self._closed or picture in self._done:
                return
            self._pictures[picture] = None
            self._pictures.move_to_end(picture)
            if len(self._pictures) > MOST_PICTURES:
                self._pictures.popitem(last=False)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="idle", daemon=True)
                self._thread.start()
            self._changed.notify()

    def disturb(self) -> None:
        """Note that somebody waits for a picture: bakes that nobody waits for stop."""
        with self._changed:
            self._disturbed = time.monotonic()
            self._changed.notify()

    @contextmanager
    def awaited(self) -> Iterator[None]:
        """Note that somebody waits for a picture until the context ends."""
        with self._changed:
            self._waiting += 1
            self._changed.notify()
        try:
            yield
        finally:
            with self._changed:
                self._waiting -= 1
            self.disturb()

    def close(self) -> None:
        """Bake nothing more, and return when the thread has ended."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _work(self) -> None:
        """Bake the texels of one picture after the other, the newest first, until closed."""
        while (picture := self._next()) is not None:
            try:
                self._bake(picture)
            except IsogiError as error:
                # As when its scene was dismissed, or its light does not fit the memory.
                log.debug("texels of a picture are not baked: %s", error)
            except Exception:
                log.exception("The texels of a picture could not be baked while nobody waited.")

    def _next(self) -> Picture | None:
        """Take the newest picture and return it, once there is one and nobody has waited for a
        picture in the last QUIET_SECONDS; return None if closed.
        """
        with self._changed:
            while not self._closed:
                quiet_seconds = time.monotonic() - self._disturbed
                ready = bool(self._pictures) and not self._waiting
                if ready and quiet_seconds >= QUIET_SECONDS:
                    return self._pictures.popitem()[0]
                # Sleep until it has been quiet for long enough; if there is no picture, or somebody
                # waits, until that changes.
                self._changed.wait(QUIET_SECONDS - quiet_seconds if ready else None)
            return None

    def _bake(self, picture: Picture) -> None:
        """Bake the texels of a ``picture``, stage after stage, until they are done or somebody
        waits for a picture; it is taken up again later then.
        """
        begun = time.monotonic()
        former = None
        while (bake := self._begin(picture)) is not None:
            # Chunks that still lack light after they were baked never get it.
            if former == (bake.bake, bake.chunks):
                break
            former = bake.bake, bake.chunks
            while bake.waiting():
                if self._interrupted(begun):
                    self._leave(IDLE_VIEWER)
                    self._put_back(picture)
                    return
        with self._changed:
            self._done[picture] = None
            if len(self._done) > MOST_DONE:
                self._done.popitem(last=False)

    def _put_back(self, picture: Picture) -> None:
        """Take up a ``picture`` again after the newer ones."""
        with self._changed:
            self._pictures.setdefault(picture)
            self._pictures.move_to_end(picture, last=False)

    def _interrupted(self, begun: float) -> bool:
        """Wait for RENEWAL_SECONDS. Return True, at once, if it was closed, or if somebody has
        waited for a picture since the time ``begun``, in seconds of the steady clock.
        """
        with self._changed:
            if self._disturbed <= begun and not (self._waiting or self._closed):
                self._changed.wait(RENEWAL_SECONDS)
            return bool(self._disturbed > begun or self._waiting or self._closed)
