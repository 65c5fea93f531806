"""The first start on a machine: kernels compile, while pictures come without light and then with
light.

    python -m benchmarks.service first-start [SCENE …] [--size 512] [--again] [--json]

Scenes come one after the other, and share a folder of compiled kernels that is empty before the
first: each compiles what those before it did not call. Each has an empty store. A picture counts as
lit once half of its surface has light that was baked. ``--again`` starts each scene a second time,
when all is compiled.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import click
import httpx

from benchmarks.common.measurement import Measurement
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from isogi_server.settings import cores

LOOK = 0.1
"""Seconds between two looks at how far a server is."""

PROMISED = 5.0
"""Seconds after the start of a compilation at which the time left is held against what it took."""

LIT = 0.5
"""Share of the surface that has light in a picture that counts as lit."""

LONGEST = 900.0
"""Seconds after which a server is given up."""


@part(size=512)
@click.argument("scenes", nargs=-1)
@click.option("--again", is_flag=True, help="Start each scene once more, with all compiled.")
def first_start(scenes: tuple[str, ...], size: int, again: bool) -> Iterator[Measurement]:
    """A server's first start: seconds to ready, to a first picture and to light, and whether the
    time left was true.
    """
    with tempfile.TemporaryDirectory() as kernels:
        for scene in scenes or ("demo:casting",):
            for warm in (False, True) if again else (False,):
                name = f"{Path(scene).stem}, {size} × {size}{', all compiled' if warm else ''}"
                yield Measurement(name, started(scene, size, kernels))


def started(scene: str, size: int, kernels: str) -> dict[str, float]:
    """Seconds from a server's start to what comes of it, with a folder for compiled ``kernels``."""
    surroundings = {"ISOGI_KERNEL_CACHE": kernels}
    with (
        tempfile.TemporaryDirectory() as store,
        serving(scene, store, cores(), environment=surroundings) as served,
    ):
        found = {"ready after, s": served.ready_after}
        begun = time.perf_counter() - served.ready_after
        while (picture := look(served, size)) is None or lit_share(picture) < LIT:
            now = time.perf_counter() - begun
            if now > LONGEST:
                raise click.ClickException(f"{scene} had no light within {LONGEST:g} seconds.")
            if picture is not None:
                found.setdefault("first picture after, s", now)
            note_compiling(served, found, now)
            time.sleep(LOOK)
        found.setdefault("first picture after, s", time.perf_counter() - begun)
        return found | {"lit after, s": time.perf_counter() - begun}


def look(served: Served, size: int) -> httpx.Response | None:
    """The picture of the scene as it starts; None where there is none yet."""
    answer = served.client.get(
        f"{served.path}/frame", params={"width": size, "height": size, "f": "jpeg"}
    )
    if answer.status_code == httpx.codes.OK:
        return answer
    return None


def lit_share(picture: httpx.Response) -> float:
    """The share of the surface that has light in a ``picture``."""
    coverage = dict(pair.split("=") for pair in picture.headers["isogi-coverage"].split(", "))
    return 1.0 - float(coverage["provisional"])


def note_compiling(served: Served, found: dict[str, float], now: float) -> None:
    """Note in ``found`` when the last kernel was compiled, and what was promised of that after
    PROMISED seconds.
    """
    compiling = served.client.get("/readyz").json().get("compiling")
    if compiling is None:
        if "kernels" in found:
            found.setdefault("compiled after, s", now)
        return
    found.setdefault("kernels", compiling["total"])
    if "seconds" in compiling and now > PROMISED:
        found.setdefault("compiled after, s, as promised first", now + compiling["seconds"])
