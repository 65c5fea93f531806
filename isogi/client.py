"""isogi from Python: send a view, get a picture or numbers. This file needs no other part of isogi.

>>> from isogi.client import Isogi
>>> with Isogi("http://127.0.0.1:8000") as isogi:
...     frame = isogi.frame("casting", isovalue=0.5, azimuth=40, wait="final")
...     frame.save("casting.png")
...     print(frame.facts)

It needs httpx, httpx-retries, httpx-sse, NumPy and Pillow: isogi's extra ``client``.
"""

from __future__ import annotations

import base64
import io
import json
import os
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self
from urllib.parse import quote
from uuid import uuid4

import httpx
import httpx_sse
import numpy as np
from httpx_retries import Retry, RetryTransport
from PIL import Image

LONGEST_WAIT = 10.0
"""Most seconds that the server waits for baking in one request."""

DEFAULT_PATIENCE_SECONDS = 60.0
"""Seconds for which a server that is busy, starting or away is asked again by default."""

FIRST_RETRY_PAUSE = 0.1
LONGEST_PAUSE = 5.0
"""Seconds between two tries: at first, and at most."""

CONNECTION_ERRORS = (httpx.NetworkError, httpx.RemoteProtocolError)
"""Errors of a request to a server that has gone."""

JOB_CHECK_SECONDS = 1.0
"""Seconds between two requests for a job's state."""

UPLOAD_BLOCK_BYTES = 1 << 20
"""Bytes that are read from a file at a time."""

PROGRESS_BAR_WIDTH = 20
"""Characters of a progress bar."""

PICTURE_PARAMETERS = ("f", "overlay", "exposure", "background", "antialias", "strip", "version")
"""Parameters of a picture that its light does not depend on."""

FORMAT_SUFFIXES = {
    "png": (".png",),
    "jpeg": (".jpg", ".jpeg"),
    "webp": (".webp",),
    "npy": (".npy",),
}
FORMAT_OF_MEDIA_TYPE = {
    "image/png": "png",
    "image/jpeg": "jpeg",
    "image/webp": "webp",
    "application/x-npy": "npy",
}

Wait = float | Literal["now", "final"]
"""How long to wait for light: not at all, until all of it is final, or for a number of seconds."""

Vector = tuple[float, float, float]
Values = float | str | Sequence[float] | None


