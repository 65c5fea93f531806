"""``isogi prewarm --server``: a server does the work, and the command follows it, or leaves it to
that.
"""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

import isogi.client as isogi_client
from isogi_server.cli.command import run
from isogi_server.prewarm.record import Summary
from tests.client.lab import TOKEN, Lab, lab_of
from tests.server.asking import Told
from tests.server.inline import LONG, chunks_in
from tests.server.sockets import wait_for

SMALL = ["--views", "2", "--width", "24", "--height", "20"]


@pytest.fixture
def lab(blocks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    monkeypatch.setenv("ISOGI_TOKEN", TOKEN)
    with lab_of(blocks, tmp_path) as lab:
        yield lab


def status(lab: Lab, address: str) -> str:
    return str(httpx.get(address, headers={"Authorization": f"Bearer {TOKEN}"}).json()["status"])


def test_a_server_is_followed_to_the_summary(
    lab: Lab, blocks: Path, tmp_path: Path, told: Told, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["prewarm", str(blocks), "--server", lab.url, *SMALL, "--json"]
    ahead = Summary.model_validate_json(told(*command, "--dry-run"))
    assert (ahead.stopped, chunks_in(tmp_path)) == ("dry run", {})
    assert run(command) == 0
    said = capsys.readouterr()
    summary = Summary.model_validate_json(said.out)
    assert (summary.final, summary.texels) == (1.0, ahead.texels)
    assert "prewarm: 100%" in said.err
    assert len(chunks_in(tmp_path)) >= summary.chunks


def test_a_server_is_left_to_it(lab: Lab, tmp_path: Path, told: Told) -> None:
    address = told("prewarm", "blocks", "--server", lab.url, *SMALL, "--detach").strip()
    assert address.startswith(f"{lab.url}/v1/jobs/")
    assert wait_for(lambda: status(lab, address) == "successful", LONG)
    assert chunks_in(tmp_path)


def test_who_interrupts_the_command_dismisses_the_job(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, told: Told
) -> None:
    jobs: list[str] = []

    def interrupted(job: isogi_client.Job, _: object) -> None:
        jobs.append(job.address)
        raise KeyboardInterrupt

    monkeypatch.setattr(isogi_client.Job, "wait", interrupted)
    assert "stopped" in told(
        "prewarm", "blocks", "--server", lab.url, "--isovalue", "0.3:0.7:0.01", status=1
    )
    assert status(lab, jobs[0]) == "dismissed"


@pytest.mark.parametrize(
    ("more", "status", "why"),
    [
        (["none.toml"], 1, "shows no scene 'none.toml'; it shows: blocks."),
        (["blocks", "--isovalue", "0.9"], 2, "must be a number from 0.2 to 0.8"),
    ],
)
def test_what_a_server_refuses_is_told(
    lab: Lab, more: list[str], status: int, why: str, told: Told
) -> None:
    assert why in told("prewarm", *more, "--server", lab.url, status=status)


def test_a_server_that_is_not_there_is_told(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISOGI_TOKEN", TOKEN)
    assert "No answer from the server" in told(
        "prewarm", "blocks", "--server", "http://127.0.0.1:9", status=1
    )
