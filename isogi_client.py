"""isogi from Python: a view in, a picture or numbers out. One file that needs no other part of
isogi.

>>> from isogi_client import Isogi
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

import httpx
import httpx_sse
import numpy as np
from httpx_retries import Retry, RetryTransport
from PIL import Image

LONGEST_WAIT = 10.0
"""Seconds that the server waits for baking in one request, at most."""

DEFAULT_PATIENCE_SECONDS = 60.0
"""Seconds for which a server that is busy, starting or away is asked again, by default."""

FIRST_RETRY_PAUSE = 0.1
LONGEST_PAUSE = 5.0
"""Seconds between two tries, at first and at most."""

CONNECTION_ERRORS = (httpx.NetworkError, httpx.RemoteProtocolError)
"""What a server that is gone makes of a request."""

JOB_CHECK_SECONDS = 1.0
"""Seconds between two requests for a job's state."""

UPLOAD_BLOCK_BYTES = 1 << 20
"""Bytes that are read from a file at a time."""

PROGRESS_BAR_WIDTH = 20
"""Characters of a progress bar."""

PICTURE_PARAMETERS = ("f", "overlay", "exposure", "background", "antialias", "strip", "version")
"""Parameters of a picture, which say nothing of its light."""

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
"""How long to wait for light: not at all, until all of it is final, or so many seconds."""

Vector = tuple[float, float, float]
Values = float | str | Sequence[float] | None


