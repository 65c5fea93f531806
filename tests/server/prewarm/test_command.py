"""``isogi prewarm`` alone: what it bakes is final at once afterwards, what it tells comes true,
what stops goes on.
"""

import json
import os
import socket
from contextlib import closing
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.frame import projected_texels
from isogi_core.kernels.shading.framebuffer import CONVERGING
from isogi_core.plan.assembly import load_scene
from isogi_server.api.prewarm_jobs import RecordAges
from isogi_server.cli.prewarm import prewarm
from isogi_server.prewarm.order import Views, order_of
from isogi_server.prewarm.record import Record, RecordDocument, Summary
from isogi_server.render.engine import RenderEngine
from isogi_server.settings import Settings
from isogi_worker import pool
from isogi_worker.errors import WorkersError
from isogi_worker.pool import Done
from isogi_worker.tasks import BakeTask
from tests.server.asking import Told
from tests.server.inline import PATHS_ALONE, InlinePool, chunks_in, view_of, weigh_at

SIZE = {"width": 24, "height": 20}


pytestmark = pytest.mark.usefixtures("inline")


def warmed(scene: Path, store: Path, *isovalues: str, dry: bool = False, **more: Any) -> Summary:
    order = order_of({"isovalues": isovalues, "views": 3, **SIZE, **more})
    return prewarm(str(scene), order, Settings(store=str(store), workers=1), dry)


@pytest.mark.slow
def test_walls_that_were_prewarmed_are_final_at_once(blocks: Path, tmp_path: Path) -> None:
    among = blocks.with_name("among.toml")
    among.write_text(blocks.read_text().replace("[[lights]]", 'room = "cornell"\n[[lights]]'))
    warmed(among, tmp_path, "0.4", "0.6", distance=4.0)
    scene = load_scene(among)
    with closing(RenderEngine([scene], str(tmp_path))) as engine:
        engine.start(with_workers=False)
        for view in Views(
            order_of({"isovalues": [0.4, 0.6], "views": 3, **SIZE, "distance": 4.0}),
            scene,
            Settings(),
        ):
            frame = engine.survey("among", view, Goal.checked(0.1))
            assert len(frame.gbuffer.walls.pixels) and not frame.quality.waiting
            between = engine.survey("among", replace(view, isovalue=0.5), Goal.checked(0.1))
            assert set(between.state.ravel()[between.gbuffer.walls.pixels]) == {CONVERGING}


def document_of(summary: Summary) -> RecordDocument:
    assert summary.file is not None
    return RecordDocument.model_validate_json(Path(summary.file).read_text())


def test_what_was_prewarmed_is_final_at_once(blocks: Path, tmp_path: Path) -> None:
    summary = warmed(blocks, tmp_path, "0.4", "0.5:0.6:0.1")
    assert (summary.views, summary.isovalues) == (9, pytest.approx((0.4, 0.5, 0.6)))
    assert (summary.final, summary.stopped, summary.target_error) == (1.0, "target", 0.1)
    assert summary.errors.mean <= summary.error <= 0.1
    assert summary.paths >= FIRST_LEVEL * summary.texels > 0 and summary.processor_seconds > 0
    assert f"{summary.paths:,} paths" in str(summary)
    assert document_of(summary).summary == summary
    scene = load_scene(blocks)
    kept = chunks_in(tmp_path)
    assert 3 < summary.chunks <= len(kept)
    assert summary.stored_bytes == sum(
        path.stat().st_size for path in tmp_path.glob("*/c/**/*") if path.is_file()
    )
    order = order_of({"isovalues": [0.4, 0.5, 0.6], "views": 3, **SIZE})
    with closing(RenderEngine([scene], str(tmp_path))) as engine:
        engine.start(with_workers=False)
        for view in Views(order, scene, Settings()):
            assert not engine.survey("blocks", view, Goal.checked(0.1)).provisional
    assert warmed(blocks, tmp_path, "0.5").paths == 0
    assert chunks_in(tmp_path) == kept


