"""Commands that run in the process of the tests."""

import pytest


@pytest.fixture(autouse=True)
def logs_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `serve` leave the logs of this process alone: other tests in it read what is logged."""
    monkeypatch.setattr("isogi_server.logs.configure", lambda form, level: None)