class IsogiError(Exception):
    """What went wrong, in a sentence, with the HTTP ``status`` and the ``problem`` document (RFC
    9457), if any.
    """

    def __init__(
        self, detail: str, status: int | None = None, problem: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.status = status
        self.problem = dict(problem or {})


class RefusedError(IsogiError):
    """The server does not take this request as it is: see ``detail``, and ``problem["parameter"]``
    where it is one.
    """


class NotFoundError(RefusedError):
    """There is no such scene, volume or job."""


class TokenError(RefusedError):
    """The server wants its token (``token=`` or ISOGI_TOKEN), or does not serve this client at
    all.
    """


class BusyError(IsogiError):
    """The server is busy, starting or stopping, and stayed so for as long as it was asked again."""


class ServerError(IsogiError):
    """The server failed on this request; ``problem["request_id"]`` finds it in its log."""


class UnreachableError(IsogiError):
    """No server answers at this address."""


class NotFinalError(IsogiError):
    """A view does not become final: some of its light cannot be baked."""


class JobError(IsogiError):
    """A job failed, or was dismissed."""


class TargetWarning(UserWarning):
    """A frame is final, and yet its estimated error is above the ``max_error`` that was asked
    for.
    """


class TimeLeft(NamedTuple):
    """Seconds until a view is final: most likely, and the range that they are likely in."""

    low: float
    likely: float
    high: float


@dataclass(frozen=True)
class Facts:
    """What the server knows of a frame's quality.

    ``coverage`` are the shares of the surface's pixels that are final, converging and provisional,
    ``error`` is the estimated relative RMSE, ``chunks`` how many are needed and final. 99 % of the
    pixels have an error below ``p99``, None where that is not measured. ``time_left`` is None where
    it is unknown or over, ``etag`` names the very picture, and ``timing`` has the milliseconds of
    the stages of the work on it. So many pixels show a ``surface``, None where the server does not
    say; the work is ``overdue`` once it takes longer than was said before.
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
        """The facts in a frame's headers."""
        left = numbers(headers.get("isogi-time-left", ""))
        return cls(
            provisional=headers["isogi-provisional"] == "?1",
            coverage=numbers(headers["isogi-coverage"]),
            **error_of_header(headers["isogi-error"]),
            chunks={name: int(count) for name, count in numbers(headers["isogi-chunks"]).items()},
            time_left=TimeLeft(**left) if left else None,
            etag=headers.get("etag"),
            timing=numbers(headers.get("server-timing", "").replace(";dur", "")),
            surface=int(headers["isogi-surface"]) if "isogi-surface" in headers else None,
            overdue=headers.get("isogi-overdue") == "?1",
        )

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self:
        """The facts in the server's document of a view's coverage."""
        known = {"surface": document.get("pixels", {}).get("surface")}
        return cls(**known | known_in(document, cls))

    def __str__(self) -> str:
        """For a person, such as ``182 of 240 chunks final, error about 1.8 %, about 40 s``."""
        if self.surface == 0:
            return "no surface in view"
        if self.error < 0.1:
            error = f"{100 * self.error:.2g}"
        else:
            error = f"{100 * self.error:.0f}"
        about = "" if self.controls else "about "
        count = (
            f"{self.chunks['final']} of {self.chunks['needed']} chunks final, error "
            f"{about}{error} %"
        )
        if self.provisional:
            left = self.time_left
        else:
            left = None
        if left is None:
            return count
        return f"{count}, about {left.likely:.0f} s"


def known_in(document: Mapping[str, Any], kind: type[Any]) -> dict[str, Any]:
    """The fields of a ``kind`` of facts in a document of the server, whose rows become tuples."""
    known = {each.name: document[each.name] for each in fields(kind) if each.name in document}
    known = {
        name: tuple(value) if isinstance(value, list) else value for name, value in known.items()
    }
    left = known.get("time_left")
    return known | ({"time_left": TimeLeft(**left)} if left else {})


def error_of_header(header: str) -> dict[str, Any]:
    """What a header such as ``0.018; noise=0.006; low=0.015; high=0.021; controls=256`` says of a
    frame's error.
    """
    error, *parts = header.split(";")
    known = numbers(",".join(part for part in parts if "=" in part))
    if "low" in known:
        measured = {"interval": (known["low"], known["high"]), "controls": int(known["controls"])}
    else:
        measured = {}
    if "p99" in known:
        tail = {"p99": known["p99"], "p99_interval": (known["p99-low"], known["p99-high"])}
    else:
        tail = {}
    return {"error": float(error), "noise": known.get("noise"), **measured, **tail}


def numbers(header: str) -> dict[str, float]:
    """The numbers in a header such as ``final=0.81, provisional=0.19``."""
    pairs = (part.partition("=") for part in header.split(",") if part.strip())
    return {name.strip(): float(number) for name, _, number in pairs}


class Planes(NamedTuple):
    """A frame as numbers, for each pixel; row 0 is the top.

    ``rgb`` (h, w, 3) is linear radiance, ``mask`` (h, w) where the surface is, ``state`` (h, w) is
    0 none, 1 provisional, 2 converging, 3 final, 4 final by a texel that cannot be projected,
    ``error`` (h, w) the relative standard error, ``position`` (h, w, 3) the surface's in world
    coordinates.
    """

    rgb: np.ndarray
    mask: np.ndarray
    state: np.ndarray
    error: np.ndarray
    position: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """A picture: its bytes (``content``) in a format ``f``, and the ``facts`` of its quality."""

    content: bytes
    f: str
    facts: Facts

    @cached_property
    def image(self) -> Image.Image:
        """The picture. ValueError where it was asked for as npy."""
        if self.f == "npy":
            raise ValueError(
                "npy holds radiance and no picture: ask for f='png', or see .array and .planes."
            )
        return Image.open(io.BytesIO(self.content))

    @cached_property
    def array(self) -> np.ndarray:
        """The picture's bytes (h, w, 3), or of an npy the numbers as they came (h, w, 9); see
        ``planes``.
        """
        if self.f == "npy":
            return np.load(io.BytesIO(self.content), allow_pickle=False)
        return np.asarray(self.image)

    @cached_property
    def planes(self) -> Planes:
        """The numbers by their names. ValueError where it was not asked for as npy."""
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
        """Write the bytes to a file. ValueError where its name is one of another format."""
        path = Path(path)
        if path.suffix.lower() not in FORMAT_SUFFIXES[self.f]:
            fitting = " or ".join(FORMAT_SUFFIXES[self.f])
            raise ValueError(
                f"This frame is {self.f}: name the file {fitting}, or ask for another f."
            )
        path.write_bytes(self.content)
        return path

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """``array``, for NumPy."""
        if dtype is None:
            return self.array
        return self.array.astype(dtype)

    def __repr__(self) -> str:
        """One line, such as ``Frame(npy, 640 × 480 × 9, 182 of 240 chunks final, error about 1.8
        %)``.
        """
        if self.f == "npy":
            wide = self.array.shape[1]
            high = self.array.shape[0]
        else:
            wide, high = self.image.size
        size = f"{wide} × {high}" + (f" × {self.array.shape[2]}" if self.f == "npy" else "")
        return f"Frame({self.f}, {size}, {self.facts})"

    def _repr_png_(self) -> bytes:
        """The picture, as notebooks show it; of numbers that of their radiance."""
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
    """A point of the surface that a view shows; lengths have the volume's ``unit``, "" where
    unknown.

    ``position`` and the outward unit ``normal`` are in the world, ``voxel`` are voxel indices, x
    first, and ``sides`` those of a patient on which the coordinates lie, "" elsewhere. ``value`` is
    the isovalue, None on the ``wall`` with that number. ``light`` is linear RGB, ``displayed`` the
    same in sRGB, ``state`` final, converging or provisional, and ``error`` the relative error of
    that pixel.
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
        """The point in the server's document of one."""
        return cls(**known_in(document, cls))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """``position``, for NumPy."""
        return np.asarray(self.position, dtype or np.float64)


def distance(a: Point | Sequence[float], b: Point | Sequence[float]) -> float:
    """How far two points of the world are from each other, in its unit.

    >>> distance((0, 0, 0), (3, 0, 4))
    5.0
    """
    return float(np.linalg.norm(np.subtract(b, a)))


def angle(
    a: Point | Sequence[float], b: Point | Sequence[float], c: Point | Sequence[float]
) -> float:
    """The angle at ``b`` between the ways to ``a`` and to ``c``, in degrees from 0 to 180; NaN
    where one has no length.

    >>> angle((1, 0, 0), (0, 0, 0), (0, 2, 0))
    90.0
    """
    u, v = np.subtract(a, b), np.subtract(c, b)
    if not (u.any() and v.any()):
        return float("nan")
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)))


