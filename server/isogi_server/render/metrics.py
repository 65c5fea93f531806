"""Metrics of a running server, for Prometheus."""

import logging
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http import HTTPStatus

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.datastructures import Headers

from isogi_core.storage.calls import Calls
from isogi_server.render.engine import RenderEngine
from isogi_server.render.jobs import Jobs

COUNTED_METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "WEBSOCKET")
ENDLESS = "text/event-stream"
TIME_BIN_ENDS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Upper ends of histogram bins of times, in seconds."""

RATES = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Upper ends of histogram bins of pictures per second."""

MOVED = 0.5
"""Seconds for which a stream's view must have moved for its rate to be counted: shorter ones
are too uncertain.
"""


class Metrics:
    """The metrics of one server, in a separate registry."""

    def __init__(self) -> None:
        """Create all metrics at zero, and those of the process: memory, files, processor time."""
        self.registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        labels = ("method", "route", "status")
        self.requests = Counter(
            "isogi_requests", "Requests that were answered.", labels, registry=registry
        )
        self.seconds = Histogram(
            "isogi_request_seconds",
            "Seconds to the end of the answer.",
            ["route"],
            buckets=TIME_BIN_ENDS,
            registry=registry,
        )
        self.open = Gauge("isogi_requests_in_progress", "Requests in progress.", registry=registry)
        self.frames = Counter(
            "isogi_frames",
            (
                "Pictures by how far they were baked (provisional, final) and how they went "
                "(request, stream, draft)."
            ),
            ["state", "way"],
            registry=registry,
        )
        self.stages = Histogram(
            "isogi_frame_stage_seconds",
            "Seconds of a frame's stages.",
            ["stage"],
            buckets=TIME_BIN_ENDS,
            registry=registry,
        )
        self.ages = Histogram(
            "isogi_stream_picture_age_seconds",
            "Seconds from the arrival of a stream's view to the sending of its first picture.",
            buckets=TIME_BIN_ENDS,
            registry=registry,
        )
        self.rates = Histogram(
            "isogi_stream_pictures_per_second",
            "Drafts per second of each stream that has ended, while its view moved.",
            buckets=RATES,
            registry=registry,
        )
        self.errors = Counter(
            "isogi_errors", "Errors that were logged, by class.", ["kind"], registry=registry
        )
        self.refused = Counter(
            "isogi_refusals",
            "Requests, and views of streams, that were refused, by reason.",
            ["why"],
            registry=registry,
        )
        self.closed = Counter(
            "isogi_connections_closed",
            "Connections that the server closed, by reason.",
            ["why"],
            registry=registry,
        )

    def count(self, method: str, route: str, status: int, seconds: float, headers: Headers) -> None:
        """Count one request, and the frame in its answer, if the ``headers`` say that there is
        one.
        """
        self.requests.labels(
            method if method in COUNTED_METHODS else "other", route, f"{status:d}"
        ).inc()
        # Streams last as long as their client: their time means nothing.
        if status != HTTPStatus.SWITCHING_PROTOCOLS and not headers.get(
            "content-type", ""
        ).startswith(ENDLESS):
            self.seconds.labels(route).observe(seconds)
        if "isogi-provisional" in headers:
            stages = dict(stages_of(headers.get("server-timing", "")))
            self.count_picture("request", headers["isogi-provisional"] == "?1", stages)

    def count_picture(self, way: str, provisional: bool, stages: Mapping[str, float]) -> None:
        """Count one picture by the ``way`` it was sent, its state, and the seconds of its
        ``stages``.
        """
        self.frames.labels("provisional" if provisional else "final", way).inc()
        for stage, seconds in stages.items():
            self.stages.labels(stage).observe(seconds)

    def count_motion(self, drafts: int, seconds: float) -> None:
        """Count a stream that ends by its rate: ``drafts`` sent in this number of ``seconds``
        of motion.
        """
        if seconds >= MOVED:
            self.rates.observe(drafts / seconds)

    @contextmanager
    def counting_errors(self) -> Iterator[None]:
        """For the block, count the errors that isogi logs: damaged chunks, failed tasks, lost
        workers.
        """
        logger = logging.getLogger("isogi")
        counter = ErrorCounter(self.errors)
        logger.addHandler(counter)
        try:
            yield
        finally:
            logger.removeHandler(counter)

    def text(self) -> bytes:
        """Return all metrics in the text format of Prometheus."""
        return generate_latest(self.registry)


class ErrorCounter(logging.Handler):
    """A log handler that counts the errors in records of level warning and above, by their
    class.
    """

    def __init__(self, counter: Counter) -> None:
        super().__init__(logging.WARNING)
        self._counter = counter

    def emit(self, record: logging.LogRecord) -> None:
        """Count the errors among a record's arguments, and the one that it was logged with."""
        if isinstance(record.args, tuple):
            logged = record.args
        else:
            logged = ()
        raised = record.exc_info[1:2] if record.exc_info else ()
        for error in (*logged, *raised):
            if isinstance(error, BaseException):
                self._counter.labels(type(error).__name__).inc()


