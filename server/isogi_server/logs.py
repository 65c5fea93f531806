"""Logs: one line for each event, as text or JSON, with the id of the request that it belongs to."""

import json
import logging
import logging.config
import re
import time
from collections.abc import Callable, Hashable
from contextvars import ContextVar
from datetime import UTC, datetime
from uuid import uuid4

from isogi_core.errors import readable

REQUEST_ID: ContextVar[str] = ContextVar("request_id", default="")
"""The id of the present request; empty outside of requests."""

WELL_FORMED = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)
STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {
    "message",
    "asctime",
    "request_id",
    "taskName",
}


def request_id(given: str | None) -> str:
    """Return the id that a client gave its request if it is well-formed, else a new one."""
    if given is not None and WELL_FORMED.fullmatch(given):
        return given
    return uuid4().hex


MAX_WARNINGS = 10
SPAN = 60.0
"""Warnings of a kind that are written in this number of seconds; further ones are only counted."""


class Repeats(logging.Filter):
    """Drops warnings and errors that are repeated, so that clients cannot fill the disk.

    Records of one kind have the same logger, the same text before its values are inserted, and the
    same class of error.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Create a filter that has seen no record."""
        super().__init__()
        self._clock = clock
        self._seen: dict[Hashable, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Let the first MAX_WARNINGS of a kind pass in each SPAN; the first one after that says
        how many were dropped.
        """
        if record.levelno < logging.WARNING:
            return True
        kind = kind_of(record)
        now = self._clock()
        begun, count = self._seen.get(kind, (now, 0))
        if now - begun >= SPAN:
            if count > MAX_WARNINGS:
                more = MORE_OF_A_KIND.format(count - MAX_WARNINGS)
            else:
                more = ""
            record.msg = record.getMessage() + more
            record.args = None
            begun = now
            count = 0
            # Forget kinds that have not come for a SPAN, so that the table stays small.
            self._seen = {
                each: seen
                for each, seen in self._seen.items()
                if now - seen[0] < SPAN or each == kind
            }
        self._seen[kind] = begun, count + 1
        return count < MAX_WARNINGS


MORE_OF_A_KIND = " (and {} more of its kind, which are not written)"


def kind_of(record: logging.LogRecord) -> Hashable:
    """Return the kind of a record."""
    if record.args:
        raised = [type(each) for each in record.args if isinstance(each, BaseException)]
    else:
        raised = []
    return record.name, record.msg, *raised, record.exc_info[0] if record.exc_info else None


class WithRequest(logging.Filter):
    """Adds the id of the present request to each record, and drops most records of other libraries.

    isogi logs the fate of workers and their tasks itself; Dask warns whenever a busy worker stops.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        """Let records of isogi pass, and warnings of other libraries except Dask."""
        record.request_id = REQUEST_ID.get() or "-"
        room = record.name.partition(".")[0]
        return room == "isogi" or (record.levelno >= logging.WARNING and room != "distributed")


class JsonLines(logging.Formatter):
    """Formats a record as one line of JSON: time, level, logger, request, message, extra facts,
    and a traceback.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        facts = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "request_id": getattr(record, "request_id", "-"),
            "message": record.getMessage(),
            **{name: value for name, value in vars(record).items() if name not in STANDARD},
        }
        if record.exc_info:
            facts["traceback"] = self.formatException(record.exc_info)
        # Names of files may hold bytes that are no UTF-8: make them readable.
        return json.dumps(
            {
                name: readable(each) if isinstance(each, str) else each
                for name, each in facts.items()
            },
            default=str,
        )


def configure(form: str, level: str) -> None:
    """Send log records from ``level`` on to stderr; ``form`` is text or json.

    Handlers that libraries such as Dask installed when they were imported are removed, as they
    write lines of their own form.
    """
    # Remove handlers of libraries that are imported already.
    for logger in logging.root.manager.loggerDict.values():
        if isinstance(logger, logging.Logger):
            logger.handlers.clear()
            logger.propagate = True
    text = {"format": "%(asctime)s %(levelname)s %(name)s [%(request_id)s] %(message)s"}
    handler = {
        "class": "logging.StreamHandler",
        "formatter": form,
        "filters": ["request", "repeats"],
    }
    logging.config.dictConfig(
        {
            "version": 1,
            "disable_existing_loggers": False,
            "filters": {"request": {"()": WithRequest}, "repeats": {"()": Repeats}},
            "formatters": {"text": text, "json": {"()": JsonLines}},
            "handlers": {"stderr": handler},
            "root": {"handlers": ["stderr"], "level": "WARNING"},
            "loggers": {"isogi": {"level": level.upper()}},
        }
    )