@dataclass(frozen=True, eq=False)
class Film:
    """Frames that follow each other, so many a second; a notebook shows them as an animation."""

    frames: Sequence[Frame]
    fps: float = 24.0

    def save(self, path: str | Path) -> Path:
        """Write them to a GIF or WebP that loops, or as numbered pictures into a folder. ValueError
        for other files.
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
        """The animation, as notebooks show it."""
        data = base64.b64encode(self._animation("webp")).decode()
        return f'<img src="data:image/webp;base64,{data}" alt="{len(self.frames)} frames">'

    def _animation(self, form: str) -> bytes:
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
    """The views of so many frames, where numbers go from one to another and the rest stays.

    An azimuth that comes around to where it began, alone, goes evenly; all else begins and ends at
    rest.

    >>> sweep(48, azimuth=(0, 360), elevation=20)
    """
    moving = {
        name: value for name, value in knobs.items() if isinstance(value, tuple) and len(value) == 2
    }
    way = {name: last - first for name, (first, last) in moving.items()}
    around = set(way) <= {"azimuth", "yaw", "pitch", "roll"} and all(
        value % 360.0 == 0.0 for value in way.values()
    )
    t = np.arange(frames) / (frames if around else max(frames - 1, 1))
    share = t if around else t * t * (3.0 - 2.0 * t)
    return [
        {**knobs, **{name: moving[name][0] + way[name] * at for name in way}}
        for at in share.tolist()
    ]


class Bar:
    """A progress bar, in a notebook or a terminal, for whatever takes ``progress=``. It is gone at
    the end, and nothing is drawn of what is done at once.

    >>> isogi.frame("casting", wait="final", progress=Bar())
    """

    def __init__(self) -> None:
        self._line = ""

    def __call__(self, news: Facts | Progress | int, total: int = 0) -> None:
        """Draw how far a frame, a job or a film is."""
        if isinstance(news, Facts):
            self._draw(news.chunks["final"], news.chunks["needed"], str(news), not news.provisional)
        elif isinstance(news, Progress):
            self._draw(news.progress, 100, news.message, news.over)
        else:
            self._draw(news, total, f"{news} of {total} frames", news == total)

    def _draw(self, done: int, total: int, note: str, over: bool) -> None:
        filled = PROGRESS_BAR_WIDTH * done // max(total, 1)
        if over:
            line = ""
        else:
            line = f"{'█' * filled}{'░' * (PROGRESS_BAR_WIDTH - filled)} {note}"
        if line != self._line:
            # a notebook shows stderr as if it were an error
            stream = sys.stdout if "ipykernel" in sys.modules else sys.stderr
            stream.write(f"\r{' ' * len(self._line)}\r{line}")
            stream.flush()
            self._line = line


@dataclass(frozen=True)
class Event:
    """An event of a view: its ``kind`` is refined, progress, final or failed, and ``data`` its
    document.

    ``id`` names the light of the frame.
    """

    kind: str
    data: Mapping[str, Any]
    id: str

    @property
    def facts(self) -> Facts | None:
        """How good the view is now; None for progress, which has the chunks ``waiting`` and the
        ``time_left``.
        """
        if self.kind == "progress":
            return None
        return Facts.of_document(self.data)


@dataclass(frozen=True)
class Progress:
    """How far a job is: its ``status`` (accepted, running, successful, failed, dismissed) and what
    it says of itself.

    ``progress`` is in percent; ``time_left`` is None where it is unknown or over.
    """

    status: str
    message: str
    progress: int
    time_left: TimeLeft | None = None

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> Self:
        """The server's document of a job."""
        return cls(**known_in(document, cls))

    @property
    def over(self) -> bool:
        """Whether nothing more is done for it."""
        return self.status not in ("accepted", "running")


