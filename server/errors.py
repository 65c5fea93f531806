"""Errors that belong to the service and not to the domain; each speaks to a person in one sentence."""

from isogi_core.errors import IsogiError, ViewError


class ParameterError(ViewError):
    """A parameter is unknown, repeated, out of range, or not read by what was asked for."""

    def __init__(self, sentence: str, parameter: str = "") -> None:
        super().__init__(sentence)
        self.parameter = parameter


class UnknownSceneError(IsogiError):
    """No scene has this id."""


class NotAcceptableError(IsogiError):
    """No picture format fits the request's Accept header."""


class BusyError(IsogiError):
    """More frames wait than the settings allow."""


class StartingError(IsogiError):
    """The renderer is not up yet."""


class LibraryError(IsogiError):
    """A library that a command needs is not installed."""
