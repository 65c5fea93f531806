"""Logs: one line an event, as text or as JSON, each with the id of the request that it is about."""

import json
import logging
import logging.config
import re
from contextvars import ContextVar
from datetime import UTC, datetime
from uuid import uuid4

REQUEST_ID: ContextVar[str] = ContextVar("request_id", default="")
"""The id of the request that is worked on; empty outside of one."""

WELL_FORMED = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)
STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "request_id", "taskName"}


def request_id(given: str | None) -> str:
    """The id that a client gave its request where it is well-formed, else a new one."""
    return given if given is not None and WELL_FORMED.fullmatch(given) else uuid4().hex


class WithRequest(logging.Filter):
    """Gives each record the id of the request that is worked on; drops most of what other libraries log.

    isogi logs itself what becomes of workers and their tasks; Dask warns of each stop of a busy worker.
    """

    def filter(self, record: logging.LogRecord) -> bool:
        """Let what isogi says pass, and the warnings of others."""
        record.request_id = REQUEST_ID.get() or "-"
        room = record.name.partition(".")[0]
        return room == "isogi" or (record.levelno >= logging.WARNING and room != "distributed")


class JsonLines(logging.Formatter):
    """A record as one line of JSON: time, level, logger, request, message, what it says besides, and a traceback."""

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
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
        return json.dumps(facts, default=str)


def configure(form: str, level: str) -> None:
    """Send what this process logs, from ``level`` on, to stderr; ``form`` is text or json."""
    text = {"format": "%(asctime)s %(levelname)s %(name)s [%(request_id)s] %(message)s"}
    handler = {"class": "logging.StreamHandler", "formatter": form, "filters": ["request"]}
    logging.config.dictConfig(
        {
            "version": 1,
            "disable_existing_loggers": False,
            "filters": {"request": {"()": WithRequest}},
            "formatters": {"text": text, "json": {"()": JsonLines}},
            "handlers": {"stderr": handler},
            "root": {"handlers": ["stderr"], "level": "WARNING"},
            "loggers": {"isogi": {"level": level.upper()}},
        }
    )