class IsogiError(Exception):
    """An error in one sentence, with the HTTP ``status``
    and the ``problem`` document (RFC 9457), if there are any.
    """

    def __init__(
        self, detail: str, status: int | None = None, problem: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.status = status
        self.problem = dict(problem or {})


class RefusedError(IsogiError):
    """The server does not accept this request as it is: see ``detail``.

    If a parameter is wrong, ``problem["parameter"]`` names it.
    """


class NotFoundError(RefusedError):
    """There is no such scene, volume or job."""


class TokenError(RefusedError):
    """The server requires its token (``token=`` or ISOGI_TOKEN),
    or does not serve this client at all.
    """


class BusyError(IsogiError):
    """The server is busy, starting or stopping, and was so for as long as it was asked again."""


class ServerError(IsogiError):
    """The server failed on this request; ``problem["request_id"]`` finds it in its log."""


class UnreachableError(IsogiError):
    """No server answers at this address."""


class NotFinalError(IsogiError):
    """A view does not become final, as some of its light cannot be baked."""


class JobError(IsogiError):
    """A job failed, or was dismissed."""


class TargetWarning(UserWarning):
    """A frame is final, but its estimated error is above the requested ``max_error``."""


class TimeLeft(NamedTuple):
    """Seconds until a view is final: the most ``likely`` value,
    and the range that probably holds the true one.
    """

    low: float
    likely: float
    high: float


@dataclass(frozen=True)
class Facts:
    """The quality of a frame, as the server measured it.

    - ``coverage``: shares of the surface's pixels that are final, converging and provisional.
    - ``error``: estimated relative root mean square error; ``noise`` is its part that more samples
      reduce, ``interval`` its 95 % interval, by ``controls`` control pixels.
    - ``p99``: error that 99 % of the pixels stay below, None if it was not measured.
    - ``chunks``: numbers of chunks that are needed and final.
    - ``time_left``: None if unknown or over. The work is ``overdue`` once it takes longer than was
      reported before.
    - ``etag``: name of this very picture.
    - ``timing``: milliseconds of the stages of the server's work.
    - ``surface``: pixels that show a surface, None if the server does not report it.
    """

    provisional: bool
    coverage: Mapping[str, float]
    error: float
    chunks: Mapping[str, int]
    time_left: TimeLeft | None = None
    noise: float | None = None
    interval: tuple[float, float] | None = None
    controls: int = 0
    p99: float | None = None
    p99_interval: tuple[float, float] | None = None
    etag: str | None = None
    timing: Mapping[str, float] | None = None
    surface: int | None = None
    overdue: bool = False

    @classmethod
    def of_headers(cls, headers: Mapping[str, str]) -> Self:
        """Read the facts in a frame's ``headers``, whose names are in lower case or ignore case.

        Raises KeyError if a header is missing that every frame has.
        """
        left = numbers(headers.get("isogi-time-left", ""))
        surface = headers.get("isogi-surface")
        # Bring stages such as ``draw;dur=3.10`` to the form ``draw=3.10``.
        timing = numbers(headers.get("server-timing", "").replace(";dur=", "="))
        return cls(
            provisional=headers["isogi-provisional"] == "?1",
            coverage=numbers(headers["isogi-coverage"]),
            **error_of_header(headers["isogi-error"]),
            chunks={name: int(count) for name, count in numbers(headers["isogi-chunks"]).items()},
            time_left=TimeLeft(**left) if left else None,
            etag=headers.get("etag"),
            timing=timing,
            surface=None if surface is None else int(surface),
            overdue=headers.get("isogi-overdue") == "?1",
        )

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self:
        """Read the facts in the server's document of a view's coverage."""
        known = {"surface": document.get("pixels", {}).get("surface")}
        return cls(**known | fields_in(document, cls))

    def __str__(self) -> str:
        """Return a text such as ``182 of 240 chunks final, error about 1.8 %, about 40 s``."""
        if self.surface == 0:
            return "no surface in view"
        # Write two digits below 10 %, else whole percents: "g" alone would write 123 as 1.2e+02.
        if self.error < 0.1:
            error = f"{100 * self.error:.2g}"
        else:
            error = f"{100 * self.error:.0f}"
        # An error without control pixels is predicted, not measured.
        about = "" if self.controls else "about "
        text = f"{self.chunks['final']} of {self.chunks['needed']} chunks final"
        text = f"{text}, error {about}{error} %"
        if self.provisional and self.time_left is not None:
            text = f"{text}, about {self.time_left.likely:.0f} s"
        return text


def fields_in(document: Mapping[str, Any], kind: type[Any]) -> dict[str, Any]:
    """Return the fields of the class ``kind`` that are in a document of the server.

    Lists become tuples.
    """
    known = {each.name: document[each.name] for each in fields(kind) if each.name in document}
    for name, value in known.items():
        if isinstance(value, list):
            known[name] = tuple(value)
    if known.get("time_left"):
        known["time_left"] = TimeLeft(**known["time_left"])
    return known


def error_of_header(header: str) -> dict[str, Any]:
    """Read a frame's error from a header such
    as ``0.018; noise=0.006; low=0.015; high=0.021; controls=256``.
    """
    error, *parts = header.split(";")
    known = numbers(",".join(part for part in parts if "=" in part))
    facts: dict[str, Any] = {"error": float(error), "noise": known.get("noise")}
    if "low" in known:
        facts |= {"interval": (known["low"], known["high"]), "controls": int(known["controls"])}
    if "p99" in known:
        facts |= {"p99": known["p99"], "p99_interval": (known["p99-low"], known["p99-high"])}
    return facts


def numbers(header: str) -> dict[str, float]:
    """Read the numbers in a header such as ``final=0.81, provisional=0.19``."""
    pairs = (part.partition("=") for part in header.split(",") if part.strip())
    return {name.strip(): float(number) for name, _, number in pairs}


class Planes(NamedTuple):
    """A frame as arrays over pixels (h, w); row 0 is the top.

    - ``rgb`` (h, w, 3): linear radiance.
    - ``mask``: True on the surface.
    - ``state``: 0 none, 1 provisional, 2 converging, 3 final, 4 final by a texel that cannot be
      projected.
    - ``error``: relative standard error.
    - ``position`` (h, w, 3): point of the surface in world coordinates.
    """

    rgb: np.ndarray
    mask: np.ndarray
    state: np.ndarray
    error: np.ndarray
    position: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """A picture: its bytes, ``content``, in a format ``f``, and the ``facts`` of its quality."""

    content: bytes
    f: str
    facts: Facts

    @cached_property
    def image(self) -> Image.Image:
        """The picture. Raises ValueError if the format is npy."""
        if self.f == "npy":
            raise ValueError(
                "npy holds radiance and no picture: ask for f='png', or see .array and .planes."
            )
        return Image.open(io.BytesIO(self.content))

    @cached_property
    def array(self) -> np.ndarray:
        """The picture's bytes (h, w, 3);
        of an npy the numbers as they came (h, w, 9), see ``planes``.
        """
        if self.f == "npy":
            return np.load(io.BytesIO(self.content), allow_pickle=False)
        return np.asarray(self.image)

    @cached_property
    def planes(self) -> Planes:
        """The numbers by name. Raises ValueError if the format is not npy."""
        if self.f != "npy":
            raise ValueError(
                f"{self.f} holds a picture and no radiance: ask for f='npy', or see .image."
            )
        planes = self.array
        mask = planes[..., 3] > 0
        state = planes[..., 4].astype(np.uint8)
        error = planes[..., 5]
        return Planes(planes[..., :3], mask, state, error, planes[..., 6:9])

    def save(self, path: str | Path) -> Path:
        """Write the picture's bytes to a file; return its path.

        Raises ValueError if its suffix is that of another format.
        """
        path = Path(path)
        if path.suffix.lower() not in FORMAT_SUFFIXES[self.f]:
            fitting = " or ".join(FORMAT_SUFFIXES[self.f])
            raise ValueError(
                f"This frame is {self.f}: name the file {fitting}, or ask for another f."
            )
        path.write_bytes(self.content)
        return path

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return ``array``, for NumPy."""
        if dtype is None:
            return self.array
        return self.array.astype(dtype)

    def __repr__(self) -> str:
        """Return one line such
        as ``Frame(npy, 640 × 480 × 9, 182 of 240 chunks final, error about 1.8 %)``.
        """
        if self.f == "npy":
            high, wide, planes = self.array.shape
            size = f"{wide} × {high} × {planes}"
        else:
            wide, high = self.image.size
            size = f"{wide} × {high}"
        return f"Frame({self.f}, {size}, {self.facts})"

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG, for notebooks; of an npy that of its radiance."""
        if self.f == "png":
            return self.content
        buffer = io.BytesIO()
        if self.f == "npy":
            shown = Image.fromarray(srgb_of(self.planes.rgb))
        else:
            shown = self.image
        shown.save(buffer, "png")
        return buffer.getvalue()


@dataclass(frozen=True)
class Point:
    """A point of the surface that a view shows. Lengths are in the volume's ``unit``, "" if
    unknown.

    - ``position``, ``normal``: in world coordinates; the normal has length 1 and points outwards.
    - ``sides``: sides of a patient on which the point lies, such as LAS, "" if unknown.
    - ``voxel``: voxel indices, x first.
    - ``value``: the isovalue; None on a wall, whose number is ``wall``.
    - ``light``, ``displayed``: linear RGB, and the same in sRGB.
    - ``state``, ``error``: final, converging or provisional, and the relative error of the pixel.
    """

    unit: str
    position: Vector
    sides: str
    voxel: Vector
    value: float | None
    wall: int | None
    normal: Vector
    light: Vector
    displayed: str
    state: str
    error: float

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self:
        """Read a point from the server's document."""
        return cls(**fields_in(document, cls))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return ``position``, for NumPy."""
        return np.asarray(self.position, dtype or np.float64)


def distance(a: Point | Sequence[float], b: Point | Sequence[float]) -> float:
    """Return the distance of two points of the world, in its unit.

    >>> distance((0, 0, 0), (3, 0, 4))
    5.0
    """
    return float(np.linalg.norm(np.subtract(b, a)))


def angle(
    a: Point | Sequence[float], b: Point | Sequence[float], c: Point | Sequence[float]
) -> float:
    """Return the angle at ``b`` between the directions to ``a`` and to ``c``, in degrees from 0 to
    180; NaN if ``b`` is one of them.

    >>> angle((1, 0, 0), (0, 0, 0), (0, 2, 0))
    90.0
    """
    u, v = np.subtract(a, b), np.subtract(c, b)
    if not (u.any() and v.any()):
        return float("nan")
    # The arc tangent of sine and cosine is accurate for small angles, too.
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)))


@dataclass(frozen=True, eq=False)
class Film:
    """Frames in a sequence, ``fps`` a second. Notebooks show them as an animation."""

    frames: Sequence[Frame]
    fps: float = 24.0

    def save(self, path: str | Path) -> Path:
        """Write the frames to a GIF or WebP file that loops, or as numbered pictures into a folder.

        Raises ValueError for other files.
        """
        path = Path(path)
        if not path.suffix:
            path.mkdir(exist_ok=True)
            for n, frame in enumerate(self.frames):
                frame.save(path / f"frame-{n + 1:05d}{FORMAT_SUFFIXES[frame.f][0]}")
        elif path.suffix.lower() in (".gif", ".webp"):
            path.write_bytes(self._animation(path.suffix[1:].lower()))
        else:
            raise ValueError(
                f"A film is written to .gif or .webp, or to a folder: {path.name} is neither."
            )
        return path

    def _repr_html_(self) -> str:
        """Return the animation as HTML, for notebooks."""
        data = base64.b64encode(self._animation("webp")).decode()
        return f'<img src="data:image/webp;base64,{data}" alt="{len(self.frames)} frames">'

    def _animation(self, form: str) -> bytes:
        """Return the frames as an animated picture of the given format."""
        buffer = io.BytesIO()
        (first, *others) = (frame.image for frame in self.frames)
        first.save(
            buffer,
            form,
            save_all=True,
            append_images=others,
            duration=round(1000.0 / self.fps),
            loop=0,
        )
        return buffer.getvalue()


def sweep(frames: int, **knobs: Values | tuple[float, float]) -> list[dict[str, Values]]:
    """Return views for ``frames`` frames. Each knob given as a pair goes from one number to the
    other, the rest stays.

    If only angles move, and all by full turns, they move evenly, so that the film loops. All other
    movements begin and end at rest.

    >>> sweep(48, azimuth=(0, 360), elevation=20)
    """
    moving = {
        name: value for name, value in knobs.items() if isinstance(value, tuple) and len(value) == 2
    }
    way = {name: last - first for name, (first, last) in moving.items()}
    # Full turns of angles, and nothing else, end where they begin.
    around = set(way) <= {"azimuth", "yaw", "pitch", "roll"} and all(
        value % 360.0 == 0.0 for value in way.values()
    )
    # A loop leaves out its last frame, which would be the first one again.
    t = np.arange(frames) / (frames if around else max(frames - 1, 1))
    # Without a loop, ease in and out by a cubic whose slope is 0 at both ends.
    share = t if around else t * t * (3.0 - 2.0 * t)
    return [
        {**knobs, **{name: moving[name][0] + way[name] * at for name in way}}
        for at in share.tolist()
    ]


class Bar:
    """A progress bar in a notebook or a terminal, for methods that take ``progress=``. It vanishes
    at the end.

    >>> isogi.frame("casting", wait="final", progress=Bar())
    """

    def __init__(self) -> None:
        self._line = ""

    def __call__(self, update: Facts | Progress | int, total: int = 0) -> None:
        """Draw the progress of a frame, a job or a film."""
        if isinstance(update, Facts):
            self._draw(
                update.chunks["final"], update.chunks["needed"], str(update), not update.provisional
            )
        elif isinstance(update, Progress):
            self._draw(update.progress, 100, update.message, update.over)
        else:
            self._draw(update, total, f"{update} of {total} frames", update == total)

    def _draw(self, done: int, total: int, note: str, over: bool) -> None:
        """Draw the bar over the one before; erase it if the work is ``over``."""
        filled = PROGRESS_BAR_WIDTH * done // max(total, 1)
        if over:
            line = ""
        else:
            line = f"{'█' * filled}{'░' * (PROGRESS_BAR_WIDTH - filled)} {note}"
        # Draw only changes: notebooks keep all output.
        if line != self._line:
            # A notebook shows stderr as if it were an error.
            stream = sys.stdout if "ipykernel" in sys.modules else sys.stderr
            stream.write(f"\r{' ' * len(self._line)}\r{line}")
            stream.flush()
            self._line = line


@dataclass(frozen=True)
class Event:
    """An event of a view: its ``kind`` (refined, progress, final or failed),
    its document ``data``, and an ``id``.

    The ``id`` names the picture that was reported last on the connection, by this event or an
    earlier one, and the kind of that event; it is empty before that.
    """

    kind: str
    data: Mapping[str, Any]
    id: str

    @property
    def facts(self) -> Facts | None:
        """The quality of the view now.

        None for progress, whose data hold the chunks ``waiting`` and the ``time_left``.
        """
        if self.kind == "progress":
            return None
        return Facts.of_document(self.data)


@dataclass(frozen=True)
class Progress:
    """The progress of a job: its ``status`` (accepted, running, successful, failed or dismissed),
    and a ``message``.

    ``progress`` is in percent; ``time_left`` is None if unknown or over.
    """

    status: str
    message: str
    progress: int
    time_left: TimeLeft | None = None

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self:
        """Read the progress from the server's document of a job."""
        return cls(**fields_in(document, cls))

    @property
    def over(self) -> bool:
        """True if the job has ended."""
        return self.status not in ("accepted", "running")


class Job:
    """Work that a server does in the background and continues after a restart.

    Its ``id`` finds it again.
    """

    def __init__(self, isogi: Isogi, key: str) -> None:
        self.id = key
        self._isogi = isogi

    @property
    def address(self) -> str:
        """The URL of the job."""
        return str(self._isogi._client.base_url.join(self._path))

    def progress(self) -> Progress:
        """Ask for the job's progress."""
        return Progress.of_document(self._isogi._json("GET", self._path))

    def wait(self, progress: Callable[[Progress], object] | None = None) -> dict[str, Any]:
        """Wait until the job has ended, and return its summary; ``progress`` is called from time to
        time.

        Raises JobError if the job failed or was dismissed.
        """
        self.end(progress)
        return self.summary()

    def end(self, progress: Callable[[Progress], object] | None = None) -> None:
        """Wait until the job has ended, and return nothing: for jobs without a summary.

        ``progress`` is called each time that the server is asked, about once a second, and once
        when the job has ended. Raises JobError if the job failed or was dismissed.
        """
        while not (now := self.progress()).over:
            if progress is not None:
                progress(now)
            time.sleep(JOB_CHECK_SECONDS)
        if progress is not None:
            progress(now)
        if now.status != "successful":
            raise JobError(f"The job is {now.status}: {now.message}")

    def summary(self) -> dict[str, Any]:
        """Return the summary of the job. Raises NotFoundError if there is none yet."""
        return self._isogi._json("GET", f"{self._path}/results")

    def dismiss(self) -> None:
        """Have the server stop the job, or forget it if it has ended. Light that it has baked
        stays.
        """
        self._isogi._ask("DELETE", self._path)

    @property
    def _path(self) -> str:
        """The job's path on the server."""
        return f"/v1/jobs/{quote(self.id, safe='')}"


class Isogi:
    """A connection to a server at ``base_url``, with an access ``token``, by default that in
    $ISOGI_TOKEN.

    A request fails if the server sends nothing for ``timeout`` seconds. If the server is busy or
    starting, or does not answer although it did before, the request is repeated for about
    ``patience`` seconds, at the times that the server names or at growing intervals. The token is
    sent to this server only.

    Methods raise IsogiError. An object can be used from several threads, and as a context manager,
    which closes the connections.
    """

    def __init__(
        self,
        base_url: str = "http://127.0.0.1:8000",
        token: str | None = None,
        timeout: float = 60.0,
        patience: float = DEFAULT_PATIENCE_SECONDS,
    ) -> None:
        token = token or os.environ.get("ISOGI_TOKEN")
        self._server: subprocess.Popen[bytes] | None = None
        # ``Scene.serve`` keeps its scene here, as the server reads files that go with the scene.
        self._kept: object = None
        self._patience = patience
        self._wait = min(LONGEST_WAIT, timeout / 2)
        # Repeat requests that the server is too busy for, at the times that it names or at growing
        # intervals. Once it has answered, repeat also those that get no connection (see
        # ``_note_answer``). The limit is the sum of the pauses, not their number: 1000 of them take
        # more than an hour. Retry refuses a limit of 0 seconds.
        self._retry = Retry(
            total=1000,
            allowed_methods=("GET", "POST", "DELETE"),
            total_timeout=max(patience, 1e-3),
            status_forcelist=(429, 503),
            retry_on_exceptions=(),
            backoff_factor=FIRST_RETRY_PAUSE,
            backoff_jitter=0.5,
            max_backoff_wait=LONGEST_PAUSE,
        )
        self._client = httpx.Client(
            base_url=base_url,
            headers={"Authorization": f"Bearer {token}"} if token else {},
            timeout=timeout,
            transport=RetryTransport(),
            event_hooks={
                "request": [self._check_server, self._ask_again],
                "response": [self._note_answer],
            },
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections, and end the server if ``serving`` has started one."""
        self._client.close()
        if self._server is not None:
            self._server.terminate()
            self._server.wait()
            self._server = None

    @classmethod
    def serving(cls, target: str | Path, **settings: Any) -> Self:
        """Start a server on this machine for a scene or a volume, and connect to it; ``close`` ends
        it. isogi must be installed.

        ``settings`` are those of ``isogi serve``, such as ``workers=2``. Raises UnreachableError if
        the server ends immediately.

        >>> isogi = Isogi.serving("engine.toml")
        """
        # Let the system choose a free port. Another process may take it before the server does: the
        # server then ends, and this call raises.
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        options = [
            f"--{name.replace('_', '-')}={value}"
            for name, value in {"port": port, **settings}.items()
        ]
        isogi = cls(f"http://127.0.0.1:{port}")
        isogi._server = subprocess.Popen(
            [sys.executable, "-m", "isogi_server", "serve", str(target), *options]
        )
        try:
            isogi._await_server()
        except BaseException:
            isogi.close()
            raise
        return isogi

    def _await_server(self) -> None:
        """Return when the started server answers. Raises UnreachableError if it has ended."""
        while self._server is not None and self._server.poll() is None:
            with suppress(httpx.TransportError):
                if httpx.get(self._client.base_url.join("/readyz")).is_success:
                    return
            time.sleep(FIRST_RETRY_PAUSE)
        raise UnreachableError("The server ended immediately: see its message above.")

    def scenes(self) -> list[dict[str, Any]]:
        """Return all scenes, each with its ``id``, ``name`` and ``href``.

        >>> [scene["id"] for scene in isogi.scenes()]
        ['casting']
        """
        return self._json("GET", "/v1/scenes")["scenes"]

    def scene(self, scene: str) -> dict[str, Any]:
        """Return the facts of a scene: volume, histogram, default and range of every knob, plan.

        >>> isogi.scene("casting")["ranges"]["isovalue"]
        {'min': 0.0, 'max': 1.0}
        """
        return self._json("GET", scene_path(scene))

    def read(self, path: str) -> bytes:
        """Return the bytes at an address of the server, such as the data that a graphics card draws
        from.

        Raises IsogiError, also for an address of another server.

        >>> isogi.read("v1/scenes/casting/card")
        """
        return self._ask("GET", path).content

    def fit(self, scene: str, **view: Values) -> dict[str, Any]:
        """Return the camera that shows a surface as large as possible, as parameters of ``frame``.

        ``view`` may hold isovalue, azimuth, elevation, fov, width and height.

        >>> isogi.frame("casting", **isogi.fit("casting"))
        """
        return self._json("GET", f"{scene_path(scene)}/fit", params=query(view))

    def coverage(self, scene: str, **view: Values) -> Facts:
        """Return how far a view is baked, without its picture."""
        return Facts.of_document(
            self._json("GET", f"{scene_path(scene)}/coverage", params=query(view))
        )

    def point(self, scene: str, x: float, y: float, **view: Values) -> Point | None:
        """Return the point of the surface at ``x``, ``y`` of a view's picture, in pixels from its
        top left; None off the surface.

        ``view`` are the parameters of ``frame`` that decide what the picture shows, and wait_ms for
        its light.

        >>> isogi.point("casting", 256, 256, azimuth=40).position
        """
        document = self._json(
            "GET", f"{scene_path(scene)}/point", params=query({"x": x, "y": y, **view})
        )
        if document["hit"]:
            return Point.of_document(document)
        return None

    def size(self, scene: str, **surface: Values) -> dict[str, Any]:
        """Return the area of an isosurface and the volume that it encloses, each with its error;
        ``unit`` is that of lengths.

        ``surface`` may hold isovalue, cut, time and hide. ``is_open`` is true if the solid reaches
        a side of the volume.

        >>> isogi.size("casting", isovalue=0.4)["area"]
        """
        return self._json("GET", f"{scene_path(scene)}/size", params=query(surface))

    def frame(
        self,
        scene: str,
        *,
        wait: Wait = "now",
        f: str = "png",
        progress: Callable[[Facts], object] | None = None,
        **view: Values,
    ) -> Frame:
        """Return the frame of a view in a format ``f``: png, jpeg, webp, or npy for numbers.

        ``wait`` is the time that its light may be baked: "now" takes the light that is there, a
        number waits at most that many seconds, and "final" waits until the view is final, through
        restarts of the server. ``progress`` is called with the facts each time that these change.
        ``view`` are the parameters of the HTTP interface: isovalue, azimuth, elevation, distance,
        fov, yaw, pitch, roll, albedo, material, width, height, shading, max_error, exposure, …

        Raises RefusedError, NotFoundError, BusyError, UnreachableError, and NotFinalError with the
        server's reason if the view cannot become final. Warns with TargetWarning if max_error is
        not reached.

        >>> isogi.frame("casting", azimuth=40, width=1024, height=768, wait=5).save("casting.png")
        """
        if "wait_ms" in view:
            raise TypeError("Use wait=, in seconds, in place of wait_ms.")
        asked = {**query(view), "f": f}
        path = scene_path(scene)
        if wait == "final":
            frame = self._wait_until_final(path, asked, progress)
        else:
            frame = self._wait_for_frame(
                path, asked, 0.0 if wait == "now" else float(wait), progress
            )
        tell_target(frame.facts, asked.get("max_error"))
        return frame

    def film(
        self,
        scene: str,
        views: Sequence[Mapping[str, Values]],
        *,
        fps: float = 24.0,
        progress: Callable[[int, int], object] | None = None,
        **more: Any,
    ) -> Film:
        """Return the frames of ``views``, such as those of ``sweep``. ``more`` are arguments of
        ``frame`` for all of them.

        ``progress`` is called with the number of frames that are done, and that of all frames.

        >>> views = sweep(48, azimuth=(0, 360))
        >>> isogi.film("casting", views, width=320, height=240, wait="final").save("turn.gif")
        """
        frames = []
        for view in views:
            frames.append(self.frame(scene, **{**more, **view}))
            if progress is not None:
                progress(len(frames), len(views))
        return Film(frames, fps)

    def watch(self, scene: str, **view: Values) -> Iterator[Event]:
        """Yield the events of a view while it becomes final. Its light is baked as long as a client
        listens.

        The last event is ``final`` or ``failed``. If the connection breaks, another one is opened.
        Its first event tells the state that the view has then, unless an event has told it before;
        states in between are left out.

        >>> for event in isogi.watch("casting", azimuth=40):
        ...     print(event.kind, event.facts)
        """
        return self._events(scene_path(scene), query(view))

    def prewarm(self, scene: str, *, dry_run: bool = False, **order: Any) -> Job:
        """Start a job that bakes light ahead, and return it. With ``dry_run``, it forecasts the
        amount of light and the time instead.

        ``order`` are the fields of the HTTP interface: isovalues, views, directions, orbits,
        all_directions, target_error, deadline, width, height, … Until a job has ended, the same
        order gives the same job.

        >>> job = isogi.prewarm("casting", isovalues=["0.4:0.6:0.05"], views=12)
        >>> job.wait(print)["error"]
        """
        body = {**order, "dry_run": dry_run}
        return Job(self, self._json("POST", f"{scene_path(scene)}/prewarm", json=body)["jobID"])

    def export(
        self,
        scene: str,
        path: str | Path,
        *,
        progress: Callable[[Progress], object] | None = None,
        **view: Values,
    ) -> Path:
        """Write an isosurface or the volume, with its light, to a file, and return its path. The
        suffix decides the format.

        ``view`` are the parameters of the HTTP interface: isovalue, yaw, exposure, max_error, …
        After ``deadline`` seconds of baking the file is made with the light that is there.

        The server's job is dismissed in any case: its file is here then, or of no use. Raises
        JobError if the job failed, and OSError if the file cannot be written.

        >>> isogi.export("casting", "casting.glb", isovalue=0.5, yaw=90, deadline=300)
        """
        asked = query({**view, "f": Path(path).suffix.removeprefix(".")})
        # The request is repeated if its answer is lost: by this key the server knows it again, and
        # begins no second job.
        once = {"Idempotency-Key": uuid4().hex}
        begun = self._json("POST", f"{scene_path(scene)}/export", params=asked, headers=once)
        job = Job(self, begun["jobID"])
        try:
            job.end(progress)
            Path(path).write_bytes(self._ask("GET", f"{job._path}/file").content)
        finally:
            job.dismiss()
        return Path(path)

    def job(self, key: str) -> Job:
        """Return the job with this id. Raises NotFoundError if there is none."""
        job = Job(self, key)
        job.progress()
        return job

    def upload(
        self,
        volume: str | Path | np.ndarray,
        name: str | None = None,
        spacing: Sequence[float] = (1.0, 1.0, 1.0),
    ) -> dict[str, Any]:
        """Send a volume, a file of a kind that isogi reads or an array, to a server that takes
        uploads; return its facts.

        An array is (z, y, x), and its voxels are ``spacing`` apart along x, y and z. Raises
        ValueError if it is not a volume.

        >>> volume = isogi.upload("engine.nrrd", name="The engine")
        >>> isogi.upload(np.hypot(*np.mgrid[:64, :64, :64][:2]), spacing=(1, 1, 2))
        >>> isogi.frame(volume["id"]).save("engine.png")
        """
        if isinstance(volume, np.ndarray):
            return self._send("/v1/volumes", nrrd_of(volume, spacing), name)
        return self._send("/v1/volumes", Path(volume), name)

    def upload_environment(self, probe: str | Path, name: str | None = None) -> dict[str, Any]:
        """Send a light probe (.hdr or .exr, latitude-longitude) to a server that takes uploads;
        return its facts.

        >>> light = isogi.upload_environment("grace.hdr")
        >>> isogi.frame("casting", environment=light["id"])
        """
        return self._send("/v1/environments", Path(probe), name)

    def delete(self, volume: str) -> None:
        """Delete a volume that was uploaded, and its scene."""
        self._ask("DELETE", f"/v1/volumes/{quote(volume, safe='')}")

    def delete_environment(self, environment: str) -> None:
        """Delete a light probe that was uploaded."""
        self._ask("DELETE", f"/v1/environments/{quote(environment, safe='')}")

    def _send(self, path: str, sent: bytes | Path, name: str | None) -> dict[str, Any]:
        """Send bytes or a file under a ``name``; return the server's document."""
        content: bytes | Blocks
        if isinstance(sent, bytes):
            size = len(sent)
            content = sent
        else:
            size = sent.stat().st_size
            content = Blocks(sent)
        headers = {"Content-Type": "application/octet-stream", "Content-Length": str(size)}
        return self._json(
            "POST", path, params={"name": name} if name else {}, content=content, headers=headers
        )

    def _wait_for_frame(
        self,
        path: str,
        asked: dict[str, str],
        seconds: float,
        progress: Callable[[Facts], object] | None,
    ) -> Frame:
        """Return the frame once it is final, or after ``seconds`` of waiting for that.

        If all chunks of a frame are final, it is returned even if the frame is not: a path-traced
        one becomes no better by baking.
        """
        deadline = time.monotonic() + seconds
        while True:
            # One request waits for a limited time; repeat it until the deadline.
            left = min(max(deadline - time.monotonic(), 0.0), self._wait)
            frame = self._frame(path, {**asked, "wait_ms": f"{1000 * left:.0f}"})
            if progress is not None:
                progress(frame.facts)
            chunks = frame.facts.chunks
            complete = not frame.facts.provisional or chunks["final"] == chunks["needed"]
            if complete or time.monotonic() >= deadline:
                return frame

    def _wait_until_final(
        self, path: str, asked: dict[str, str], progress: Callable[[Facts], object] | None
    ) -> Frame:
        """Return the frame once it is final."""
        # A view that was final may need light again, after damage in the store: ask until the frame
        # itself is final.
        while (frame := self._frame(path, asked)).facts.provisional:
            self._listen(path, asked, progress or (lambda _: None))
        if progress is not None:
            progress(frame.facts)
        return frame

    def _listen(
        self, path: str, asked: Mapping[str, str], progress: Callable[[Facts], object]
    ) -> None:
        """Return when the view is final. Raises NotFinalError if it cannot become so."""
        seen = {name: text for name, text in asked.items() if name not in PICTURE_PARAMETERS}
        for event in self._events(path, seen):
            if event.kind == "failed":
                raise NotFinalError(event.data["detail"], problem=event.data)
            if event.facts is not None:
                progress(event.facts)

    def _events(self, path: str, asked: Mapping[str, str]) -> Iterator[Event]:
        """Yield the events of a view up to the last one, over several connections if need be."""
        last = ""
        heard = time.monotonic()
        while True:
            for event in self._connection(f"{path}/events", asked, last):
                last = event.id or last
                heard = time.monotonic()
                yield event
                if event.kind in ("final", "failed"):
                    return
            # Give up if no event came for longer than a busy server is asked again.
            if time.monotonic() - heard > self._patience:
                raise UnreachableError("The server repeatedly ends its events too early.")
            time.sleep(FIRST_RETRY_PAUSE)

    def _connection(self, path: str, asked: Mapping[str, str], last: str) -> Iterator[Event]:
        """Yield the events of one connection until it ends or breaks.

        ``last`` is the id of the last event that came before, empty if none came. The server leaves
        its first event out if that has the same id.
        """
        headers = {"Accept": "text/event-stream"}
        if last:
            headers["Last-Event-ID"] = last
        with (
            translated_errors(),
            self._client.stream("GET", path, params=asked, headers=headers) as answer,
        ):
            if answer.status_code != httpx.codes.OK:
                answer.read()
                raise error_of(answer)
            try:
                for event in httpx_sse.EventSource(answer).iter_sse():
                    if event.data:
                        yield Event(event.event, read_json(event.data), event.id)
            except (*CONNECTION_ERRORS, httpx.ReadTimeout):
                # The caller opens another connection, with the id of the last event.
                return

    def _frame(self, path: str, asked: Mapping[str, str]) -> Frame:
        """Ask for a frame, and return it as it is now."""
        answer = self._ask("GET", f"{path}/frame", params=asked)
        return Frame(
            answer.content,
            FORMAT_OF_MEDIA_TYPE[answer.headers["content-type"]],
            Facts.of_headers(answer.headers),
        )

    def _json(self, method: str, path: str, **more: Any) -> Any:
        """Return the JSON document of the server's answer."""
        return document_of(self._ask(method, path, **more))

    def _ask(self, method: str, path: str, **more: Any) -> httpx.Response:
        """Return the server's answer. Raises IsogiError if it is not one of success."""
        with translated_errors():
            answer = self._client.request(method, path, **more)
        if not answer.is_success:
            raise error_of(answer)
        return answer

    def _check_server(self, request: httpx.Request) -> None:
        """Raise RefusedError for a request to another server, which would get the token."""
        base = self._client.base_url
        if origin_of(request.url) != origin_of(base):
            raise RefusedError(
                f"{request.url} is no address of the server at {base}: use an Isogi for that "
                "server."
            )

    def _ask_again(self, request: httpx.Request) -> None:
        """Set the rules by which the request is repeated."""
        request.extensions["retry"] = self._retry

    def _note_answer(self, _: httpx.Response) -> None:
        """Note that the server has answered: from now on, requests are repeated if it does not."""
        self._retry = self._retry.copy_with(retry_on_exceptions=CONNECTION_ERRORS)


NRRD_TYPES = {
    "u1": "uint8",
    "i1": "int8",
    "u2": "uint16",
    "i2": "int16",
    "u4": "uint32",
    "i4": "int32",
    "f4": "float",
}
"""NRRD's names of the types that volumes may have besides double."""


def nrrd_of(array: np.ndarray, spacing: Sequence[float]) -> bytes:
    """Return an array (z, y, x) as the bytes of an NRRD file, with voxels ``spacing`` apart along
    x, y and z.

    Raises ValueError if it is not a volume of real numbers or booleans, or if ``spacing`` is not
    three distances above 0.
    """
    if array.ndim != 3 or array.dtype.kind not in "biuf":
        raise ValueError(
            f"A volume is an array of numbers (z, y, x), not one of {array.dtype} {array.shape}."
        )
    if len(spacing) != 3 or not all(np.isfinite(step) and step > 0 for step in spacing):
        raise ValueError(f"spacing is three distances above 0, along x, y and z, not {spacing!r}.")
    # Write types that NRRD has as they are, logical values as bytes, and all others as double.
    if array.dtype.str[1:] in NRRD_TYPES:
        code = array.dtype.str[1:]
    elif array.dtype.kind == "b":
        code = "u1"
    else:
        code = "f8"
    sizes = " ".join(map(str, array.shape[::-1]))
    steps = " ".join(repr(float(step)) for step in spacing)
    header = (
        f"NRRD0004\ntype: {NRRD_TYPES.get(code, 'double')}\ndimension: 3\nsizes: "
        f"{sizes}\nspacings: {steps}\n"
    )
    return (
        f"{header}encoding: raw\nendian: little\n\n".encode() + array.astype(f"<{code}").tobytes()
    )


@dataclass(frozen=True)
class Blocks:
    """The bytes of a file, block by block.

    They can be read several times, as a request may be sent again.
    """

    path: Path

    def __iter__(self) -> Iterator[bytes]:
        with self.path.open("rb") as file:
            while block := file.read(UPLOAD_BLOCK_BYTES):
                yield block


def scene_path(scene: str) -> str:
    """Return the path of a scene on the server."""
    return f"/v1/scenes/{quote(scene, safe='')}"


def query(view: Mapping[str, Values]) -> dict[str, str]:
    """Return the parameters of a view as texts:
    sequences such as eye=(1, 2, 3) with commas, without those that are None.
    """
    return {name: text_of(value) for name, value in view.items() if value is not None}


def text_of(value: float | str | Sequence[float]) -> str:
    """Return a value as the server reads it."""
    if isinstance(value, str):
        return value
    row = np.atleast_1d(value).tolist()
    return ",".join(repr(number) for number in row)


def srgb_of(linear: np.ndarray) -> np.ndarray:
    """Return linear radiance as sRGB bytes (IEC 61966-2-1)."""
    share = np.clip(linear, 0.0, 1.0)
    curve = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1.0 / 2.4) - 0.055)
    return np.asarray(255.0 * curve + 0.5, np.uint8)


