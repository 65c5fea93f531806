"""The client's jobs: prewarms that are asked about, waited for, found again and dismissed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from isogi_client import Isogi, JobError, NotFoundError, Progress, RefusedError
from tests.client.lab import TOKEN, Broken, lab_of
from worker.pool import WorkerPool

ORDER: dict[str, Any] = {"isovalues": [0.5, "0.4:0.45:0.05"], "views": 2, "width": 24, "height": 20}


@pytest.fixture(scope="module")
def isogi(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Isogi]:
    with lab_of(small_scene, tmp_path_factory.mktemp("lab")) as lab, Isogi(lab.url, TOKEN) as isogi:
        yield isogi


def test_a_prewarm_is_asked_about_and_waited_for(isogi: Isogi) -> None:
    ahead = isogi.prewarm("small", dry_run=True, **ORDER).wait()
    assert (ahead["stopped"], ahead["views"], ahead["final"]) == ("dry run", 6, 0.0)
    told: list[Progress] = []
    job = isogi.prewarm("small", **ORDER)
    summary = job.wait(told.append)
    assert (summary["stopped"], summary["final"], summary["texels"]) == ("target", 1.0, ahead["texels"])
    assert told[-1] == Progress("successful", "This is done.", 100) and told[-1].over
    assert isogi.job(job.id).summary() == summary
    assert job.address.endswith(f"/v1/jobs/{job.id}")
    assert not isogi.frame("small", isovalue=0.45, azimuth=0.0, elevation=30.0, width=24, height=20).facts.error > 0.5


def test_an_export_is_a_file_and_leaves_no_job(isogi: Isogi, tmp_path: Path) -> None:
    told: list[Progress] = []
    path = isogi.export("small", tmp_path / "a.glb", isovalue=0.5, yaw=40, progress=told.append)
    assert path.read_bytes().startswith(b"glTF") and told[-1].status == "successful"
    assert all(job["processID"] != "export" for job in isogi._json("GET", "/v1/jobs")["jobs"])
    with pytest.raises(RefusedError, match="glb, usdz"):
        isogi.export("small", tmp_path / "a.stl")


def test_what_is_refused_says_why(isogi: Isogi) -> None:
    with pytest.raises(RefusedError, match="no parameter 'paint'") as caught:
        isogi.prewarm("small", paint=1)
    assert caught.value.problem["parameter"] == "paint"
    with pytest.raises(NotFoundError):
        isogi.prewarm("none")
    with pytest.raises(NotFoundError):
        isogi.job("none")


def test_a_job_that_is_dismissed_or_fails_says_so(small_scene: Path, tmp_path: Path) -> None:
    with lab_of(small_scene, tmp_path, bakes=False) as lab, Isogi(lab.url, TOKEN) as isogi:
        job = isogi.prewarm("small", **ORDER)
        with pytest.raises(NotFoundError, match="no document"):
            job.summary()
        job.dismiss()
        with pytest.raises(JobError, match="dismissed"):
            job.wait()
        lab.baker.employ(cast(WorkerPool, Broken()))
        with pytest.raises(JobError, match="cursed"):
            isogi.prewarm("small", **ORDER).wait()
