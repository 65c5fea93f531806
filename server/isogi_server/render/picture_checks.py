"""Checks of pictures: steps that measure and refine pictures that lack no texels, on one thread."""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from isogi_core.bake.noise import Goal
from isogi_core.errors import IsogiError
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.bake_requests import Viewer

log = logging.getLogger("isogi.render")

CHECK: Index = (-1, -1, -1)
"""Stands for the check of a picture among the chunks that will have updates."""

MAX_WAITING_PICTURES = 64
"""Pictures that wait for their check at most. If there are more, the one that was requested longest
ago is dropped.
"""

MAX_VIEWERS = 64
"""Viewers of one picture that are remembered, the newest. A script that asks again and again for
its picture is another viewer with each request.
"""

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
    """A view of a scene whose total error is to reach a ``goal``."""

    scene: str
    view: View
    goal: Goal


@dataclass(eq=False)
class Wanted:
    """A ``picture`` that ``viewers`` want checked, the newest last. Steps are taken from the time
    ``due`` on, in seconds of the steady clock. ``cancelled`` is set once no viewer wants it any
    more.
    """

    picture: Picture
    due: float
    viewers: dict[Viewer, None] = field(default_factory=dict)
    cancelled: threading.Event = field(default_factory=threading.Event)


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
        # The pictures that are wanted, the one requested last at the end; and that of each viewer.
        self._wanted: OrderedDict[Picture, Wanted] = OrderedDict()
        self._pictures: dict[Viewer, Picture] = {}
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
        cancelled if nobody else wants it.

        If an equal picture is asked for again, by any viewer, the earlier of the two times holds,
        and a step of it that is running goes on. If too many pictures wait, the one that was
        requested longest ago is dropped.
        """
        picture = Picture(scene, view, goal)
        with self._changed:
            if self._closed:
                return
            now = time.monotonic()
            due = now + delay
            # Wait longer for a picture whose check failed a moment ago.
            self._failed = {each: until for each, until in self._failed.items() if until > now}
            if (until := self._failed.get(picture)) is not None:
                due = max(due, until)
            # The viewer's former picture goes, unless it is this one.
            new = self._pictures.get(viewer) != picture
            if new:
                self._leave(viewer)
            wanted = self._wanted.setdefault(picture, Wanted(picture, due))
            wanted.due = min(wanted.due, due)
            if new:
                self._add(viewer, wanted)
            # The thread starts with the first picture, as many engines check none.
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="checking", daemon=True)
                self._thread.start()
            self._changed.notify()

    def leave(self, viewer: Viewer) -> None:
        """Check nothing more for a viewer that has gone or looks at another picture."""
        with self._changed:
            self._leave(viewer)

    def close(self) -> None:
        """Cancel all checks, and return when the thread has ended."""
        with self._changed:
            self._closed = True
            for wanted in list(self._wanted.values()):
                self._drop(wanted)
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _add(self, viewer: Viewer, wanted: Wanted) -> None:
        """Add a viewer to those of a ``wanted`` picture, which is the newest then. Drop the oldest
        viewer, or the oldest picture, if there are too many.
        """
        wanted.viewers[viewer] = None
        self._pictures[viewer] = wanted.picture
        self._wanted.move_to_end(wanted.picture)
        if len(wanted.viewers) > MAX_VIEWERS:
            self._leave(next(iter(wanted.viewers)))
        if len(self._wanted) > MAX_WAITING_PICTURES:
            self._drop(next(iter(self._wanted.values())))

    def _leave(self, viewer: Viewer) -> None:
        """Forget what a viewer wanted. Drop its picture if nobody else wants it."""
        picture = self._pictures.pop(viewer, None)
        if picture is None:
            return
        wanted = self._wanted[picture]
        del wanted.viewers[viewer]
        if not wanted.viewers:
            self._drop(wanted)

    def _drop(self, wanted: Wanted) -> None:
        """Forget a picture and that its viewers want it, and cancel its step if one is running."""
        for viewer in wanted.viewers:
            del self._pictures[viewer]
        del self._wanted[wanted.picture]
        wanted.cancelled.set()

    def _work(self) -> None:
        """Take steps of the pictures that are wanted, until closed."""
        while (wanted := self._next()) is not None:
            picture = wanted.picture
            try:
                more = self._step(picture.scene, picture.view, picture.goal, wanted.cancelled)
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
                self._done(wanted)
            self._notify(picture.scene, picture.view, more)

    def _next(self) -> Wanted | None:
        """Return the newest picture that is wanted and due, once there is one; None if closed."""
        with self._changed:
            while not self._closed:
                now = time.monotonic()
                for wanted in reversed(self._wanted.values()):
                    if wanted.due <= now:
                        return wanted
                # Sleep until the next picture is due, or until others are asked for.
                waits = [wanted.due - now for wanted in self._wanted.values()]
                self._changed.wait(min(waits, default=None))
            return None

    def _done(self, wanted: Wanted) -> None:
        """Forget a picture that needs no further step, unless it was dropped meanwhile."""
        with self._changed:
            if self._wanted.get(wanted.picture) is wanted:
                self._drop(wanted)