def tell_target(facts: Facts, target: str | None) -> None:
    """Warn of a final frame whose error is above the requested one."""
    if target is not None and not facts.provisional and facts.error > float(target):
        warnings.warn(
            f"The frame is final, but its total error is {facts.error:.3g} and not {target}: "
            "pixels have taken the most paths that they may.",
            TargetWarning,
            stacklevel=3,
        )


def origin_of(url: httpx.URL) -> tuple[str, str, int | None]:
    """Return scheme, host and port of a server's address.

    The port is None if it is the scheme's default.
    """
    return url.scheme, url.host, url.port


def document_of(answer: httpx.Response) -> Any:
    """Return the JSON document in an answer. Raises ServerError if there is none."""
    return read_json(answer.text)


def read_json(text: str) -> Any:
    """Return the JSON document in a text from the server.

    Raises ServerError if there is none, or if it is nested too deep for Python.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ServerError(
            "The answer is no JSON document that can be read: is this an isogi?"
        ) from error


def error_of(answer: httpx.Response) -> IsogiError:
    """Return the error for an answer that is not one of success."""
    try:
        problem = document_of(answer)
    except ServerError:
        problem = {}
    if not isinstance(problem, dict):
        problem = {}
    status = answer.status_code
    detail = problem.get("detail") or f"The server answered {status} {answer.reason_phrase}."
    return kind_of(status)(detail, status, problem)


def kind_of(status: int) -> type[IsogiError]:
    """Return the class of error for an HTTP status."""
    known: dict[int, type[IsogiError]] = {401: TokenError, 403: TokenError, 404: NotFoundError}
    known |= {429: BusyError, 503: BusyError}
    if status in known:
        return known[status]
    return RefusedError if status < 500 else ServerError


@contextmanager
def translated_errors() -> Iterator[None]:
    """Raise UnreachableError if a request in the block gets no answer."""
    try:
        yield
    except httpx.HTTPError as error:
        raise UnreachableError(
            f"No answer from the server: {error}. Does it run, and at this address?"
        ) from error
