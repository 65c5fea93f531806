"""What goes over a stream: views and receipts from the client, facts and problems to it."""

from __future__ import annotations

import json
from http import HTTPStatus
from typing import Annotated, Any, NoReturn

from pydantic import Field, StrictBool

from isogi_core.errors import IsogiError
from server.errors import ParameterError
from server.facts import coverage_facts
from server.order import Shown
from server.params import FrameParams, NoParams, read
from server.pictures import MEDIA_TYPES
from server.problems import Problem, status_of
from server.values import Span

Id = Annotated[int, Span(0, 2**53 - 1, whole=True)]


class Receipt(NoParams):
    """The client has shown a picture of the view with this id; it ``took`` so many milliseconds from when it came."""

    shown: Id
    took: Annotated[float, Span(0.0, 60_000.0)] = 0.0


class Wish(NoParams):
    """The client's view is now this one, and whether it is still ``moving``."""

    id: Id
    view: dict[str, Any] = Field(default_factory=dict)
    moving: StrictBool = False

    def params(self) -> FrameParams:
        """The view's parameters; ParameterError where they are not those of a frame."""
        params = read(FrameParams, self.view.items())
        if "wait_ms" in params.model_fields_set:
            raise ParameterError(
                "wait_ms is for requests, a stream tells of new light by itself: leave it out.", "wait_ms"
            )
        return params


def message_of(text: str) -> dict[str, Any]:
    """The JSON object in a message; ParameterError where there is none."""
    try:
        message = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise ParameterError("A message must be JSON, with numbers that are finite.") from None
    if not isinstance(message, dict):
        raise ParameterError('A message must be an object such as {"id": 1, "view": {}} or {"shown": 1}.')
    return message


def read_message(message: dict[str, Any]) -> Wish | Receipt:
    """The message as what it is; ParameterError on the first thing that is wrong."""
    return read(Receipt, message.items()) if "shown" in message else read(Wish, message.items())


def answer(wish: int, shown: Shown, form: str, draft: bool) -> str:
    """The facts of the picture that follows, an answer to the ``wish`` of this id."""
    frame = shown.frame
    return json.dumps(
        {
            "id": wish,
            "draft": draft,
            "final": not draft and not frame.provisional,
            "width": frame.view.width,
            "height": frame.view.height,
            "media_type": MEDIA_TYPES[form],
            "facts": coverage_facts(frame, shown.time_left).model_dump(),
            "timing": {stage: round(1000.0 * seconds, 2) for stage, seconds in shown.watch.seconds.items()},
        }
    )


def complaint(wish: Any, error: IsogiError, path: str) -> str:
    """A problem with the message of this id, null where it has none."""
    status = status_of(error)
    told = Problem(
        type="about:blank", title=HTTPStatus(status).phrase, status=status, detail=str(error), instance=path
    ).model_dump()
    if isinstance(error, ParameterError) and error.parameter:
        told["parameter"] = error.parameter
    return json.dumps({"id": wish if isinstance(wish, int) else None, "problem": told})


def _refuse(constant: str) -> NoReturn:
    raise ValueError(constant)