class Job:
    """Work that a server goes on with by itself, also when it is started again; its ``id`` finds it
    again.
    """

    def __init__(self, isogi: Isogi, key: str) -> None:
        self.id = key
        self._isogi = isogi

    @property
    def address(self) -> str:
        """The address of the job."""
        return str(self._isogi._client.base_url.join(self._path))

    def progress(self) -> Progress:
        """How far it is."""
        return Progress.of_document(self._isogi._json("GET", self._path))

    def wait(self, progress: Callable[[Progress], object] | None = None) -> dict[str, Any]:
        """The summary, once it has ended; ``progress`` is called now and then.

        Raises JobError where it failed or was dismissed.
        """
        self.end(progress)
        return self.summary()

    def end(self, progress: Callable[[Progress], object] | None = None) -> None:
        """Returns once it has ended; as ``wait`` does, of a job without a summary."""
        while not (now := self.progress()).over:
            if progress is not None:
                progress(now)
            time.sleep(JOB_CHECK_SECONDS)
        if progress is not None:
            progress(now)
        if now.status != "successful":
            raise JobError(f"The job is {now.status}: {now.message}")

    def summary(self) -> dict[str, Any]:
        """What it came to. NotFoundError where there is nothing yet."""
        return self._isogi._json("GET", f"{self._path}/results")

    def dismiss(self) -> None:
        """End it: nothing more is baked for it, and what was baked stays."""
        self._isogi._ask("DELETE", self._path)

    @property
    def _path(self) -> str:
        return f"/v1/jobs/{quote(self.id, safe='')}"


