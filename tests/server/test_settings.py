"""Settings by option, environment variable and file."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from isogi_server.cli.command import run
from isogi_server.cli.setting_options import unknown_variables
from isogi_server.settings import Settings, read_settings


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
    names = "127.0.0.1", "localhost", "::1"
    assert Settings(host="127.0.0.1").hosts() == names
    assert Settings(host="127.0.0.2").hosts() == (*names, "127.0.0.2")
    assert Settings(host="0.0.0.0").hosts() is None


def test_options_precede_the_environment_and_that_the_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "isogi-server.toml"
    file.write_text(
        'port = 81\nmax_pixels = 82\nworkers = 83\nallowed_origins = ["https://Lab.example"]\n'
    )
    monkeypatch.setenv("ISOGI_PORT", "91")
    monkeypatch.setenv("ISOGI_MAX_PIXELS", "92")
    settings = read_settings(file, port="1")
    assert (settings.port, settings.max_pixels, settings.workers) == (1, 92, 83)
    assert settings.allowed_origins == ("https://lab.example",)
    assert read_settings(port="1").workers != 83


@pytest.mark.parametrize("text", ["prt = 1", "port = 99999", 'token = "short"', "port ="])
def test_a_wrong_file_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ValueError, match=r"prt|port|token|value"):
        read_settings(tmp_path / "a.toml")


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_settings(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("host", "exposed"),
    [
        *[(host, False) for host in ("127.0.0.1", "127.1.2.3", "::1", "localhost")],
        *[(host, True) for host in ("0.0.0.0", "::", "192.168.0.3", "lab.example", "")],
    ],
)
def test_what_is_not_loopback_is_exposed(host: str, exposed: bool) -> None:
    assert Settings(host=host).exposed is exposed


@pytest.mark.parametrize(
    "origin", ["*", "lab.example", "https://", "https://*.lab.example", "https://lab.example/a"]
)
def test_an_origin_is_a_scheme_and_a_host(origin: str) -> None:
    with pytest.raises(ValidationError, match="is no origin"):
        Settings(allowed_origins=(origin,))


def test_the_token_is_not_shown() -> None:
    assert "correct horse" not in repr(Settings(token="correct horse battery"))


@pytest.mark.parametrize(
    ("name", "value"), [("ISOGI_PORT", "70000"), ("ISOGI_WORKERS", "0"), ("ISOGI_MAX_PIXELS", "x")]
)
def test_nonsense_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(ValidationError):
        Settings()


def certificates(folder: Path) -> dict[str, Path]:
    """Files of the names that certificates have."""
    files = {f"scheduler_{what}": folder / f"{what}.pem" for what in ("ca", "cert", "key")}
    for file in files.values():
        file.touch()
    return files


def test_a_scheduler_without_certificates_is_refused(tmp_path: Path) -> None:
    address = "tls://lab:8786"
    known = certificates(tmp_path)
    assert Settings(scheduler=address, **known).certificates == tuple(known.values())
    for wrong in ({}, {"scheduler": "tcp://lab:8786", **known}, {**known, "scheduler_key": None}):
        with pytest.raises(ValidationError, match="can run code there"):
            Settings(**{"scheduler": address, **wrong})
    assert Settings(scheduler="tcp://lab:8786", insecure_scheduler=True).certificates == (
        None,
        None,
        None,
    )
    with pytest.raises(ValidationError, match="not point to a file"):
        Settings(scheduler=address, **{**known, "scheduler_ca": tmp_path / "none.pem"})


def test_a_file_may_hold_the_token(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("correct horse battery\n")
    read = Settings(token_file=str(tmp_path / "token")).token
    assert read is not None and read.get_secret_value() == "correct horse battery"
    with pytest.raises(ValidationError, match="cannot be read"):
        Settings(token_file=str(tmp_path / "none"))


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("ISOGI_WROKERS", "did you mean ISOGI_WORKERS?"),
        ("ISOGI_TOKENFILE", "did you mean ISOGI_TOKEN_FILE?"),
        ("ISOGI_KERNELCACHE", "did you mean ISOGI_KERNEL_CACHE?"),
        ("ISOGI_QQQQ", "`isogi serve --help` lists all."),
    ],
)
def test_a_misspelt_variable_is_named_at_the_start(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, hint: str
) -> None:
    monkeypatch.setenv(name, "3")
    monkeypatch.setenv("ISOGI_PORT_8000_TCP", "tcp://10.0.0.1:8000")
    monkeypatch.setenv("ISOGI_SERVICE_HOST", "10.0.0.1")
    monkeypatch.setenv("ISOGI_WORKERS", "2")
    monkeypatch.setenv("ISOGI_KERNEL_CACHE", "/tmp")
    (sentence,) = unknown_variables()
    assert sentence == f"{name} is no variable of isogi and is ignored: {hint}"
    assert run(["inspect", "/"]) == 2
    assert capsys.readouterr().err.splitlines()[0] == f"isogi: {sentence}"


def test_a_server_logs_a_misspelt_variable(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("ISOGI_WROKERS", "3")
    monkeypatch.setattr("isogi_server.logs.configure", lambda form, level: None)
    assert run(["serve", "/"]) == 2
    assert "did you mean ISOGI_WORKERS?" in caplog.text
