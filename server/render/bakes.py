"""Bakes of a scene as the workers know them, bakes of other texels and sides, background bakes, and
patience.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import math
import threading
import time
import weakref
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from fastapi import Request
from starlette.requests import HTTPConnection

from isogi_core.bake.bake_spec import SPECS
from isogi_core.cache.costs import Costs
from isogi_core.cache.fresh_light import fresh_light
from isogi_core.cache.scene_assets import SceneAssets, send_assets
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.upkeep import trim_projected
from isogi_core.errors import Cancelled, IsogiError, StoreFullError, StoreReadOnlyError
from isogi_core.frame.texel_reading import Stage
from isogi_core.model.view import View
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.store import Store
from server.bearers import bearer_of, client_of
from worker.bake_requests import Viewer
from worker.baker import Bake, Baker
from worker.errors import WorkersError
from worker.progress import TimeLeft
from worker.tasks import Assets, Whole


def bake_name(scene: str, spec: str) -> str:
    """The name of a scene's bake by a spec, among all bakes; the scene's own name for the scene's
    own spec.
    """
    if spec == "gi":
        return scene
    return f"{scene} ({spec})"


Lend = Callable[[PreparedScene], Assets | None]
"""Gives what workers open in place of a scene's files; None if they read these."""


def lend_nothing(prepared: PreparedScene) -> None:
    """Have workers read the scene's files."""


def lend_by_store(store: Store) -> Lend:
    """Have joined workers read copies of the scene's files in the ``store``, unless it takes
    nothing.
    """

    def sent(prepared: PreparedScene) -> SceneAssets | None:
        with suppress(StoreReadOnlyError, StoreFullError):
            return send_assets(prepared.scene, store)
        return None

    return sent


Arrived = Callable[[str, Index, Isovalue | None], None]


def make_bake(
    caches: Caches,
    name: str,
    assets: Assets | None,
    arrived: Arrived,
    shown: Isovalue | None = None,
    whole: Whole | None = None,
) -> Bake:
    """The bake of a spec, by its name; workers open the ``assets`` in place of the scene's files.

    Of texels projected onto an isosurface where one is ``shown``, and of a scene that may be cut
    from a ``whole``. Nothing of the ``caches`` is kept: ``arrived`` is called with the spec's name,
    a chunk that has new light, and the isosurface.
    """
    spec = replace(caches.spec(name), shown=shown)
    store = caches.store
    scene = spec.prepared.scene
    plan = replace(spec.plan, left_out=(), notes=())
    layers = frozenset(scene.layer_digest(layer, shown) for layer in plan.layers)
    costs = Costs(store, spec.digest)
    costs.read()

    def note(index: Index) -> None:
        arrived(name, index, shown)

    light = fresh_light(store, spec.digest)
    how = (assets, shown, whole, light)
    return Bake(scene.source, plan, spec.digest, layers, store.url, note, costs, *how)


BACKGROUND_VIEWER = Viewer("background", patient=True)
"""Background bakes yield to people who wait for a frame."""


class BackgroundBake:
    """Light that is baked while no frame waits: what a ``stage`` demands of one ``bake``, by its
    name.
    """

    def __init__(
        self, baker: Baker, bake: str, stage: Stage, viewer: Viewer = BACKGROUND_VIEWER
    ) -> None:
        """Request it from the ``baker``, for a ``viewer``; ``coming`` are the chunks that were not
        given up before.
        """
        self._baker = baker
        self._viewer = viewer
        self.bake = bake
        self.chunks = [demand.index for demand in stage.demands]
        self.coming = baker.request(bake, stage.demands, stage.target, viewer, stage.enough)

    def waiting(self) -> int:
        """How many of its ``chunks`` are neither baked nor given up. Asked now and then, it stays
        wanted.
        """
        return self._baker.open(self.bake, self.chunks, self._viewer)

    def failures(self) -> dict[Index, str]:
        """Why those of its chunks that were given up were."""
        return self._baker.failures(self.bake, self.chunks)

    def wait(self, seconds: float) -> None:
        """Block until all of it is baked or given up, at most ``seconds``."""
        self._baker.wait(self.bake, self.chunks, seconds)

    def time_left(self) -> TimeLeft | None:
        """Seconds until all of it is baked; None where that is unknown."""
        return self._baker.time_left(self.bake, self._viewer, self.chunks)


