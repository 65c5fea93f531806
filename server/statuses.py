"""The status documents of jobs, as OGC API Processes (part 1, 7.11) names what is in them."""

from __future__ import annotations

from dataclasses import asdict
from datetime import datetime

from pydantic import BaseModel

from server.facts import TimeLeftFacts
from server.jobs import Job, Status

RESULTS = "http://www.opengis.net/def/rel/ogc/1.0/results"
"""What links to the results of a job are called."""


class JobLink(BaseModel):
    """An address: what it is to the job (``rel``), and what is there."""

    href: str
    rel: str
    type: str
    title: str


class JobFacts(BaseModel):
    """One job. ``progress`` is in percent; times are in UTC, null while they are to come.

    ``expires`` is when a job that has ended is forgotten; all are when the server stops, and prewarms are taken up
    when it starts again. ``time_left`` is null where
    it is unknown.
    """

    jobID: str
    processID: str
    type: str = "process"
    status: Status
    message: str
    progress: int
    created: datetime
    started: datetime | None
    finished: datetime | None
    updated: datetime
    expires: datetime | None
    time_left: TimeLeftFacts | None
    links: list[JobLink]


class JobList(BaseModel):
    """All jobs, the newest first."""

    jobs: list[JobFacts]
    links: list[JobLink]


def job_facts(job: Job) -> JobFacts:
    """The document of one job."""
    own = JobLink(href=address(job), rel="self", type="application/json", title=job.title)
    names = ("status", "message", "progress", "created", "started", "finished", "updated", "expires")
    return JobFacts(
        jobID=job.id,
        processID=job.process,
        **{name: getattr(job, name) for name in names},
        time_left=None if job.time_left is None else TimeLeftFacts(**asdict(job.time_left)),
        links=[own, *(JobLink(rel=RESULTS, **asdict(result)) for result in job.results)],
    )


def address(job: Job) -> str:
    """Where a job is asked for."""
    return f"/v1/jobs/{job.id}"
