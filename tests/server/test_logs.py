"""Lines of the log."""

import json
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from isogi_server.logs import REQUEST_ID, JsonLines, Repeats, WithRequest

ROOT = Path(__file__).resolve().parents[2]
CODE = """
import logging
from isogi_server.logs import REQUEST_ID, configure
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
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stderr


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


IMPORTED = """
import logging
import distributed
from isogi_server.logs import configure
configure("json", "info")
logging.getLogger("distributed.client").error("a line of its own form")
logging.getLogger("tornado.application").error("of another library")
logging.getLogger("isogi").info("ours")
"""


def test_libraries_write_no_lines_of_their_form() -> None:
    """Dask gives its loggers handlers when it is imported, before the log is configured."""
    command = [sys.executable, "-c", IMPORTED]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stderr
    lines = [json.loads(line) for line in said.splitlines()]
    assert [line["logger"] for line in lines] == ["tornado.application", "isogi"]


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def passed(
    repeats: Repeats, text: str, *values: Any, level: int = logging.WARNING, name: str = "isogi"
) -> str | None:
    """What is written of a record; None where nothing is."""
    record = logging.LogRecord(name, level, "", 0, text, values, None)
    if repeats.filter(record):
        return record.getMessage()
    return None


def test_what_comes_again_is_written_ten_times_a_minute() -> None:
    clock = Clock()
    repeats = Repeats(clock)
    written = [passed(repeats, "bad byte %d", each) for each in range(100)]
    assert written == [f"bad byte {each}" for each in range(10)] + [None] * 90
    clock.now = 59
    assert passed(repeats, "bad byte %d", 1) is None
    clock.now = 60
    assert (
        passed(repeats, "bad byte %d", 2)
        == "bad byte 2 (and 91 more of its kind, which are not written)"
    )
    assert passed(repeats, "bad byte %d", 3) == "bad byte 3"
    clock.now = 121
    assert passed(repeats, "bad byte %d", 4) == "bad byte 4"


def test_other_kinds_and_what_is_no_warning_are_written() -> None:
    repeats = Repeats(Clock())
    for number in range(30):
        passed(repeats, "%s", ValueError("bad"))
        assert passed(repeats, "request %d", number, level=logging.INFO)
    assert passed(repeats, "%s", ValueError("bad")) is None
    assert passed(repeats, "%s", KeyError("other")) and passed(repeats, "%s", "text")
    assert passed(repeats, "%s", ValueError("bad"), name="isogi.store")


FLOOD = """
import logging
from isogi_server.logs import configure
configure("text", "warning")
for n in range(1000):
    logging.getLogger("uvicorn.error").error("bad", exc_info=ValueError("bad"))
"""


def test_a_flood_leaves_few_lines() -> None:
    command = [sys.executable, "-c", FLOOD]
    said = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stderr
    assert said.count("ERROR uvicorn.error") == 10


def told(error: Exception, **more: Any) -> dict[str, Any]:
    """A record with an error, as JSON."""
    info = (type(error), error, error.__traceback__)
    record = logging.makeLogRecord(
        {"name": "isogi", "msg": "failed", "levelname": "ERROR", "exc_info": info, **more}
    )
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
