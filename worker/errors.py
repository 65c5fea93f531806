"""Errors of the workers."""

from isogi_core.errors import IsogiError


class WorkersError(IsogiError):
    """The worker processes cannot be started or reached."""


class LostWorkerError(WorkersError):
    """A worker process died at a task, or while one waited for it."""


class WorkersAwayError(WorkersError):
    """The workers cannot be reached at the moment; what is asked of them later will be done."""