def test_whole_isosurfaces_are_final_from_all_sides_and_between(
    blocks: Path, tmp_path: Path
) -> None:
    order = order_of({"isovalues": ["0.45:0.55"], "all_directions": True})
    settings = Settings(store=str(tmp_path), workers=1)
    ahead = prewarm(str(blocks), order, settings, dry=True)
    summary = prewarm(str(blocks), order, settings)
    assert (summary.final, summary.stopped, summary.views) == (1.0, "target", 0)
    assert ahead.texels == summary.texels > 0
    scene = load_scene(blocks)
    rng = np.random.default_rng(3)
    with closing(RenderEngine([scene], str(tmp_path))) as engine:
        engine.start(with_workers=False)
        for isovalue in rng.uniform(0.45, 0.55, 8):
            view = view_of(scene, float(rng.uniform(0, 360)), float(isovalue))
            assert not engine.survey("blocks", view, Goal.checked(0.1)).provisional
        assert engine.survey("blocks", view_of(scene, isovalue=0.7), Goal.checked(0.1)).provisional
    assert prewarm(str(blocks), order, settings).paths == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "asked", [{"views": 3, **SIZE}, {"all_directions": True}], ids=["views", "whole isosurfaces"]
)
def test_projected_texels_are_prewarmed_too(
    blocks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: dict[str, Any]
) -> None:
    monkeypatch.setattr(projected_texels, "STEEPNESS", 2.0)
    path = blocks.with_name("projected.toml")
    path.write_text(f"projected = true\n{blocks.read_text()}")
    order = order_of({"isovalues": ["0.4", "0.5"], **asked})
    settings = Settings(store=str(tmp_path / "light"), workers=1)
    ahead, plain = (prewarm(str(each), order, settings, dry=True) for each in (path, blocks))
    summary = prewarm(str(path), order, settings)
    scene = load_scene(path)
    assert (summary.final, summary.stopped) == (1.0, "target")
    assert ahead.texels == summary.texels > plain.texels
    with closing(RenderEngine([scene], str(tmp_path / "light"))) as engine:
        engine.start(with_workers=False)
        for view in Views(
            order_of({"isovalues": ["0.4", "0.5"], "views": 3, **SIZE}), scene, Settings()
        ):
            frame = engine.survey("projected", view, Goal.checked(0.1))
            assert not frame.provisional and frame.quality.projection
            shares = frame.quality.projection.shares
            assert shares["projected"] > 0.2 and shares["pending"] == 0.0
    assert prewarm(str(path), order, settings).paths == 0


