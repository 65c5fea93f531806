"""Damaged chunks under a running server: all are noticed and baked again, and no pixel is ever
wrong.

    python -m benchmarks.scaling damage [SCENE.toml] [--damaged 200] [--flips 10000] [--views 8]
    [--seed 0] [--json]

Views are baked. Then objects of their light are damaged, each in another way, while a server runs
that has not read them yet, and all views are asked for until they are final again. Where the store
has fewer objects than are to be damaged, that is done again with another server. Before that,
single bits of single objects are flipped, each object is read as servers and workers read it, and
has its bytes back.

Each picture decides how many samples its texels take, by what it measures while they are baked; so
another server may bake texels less far than the first. Of as many samples their light is the same
to the bit.
"""

import io
import random
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from benchmarks.scaling.visiting import small_scene, view
from benchmarks.scaling.watching import altered, light_in, texels_of
from isogi_core.cache.upkeep import census_of, samples_in
from isogi_core.storage.store import Store

WORKERS = 2
HUGE = 16 << 20
"""Bytes that an object grows by which is made huge."""

SURELY = 4.0
"""Standard errors that nothing exceeds by chance, of some ten thousand pixels."""

SETTLED = 120.0
"""Seconds within which nothing is baked any more, once all views are final."""

Damage = Callable[[Path, Path, random.Random], Any]
"""Does something to an object; the second path is that of another."""


def flipped(path: Path, _: Path, chance: random.Random) -> None:
    """One bit of it is another."""
    content = bytearray(path.read_bytes())
    bit = chance.randrange(8 * len(content))
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


