"""The options of ``isogi serve``, the settings and their documentation: one list."""

from pathlib import Path

import pytest

from server.cli.command import run
from server.cli.help import FIRST_HEADING, group_of
from server.cli.setting_options import SECRET_SETTINGS, flag, rows, variable
from server.settings import Settings

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "settings.md"


def test_the_help_lists_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["serve", "--help"]) == 0
    words = capsys.readouterr().out.replace("[", " ").replace("]", " ").split()
    for name in Settings.model_fields:
        assert variable(name) in words
        assert (flag(name) in words) is (name not in SECRET_SETTINGS)
    assert "--config" in words


def test_only_where_to_listen_is_in_no_group() -> None:
    """Where it fails: a new setting belongs into a group of ``server.cli.help``."""
    assert [name for name in Settings.model_fields if group_of(name) == FIRST_HEADING] == [
        "host",
        "port",
        *SECRET_SETTINGS,
    ]


def test_the_document_has_a_row_for_each_setting() -> None:
    """Where it fails: the rows of docs/settings.md are those that ``server.cli.setting_options.rows`` gives."""
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if "`ISOGI_" in line and line.startswith("| ")] == rows()


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """What stderr has, in one line, of a use that is wrong."""
    assert run(["serve", *arguments]) == 2
    out, error = capsys.readouterr()
    assert (out, error.count("\n")) == ("", 1)
    return error


def test_a_misspelt_setting_is_answered_with_the_nearest(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "isogi.toml").write_text("prot = 8123")
    assert run(["serve", "--config", str(tmp_path / "isogi.toml")]) == 2
    assert capsys.readouterr().err == "isogi: There is no setting 'prot': did you mean 'port'?\n"


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_others_are_not_served_without_a_token(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, host: str
) -> None:
    monkeypatch.delenv("ISOGI_TOKEN", raising=False)
    assert "ISOGI_TOKEN" in refusal(capsys, "demo:orbital", "--host", host)


def test_a_wrong_file_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "isogi-server.toml"
    assert "isogi-server.toml" in refusal(capsys, "--config", str(file))
    file.write_text("colour = 1")
    assert "colour" in refusal(capsys, "--config", str(file))
    file.write_text("port =")
    assert "isogi-server.toml" in refusal(capsys, "--config", str(file))


def test_a_former_setting_is_refused_with_its_new_name(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "isogi-server.toml"
    file.write_text("sharp_mb = 5")
    for given in (["--sharp-mb", "5"], ["--config", str(file)]):
        assert "sharp_mb is called projected_mb now" in refusal(capsys, *given)
    monkeypatch.setenv("ISOGI_SHARP_MB", "5")
    assert "sharp_mb is called projected_mb now" in refusal(capsys, "demo:orbital")


def test_a_token_that_is_too_short_is_not_repeated(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ISOGI_TOKEN", "hunter2")
    error = refusal(capsys, "demo:orbital")
    assert "token" in error and "hunter2" not in error
