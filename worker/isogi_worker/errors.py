"""Errors of the workers."""

from isogi_core.errors import IsogiError


class WorkersError(IsogiError):
    """The worker processes cannot be started or reached."""


class LostWorkerError(WorkersError):
    """A worker process died while it did a task, or while a task waited for it."""


class WorkersAwayError(WorkersError):
    """The workers cannot be reached at the moment; work is done when they are back."""
