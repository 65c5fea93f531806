"""Checks of pictures: steps that measure the total error and refine the picture, in a thread."""

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

from isogi_core.errors import IsogiError
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index
from worker.bake_requests import Viewer

log = logging.getLogger("isogi.render")

CHECK: Index = (-1, -1, -1)
"""Stands for a picture's check among the chunks that are coming for it."""

MAX_WAITING_PICTURES = 64
"""Pictures that wait to be checked: those asked for last."""


@dataclass(frozen=True)
class Picture:
    """A view of a scene whose total error is to reach a ``target``; nobody wants it once it is
    ``cancelled``.
    """

    scene: str
    view: View
    target: float
    cancelled: threading.Event = field(default_factory=threading.Event, compare=False)


Step = Callable[[str, View, float, threading.Event], bool]
Listener = Callable[[str, View, bool], object]


class PictureChecks:
    """Checks pictures step by step, the one asked for last first. Safe to use from many threads."""

    def __init__(self, step: Step, notify: Listener) -> None:
        """Take each ``step`` that there is; ``notify`` hears of it, and whether ``more`` are to
        come.
        """
        self._step = step
        self._notify = notify
        self._wanted: OrderedDict[Viewer, Picture] = OrderedDict()
        self._changed = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None

    def request(self, scene: str, view: View, target: float, viewer: Viewer) -> None:
        """Have a picture checked for a ``viewer``, in place of the one that it looked at before."""
        with self._changed:
            picture = Picture(scene, view, target)
            if self._closed or self._wanted.get(viewer) == picture:
                return
            self._drop(viewer)
            self._wanted[viewer] = picture
            if len(self._wanted) > MAX_WAITING_PICTURES:
                self._drop(next(iter(self._wanted)))
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="checking", daemon=True)
                self._thread.start()
            self._changed.notify()

    def leave(self, viewer: Viewer) -> None:
        """Check nothing more for a viewer that has gone, or looks at something else."""
        with self._changed:
            self._drop(viewer)

    def close(self) -> None:
        """Stop, and wait until it has."""
        with self._changed:
            self._closed = True
            for viewer in list(self._wanted):
                self._drop(viewer)
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _drop(self, viewer: Viewer) -> None:
        if (former := self._wanted.pop(viewer, None)) is not None:
            former.cancelled.set()

    def _work(self) -> None:
        """Check what is wanted, until closed."""
        while (found := self._next()) is not None:
            viewer, picture = found
            try:
                more = self._step(picture.scene, picture.view, picture.target, picture.cancelled)
            except IsogiError as error:
                log.debug("a picture is not checked: %s", error)
                more = False
            except Exception:
                log.exception(
                    "The check of a picture failed: it keeps the error that it has, others are "
                    "checked."
                )
                more = False
            if not more:
                self._done(viewer, picture)
            self._notify(picture.scene, picture.view, more)

    def _next(self) -> tuple[Viewer, Picture] | None:
        """The newest picture that is wanted, once there is one; None when closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._wanted or self._closed)
            if self._closed:
                return None
            return next(reversed(self._wanted.items()))

    def _done(self, viewer: Viewer, picture: Picture) -> None:
        with self._changed:
            if self._wanted.get(viewer) is picture:
                self._drop(viewer)