class Isogi:
    """A server at ``base_url``, which is shown the ``token``, by default that in $ISOGI_TOKEN.

    An answer may be silent for ``timeout`` seconds. A server that is busy or starting, or that is
    away once it has answered, is asked again, when it says or ever more rarely, for about
    ``patience`` seconds. The token is shown to this server alone. Methods raise IsogiError. Usable
    as a context manager, which closes the connections, and from several threads.
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
        self._patience = patience
        self._wait = min(LONGEST_WAIT, timeout / 2)
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
                "response": [self._meet],
            },
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections, and end a server of one's own."""
        self._client.close()
        if self._server is not None:
            self._server.terminate()
            self._server.wait()
            self._server = None

    @classmethod
    def serving(cls, target: str | Path, **settings: Any) -> Self:
        """A server of one's own for a scene or a volume, which ends with ``close``; isogi must be
        installed.

        ``settings`` are those of ``isogi serve``, such as ``workers=2``. Raises UnreachableError
        where it ends at once.

        >>> isogi = Isogi.serving("engine.toml")
        """
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        options = [
            f"--{name.replace('_', '-')}={value}"
            for name, value in {"port": port, **settings}.items()
        ]
        isogi = cls(f"http://127.0.0.1:{port}")
        isogi._server = subprocess.Popen(
            [sys.executable, "-m", "server", "serve", str(target), *options]
        )
        try:
            isogi._await_server()
        except BaseException:
            isogi.close()
            raise
        return isogi

    def _await_server(self) -> None:
        """Return when the server that was started answers. Raises UnreachableError where it has
        ended.
        """
        while self._server is not None and self._server.poll() is None:
            with suppress(httpx.TransportError):
                if httpx.get(self._client.base_url.join("/readyz")).is_success:
                    return
            time.sleep(FIRST_RETRY_PAUSE)
        raise UnreachableError("The server ended at once: it has said above why.")

    def scenes(self) -> list[dict[str, Any]]:
        """All scenes, each with its ``id``, ``name`` and ``href``.

        >>> [scene["id"] for scene in isogi.scenes()]
        ['casting']
        """
        return self._json("GET", "/v1/scenes")["scenes"]

    def scene(self, scene: str) -> dict[str, Any]:
        """The facts of a scene: volume, histogram, defaults and ranges of every knob, plan.

        >>> isogi.scene("casting")["ranges"]["isovalue"]
        {'min': 0.0, 'max': 1.0}
        """
        return self._json("GET", scene_path(scene))

    def read(self, path: str) -> bytes:
        """The bytes at an address of the server, such as what a graphics card draws from. Raises
        IsogiError, also for an address of another server.

        >>> isogi.read("v1/scenes/casting/card")
        """
        return self._ask("GET", path).content

    def fit(self, scene: str, **view: Values) -> dict[str, Any]:
        """The camera that shows a surface whole and large: parameters of ``frame``.

        ``view`` may hold isovalue, azimuth, elevation, fov, width and height.

        >>> isogi.frame("casting", **isogi.fit("casting"))
        """
        return self._json("GET", f"{scene_path(scene)}/fit", params=query(view))

    def coverage(self, scene: str, **view: Values) -> Facts:
        """How far a view is baked, without its picture."""
        return Facts.of_document(
            self._json("GET", f"{scene_path(scene)}/coverage", params=query(view))
        )

    def point(self, scene: str, x: float, y: float, **view: Values) -> Point | None:
        """The surface at the place ``x``, ``y`` of a view's picture, in pixels from its top left;
        None off the surface.

        ``view`` are the parameters of ``frame`` that say what the picture shows, and wait_ms for
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
        """Area of an isosurface and volume of what it encloses, each with its error; ``unit`` is
        that of lengths.

        ``surface`` may hold isovalue, cut, time and hide. ``is_open``: whether the solid reaches a
        side of the volume.

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
        """The frame of a view in a format ``f``: png, jpeg, webp, or npy for numbers.

        ``wait`` says for how long its light may be baked: "now" takes what there is, a number waits
        so many seconds at most, "final" until it is final, through restarts of the server.
        ``progress`` is called with the facts each time that more is known. ``view`` are the
        parameters of the HTTP interface: isovalue, azimuth, elevation, distance, fov, yaw, pitch,
        roll, albedo, material, width, height, shading, max_error, exposure, …

        Raises RefusedError, NotFoundError, BusyError, UnreachableError; NotFinalError with the
        server's reason where waiting for "final" is in vain. Warns with TargetWarning where
        max_error is not reached.

        >>> isogi.frame("casting", azimuth=40, width=1024, height=768, wait=5).save("casting.png")
        """
        if "wait_ms" in view:
            raise TypeError("Say how long to wait by wait=, in seconds.")
        asked = {**query(view), "f": f}
        path = scene_path(scene)
        if wait == "final":
            frame = self._final(path, asked, progress)
        else:
            frame = self._waited(path, asked, 0.0 if wait == "now" else float(wait), progress)
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
        """The frames of ``views``, such as those of ``sweep``, each as ``frame`` has it with what
        ``more`` says.

        ``progress`` is called with how many frames are there, and how many there will be.

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
        """How a view becomes final, event by event; its light is baked while a client listens.

        Ends with the event ``final`` or ``failed``, and goes on where it was when the connection
        breaks.

        >>> for event in isogi.watch("casting", azimuth=40):
        ...     print(event.kind, event.facts)
        """
        return self._events(scene_path(scene), query(view))

    def prewarm(self, scene: str, *, dry_run: bool = False, **order: Any) -> Job:
        """Bake light ahead; the job that does it. ``dry_run``: forecast how much that is, and how
        long it takes.

        ``order`` are the fields of the HTTP interface: isovalues, views, directions, orbits,
        all_directions, target_error, deadline, width, height, … The same order once more is the
        same job until that has ended.

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
        """Write an isosurface, or the volume, with its light to a file, whose suffix says the kind;
        its path.

        ``view`` are the fields of the HTTP interface: isovalue, yaw, exposure, max_error, deadline,
        … What it bakes is dropped where this is interrupted.

        >>> isogi.export("casting", "casting.glb", isovalue=0.5, yaw=90, deadline=300)
        """
        asked = query({**view, "f": Path(path).suffix.removeprefix(".")})
        job = Job(self, self._json("POST", f"{scene_path(scene)}/export", params=asked)["jobID"])
        try:
            job.end(progress)
            Path(path).write_bytes(self._ask("GET", f"{job._path}/file").content)
        finally:
            job.dismiss()
        return Path(path)

    def job(self, key: str) -> Job:
        """The job with this id. Raises NotFoundError."""
        job = Job(self, key)
        job.progress()
        return job

    def upload(
        self,
        volume: str | Path | np.ndarray,
        name: str | None = None,
        spacing: Sequence[float] = (1.0, 1.0, 1.0),
    ) -> dict[str, Any]:
        """Send a volume where the server takes uploads: a file of a kind that isogi reads, or an
        array; its facts.

        An array is (z, y, x), and its voxels are ``spacing`` apart along x, y and z. ValueError
        where it is no volume.

        >>> volume = isogi.upload("engine.nrrd", name="The engine")
        >>> isogi.upload(np.hypot(*np.mgrid[:64, :64, :64][:2]), spacing=(1, 1, 2))
        >>> isogi.frame(volume["id"]).save("engine.png")
        """
        sent = nrrd_of(volume, spacing) if isinstance(volume, np.ndarray) else Path(volume)
        return self._send("/v1/volumes", sent, name)

    def upload_environment(self, probe: str | Path, name: str | None = None) -> dict[str, Any]:
        """Send a light probe (.hdr, latitude-longitude) where the server takes uploads; its facts.

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
        """What the server says of bytes, or of a file, that it is sent under a ``name``."""
        (size, content) = (
            (len(sent), sent) if isinstance(sent, bytes) else (sent.stat().st_size, Blocks(sent))
        )
        headers = {"Content-Type": "application/octet-stream", "Content-Length": str(size)}
        return self._json(
            "POST", path, params={"name": name} if name else {}, content=content, headers=headers
        )

    def _waited(
        self,
        path: str,
        asked: dict[str, str],
        seconds: float,
        progress: Callable[[Facts], object] | None,
    ) -> Frame:
        """The frame once it is final, or after so many seconds of waiting for that.

        A frame whose chunks are all final is not waited for: a path-traced one is as good as its
        samples.
        """
        deadline = time.monotonic() + seconds
        while True:
            left = min(max(deadline - time.monotonic(), 0.0), self._wait)
            frame = self._frame(path, {**asked, "wait_ms": f"{1000 * left:.0f}"})
            if progress is not None:
                progress(frame.facts)
            chunks = frame.facts.chunks
            complete = not frame.facts.provisional or chunks["final"] == chunks["needed"]
            if complete or time.monotonic() >= deadline:
                return frame

    def _final(
        self, path: str, asked: dict[str, str], progress: Callable[[Facts], object] | None
    ) -> Frame:
        """The frame once it is final; what was final and is no more, such as after damage, is
        waited for again.
        """
        while (frame := self._frame(path, asked)).facts.provisional:
            self._listen(path, asked, progress or (lambda _: None))
        if progress is not None:
            progress(frame.facts)
        return frame

    def _listen(
        self, path: str, asked: Mapping[str, str], progress: Callable[[Facts], object]
    ) -> None:
        """Returns when the view is final. Raises NotFinalError where it does not become so."""
        seen = {name: text for name, text in asked.items() if name not in PICTURE_PARAMETERS}
        for event in self._events(path, seen):
            if event.kind == "failed":
                raise NotFinalError(event.data["detail"], problem=event.data)
            if event.facts is not None:
                progress(event.facts)

    def _events(self, path: str, asked: Mapping[str, str]) -> Iterator[Event]:
        """The events of a view to the last one, over as many connections as that takes."""
        last = ""
        heard = time.monotonic()
        while True:
            for event in self._connection(f"{path}/events", asked, last):
                last = event.id or last
                heard = time.monotonic()
                yield event
                if event.kind in ("final", "failed"):
                    return
            if time.monotonic() - heard > self._patience:
                raise UnreachableError("The server ends its events too early, again and again.")
            time.sleep(FIRST_RETRY_PAUSE)

    def _connection(self, path: str, asked: Mapping[str, str], last: str) -> Iterator[Event]:
        """The events of one connection, to its end or until it breaks; those after the ``last``
        alone, if any.
        """
        headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": last} if last else {})
        with (
            translated(),
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
                return

    def _frame(self, path: str, asked: Mapping[str, str]) -> Frame:
        answer = self._ask("GET", f"{path}/frame", params=asked)
        return Frame(
            answer.content,
            FORMAT_OF_MEDIA_TYPE[answer.headers["content-type"]],
            Facts.of_headers(answer.headers),
        )

    def _json(self, method: str, path: str, **more: Any) -> Any:
        return document_of(self._ask(method, path, **more))

    def _ask(self, method: str, path: str, **more: Any) -> httpx.Response:
        """The server's answer. Raises IsogiError for one that is none of success."""
        with translated():
            answer = self._client.request(method, path, **more)
        if not answer.is_success:
            raise error_of(answer)
        return answer

    def _check_server(self, request: httpx.Request) -> None:
        """Raise RefusedError for a request to another server, which would be shown the token."""
        base = self._client.base_url
        if origin_of(request.url) != origin_of(base):
            raise RefusedError(
                f"{request.url} is no address of the server at {base}: make an Isogi of that "
                "server."
            )

    def _ask_again(self, request: httpx.Request) -> None:
        request.extensions["retry"] = self._retry

    def _meet(self, _: httpx.Response) -> None:
        """The server has answered: from now on it is away for a while where it does not."""
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
    """An array (z, y, x) as an NRRD file. ValueError where it is no volume, or the ``spacing`` is
    none.
    """
    if array.ndim != 3 or array.dtype.kind not in "biuf":
        raise ValueError(
            f"A volume is an array of numbers (z, y, x), not one of {array.dtype} {array.shape}."
        )
    if len(spacing) != 3 or not all(np.isfinite(step) and step > 0 for step in spacing):
        raise ValueError(f"spacing is three distances above 0, along x, y and z, not {spacing!r}.")
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
    """The bytes of a file, block by block, as often as they are asked for: a request may be sent
    again.
    """

    path: Path

    def __iter__(self) -> Iterator[bytes]:
        with self.path.open("rb") as file:
            while block := file.read(UPLOAD_BLOCK_BYTES):
                yield block