DAMAGES: dict[str, Damage] = {
    "cut in half": lambda path, _, __: path.write_bytes(
        path.read_bytes()[: path.stat().st_size // 2]
    ),
    "cut by a byte": lambda path, _, __: path.write_bytes(path.read_bytes()[:-1]),
    "empty": lambda path, _, __: path.write_bytes(b""),
    "three bytes": lambda path, _, __: path.write_bytes(path.read_bytes()[:3]),
    "one bit flipped": flipped,
    "zeros": lambda path, _, __: path.write_bytes(bytes(path.stat().st_size)),
    "four bytes more": lambda path, _, __: path.write_bytes(path.read_bytes() + b"more"),
    "another chunk's": lambda path, other, _: shutil.copyfile(other, path),
    "another layer's": lambda path, _, __: shutil.copyfile(elsewhere(path), path),
    "deleted": lambda path, _, __: path.unlink(),
    "huge": lambda path, _, __: path.write_bytes(path.read_bytes() + bytes(HUGE)),
}


def elsewhere(path: Path) -> Path:
    """The object of the same chunk in another layer; of the same, where there is no other."""
    layer = path.parents[4]
    others = [
        each / path.relative_to(layer)
        for each in layer.parent.iterdir()
        if each not in (layer, path)
    ]
    return next(
        (each for each in others if each.is_file()), next(each for each in layer.glob("c/*/*/*/0"))
    )


def missed(store: str, flips: int, chance: random.Random) -> int:
    """Flip so many bits, one at a time, of one object each; how many of these a reader does not
    notice.
    """
    root = Store(store, make=False)
    unnoticed = 0
    counts = census_of(root, texels=False).counts.values()
    chunks = [
        (count, index, each.key)
        for count in counts
        for index, each in sorted(count.files.chunks.items())
    ]
    for _ in range(flips):
        count, index, key = chance.choice(chunks)
        whole = Path(store, key).read_bytes()
        flipped(Path(store, key), Path(store, key), chance)
        unnoticed += samples_in(root, count, index) is not None
        Path(store, key).write_bytes(whole)
    return unnoticed


def spoil(store: str, many: int, chance: random.Random) -> Counter[str]:
    """Damage so many objects, at most all but one of them; how many in which way."""
    keys = sorted(light_in(store))
    chosen = chance.sample(keys, min(many, len(keys) - 1))
    whole = sorted(set(keys) - set(chosen))
    kinds = [list(DAMAGES)[number % len(DAMAGES)] for number in range(len(chosen))]
    for key, kind in zip(chosen, kinds, strict=True):
        DAMAGES[kind](Path(store, key), Path(store, chance.choice(whole)), chance)
    return Counter(kinds)


def look(server: Served, number: int, wait: float) -> tuple[int, np.ndarray | None, bool]:
    """One look at a view: the status of the answer, the planes in it, (h, w, 9), and whether they
    are final.
    """
    answer = server.client.get(
        f"{server.path}/frame", params=view(number) | {"wait_ms": int(1000 * wait)}
    )
    if answer.status_code == 200:
        planes = np.load(io.BytesIO(answer.content))
    else:
        planes = None
    return answer.status_code, planes, answer.headers.get("isogi-provisional") == "?0"


class Seen(NamedTuple):
    """The planes of a view by the light of its texels alone, ``lit``, and once its picture was
    checked, ``final``.
    """

    lit: np.ndarray
    final: np.ndarray


def bake(server: Served, views: int) -> list[Seen]:
    """The views, final."""
    return [see(server, number, Counter()) for number in range(views)]


def see(server: Served, number: int, seen: Counter[str], expected: Seen | None = None) -> Seen:
    """Look at a view until it is final, and count the ``seen`` answers and pixels by whether they
    are right.
    """
    wait = 0.0
    lit = None
    while True:
        status, planes, final = look(server, number, wait)
        wait = 1.0
        seen["answers"] += 1
        seen["answers 5xx"] += status >= 500
        if planes is None:
            continue
        if expected is not None:
            compare(planes, expected, seen)
        if lit is None and np.isin(planes[..., 4], (0, 3)).all():
            lit = planes
        if final:
            return Seen(planes if lit is None else lit, planes)


def compare(planes: np.ndarray, expected: Seen, seen: Counter[str]) -> None:
    """Count the final pixels of a picture, and those of them that are not as expected.

    They are expected to be as before by texels alone, or as they are in the end: checks give some
    of them light of their own. A texel that lost one of its layers has reached its error when that
    has caught up in part, and the pixel may be final with fewer paths than before: another number,
    as good as it is told to be. What is told of the two is the standard error of their difference,
    which every third exceeds; one that is SURELY times as far off is wrong.
    """
    sure = planes[..., 4] == 3
    off = np.min(
        [np.abs(planes[sure][:, :3] - each[sure][:, :3]).max(axis=1) for each in expected], axis=0
    )
    told = np.hypot(planes[sure][:, 5], expected.final[sure][:, 5]) * expected.final[sure][
        :, :3
    ].max(axis=1)
    seen["final pixels"] += int(sure.sum())
    seen["of fewer paths for a while"] += int((off > 0.0).sum())
    seen["of these beyond the error told"] += int((off > told).sum())
    seen["wrong pixels"] += int((off > SURELY * told).sum())


def settle(server: Served) -> None:
    """Wait until nothing is baked any more."""
    deadline = time.monotonic() + SETTLED
    while (
        server.metric("isogi_queue_chunks") + server.metric("isogi_tasks_in_flight")
        and time.monotonic() < deadline
    ):
        time.sleep(0.1)


def round_of(
    scene: str, store: str, damage: Callable[[str], Counter[str]], expected: Sequence[Seen]
) -> Counter[str]:
    """Damage objects of a store under a server, and look at all views until they are final
    again.
    """
    with serving(scene, store, WORKERS) as server:
        found: Counter[str] = Counter()
        kinds = damage(store)
        for number, before in enumerate(expected):
            see(server, number, found, before)
        settle(server)
        found["damaged"] = kinds.total()
        found["told as damaged"] = int(
            server.labelled("isogi_errors_total", kind="DamagedChunkError")
        )
        found["not to be noticed: deleted"] = kinds["deleted"]
        found["healed by workers"] = int(server.metric("isogi_chunks_healed_total"))
        found["failed tasks"] = int(server.metric("isogi_tasks_failed_total"))
    return found


def measure(scene: str, store: str, damaged: int, flips: int, views: int, seed: int) -> Figures:
    """Bake, damage and heal."""
    chance = random.Random(seed)
    found = Counter[str]()
    with serving(scene, store, WORKERS) as server:
        expected = bake(server, views)
    whole = texels_of(store)
    objects = len({key for key, _ in whole})
    unnoticed = missed(store, flips, chance)
    differ = 0
    while found["damaged"] < damaged:
        spoiled = partial(spoil, many=damaged - found["damaged"], chance=chance)
        found += round_of(scene, store, spoiled, expected)
        differ += altered(whole, texels_of(store))
    names = (
        "damaged",
        "told as damaged",
        "not to be noticed: deleted",
        "healed by workers",
        "failed tasks",
    )
    pixels = (
        "final pixels",
        "of fewer paths for a while",
        "of these beyond the error told",
        "wrong pixels",
    )
    seen = ("answers", "answers 5xx", *pixels)
    return {
        "objects": objects,
        "bits flipped, one at a time": flips,
        "not noticed by a reader": unnoticed,
        **{name: found[name] for name in (*names, *seen)},
        "texels lost, or of other light by as many samples": differ,
    }


@part()
@click.argument("target", required=False)
@click.option("--damaged", default=200, show_default=True, help="Objects that are damaged.")
@click.option(
    "--flips",
    default=10_000,
    show_default=True,
    help="Bits that are flipped before, one at a time.",
)
@click.option("--views", default=8, show_default=True, help="Views that are looked at.")
@click.option("--seed", default=0, show_default=True, help="Decides which, and how.")
def damage(target: str | None, damaged: int, flips: int, views: int, seed: int) -> Measurement:
    """Damaged chunks under a running server: all are noticed and baked again."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or small_scene(Path(folder))
        found = measure(scene, f"{folder}/light", damaged, flips, views, seed)
    return Measurement(f"{Path(scene).stem}, {damaged} damaged objects", found)
