"""The service around an engine that does as the test says: starting, failing, full, deserted."""

import asyncio
import re
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import aclosing, asynccontextmanager
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from isogi_core.bake.noise import Goal
from isogi_core.errors import Cancelled, NoRoomError, StoreError
from isogi_core.frame.frame import Frame, Quality
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Stopwatch
from isogi_core.kernels._compilation import KernelProgress
from isogi_core.kernels.shading.framebuffer import CONVERGING, PROVISIONAL
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.store import Store
from isogi_server.api import service as service_module
from isogi_server.api.app import create_app
from isogi_server.api.lifespan import Startup
from isogi_server.api.routes import frames as frames_module
from isogi_server.api.routes.events import event_of
from isogi_server.api.routes.frames import InTurn
from isogi_server.api.routes.scenes import scene_facts
from isogi_server.api.service import Service
from isogi_server.errors import BusyError
from isogi_server.parameters import ViewParams
from isogi_server.pictures import npy_bytes
from isogi_server.render.picture_checks import CHECK
from isogi_server.render.scene_variant import SceneVariant
from isogi_server.render.scheduling import Rank, Renders
from isogi_server.render.update_bus import UpdateBus
from isogi_server.settings import Patience, Settings
from isogi_server.views import view_of
from isogi_worker.bake_requests import Viewer
from isogi_worker.baker import Listener
from isogi_worker.progress import TimeLeft
from tests.server.sockets import wait_for

FRAME = "/v1/scenes/orbital/frame"


class FakeKernels:
    """Kernels that are there once ``compiled`` is set, as it is unless the test says otherwise."""

    def __init__(self) -> None:
        self.compiled = threading.Event()
        self.compiled.set()

    @property
    def progress(self) -> KernelProgress | None:
        if self.compiled.is_set():
            return None
        return KernelProgress(7, 24, 40.0)

    @property
    def compiling(self) -> str:
        if self.compiled.is_set():
            return ""
        return "Compiling, once on this machine: 7 of 24, about 40 s left."

    def others(self) -> None:
        assert self.compiled.wait(10)


class FakeEngine:
    """An engine whose frames are grey squares; ``doing`` is called in the middle of each."""

    store = Store("memory://fake")

    def __init__(self, scene: Scene, doing: Callable[[threading.Event], None]) -> None:
        self.scenes = {scene.id: scene}
        self.doing = doing
        self.views: list[tuple[View, Goal]] = []
        self.wants: list[Viewer] = []
        self.left: list[Viewer] = []
        self.coming: frozenset[Index] = frozenset()
        self.version = "v1"
        self.state = PROVISIONAL
        self.took: dict[str, float] = {}
        self.publish: Listener = lambda *_: None
        self.startable: Exception | None = None
        self.stopped = False
        self.closed = False
        self.kernels = FakeKernels()

    def open(self) -> None:
        if self.startable:
            raise self.startable

    @property
    def own_scenes(self) -> list[Scene]:
        return list(self.scenes.values())

    def variant(self, scene: str) -> SceneVariant:
        return SceneVariant(scene)

    def planned(self, scene: str) -> Scene:
        return self.scenes[scene]

    def light(self) -> None:
        assert self.kernels.compiled.wait(10)

    def stop(self) -> None:
        self.stopped = True

    def close(self) -> None:
        assert self.stopped
        self.closed = True

    def notes(self) -> list[str]:
        if self.kernels.compiling:
            return [self.kernels.compiling]
        return []

    def unready(self) -> list[str]:
        return ["No worker is alive."]

    def unlit_frame(
        self, scene: str, view: View, goal: Goal, cancelled: threading.Event
    ) -> Frame | None:
        return None

    def survey(
        self, scene: str, view: View, goal: Goal, cancelled: threading.Event, watch: Stopwatch
    ) -> Frame:
        self.views.append((view, goal))
        self.doing(cancelled)
        return self.picture(view, watch)

    def picture(self, view: View, watch: Stopwatch) -> Frame:
        watch.seconds |= self.took
        shape = (view.height, view.width)
        colour = np.full((*shape, 3), 0.5, np.float32)
        ones = np.ones(shape, np.float32)
        pixels = np.arange(ones.size, dtype=np.uint32)
        surface = GBuffer(
            shape, (1.0, 1.0, 1.0), (9.0, 0.0, 0.0), 0.5, pixels, colour.reshape(-1, 3)
        )
        state = np.full(shape, self.state, np.uint8)
        quality = Quality(chunks=(3, 1))
        return Frame(view, colour, state, ones, surface, self.version, watch.seconds, quality)

    def grow(self, _: threading.Event) -> None:
        """Done in a picture, so that each has a version of its own."""
        self.version = f"v{len(self.views)}"

    def want(self, scene: str, frame: Frame, goal: Goal, viewer: Viewer) -> frozenset[Index]:
        self.wants.append(viewer)
        return self.coming

    def leave(self, viewer: Viewer) -> None:
        self.left.append(viewer)

    def listen(self, listener: Listener) -> None:
        self.publish = listener

    def bake_of(self, scene: str, view: View) -> str:
        return scene

    def time_left(self, scene: str, frame: Frame, goal: Goal) -> TimeLeft:
        return TimeLeft(1.0, 2.0, 3.25)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("demo:orbital", lights=[{"type": "constant"}], rotating=False)