def scene_path(scene: str) -> str:
    """Where a scene is asked for."""
    return f"/v1/scenes/{quote(scene, safe='')}"


def query(view: Mapping[str, Values]) -> dict[str, str]:
    """The parameters of a view as text; rows such as eye=(1, 2, 3) with commas, None left out."""
    return {name: text_of(value) for name, value in view.items() if value is not None}


def text_of(value: float | str | Sequence[float]) -> str:
    """A value as the server reads it."""
    if isinstance(value, str):
        return value
    row = np.atleast_1d(value).tolist()
    return ",".join(repr(number) for number in row)


def srgb_of(linear: np.ndarray) -> np.ndarray:
    """Linear radiance as sRGB bytes (IEC 61966-2-1)."""
    share = np.clip(linear, 0.0, 1.0)
    curve = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1.0 / 2.4) - 0.055)
    return np.asarray(255.0 * curve + 0.5, np.uint8)


def tell_target(facts: Facts, target: str | None) -> None:
    """Warn of a final frame whose error is above what was asked for."""
    if target is not None and not facts.provisional and facts.error > float(target):
        warnings.warn(
            f"The frame is final, but its total error is {facts.error:.3g} and not {target}: "
            "pixels have taken"
            " the most paths that they may.",
            TargetWarning,
            stacklevel=3,
        )


def origin_of(url: httpx.URL) -> tuple[str, str, int | None]:
    """Scheme, host and port of a server's address; the port is None for the scheme's."""
    return url.scheme, url.host, url.port


def document_of(answer: httpx.Response) -> Any:
    """The JSON document in an answer. Raises ServerError if there is none."""
    return read_json(answer.text)


def read_json(text: str) -> Any:
    """The JSON document in a text from the server. Raises ServerError if there is none, or one so
    deep that Python cannot read it.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ServerError(
            "The answer is no JSON document that can be read: is this an isogi?"
        ) from error


def error_of(answer: httpx.Response) -> IsogiError:
    """What an answer that is none of success says."""
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
    """The class of error that a status is."""
    known: dict[int, type[IsogiError]] = {401: TokenError, 403: TokenError, 404: NotFoundError}
    known |= {429: BusyError, 503: BusyError}
    return known.get(status) or (RefusedError if status < 500 else ServerError)


@contextmanager
def translated() -> Iterator[None]:
    """Around a request: no answer is an IsogiError too."""
    try:
        yield
    except httpx.HTTPError as error:
        raise UnreachableError(
            f"No answer from the server: {error}. Does it run, and at this address?"
        ) from error