class BakingCollector(Collector):
    """Collects the state of an engine's baking when metrics are read."""

    def __init__(self, engine: "RenderEngine") -> None:
        self._engine = engine

    def describe(self) -> Iterable[Metric]:
        """Describe nothing in advance: the engine may not have started."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Yield the metrics of the queue, of tasks and of workers."""
        tally = self._engine.baker.tally()
        yield GaugeMetricFamily(
            "isogi_queue_chunks", "Chunks that wait to be baked.", tally.waiting
        )
        yield GaugeMetricFamily(
            "isogi_queue_age_seconds", "Seconds for which the oldest chunk has waited.", tally.age
        )
        yield GaugeMetricFamily(
            "isogi_tasks_in_flight", "Tasks that workers are running.", tally.in_flight
        )
        yield GaugeMetricFamily(
            "isogi_chunks_given_up",
            "Chunks that were given up after repeated failures.",
            tally.given_up,
        )
        yield GaugeMetricFamily("isogi_workers", "Processes that bake.", tally.workers)
        busy = min(tally.in_flight / max(tally.workers, 1), 1.0)
        yield GaugeMetricFamily(
            "isogi_workers_utilization", "Share of the workers that have a task.", busy
        )
        yield CounterMetricFamily(
            "isogi_tasks_done",
            "Tasks that workers completed, of one or more chunks each.",
            tally.done,
        )
        yield CounterMetricFamily(
            "isogi_chunks_baked",
            "Chunks that tasks added light to, counted each time.",
            tally.chunks,
        )
        yield CounterMetricFamily("isogi_tasks_failed", "Chunks whose task failed.", tally.failed)
        yield CounterMetricFamily(
            "isogi_tasks_duplicate",
            "Chunks of tasks whose light was there already.",
            tally.duplicate,
        )
        yield CounterMetricFamily(
            "isogi_chunks_healed", "Damaged chunks that were baked again.", tally.healed
        )
        yield CounterMetricFamily("isogi_paths", "Paths that were baked.", tally.paths)
        yield CounterMetricFamily(
            "isogi_texels_kept", "Texels whose light was kept when the volume was cut.", tally.kept
        )
        yield CounterMetricFamily(
            "isogi_worker_deaths", "Baking processes that died.", tally.deaths
        )


class StoreCollector(Collector):
    """Collects the calls of this process to a store when metrics are read."""

    def __init__(self, calls: Calls) -> None:
        self._calls = calls

    def collect(self) -> Iterable[Metric]:
        """Yield the number, time and failures of calls, by kind."""
        calls = self._calls
        for name, about, counts in (
            ("isogi_store_calls", "Calls to the store, by kind.", calls.count),
            ("isogi_store_failures", "Calls to the store that failed, by kind.", calls.failed),
            (
                "isogi_store_seconds",
                "Seconds that calls to the store took, by kind.",
                calls.seconds,
            ),
        ):
            family = CounterMetricFamily(name, about, labels=["call"])
            # Iterate over a copy: a call of another thread may add a kind meanwhile.
            for kind, number in list(counts.items()):
                family.add_metric([kind], number)
            yield family


class ServerCollector(Collector):
    """Collects the threads of this process, and the ``quota`` and ``free`` bytes of uploads,
    when metrics are read.
    """

    def __init__(self, quota: Callable[[], int], free: Callable[[], int]) -> None:
        self._quota = quota
        self._free = free

    def describe(self) -> Iterable[Metric]:
        """Describe nothing in advance: threads and bytes are counted when metrics are read."""
        return ()

    def collect(self) -> Iterable[Metric]:
        """Yield the number of threads, and the bytes of uploads."""
        yield GaugeMetricFamily("isogi_threads", "Threads of the server's process.", threads())
        yield GaugeMetricFamily(
            "isogi_uploads_quota_bytes", "Bytes that uploads may take.", self._quota()
        )
        yield GaugeMetricFamily(
            "isogi_uploads_free_bytes", "Bytes of the quota of uploads that are free.", self._free()
        )


def threads() -> int:
    """Return the number of threads of this process, with those of native libraries if the
    system reports them.
    """
    with suppress(OSError):
        return len(os.listdir("/proc/self/task"))
    return threading.active_count()


class JobsCollector(Collector):
    """Collects the number of jobs of each status when metrics are read."""

    def __init__(self, jobs: "Jobs") -> None:
        self._jobs = jobs

    def collect(self) -> Iterable[Metric]:
        """Yield the number of known jobs of each status."""
        family = GaugeMetricFamily("isogi_jobs", "Known jobs, by status.", labels=["status"])
        for status, number in self._jobs.counts().items():
            family.add_metric([status.value], number)
        yield family


def stages_of(server_timing: str) -> Iterator[tuple[str, float]]:
    """Yield the name and seconds of each stage in a Server-Timing header."""
    for part in filter(None, server_timing.split(", ")):
        stage, _, milliseconds = part.partition(";dur=")
        yield stage, float(milliseconds) / 1000.0
