"""The benchmark of prewarms compares what is told with what comes, here on something tiny in this process."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from benchmarks import prewarm
from server.prewarm.command import prewarm as prewarm_views
from server.prewarm.options import told_by
from server.prewarm.order import order_of
from server.settings import Settings
from tests.server.inline import InlinePool
from worker import pool


def in_process(target: str, store: Path, *more: str) -> dict[str, Any]:
    """What the command does, without a process of its own."""
    named = dict(option.removeprefix("--").replace("-", "_").partition("=")[::2] for option in more)
    dry, isovalue = "dry_run" in named, named["isovalue"]
    given = {name: value for name, value in named.items() if name not in ("dry_run", "isovalue", "workers")}
    order = order_of(told_by(given | {"isovalues": (isovalue,)}))
    return prewarm_views(target, order, Settings(store=str(store), workers=1), dry).model_dump(mode="json") | {
        "cpu": 1.0
    }


def test_what_came_is_told_beside_what_was_foretold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "WorkerPool", InlinePool)
    monkeypatch.setattr(prewarm, "prewarm", in_process)
    options = ["--only", "casting", "--size", "12", "--views", "1", "--error", "0.5", "--json"]
    done = CliRunner().invoke(prewarm.main, options, catch_exceptions=False)
    figures = json.loads(done.stdout.splitlines()[-1])
    assert figures["casting: final"] == 1.0
    assert figures["casting: worst error"] <= 0.5
    assert figures["casting: bytes stored over told"] == pytest.approx(1.0, abs=0.3)
    ratio = figures["casting: took, s"] / figures["casting: told, s"]
    assert figures["casting: took over told"] == pytest.approx(ratio)
