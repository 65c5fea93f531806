"""Names of files that are not UTF-8: shown in every answer, header, line and log, and nothing
fails.
"""

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from isogi_core.errors import VolumeError, readable
from isogi_core.plan.assembly import load_scene
from isogi_server.logs import JsonLines
from tests.live import serving

ROOT = Path(__file__).resolve().parents[3]
HEADER = b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 20 20 20\nencoding: raw\n\n"
SHOWN = r"Gr\xf6\xdfe"


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """A volume whose file has a name in Latin-1."""
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/Gr\xf6\xdfe.nrrd"))
    values = bytes((x * y * z) % 251 for x in range(20) for y in range(20) for z in range(20))
    path.write_bytes(HEADER + values)
    return path


def test_bytes_that_are_no_text_are_shown_as_numbers() -> None:
    assert readable(os.fsdecode(b"Gr\xf6\xdfe")) == SHOWN
    assert readable("Größe, \ud800") == r"Größe, \ud800"
    name = os.fsdecode(b"a-\xff")
    assert str(VolumeError(f"There is no file {name}.")) == r"There is no file a-\xff."


def test_a_scene_of_such_a_file_is_served(odd: Path, tmp_path: Path) -> None:
    with (
        serving(odd, tmp_path / "light") as url,
        httpx.Client(base_url=url, timeout=120) as client,
    ):
        (listed,) = client.get("/v1/scenes").raise_for_status().json()["scenes"]
        assert listed["name"] == SHOWN
        scene = f"/v1/scenes/{listed['id']}"
        facts = client.get(scene).raise_for_status().json()
        assert (facts["name"], facts["volume"]["name"]) == (SHOWN, SHOWN)
        assert client.get("/").status_code == 200
        view = {"width": 16, "height": 16}
        assert client.get(f"{scene}/frame", params=view).status_code == 200
        assert client.get(f"{scene}/card", params=view).status_code == 200


def test_a_file_that_is_gone_is_named_in_an_answer(odd: Path) -> None:
    odd.rename(odd.with_name("other.nrrd"))
    with pytest.raises(VolumeError) as raised:
        load_scene(odd)
    assert SHOWN in str(raised.value)
    str(raised.value).encode()


def test_such_a_name_is_written_to_a_log_of_json() -> None:
    line = JsonLines().format(
        logging.makeLogRecord({"name": "isogi", "msg": "bad %s", "args": ("\udcf6",)})
    )
    assert json.loads(line)["message"] == r"bad \xf6"


@pytest.mark.parametrize(
    ("command", "status"),
    [(["inspect"], 0), (["inspect", "--json"], 0), (["inspect", "--picture", "/nowhere/a.png"], 2)],
)
def test_commands_show_such_names(odd: Path, command: list[str], status: int) -> None:
    """Whatever the encoding of stdout and its way with what it lacks."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(
        [sys.executable, "-m", "isogi_server", *command, str(odd)],
        env=environment,
        capture_output=True,
        check=False,
    )
    assert done.returncode == status, done.stderr
    said = (done.stdout or done.stderr).decode()
    if command[-1] == "--json":
        assert json.loads(said)["volume"]["name"] == SHOWN
    elif status == 0:
        assert SHOWN in said