def test_a_dry_run_bakes_nothing_and_tells_what_there_is(
    blocks: Path, tmp_path: Path, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    weigh_at(PATHS_ALONE, monkeypatch)
    dry = warmed(blocks, tmp_path, "0.5", dry=True)
    assert (dry.final, dry.refined, dry.stopped, chunks_in(tmp_path)) == (0.0, 0, "dry run", {})
    assert not (tmp_path / "jobs").exists()
    assert 0.0 < dry.time_left.low < dry.time_left.likely < dry.time_left.high
    assert "time with --workers 1: about" in str(dry)
    came = warmed(blocks, tmp_path, "0.5", target_error=0.4)
    assert (came.texels, came.chunks) == (dry.texels, dry.chunks)
    assert came.stored_bytes == pytest.approx(dry.stored_bytes, rel=0.3)
    larger = ["prewarm", blocks, "--isovalue", "0.5", "--views", "3", "--store", tmp_path]
    larger += ["--width", "144", "--height", "120", "--target-error"]
    told(*larger, "0.4")
    ahead = Summary.model_validate_json(told(*larger, "0.002", "--dry-run", "--json"))
    assert ahead.texels == ahead.bytes == 0 and ahead.refined > 0
    assert 0.0 < ahead.time_left.low < ahead.time_left.high


def test_it_ends_with_its_deadline_and_goes_on(
    blocks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told: Told
) -> None:
    asked: list[BakeTask] = []
    with monkeypatch.context() as patch:
        patch.setattr(InlinePool, "submit", lambda _, task, done: asked.append(task))
        summary = warmed(blocks, tmp_path, "0.5", deadline=0)
    assert (summary.stopped, summary.paths, summary.final, asked) == ("deadline", 0, 0.0, [])
    assert document_of(summary).unfinished
    command = ["prewarm", blocks, "--continue", "--store", tmp_path, "--workers", "1", "--json"]
    again = Summary.model_validate_json(told(*command))
    assert (again.stopped, again.final, again.file) == ("target", 1.0, summary.file)
    assert "no unfinished prewarm of blocks" in told(*command, status=2)


def test_workers_that_fail_end_it(
    blocks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise WorkersError("No workers today.")

    monkeypatch.setattr(pool, "start_pool", refuse)
    with pytest.raises(WorkersError, match=r"^No workers today\.$"):
        warmed(blocks, tmp_path, "0.5")
    (record,) = (tmp_path / "jobs").glob("*.json")
    assert json.loads(record.read_text())["status"] == "failed"


def test_a_chunk_that_cannot_be_baked_is_told_and_the_others_are(
    blocks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    submit = InlinePool.submit

    def cursed(workers: InlinePool, task: BakeTask, done: Done) -> None:
        if task.index == (0, 1, 1):
            done(None, RuntimeError("The texels are cursed."))
        else:
            submit(workers, task, done)

    monkeypatch.setattr(InlinePool, "submit", cursed)
    summary = warmed(blocks, tmp_path, "0.5")
    assert (summary.stopped, summary.failed) == ("failures", 1)
    assert summary.failures[0].chunk == (0, 1, 1)
    assert "cursed" in summary.failures[0].reason and "cursed" in str(summary)
    assert 0.0 < summary.final < 1.0, "a picture that lacks a chunk is not final, the others are"
    assert len(chunks_in(tmp_path)) == summary.chunks - 1


def test_it_says_at_once_what_it_does(
    blocks: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    start = RenderEngine.start
    said = list[str]()

    def slow(engine: RenderEngine, with_workers: bool = True) -> None:
        said.append(capsys.readouterr().err)
        start(engine, with_workers)

    monkeypatch.setattr(RenderEngine, "start", slow)
    warmed(blocks, tmp_path, "0.5", dry=True)
    assert said == ["\rloading kernels, 00:00"]
    error = capsys.readouterr().err
    assert "planning, 00:00" in error and "looking:   0%" in error


def test_who_interrupts_it_is_told_how_to_go_on(
    blocks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told: Told
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("isogi_server.prewarm.baking.Baking.run", interrupted)
    said = told("prewarm", blocks, "--views", "3", "--store", tmp_path, "--workers", "1", status=1)
    assert "--continue goes on" in said
    (record,) = (tmp_path / "jobs").glob("*.json")
    assert json.loads(record.read_text())["status"] == "dismissed"


def test_a_record_knows_its_process_and_the_time_left(blocks: Path) -> None:
    scene = load_scene(blocks)
    order = order_of({"deadline": 100})
    document = Record("store", scene, order, "server").document
    ended = {"worker": f"{socket.gethostname()}/{os.getpid()}/other"}
    assert not document.left
    assert document.model_copy(update=ended).left
    assert not document.model_copy(update={"worker": "elsewhere/1/other"}).left
    assert not document.model_copy(update={**ended, "status": "dismissed"}).left
    assert document.model_copy(update={"spent": 60.0}).rest.deadline == 40.0


def test_silence_is_counted_by_the_clock_of_who_listens(blocks: Path) -> None:
    clock = [7.0]
    silence = RecordAges(lambda: clock[0])
    document = Record("store", load_scene(blocks), order_of({}), "server").document
    future = document.model_copy(update={"updated": document.updated + timedelta(days=1)})
    heard = []
    for clock[0], each in ((7.0, document), (20.0, document), (21.0, future), (26.0, future)):
        heard.append(silence.of(each))
    assert heard == [0.0, 13.0, 0.0, 5.0]
