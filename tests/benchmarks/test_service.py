"""The service suite on something tiny: real servers, real clients."""

import shutil
from pathlib import Path

import pytest

from benchmarks.service.drag import drag
from benchmarks.service.first_start import first_start, started
from benchmarks.service.fuzz import fuzz
from benchmarks.service.load import load
from benchmarks.service.malformed import malformed
from benchmarks.service.memory import memory
from benchmarks.service.time_left import Estimate, judged
from benchmarks.service.warm_view import warm_view
from isogi_core.kernels._jit import KERNEL_FOLDER
from isogi_worker.progress import TimeLeft
from tests.benchmarks.parts import figures
from tests.compile_kernels import compile_all

LACKING = ("framebuffer.tally", "transfer.locate_texels", "transfer.bake_texels")
"""Kernels that a first start compiles, one for pictures and two for light: all would take a
minute.
"""


def test_warm_view() -> None:
    found = figures(warm_view, "demo:orbital", "--size", "32", "--repeats", "1")
    places = ("folder", "disk", "s3")
    assert [found[f"{where}: bytes / plain bytes"] for where in places] == [1.0, 1.0, 1.0]
    assert all(
        found[f"{where}: {what}"] > 0.0
        for where in places
        for what in ("view / plain reads", "unwrapping, ms")
    )


@pytest.mark.long
def test_drag() -> None:
    found = figures(
        drag, "demo:orbital", "--size", "48", "--seconds", "1", "--pages", "2", "--workers", "1"
    )
    waits = [found[f"input to picture, {which}"] for which in ("median", "95 %", "longest")]
    assert 0.0 < waits[0] <= waits[1] <= waits[2]
    assert found["drafts a second and page"] > 1.0
    assert 12 <= found["pixels along a draft, median"] <= 48
    assert found["rest to full picture, longest"] > 0.0


@pytest.mark.long
def test_load() -> None:
    found = figures(load, "demo:orbital", "--clients", "9", "--seconds", "1", "--workers", "1")
    assert {key for key in found if key.startswith("answered")} <= {
        f"answered {n}" for n in (200, 304, 429, 503)
    }
    assert found["answered 200"] > 0 and found["livez, answers"] > 0
    assert found["requests in progress, afterwards"] == 0


@pytest.mark.long
def test_memory() -> None:
    found = figures(
        memory, "--uploads", "6", "--uploads-mb", "1", "--views", "4", "--requests", "1"
    )
    assert (found["uploads: answered 201"], found["uploads: answered 507"]) == (3, 3)
    assert found["kept"] == found["volumes looked at: answered 200"] == 3
    refused = {int(name[-3:]) for name in found if name.startswith("hostile requests: answered ")}
    assert {404, 421, 422} <= refused and max(refused) < 500
    assert found["all views: answered 200"] == 2 and found["all views: server, MiB"] > 0.0


@pytest.mark.long
def test_fuzz() -> None:
    found = figures(fuzz, "--messages", "200")
    assert found["server alive"] is True and found["tracebacks"] == 0
    assert found["problems"] > 20


@pytest.mark.long
def test_malformed() -> None:
    found = figures(malformed, "--files", "6")
    assert found["files"] == 6 and found["server alive"] is True
    assert found["other answers"] == "" and found["left after a kill"] == 0


def nearly_compiled(scene: str, size: int, kernels: str) -> dict[str, float]:
    """A start from an empty folder of ``kernels``, once it has all but ``LACKING``."""
    assert not list(Path(kernels).iterdir())
    lacking = shutil.ignore_patterns(*(f"{name}-*" for name in LACKING))
    shutil.copytree(KERNEL_FOLDER, Path(kernels) / KERNEL_FOLDER.name, ignore=lacking)
    return started(scene, size, kernels)


@pytest.mark.long
def test_first_start(monkeypatch: pytest.MonkeyPatch) -> None:
    compile_all()
    monkeypatch.setitem(first_start.callback.__wrapped__.__globals__, "started", nearly_compiled)
    found = figures(first_start, "demo:orbital", "--size", "64")
    moments = [found[f"{what} after, s"] for what in ("ready", "first picture", "lit")]
    assert 0.0 < moments[0] <= moments[1] <= moments[2]
    assert found["kernels"] == len(LACKING)


def test_a_time_left_that_is_right_is_told_from_one_that_stands() -> None:
    """Pictures of 60 seconds: one estimate that counts down, and one that is renewed unchanged."""
    right = judged(60.0, [Estimate(0.5, TimeLeft(50.0, 59.5, 70.0))])
    assert right["within"] == 1.0 and right["stands"] < 1.0
    stuck = [Estimate(float(at), TimeLeft(4.0, 5.0, 6.0)) for at in range(60)]
    wrong = judged(60.0, stuck)
    assert wrong["within"] == pytest.approx(8 / 58, abs=0.03) and wrong["stands"] > 10.0
    assert judged(60.0, [Estimate(0.5, None)])["samples"] == 0.0
