"""The store fails at its n-th call, for every n of a small bake: no pixel is wrong, and all light
comes in the end.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing
from functools import partial
from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.errors import StoreError
from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene
from isogi_core.storage.store import Store
from isogi_server.render.engine import RenderEngine
from tests.server.failing import Failing, failing_bucket, failing_folder
from tests.server.inline import LONG, view_of

StoreMaker = Callable[[], AbstractContextManager[Failing]]


pytestmark = pytest.mark.usefixtures("hasty")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A ball of 16³ voxels whose light is one chunk."""
    path = tmp_path_factory.mktemp("scene") / "ball.nrrd"
    distance = np.linalg.norm(np.mgrid[:16, :16, :16] - 7.5, axis=0)
    nrrd.write(str(path), (8.0 - distance).astype(np.float32), index_order="C")
    light = {"type": "constant", "radiance": 1.0}
    return load_scene(path, isovalue=3.0, bounces=1, target_error=0.3, lights=[light])


@pytest.fixture(params=["folder", "bucket"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    """Makes a new store."""
    if request.param == "folder":
        return partial(failing_folder, tmp_path)
    return partial(failing_bucket, request.getfixturevalue("s3"))


def begun(scene: Scene, failing: Failing) -> RenderEngine:
    """An engine on the store, begun anew by a person where the store has it fail."""
    for _ in range(100):
        engine = RenderEngine([scene], Store(failing.place))
        try:
            engine.start()
            return engine
        except StoreError as error:
            assert str(error).endswith(".")
            engine.close()
    raise AssertionError("it never starts")


def frames(engine: RenderEngine, scene: Scene) -> Iterator[Frame]:
    """What there is to show, again and again, until it is final; nothing while the store is
    away.
    """
    deadline = time.monotonic() + LONG
    while time.monotonic() < deadline:
        try:
            frame = engine.frame(scene.id, view_of(scene), wait=1.0)
        except StoreError:
            continue
        yield frame
        if not frame.provisional:
            return
    raise AssertionError(f"it never ends: {engine.unready()}")


def whole(scene: Scene, store: StoreMaker) -> tuple[Frame, dict[str, bytes], int]:
    """The last frame of a bake that nothing disturbs, what it leaves in the store, and the calls it
    took.
    """
    with store() as failing:
        with closing(begun(scene, failing)) as engine:
            *_, frame = frames(engine, scene)
        return frame, failing.objects(), failing.calls


def endure(scene: Scene, failing: Failing, reference: Frame) -> dict[str, bytes]:
    """Bake in a store that fails; what is left in it. No final pixel differs from the
    reference's.
    """
    with closing(begun(scene, failing)) as engine:
        for frame in frames(engine, scene):
            final = frame.state == FINAL
            np.testing.assert_array_equal(frame.radiance[final], reference.radiance[final])
        assert engine.baker.tally().given_up == 0
    return failing.objects()


@pytest.mark.slow
@pytest.mark.parametrize(("row", "step"), [(1, 1), (12, 3)], ids=["once", "for a while"])
def test_a_store_that_fails_costs_no_light(
    scene: Scene, store: StoreMaker, row: int, step: int
) -> None:
    """At each call alone, and from each third call on for as many as several tasks and frames
    make.
    """
    reference, kept, calls = whole(scene, store)
    assert calls > 10 and [key.partition("/")[2] for key in kept if "/c/" in key] == ["c/0/0/0/0"]
    for n in range(1, calls + 1, step):
        with store() as failing:
            failing.fails = lambda number, n=n: n <= number < n + row  # type: ignore[misc]
            assert endure(scene, failing, reference) == kept, n
            assert failing.calls >= n