MAX_BAKES = 32
"""Bakes of projected or finer texels, and of sides, of all scenes, that may be at work: those asked
for last.
"""


class SideBakes:
    """The bakes of projected or finer texels, and of surfaces' sides, that a ``baker`` knows. Safe
    to use from many threads.
    """

    def __init__(self, baker: Baker, store: Store, most: int) -> None:
        """None yet. When one is added, a thread trims the ``store`` to ``most`` bytes of projected
        texels.
        """
        self._baker = baker
        self._store = store
        self._most = most
        self._names: OrderedDict[str, str] = OrderedDict()
        self._readers = weakref.WeakValueDictionary[str, Caches]()
        self._lit: set[tuple[str, float]] = set()
        self._lock = threading.Lock()
        self._trimmer: threading.Thread | None = None

    def name(
        self, scene: str, shown: Isovalue | None, fineness: int, make: Callable[[], Bake]
    ) -> str:
        """The name of a bake of a scene's texels, made where it is new.

        They are finer than its own by ``fineness`` steps, and projected onto the isosurface
        ``shown``, where one is.
        """
        return self._named(
            f"{scene} (texels finer by {fineness}, projected at {shown!r})", scene, shown, make
        )

    def side(self, scene: str, spec: str, stage: Stage, lend: Lend) -> str:
        """The name of the bake of a ``stage``, by a ``spec``, of one of the sides of a scene's
        surfaces; made where it is new. Workers open what ``lend`` gives. The caches that asked last
        are told of its light: those before them may have been let go.
        """
        if stage.caches is None:
            raise ValueError("A stage of the scene's own light has a bake already.")
        caches = stage.caches
        name = f"{scene} (light {caches.spec(spec).digest}, projected at {stage.shown!r})"
        self._readers[name] = caches

        def arrived(spec: str, index: Index, shown: Isovalue | None) -> None:
            if (held := self._readers.get(name)) is not None:
                held.refresh(spec, index, shown)

        def make() -> Bake:
            return make_bake(caches, spec, lend(caches.prepared), arrived, stage.shown)

        return self._named(name, bake_name(scene, spec), stage.shown, make)

    def _named(self, name: str, own: str, shown: Isovalue | None, make: Callable[[], Bake]) -> str:
        """Add the bake of this ``name`` where it is new; views read the bake ``own`` besides."""
        with self._lock:
            new = name not in self._names
            if new:
                self._baker.add(name, make())
            self._names[name] = own
            self._names.move_to_end(name)
            old = [self._names.popitem(last=False)[0] for _ in range(len(self._names) - MAX_BAKES)]
        for each in old:
            self._baker.forget(each)
        if new and shown is not None:
            self._trim()
        return name

    def lit(self, scene: str, isovalue: float) -> None:
        """Note that the walls of a scene have light for an isovalue."""
        if (scene, isovalue) not in self._lit:
            self._lit.add((scene, isovalue))
            self._trim()

    def _trim(self) -> None:
        """Have a thread trim the store, unless one does: there is light for one isovalue more."""
        with self._lock:
            if self._trimmer is None or not self._trimmer.is_alive():
                trimmed = self._store, self._most
                self._trimmer = threading.Thread(
                    target=trim_projected, args=trimmed, name="trimming", daemon=True
                )
                self._trimmer.start()

    def settle(self) -> None:
        """Returns when nothing is being trimmed."""
        if self._trimmer is not None:
            self._trimmer.join()

    def scene(self, bake: str) -> str:
        """The name of the bake that views read besides one of projected or finer texels; any other
        is its own.
        """
        return self._names.get(bake, bake)

    def forget(self, scene: str) -> None:
        """Bake no more projected or finer texels of a scene."""
        with self._lock:
            every = {bake_name(scene, spec) for spec in SPECS}
            gone = [name for name, own in self._names.items() if own in every]
            for name in gone:
                del self._names[name]
        for name in gone:
            self._baker.forget(name)


STALLED_SECONDS = 120.0
"""Seconds without anything new after which the workers are taken for broken."""


