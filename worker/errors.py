"""Errors of the workers."""

from isogi_core.errors import IsogiError


class WorkersError(IsogiError):
    """The worker processes cannot be started or reached."""
