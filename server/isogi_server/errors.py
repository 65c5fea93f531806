"""Errors of the service, in addition to those of the domain; each message is one sentence for a
person.
"""

from isogi_core.errors import IsogiError, ViewError


class ParameterError(ViewError):
    """A parameter is unknown, repeated, out of range, or not read by the requested format.
    ``parameter`` is its name.
    """

    def __init__(self, sentence: str, parameter: str = "") -> None:
        super().__init__(sentence)
        self.parameter = parameter


class UnknownSceneError(IsogiError):
    """No scene has this id."""


class UnknownPartError(IsogiError):
    """A scene has no such chunk of texels or layers of voxels."""


class UnknownJobError(IsogiError):
    """No job has this id, or the job was forgotten."""


class NotAcceptableError(IsogiError):
    """No picture format fits the request's Accept header."""


class UnknownResultError(IsogiError):
    """A job has no document or file, or none yet."""


class BusyError(IsogiError):
    """More is asked for at a time than the settings allow. ``why`` is the reason in a word, for
    metrics.
    """

    def __init__(self, sentence: str, why: str = "late") -> None:
        super().__init__(sentence)
        self.why = why


class StartingError(IsogiError):
    """The service has not started yet."""


class LibraryError(IsogiError):
    """A library that a command needs is not installed."""


class StreamError(IsogiError):
    """A client breaks a limit of its stream, which is closed with this ``code`` (RFC 6455, 7.4)."""

    def __init__(self, sentence: str, code: int = 1008) -> None:
        super().__init__(sentence)
        self.code = code


class ForbiddenError(IsogiError):
    """The token does not allow the change, or the server does not hand out the data."""


class UploadsOffError(IsogiError):
    """This server takes no uploads."""


class UnknownVolumeError(IsogiError):
    """No uploaded volume has this id."""


class SlowUploadError(IsogiError):
    """An upload has stopped to arrive."""


class LateError(IsogiError):
    """An upload could not be read in time because the machine is busy."""


class FullError(IsogiError):
    """An upload or an export exceeds the quota or the free space of the disk."""


class UploadFolderError(IsogiError):
    """The folder of uploads cannot be used."""


class StalledError(IsogiError):
    """A client takes nothing of its answer while other answers wait."""
