"""Settings by environment variable."""

import pytest
from pydantic import ValidationError

from server.settings import LOOPBACK, Settings


def test_every_setting_is_documented() -> None:
    assert all(field.description for field in Settings.model_fields.values())


def test_the_environment_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISOGI_PORT", "81")
    monkeypatch.setenv("ISOGI_ALLOWED_HOSTS", "render.example, localhost")
    settings = Settings()
    assert settings.port == 81
    assert settings.hosts() == ("render.example", "localhost")
    assert Settings(port=82).port == 82


def test_hosts_are_loopback_names_on_loopback_and_any_elsewhere() -> None:
    assert Settings(host="127.0.0.1").hosts() == LOOPBACK
    assert Settings(host="0.0.0.0").hosts() is None


@pytest.mark.parametrize(
    ("name", "value"), [("ISOGI_PORT", "70000"), ("ISOGI_WORKERS", "0"), ("ISOGI_MAX_PIXELS", "x")]
)
def test_nonsense_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(ValidationError):
        Settings()
