"""Errors that belong to the service and not to the domain; each speaks to a person in one
sentence.
"""

from isogi_core.errors import IsogiError, ViewError


class ParameterError(ViewError):
    """A parameter is unknown, repeated, out of range, or not read by what was asked for."""

    def __init__(self, sentence: str, parameter: str = "") -> None:
        super().__init__(sentence)
        self.parameter = parameter


class UnknownSceneError(IsogiError):
    """No scene has this id."""


class UnknownPartError(IsogiError):
    """A scene has no such chunk of texels, or layers of voxels."""


class UnknownJobError(IsogiError):
    """No job has this id, or it is forgotten."""


class NotAcceptableError(IsogiError):
    """No picture format fits the request's Accept header."""


class UnknownResultError(IsogiError):
    """A job has no result of its own, or none yet."""


class BusyError(IsogiError):
    """More of something is asked for at once than the settings allow: ``why``, in a word that is
    counted.
    """

    def __init__(self, sentence: str, why: str = "late") -> None:
        super().__init__(sentence)
        self.why = why


class StartingError(IsogiError):
    """The renderer is not up yet."""


class LibraryError(IsogiError):
    """A library that a command needs is not installed."""


class StreamError(IsogiError):
    """A client breaks a limit of its stream, which is closed with this ``code`` (RFC 6455, 7.4)."""

    def __init__(self, sentence: str, code: int = 1008) -> None:
        super().__init__(sentence)
        self.code = code


class ForbiddenError(IsogiError):
    """What is to be changed belongs to somebody else."""


class UploadsOffError(IsogiError):
    """This server takes no uploads."""


class UnknownVolumeError(IsogiError):
    """No uploaded volume has this id."""


class SlowUploadError(IsogiError):
    """An upload stands still."""


class LateError(IsogiError):
    """An upload could not be read in time, as the machine is busy."""


class FullError(IsogiError):
    """An upload, or an export, is more than the quota, or the disk, has room for."""


class UploadFolderError(IsogiError):
    """The folder of uploads cannot be used."""


class StalledError(IsogiError):
    """A client takes nothing of an answer that others wait for."""
