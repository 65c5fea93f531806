"""Checks of pictures: steps that measure and refine pictures that lack no texels, on one thread."""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from isogi_core.bake.noise import Goal
from isogi_core.errors import IsogiError
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.bake_requests import Viewer

log = logging.getLogger("isogi.render")

CHECK: Index = (-1, -1, -1)
"""Stands for the check of a picture among the chunks that will have updates."""

MAX_WAITING_PICTURES = 64
"""Pictures that wait for their check at most. If there are more, the oldest request is dropped."""

LIGHT_PATIENCE_SECONDS = 2.0
"""Time for which a picture with a part of its light waits for the rest before control pixels
measure it as it is: their paths would take processors from workers, and delay the whole picture.
"""

FAILURE_PATIENCE_SECONDS = 10.0
"""Time after which a picture is checked again whose check failed by an unexpected error. Clients
that wait for the picture ask many times a second.
"""


@dataclass(frozen=True)
class Picture:
    """A view of a scene whose total error is to reach a ``goal``. Pictures are equal if these three
    are equal.

    ``cancelled`` is set once no viewer wants the picture. Steps are taken from the time ``due`` on,
    in seconds of the steady clock.
    """

    scene: str
    view: View
    goal: Goal
    cancelled: threading.Event = field(default_factory=threading.Event, compare=False)
    due: float = field(default=0.0, compare=False)


Step = Callable[[str, View, Goal, threading.Event], bool]
Listener = Callable[[str, View, bool], object]


class PictureChecks:
    """Checks pictures step by step on one thread, the one requested last first. Safe to use
    from many threads.
    """

    def __init__(self, step: Step, notify: Listener) -> None:
        """Set the functions of a check.

        ``step`` takes one step of a picture's check and returns True if there may be more.
        ``notify`` is called after each step with the scene, the view, and that answer.
        """
        self._step = step
        self._notify = notify
        self._wanted: OrderedDict[Viewer, Picture] = OrderedDict()
        # Pictures whose check failed, until the times at which they may be checked again.
        self._failed: dict[Picture, float] = {}
        self._changed = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None

    def request(
        self, scene: str, view: View, goal: Goal, viewer: Viewer, delay: float = 0.0
    ) -> None:
        """Have a picture checked for a ``viewer`` after ``delay`` seconds, or later if its check
        failed a moment ago. It replaces the picture that the viewer looked at before, whose step is
        cancelled.

        If an equal picture is asked for again, the earlier of the two times holds, and a step of it
        that is running goes on. If too many pictures wait, the oldest request is dropped.
        """
        with self._changed:
            now = time.monotonic()
            picture = Picture(scene, view, goal, due=now + delay)
            # Wait longer for a picture whose check failed a moment ago.
            self._failed = {each: until for each, until in self._failed.items() if until > now}
            if (until := self._failed.get(picture)) is not None:
                picture = replace(picture, due=max(picture.due, until))
            # Keep an equal picture that is due no later, as is each one whose step is running.
            former = self._wanted.get(viewer)
            if self._closed or (former and former == picture and former.due <= picture.due):
                return
            self._drop(viewer)
            self._wanted[viewer] = picture
            if len(self._wanted) > MAX_WAITING_PICTURES:
                self._drop(next(iter(self._wanted)))
            # The thread starts with the first picture, as many engines check none.
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="checking", daemon=True)
                self._thread.start()
            self._changed.notify()

    def leave(self, viewer: Viewer) -> None:
        """Check nothing more for a viewer that has gone or looks at another picture."""
        with self._changed:
            self._drop(viewer)

    def close(self) -> None:
        """Cancel all checks, and return when the thread has ended."""
        with self._changed:
            self._closed = True
            for viewer in list(self._wanted):
                self._drop(viewer)
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _drop(self, viewer: Viewer) -> None:
        """Forget a viewer's picture, and cancel its step if one is running."""
        if (former := self._wanted.pop(viewer, None)) is not None:
            former.cancelled.set()

    def _work(self) -> None:
        """Take steps of the pictures that are wanted, until closed."""
        while (found := self._next()) is not None:
            viewer, picture = found
            try:
                more = self._step(picture.scene, picture.view, picture.goal, picture.cancelled)
            except IsogiError as error:
                # Expected, as when nobody wants the picture any more: it may be asked for again
                # immediately.
                log.debug("a picture is not checked: %s", error)
                more = False
            except Exception:
                # An unexpected error ends the check of this picture only, for some time.
                with self._changed:
                    self._failed[picture] = time.monotonic() + FAILURE_PATIENCE_SECONDS
                log.exception(
                    "The check of a picture failed: it keeps the error that it has, others are "
                    "checked, and it is tried again if it is looked at in %g s.",
                    FAILURE_PATIENCE_SECONDS,
                )
                more = False
            if not more:
                self._done(viewer, picture)
            self._notify(picture.scene, picture.view, more)

    def _next(self) -> tuple[Viewer, Picture] | None:
        """Return the newest picture that is wanted and due, with its viewer, once there is one;
        None if closed.
        """
        with self._changed:
            while not self._closed:
                now = time.monotonic()
                for viewer, picture in reversed(self._wanted.items()):
                    if picture.due <= now:
                        return viewer, picture
                # Sleep until the next picture is due, or until others are asked for.
                waits = [picture.due - now for picture in self._wanted.values()]
                self._changed.wait(min(waits, default=None))
            return None

    def _done(self, viewer: Viewer, picture: Picture) -> None:
        """Forget a picture that needs no further step, unless its viewer has asked for another
        one meanwhile.
        """
        with self._changed:
            if self._wanted.get(viewer) is picture:
                self._drop(viewer)