class Patience:
    """How long to wait for light: so many ``seconds`` without anything new, while workers can
    bake.
    """

    def __init__(
        self, seconds: float = STALLED_SECONDS, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin now."""
        self._seconds = seconds
        self._clock = clock
        self._since = clock()
        self._seen = None

    def check(self, progress: Any, preparing: str, reasons: Iterable[str]) -> None:
        """Go on where ``progress`` is another value than before, or workers are ``preparing``: they
        start or compile.

        Raises WorkersError, with the ``reasons`` that are known, once the patience has ended.
        """
        now = self._clock()
        if preparing or progress != self._seen:
            self._since = now
            self._seen = progress
        elif now - self._since > self._seconds:
            why = " ".join(reasons) or "The workers bake nothing new."
            raise WorkersError(f"No light came for {self._seconds:g} seconds. {why}")


@contextmanager
def time_limit(end: float) -> Iterator[threading.Event]:
    """An event for the block that is set once the monotonic clock is at the ``end``: it cancels a
    step that would take longer, between two of its tiles.
    """
    over = threading.Event()
    if math.isinf(end):
        yield over
        return
    timer = threading.Timer(max(end - time.monotonic(), 0.0), over.set)
    timer.daemon = True
    timer.start()
    try:
        yield over
    finally:
        timer.cancel()


@dataclass(eq=False)
class Pending:
    """``chunks`` of a ``bake`` that are waited for: ``some`` is set with the first update, ``all``
    with the last.

    The last update of a chunk says that no more of it is going to be baked: it is final or given
    up. ``lit`` is set with ``all``, and once each of those that were ``dark`` has had an update.
    """

    bake: str
    chunks: set[Index]
    dark: set[Index] = field(default_factory=set)
    some: asyncio.Event = field(default_factory=asyncio.Event)
    lit: asyncio.Event = field(default_factory=asyncio.Event)
    all: asyncio.Event = field(default_factory=asyncio.Event)

    def note(self, index: Index, more: bool) -> None:
        """Note an update of a chunk, and whether there will be more."""
        if index in self.chunks:
            self.some.set()
            if not more:
                self.chunks.discard(index)
        if index in self.dark:
            self.dark.discard(index)
            if not self.dark:
                self.lit.set()
        if not self.chunks:
            self.lit.set()
            self.all.set()


class UpdateBus:
    """The updates so far, numbered. All but ``publish`` belongs to the event loop that made it."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._count = 0
        self._last: dict[tuple[str, Index], tuple[int, bool]] = {}
        self._newest: dict[str, int] = {}
        self._pending: set[Pending] = set()

    def publish(self, bake: str, index: Index, more: bool) -> None:
        """Say that a chunk of a bake has new light, or its task failed, and whether ``more`` is
        coming. Any thread.
        """
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._note, bake, index, more)

    def newest(self, bake: str) -> int:
        """The number of the newest update of a bake; 0 where there was none."""
        return self._newest.get(bake, 0)

    @contextmanager
    def pending(
        self, bake: str, chunks: Collection[Index], since: int, dark: Collection[Index] = ()
    ) -> Iterator[Pending]:
        """Watch ``chunks`` of a bake, some of which are ``dark``, from the update after number
        ``since`` on.
        """
        pending = Pending(bake, set(chunks), set(dark))
        for index in chunks:
            number, more = self._last.get((bake, index), (0, True))
            if number > since:
                pending.note(index, more)
        self._pending.add(pending)
        try:
            yield pending
        finally:
            self._pending.discard(pending)

    def _note(self, bake: str, index: Index, more: bool) -> None:
        self._count += 1
        self._newest[bake] = self._count
        self._last[bake, index] = self._count, more
        for pending in self._pending:
            if pending.bake == bake:
                pending.note(index, more)


Result = TypeVar("Result")

_visits = itertools.count(1)


def request_viewer(request: Request) -> Viewer:
    """The viewer of one request: all requests of a bearer at an address are one client's."""
    bakes = bearer_of(request.scope).may("bake")
    return Viewer(client_of(request.scope), next(_visits), bakes=bakes)


