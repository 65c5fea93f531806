"""Jobs: work that goes on when its request has been answered."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Response

from server.errors import UnknownResultError
from server.params import NoParamsDep
from server.prewarm.summary import Summary
from server.problems import documented_problems
from server.service import ServiceDep
from server.statuses import JobFacts, JobLink, JobList, job_facts

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], dependencies=[NoParamsDep])
UNKNOWN: dict[int | str, dict[str, Any]] = documented_problems(404, 422, 503)
JobId = Annotated[str, Path(description="As in the Location of the answer that the job began with.")]


@router.get("", responses=documented_problems(422))
async def list_jobs(service: ServiceDep, response: Response) -> JobList:
    """All jobs that are known, the newest first."""
    response.headers["Cache-Control"] = "no-store"
    own = JobLink(href="/v1/jobs", rel="self", type="application/json", title="Jobs")
    return JobList(jobs=[job_facts(job) for job in service.jobs.all()], links=[own])


@router.get("/{job}", responses=UNKNOWN)
async def read_job(job: JobId, service: ServiceDep, response: Response) -> JobFacts:
    """How far a job is, the time that is left, and at the end where its results are."""
    response.headers["Cache-Control"] = "no-store"
    return job_facts(service.job(job))


@router.get("/{job}/results", responses=UNKNOWN)
async def read_results(job: JobId, service: ServiceDep, response: Response) -> Summary:
    """What a prewarm came to: what was asked, what there was to do, what it took and how good the light is."""
    response.headers["Cache-Control"] = "no-store"
    found = service.job(job)
    if not isinstance(found.document, Summary):
        raise UnknownResultError(f"The job '{found.id}' has no document here: its links lead to its results.")
    return found.document


@router.delete("/{job}", responses=UNKNOWN)
async def dismiss_job(job: JobId, service: ServiceDep) -> JobFacts:
    """End a job: nothing more is baked for it. One that has ended is forgotten at once."""
    return job_facts(await service.jobs.dismiss(service.job(job).id))