@pytest.fixture
def engine(scene: Scene) -> FakeEngine:
    return FakeEngine(scene, lambda _: None)


@pytest.fixture
def settings() -> Settings:
    return Settings(render_threads=2).with_patience(Patience(render_queue=6))


@pytest.fixture
def app(engine: FakeEngine, settings: Settings) -> Iterator[FastAPI]:
    app = create_app(engine, settings)  # type: ignore[arg-type]
    yield app
    app.state.service.threads.close()


@asynccontextmanager
async def asking(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    """A client, once the engine has started."""
    await app.state.service.start()
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        yield client


async def started(app: FastAPI, *queries: dict[str, Any]) -> list[httpx.Response]:
    """Answers to frame requests sent at the same time."""
    async with asking(app) as client:
        answers = await asyncio.gather(
            *(client.get(FRAME, params={"width": 4, **q}) for q in queries)
        )
    app.state.service.engine.kernels.compiled.set()  # or the loop waits at its end for who compiles
    return answers


def test_until_the_engine_is_up_frames_are_503_and_scenes_listed(
    ask: Callable[..., httpx.Response], app: FastAPI
) -> None:
    answer = ask(app, "GET", FRAME)
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "1"
    assert "is starting" in answer.json()["detail"]
    assert ask(app, "GET", "/readyz").json()["reasons"] == [answer.json()["detail"]]
    assert ask(app, "GET", "/livez").status_code == 200
    assert ask(app, "GET", "/v1/scenes").json()["scenes"][0]["id"] == "orbital"


async def test_a_engine_that_does_not_start_is_told_and_never_asked(
    engine: FakeEngine, app: FastAPI
) -> None:
    engine.startable = StoreError("The store is full.")
    (answer,) = await started(app, {})
    assert answer.status_code == 503
    assert answer.json()["detail"] == "isogi did not start: The store is full."
    assert not engine.views


def test_what_the_engine_misses_is_told(ask: Callable[..., httpx.Response], app: FastAPI) -> None:
    asyncio.run(app.state.service.start())
    answer = ask(app, "GET", "/bakez")
    assert (answer.status_code, answer.json()["detail"]) == (503, "No worker is alive.")
    serves = ask(app, "GET", "/readyz")
    assert (serves.status_code, serves.json()["reasons"]) == (200, ["No worker is alive."])


async def test_a_frame_reaches_the_engine_as_a_view(engine: FakeEngine, app: FastAPI) -> None:
    (answer,) = await started(
        app, {"height": 3, "isovalue": 0.3, "wait_ms": 250, "max_error": 0.1, "f": "npy"}
    )
    assert answer.status_code == 200, answer.text
    view, goal = engine.views[0]
    assert (view.width, view.height, view.isovalue, goal) == (4, 3, 0.3, Goal.checked(0.1))
    assert answer.headers["isogi-provisional"] == "?1"
    assert answer.headers["isogi-chunks"] == "needed=3, final=1"
    assert answer.headers["isogi-coverage"] == "final=0.000, converging=0.000, provisional=1.000"
    assert answer.headers["isogi-time-left"] == "low=1.0, likely=2.0, high=3.2"
    assert answer.headers["server-timing"].startswith("queue;dur=")
    assert answer.headers["cache-control"] == "no-cache"


async def test_each_overlay_is_a_picture_of_its_own(app: FastAPI) -> None:
    plain, *marked = answers = await started(
        app, {}, {"overlay": "provisional"}, {"overlay": "error"}
    )
    assert all(answer.content != plain.content for answer in marked)
    assert len({answer.headers["etag"] for answer in answers}) == 3


@pytest.mark.parametrize(
    "query",
    [
        {"isovalue": "nan"},
        {"width": 0},
        {"colour": 1},
        {"yaw": 5},
        {"light": "0,1,0,0"},
        {"up": "0,0,0"},
    ],
)
async def test_a_refused_view_never_reaches_the_engine(
    engine: FakeEngine, app: FastAPI, query: dict[str, Any]
) -> None:
    (answer,) = await started(app, query)
    assert answer.status_code == 422, answer.text
    assert not engine.views


async def test_a_light_that_does_not_turn_may_be_told_so(engine: FakeEngine, app: FastAPI) -> None:
    (answer,) = await started(app, {"yaw": 0, "pitch": 0, "roll": 360})
    assert answer.status_code == 200, answer.text
    assert engine.views[0][0].light == (1, 0, 0, 0)


async def test_errors_at_work_are_problems(engine: FakeEngine, app: FastAPI) -> None:
    def fail(_: threading.Event) -> None:
        raise StoreError("The store does not answer.")

    engine.doing = fail
    (answer,) = await started(app, {})
    assert (answer.status_code, answer.json()["detail"]) == (503, "The store does not answer.")


async def test_beyond_the_queue_is_429_and_the_rest_is_served(
    engine: FakeEngine, app: FastAPI
) -> None:
    release = threading.Event()
    engine.doing = lambda _: None if release.wait(10) else pytest.fail("nobody was refused")
    answers = await crowd(app, 14, release)
    assert [answer.status_code for answer in answers] == [429] * 6 + [200] * 8
    assert answers[0].headers["retry-after"] == "1"


async def crowd(app: FastAPI, clients: int, release: threading.Event) -> list[httpx.Response]:
    """Answers to so many clients at once, in the order they came; frames are held until the 6th."""
    async with asking(app) as client:
        answers: list[httpx.Response] = []
        for answer in asyncio.as_completed(
            [client.get(FRAME, params={"width": 4}) for _ in range(clients)]
        ):
            answers.append(await answer)
            if len(answers) == 6:
                release.set()
        return answers


async def test_path_traced_pictures_keep_no_others_from_their_turn(
    engine: FakeEngine, app: FastAPI
) -> None:
    release = threading.Event()

    def work(_: threading.Event) -> None:
        if engine.views[-1][0].shading == "path_traced":
            assert release.wait(30), "the frames of others waited"

    engine.doing = work
    async with asking(app) as client:
        size = {"width": 4, "shading": "path_traced", "samples": 1}
        long = [
            asyncio.create_task(client.get(FRAME, params={**size, "azimuth": turn}))
            for turn in range(3)
        ]
        while not engine.views:
            await asyncio.sleep(0.01)
        async with asyncio.timeout(10):
            answer = await client.get(FRAME, params={"width": 4, "shading": "lambert"})
        release.set()
        statuses = [(await each).status_code for each in long]
    assert (answer.status_code, statuses) == (200, [200] * 3)


def test_a_client_that_leaves_stops_its_frame(engine: FakeEngine, app: FastAPI) -> None:
    begun = threading.Event()
    seen = threading.Event()

    def work(cancelled: threading.Event) -> None:
        begun.set()
        if cancelled.wait(10):
            seen.set()
            raise Cancelled("Nobody waits.")

    engine.doing = work
    asyncio.run(leave(app, begun))
    assert seen.wait(10)
    assert engine.wants == []
    assert wait_for(lambda: len(engine.left) == 1)


def test_a_client_that_leaves_has_no_light_baked_any_more(engine: FakeEngine, app: FastAPI) -> None:
    engine.coming = frozenset({(0, 0, 1)})
    begun = threading.Event()
    engine.doing = lambda _: begun.set()
    asyncio.run(leave(app, begun, wait_ms=10_000))
    assert engine.left == engine.wants
    assert len(engine.wants) == 1


async def test_requests_for_the_same_at_the_same_time_share_one_render(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    renders = app.state.service.threads.pictures
    share = renders.share
    asked = [0]
    together = threading.Event()

    async def counted(*given: Any) -> Any:
        asked[0] += 1
        return await share(*given)

    def work(_: threading.Event) -> None:
        """Takes until all have asked."""
        if not together.is_set() and wait_for(lambda: asked[0] == 4):
            together.set()

    monkeypatch.setattr(renders, "share", counted)
    engine.doing = work
    answers = await started(app, {}, {"f": "jpeg"}, {"azimuth": 7}, {})
    assert [answer.status_code for answer in answers] == [200] * 4
    assert len(engine.views) == 2
    assert len(engine.wants) == 4
    assert answers[0].content == answers[3].content


def test_leaving_a_shared_render_does_not_end_it_for_others(
    engine: FakeEngine, app: FastAPI
) -> None:
    begun = threading.Event()
    release = threading.Event()

    def work(cancelled: threading.Event) -> None:
        begun.set()
        release.wait(10)
        if cancelled.is_set():
            raise Cancelled("Nobody waits.")

    async def both() -> httpx.Response:
        async with asking(app) as client:
            staying = asyncio.create_task(client.get(FRAME, params={"width": 4}))
            await leave(app, begun)
            release.set()
            return await staying

    engine.doing = work
    assert asyncio.run(both()).status_code == 200
    assert len(engine.views) == 1
    assert len(engine.left) == 1


@pytest.mark.slow
async def test_a_frame_is_drawn_again_once_all_its_light_is_there(
    engine: FakeEngine, app: FastAPI
) -> None:
    engine.coming = frozenset({(0, 0, 1), (0, 0, 2)})

    def bake(_: threading.Event) -> None:
        if len(engine.views) == 1:
            engine.publish("orbital", (0, 0, 1), False)
            engine.publish("orbital", (0, 0, 9), False)
            threading.Timer(0.2, finish).start()

    def finish() -> None:
        engine.coming = frozenset()
        engine.version = "v2"
        engine.publish("orbital", (0, 0, 2), False)

    engine.doing = bake
    (answer,) = await started(app, {"wait_ms": 10_000})
    assert answer.status_code == 200
    assert len(engine.views) == 2
    bake_ms = float(re.findall(r"bake;dur=([\d.]+)", answer.headers["server-timing"])[0])
    assert 100.0 < bake_ms < 5000.0


async def test_a_request_waits_for_light_and_for_no_check_beside_it(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture with a part of its light may be measured as it is: that may take longer."""
    light: Index = (0, 0, 1)
    awaited: list[frozenset[Index]] = []
    pending = UpdateBus.pending

    def watch(self: UpdateBus, bake: str, chunks: frozenset[Index], since: int) -> Any:
        awaited.append(chunks)
        for each in chunks:
            self.publish(bake, each, False)
        return pending(self, bake, chunks, since)

    monkeypatch.setattr(UpdateBus, "pending", watch)
    coming = iter([{light, CHECK}, {CHECK}, set[Index]()])
    monkeypatch.setattr(engine, "want", lambda *_: frozenset(next(coming)))
    (answer,) = await started(app, {"wait_ms": 10_000})
    assert answer.status_code == 200
    assert awaited == [{light}, {CHECK}], "the check alone is waited for once light is there"


async def test_pictures_are_drawn_while_asking_for_light_takes_long(
    engine: FakeEngine, app: FastAPI
) -> None:
    """The queue of bakes may be busy for as many requests as there are threads that render."""
    drawn = threading.Event()

    def want(scene: str, frame: Frame, goal: Goal, viewer: Viewer) -> frozenset[Index]:
        assert wait_for(drawn.is_set)
        return frozenset()

    def work(_: threading.Event) -> None:
        if len(engine.views) == 8:
            drawn.set()

    engine.want = want
    engine.doing = work  # type: ignore[method-assign]
    answers = await started(app, *({"azimuth": azimuth} for azimuth in range(8)))
    assert [answer.status_code for answer in answers] == [200] * 8


async def test_large_pictures_are_drawn_one_at_a_time(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each takes memory besides what is kept."""
    monkeypatch.setattr(service_module, "LARGE_PICTURE_PIXELS", 100)
    drawing = set[int]()
    most = [0]

    def work(_: threading.Event) -> None:
        drawing.add(threading.get_ident())
        most[0] = max(most[0], len(drawing))
        time.sleep(0.05)
        drawing.discard(threading.get_ident())

    engine.doing = work
    answers = await started(app, *({"azimuth": azimuth, "height": 64} for azimuth in range(4)))
    assert [answer.status_code for answer in answers] == [200] * 4
    assert len(engine.views) == 4 and most == [1]


async def test_a_large_picture_has_its_place_until_it_is_encoded(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame that waits to be encoded takes as much memory as one that is being drawn."""
    monkeypatch.setattr(service_module, "LARGE_PICTURE_PIXELS", 100)
    steps: list[str] = []

    def work(_: threading.Event) -> None:
        steps.append("drawn")
        time.sleep(0.02)

    def slowly(*arguments: Any) -> bytes:
        time.sleep(0.05)
        steps.append("encoded")
        return b"a picture"

    engine.doing = work
    monkeypatch.setattr(frames_module, "encode", slowly)
    answers = await started(app, *({"azimuth": azimuth, "height": 64} for azimuth in range(4)))
    assert [answer.status_code for answer in answers] == [200] * 4
    assert steps == ["drawn", "encoded"] * 4


async def test_large_arrays_are_sent_few_at_once(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that takes nothing keeps its picture in memory: it is cut short if others wait."""
    monkeypatch.setattr(service_module, "SENT_PIXELS", 100)
    monkeypatch.setattr(service_module, "SENT_PICTURES", 1)
    monkeypatch.setattr(frames_module, "SLOWEST_PART", 0.1)
    service = Service(engine, Settings())  # type: ignore[arg-type]
    frame = engine.picture(
        view_of(engine.own_scenes[0], ViewParams(width=16, height=16), Settings()),
        Stopwatch(),
    )
    (stalled, taken) = (InTurn(service, Viewer(name), frame, {}) for name in "ab")
    begun = asyncio.Event()
    sent: list[Any] = []

    async def stall(message: Any) -> None:
        begun.set()
        await asyncio.Event().wait()

    async def take(message: Any) -> None:
        sent.append(message)

    sending = asyncio.create_task(stalled.stream_response(stall))
    await asyncio.wait_for(begun.wait(), 10)
    await asyncio.sleep(0.3)
    assert not sending.done()
    await asyncio.wait_for(taken.stream_response(take), 10)
    assert sum(len(each.get("body", b"")) for each in sent) == npy_bytes(frame)
    await asyncio.wait_for(sending, 10)
    service.threads.close()


async def test_no_place_is_held_while_light_is_baked(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clients that listen to a large view wait for its light without a picture in memory."""
    monkeypatch.setattr(service_module, "LARGE_PICTURE_PIXELS", 4)
    engine.coming = frozenset({(0, 0, 1)})
    service = app.state.service
    async with watching(service, Viewer("a")) as refinements:
        waiting = asyncio.ensure_future(anext(refinements))
        await asyncio.sleep(0.1)
        rank = Rank.within(0.0, 5.0)
        place = await service.threads.enter(engine.views[0][0], rank)
        assert not waiting.done()
        place.leave()
        waiting.cancel()
        await asyncio.wait({waiting})


async def test_a_preview_tells_that_the_picture_is_coming(app: FastAPI) -> None:
    """While kernels are compiled, nothing is baked: clients must not take that for a failure."""
    service = app.state.service
    await service.start()
    service.startup.lit.clear()
    picture = service.picture_of(service.engine.scenes["orbital"], ViewParams(width=4, height=4))
    async with aclosing(service.refinements(picture, Viewer("a"))) as refinements:
        preview = await anext(refinements)
        assert not preview.frame.final and preview.coming
        assert event_of(service, preview, Viewer("a"))[0] == "refined"


async def leave(app: FastAPI, begun: threading.Event, wait_ms: int = 0) -> None:
    """Ask for a frame and disconnect once its work has begun; it has been left when the loop has
    ended.
    """
    await app.state.service.start()

    async def receive() -> dict[str, Any]:
        await asyncio.to_thread(begun.wait, 10)
        await asyncio.sleep(0.2)
        return {"type": "http.disconnect"}

    async def send(message: Any) -> None:
        pass

    query = f"width=4&wait_ms={wait_ms}".encode()
    scope = {
        **{
            "type": "http",
            "http_version": "1.1",
            "method": "GET",
            "path": FRAME,
            "raw_path": FRAME.encode(),
        },
        **{
            "query_string": query,
            "headers": [(b"host", b"localhost")],
            "scheme": "http",
            "root_path": "",
        },
        **{"server": ("localhost", 80), "client": ("localhost", 1)},
    }
    await app(scope, receive, send)  # type: ignore[arg-type]


@asynccontextmanager
async def watching(service: Service, viewer: Viewer) -> AsyncIterator[Any]:
    """What a viewer of a small picture is sent, after the first picture."""
    await service.start()
    picture = service.picture_of(service.engine.scenes["orbital"], ViewParams(width=4, height=4))
    async with aclosing(service.refinements(picture, viewer)) as refinements:
        await anext(refinements)
        yield refinements


async def second_after(engine: FakeEngine, service: Service, rest: float = 0.0) -> float:
    """Seconds from when the first picture of a view was looked at for ``rest`` seconds until a
    better one comes.

    A chunk has new light a tenth of a second after that.
    """
    clock = asyncio.get_running_loop().time
    async with watching(service, Viewer("a")) as refinements:
        await asyncio.sleep(rest)
        asyncio.get_running_loop().call_later(0.1, engine.publish, "orbital", (0, 0, 1), True)
        begun = clock()
        await anext(refinements)
        return clock() - begun


@pytest.mark.parametrize(("state", "at_once"), [(PROVISIONAL, True), (CONVERGING, False)])
async def test_first_light_is_shown_as_soon_as_it_comes(
    engine: FakeEngine, app: FastAPI, state: int, at_once: bool
) -> None:
    """A picture of a quarter of a second is drawn again after three; without any light in it, at
    once.
    """
    engine.coming = frozenset({(0, 0, 1), (0, 0, 2)})
    engine.doing = engine.grow
    engine.state = state
    engine.took = {"shade": 0.25, "primary": 60.0}  # the latter is kept
    took = await second_after(engine, app.state.service)
    assert took < 0.7 if at_once else 0.7 < took < 30.0


async def test_new_views_precede_requests_and_these_better_pictures(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Among the work of one client, a draft comes first of all; no work lets others pass for as
    long as a second.
    """
    waits: list[float] = []
    draw = Service.frame

    async def noted(service: Service, picture: Any, rank: Rank, watch: Stopwatch) -> Frame:
        waits.append(rank.due - asyncio.get_running_loop().time())
        return await draw(service, picture, rank, watch)

    monkeypatch.setattr(Service, "frame", noted)
    engine.coming = frozenset({(0, 0, 1), (0, 0, 2)})
    engine.doing = engine.grow
    await second_after(engine, app.state.service)
    rest, better = waits[:2]
    async with asking(app) as client:
        await client.get(FRAME, params={"width": 4})
    request = waits[-1]
    draft = app.state.service.draft_rank(Viewer("a")).due - asyncio.get_running_loop().time()
    assert draft < rest < request < better < 1.0


@pytest.mark.parametrize("younger", [0.0, 4.0])
async def test_pictures_of_a_view_that_has_long_been_shown_come_rarely(
    younger: float, engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A light takes as long to become visibly better as it has been baked for, times a share; not
    longer, though.
    """
    engine.coming = frozenset({(0, 0, 1), (0, 0, 2)})
    engine.doing = engine.grow
    engine.state = CONVERGING
    engine.took = {"shade": 1e-3}
    monkeypatch.setattr(service_module, "YOUNGER", younger)
    monkeypatch.setattr(service_module, "LONGEST_PAUSE", 0.9)
    took = await second_after(engine, app.state.service, rest=0.3)
    assert 0.9 <= took < 30.0 if younger else took < 0.7


async def test_light_of_a_new_view_is_requested_before_it_is_drawn(
    engine: FakeEngine, app: FastAPI, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For a viewer that may have light baked, and for no other; nor where others wait for their
    turn.
    """
    drawn = list[int]()

    async def first(viewer: Viewer) -> None:
        async with watching(app.state.service, viewer):
            pass

    engine.doing = lambda _: drawn.append(len(engine.wants))
    monkeypatch.setattr(
        engine, "unlit_frame", lambda _scene, view, *_: engine.picture(view, Stopwatch())
    )
    await first(Viewer("a"))
    assert drawn == [1] and engine.wants == [Viewer("a"), Viewer("a")]
    await first(Viewer("b", bakes=False))
    assert drawn == [1, 2] and len(engine.wants) == 2
    monkeypatch.setattr(Renders, "crowded", True)
    await first(Viewer("c"))
    assert drawn == [1, 2, 2] and engine.wants[2:] == [Viewer("c")]


async def test_the_lifespan_starts_and_closes_the_engine(engine: FakeEngine, app: FastAPI) -> None:
    async with app.router.lifespan_context(app):
        await asyncio.wait_for(app.state.service.startup.settled.wait(), 10)
        assert engine.closed is False
    assert engine.closed


async def test_while_kernels_are_compiled_pictures_have_no_light(
    engine: FakeEngine, app: FastAPI
) -> None:
    engine.kernels.compiled.clear()
    lit, plain = await started(app, {"f": "png"}, {"shading": "phong"})
    assert [answer.status_code for answer in (lit, plain)] == [200, 200]
    assert lit.headers["isogi-provisional"] == "?1"
    assert [(view.shading, view.smooth) for view, _ in engine.views] == [
        ("lambert", False),
        ("phong", False),
    ]


def test_while_kernels_are_compiled_the_server_says_how_far(
    ask: Callable[..., httpx.Response], engine: FakeEngine, app: FastAPI
) -> None:
    engine.kernels.compiled.clear()
    starting = ask(app, "GET", FRAME)
    assert starting.status_code == 503
    assert starting.json()["detail"] == "Compiling, once on this machine: 7 of 24, about 40 s left."
    assert ask(app, "GET", "/readyz").json()["reasons"] == [starting.json()["detail"]]


def test_a_store_is_not_read_only_while_kernels_are_compiled(
    engine: FakeEngine, app: FastAPI, scene: Scene
) -> None:
    engine.kernels.compiled.clear()
    facts = scene_facts(scene, scene, None, app.state.service)
    assert facts.plan.notes[-1] == engine.kernels.compiling and not facts.read_only


async def test_a_view_at_rest_is_lit_once_kernels_are_there(
    engine: FakeEngine, app: FastAPI
) -> None:
    engine.kernels.compiled.clear()
    async with watching(app.state.service, Viewer("a")) as refinements:
        engine.kernels.compiled.set()
        await anext(refinements)
    assert [view.shading for view, _ in engine.views] == ["lambert", "gi"]


async def test_a_picture_whose_kernels_are_compiled_does_not_hang(engine: FakeEngine) -> None:
    service: Any = Service(engine, Settings().with_patience(Patience(queue_seconds=0.01)))  # type: ignore[arg-type]
    picture: Any = SimpleNamespace(view=SimpleNamespace(shading="path_traced"))
    with pytest.raises(BusyError, match="path_traced pictures is being compiled"):
        await service.frame(picture, Rank(0.0), Stopwatch())


async def test_a_view_whose_light_does_not_fit_is_shown_without(
    engine: FakeEngine, app: FastAPI
) -> None:
    def refuse(_: threading.Event) -> None:
        if engine.views[-1][0].shading == "gi":
            raise NoRoomError("The light of this view does not fit the memory.")

    engine.doing = refuse
    (answer,) = await started(app, {})
    assert (answer.status_code, answer.headers["isogi-provisional"]) == (200, "?1")
    assert [view.shading for view, _ in engine.views] == ["gi", "lambert"]


@pytest.fixture
def did() -> list[str]:
    """What a service did while it started."""
    return []


@pytest.fixture
def startup(did: list[str]) -> Startup:
    """The start of an engine of two scenes."""
    kernels = SimpleNamespace(progress=None, others=lambda: did.append("others"))
    engine: Any = SimpleNamespace(
        **{name: lambda name=name: did.append(name) for name in ("open", "light")},
        **{
            "kernels": kernels,
            "stop": lambda: None,
            "scenes": {"one": "a scene", "other": "another"},
        },
    )
    return Startup(engine)


async def test_what_visitors_ask_for_is_surveyed_once_there_is_light(
    startup: Startup, did: list[str]
) -> None:
    await startup.run(lambda: did.append("prepare"), did.append)  # type: ignore[arg-type]
    assert startup.lit.is_set() and not startup.failure
    await startup.others("phong", 5.0)
    await startup.close()
    assert did == ["open", "prepare", "light", "a scene", "another", "others"]


async def test_a_start_that_failed_compiles_nothing_more(startup: Startup, did: list[str]) -> None:
    def prepare() -> None:
        raise OSError("no room")

    await startup.run(prepare, did.append)  # type: ignore[arg-type]
    await startup.others("phong", 5.0)
    assert startup.lit.is_set() and not startup.open
    assert did == ["open"]


async def test_pictures_are_drawn_though_rare_kernels_fail(
    startup: Startup, caplog: pytest.LogCaptureFixture
) -> None:
    startup._engine.kernels.others = lambda: 1 // 0  # type: ignore[method-assign,assignment]
    await startup.run(lambda: None, lambda _: None)
    await startup.others("phong", 5.0)
    assert startup.open and startup.lit.is_set()
    assert "few pictures need" in caplog.text


async def test_pictures_are_drawn_though_a_survey_fails(
    startup: Startup, did: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    def survey(scene: Any) -> None:
        did.append(scene.id)
        raise ZeroDivisionError

    startup._engine.scenes = {each: SimpleNamespace(id=each) for each in ("one", "other")}  # type: ignore[misc]
    await startup.run(lambda: None, survey)
    await startup.others("phong", 5.0)
    assert startup.open
    assert did == ["open", "light", "one", "other", "others"]
    assert "document of the scene one" in caplog.text


async def test_scenes_are_not_surveyed_once_it_is_to_stop(startup: Startup, did: list[str]) -> None:
    """A server of many scenes would stop late."""
    surveyed = asyncio.Event()
    loop = asyncio.get_running_loop()

    def survey(scene: str) -> None:
        did.append(scene)
        loop.call_soon_threadsafe(surveyed.set)
        time.sleep(0.2)

    await startup.run(lambda: None, survey)  # type: ignore[arg-type]
    await surveyed.wait()
    await startup.close()
    assert "a scene" in did and "another" not in did