def stream_viewer(connection: HTTPConnection) -> Viewer:
    """The viewer of a stream: a client of its own, which looks at one view at a time."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True, bakes=bearer_of(connection.scope).may("bake"))


def background_viewer() -> Viewer:
    """The viewer of work in the background: a client of its own, which yields to all others."""
    visit = next(_visits)
    return Viewer(visit, visit, single=True, patient=True)


async def attended(request: Request, answer: Coroutine[Any, Any, Result]) -> Result:
    """The answer to a request. Once its client has left, the answer is cancelled and Cancelled
    raised.
    """
    return await until(answer, gone(request))


async def until(work: Awaitable[Result], end: Awaitable[object]) -> Result:
    """What some work comes to, or raises; where the ``end`` comes first, it is cancelled and
    Cancelled raised.
    """
    working = asyncio.ensure_future(work)
    ending = asyncio.ensure_future(end)
    try:
        await asyncio.wait({working, ending}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise Cancelled("Nobody waits for this any more.")
        return await working
    finally:
        working.cancel()
        ending.cancel()
        del working, ending  # an error in them would hold itself until garbage is looked for


async def gone(request: Request) -> None:
    """Returns when the client has disconnected."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


log = logging.getLogger("isogi.render")

CHECK: Index = (-1, -1, -1)
"""Stands for a picture's check among the chunks that are coming for it."""

MAX_WAITING_PICTURES = 64
"""Pictures that wait to be checked: those asked for last."""


@dataclass(frozen=True)
class Picture:
    """A view of a scene whose total error is to reach a ``target``; nobody wants it once it is
    ``cancelled``.
    """

    scene: str
    view: View
    target: float
    cancelled: threading.Event = field(default_factory=threading.Event, compare=False)


Step = Callable[[str, View, float, threading.Event], bool]
Listener = Callable[[str, View, bool], object]


class PictureChecks:
    """Checks pictures step by step, the one asked for last first. Safe to use from many threads."""

    def __init__(self, step: Step, notify: Listener) -> None:
        """Take each ``step`` that there is; ``notify`` hears of it, and whether ``more`` are to
        come.
        """
        self._step = step
        self._notify = notify
        self._wanted: OrderedDict[Viewer, Picture] = OrderedDict()
        self._changed = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None

    def request(self, scene: str, view: View, target: float, viewer: Viewer) -> None:
        """Have a picture checked for a ``viewer``, in place of the one that it looked at before."""
        with self._changed:
            picture = Picture(scene, view, target)
            if self._closed or self._wanted.get(viewer) == picture:
                return
            self._drop(viewer)
            self._wanted[viewer] = picture
            if len(self._wanted) > MAX_WAITING_PICTURES:
                self._drop(next(iter(self._wanted)))
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="checking", daemon=True)
                self._thread.start()
            self._changed.notify()

    def leave(self, viewer: Viewer) -> None:
        """Check nothing more for a viewer that has gone, or looks at something else."""
        with self._changed:
            self._drop(viewer)

    def close(self) -> None:
        """Stop, and wait until it has."""
        with self._changed:
            self._closed = True
            for viewer in list(self._wanted):
                self._drop(viewer)
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _drop(self, viewer: Viewer) -> None:
        if (former := self._wanted.pop(viewer, None)) is not None:
            former.cancelled.set()

    def _work(self) -> None:
        """Check what is wanted, until closed."""
        while (found := self._next()) is not None:
            viewer, picture = found
            try:
                more = self._step(picture.scene, picture.view, picture.target, picture.cancelled)
            except IsogiError as error:
                log.debug("a picture is not checked: %s", error)
                more = False
            except Exception:
                log.exception(
                    "The check of a picture failed: it keeps the error that it has, others are "
                    "checked."
                )
                more = False
            if not more:
                self._done(viewer, picture)
            self._notify(picture.scene, picture.view, more)

    def _next(self) -> tuple[Viewer, Picture] | None:
        """The newest picture that is wanted, once there is one; None when closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._wanted or self._closed)
            if self._closed:
                return None
            return next(reversed(self._wanted.items()))

    def _done(self, viewer: Viewer, picture: Picture) -> None:
        with self._changed:
            if self._wanted.get(viewer) is picture:
                self._drop(viewer)
