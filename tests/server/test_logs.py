"""Lines of the log."""

import json
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from server.logs import REQUEST_ID, JsonLines, WithRequest

ROOT = Path(__file__).resolve().parents[2]
CODE = """
import logging
from server.logs import REQUEST_ID, configure
configure({form!r}, "info")
REQUEST_ID.set("mine")
logging.getLogger("isogi.test").info("two\\nlines", extra=dict(status=200))
logging.getLogger("isogi.test").debug("no")
logging.getLogger("other").info("no")
logging.getLogger("distributed.nanny").error("no")
"""


def logged(form: str) -> str:
    """What a process writes that logs in this form."""
    code = CODE.format(form=form)
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stderr


def test_json_is_one_line_an_event_with_its_request() -> None:
    (line,) = logged("json").splitlines()
    facts = json.loads(line)
    assert facts.pop("time").endswith("+00:00")
    assert facts == {
        **{"level": "info", "logger": "isogi.test", "request_id": "mine"},
        **{"message": "two\nlines", "status": 200},
    }


def test_text_names_the_request() -> None:
    assert "INFO isogi.test [mine] two" in logged("text")


def told(error: Exception, **more: Any) -> dict[str, Any]:
    """A record with an error, as JSON."""
    info = (type(error), error, error.__traceback__)
    record = logging.makeLogRecord({"name": "isogi", "msg": "failed", "levelname": "ERROR", "exc_info": info, **more})
    assert WithRequest().filter(record)
    facts: dict[str, Any] = json.loads(JsonLines().format(record))
    return facts


def test_a_traceback_stays_on_the_line() -> None:
    REQUEST_ID.set("")
    with pytest.raises(ZeroDivisionError) as raised:
        _ = 1 / 0
    facts = told(raised.value, place=Path("/store"))
    assert "ZeroDivisionError" in facts["traceback"]
    assert (facts["request_id"], facts["place"]) == ("-", "/store")
