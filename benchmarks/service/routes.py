"""The most that one request of each route takes of a server: memory and time of the processor.

    python -m benchmarks.service routes [TARGET] [--at-once 12] [--seconds 60] [--json] [--write]

A server asks for tokens, and a client that may only look sends each operation of the API's own
document the costliest requests that there are known to be, one alone, and then several at once.
Tells the time of the processor of the one alone, how far the server's memory (RSS) rises above what
it was before, and the highest that it is while several are at work. A client waits so many seconds
for an answer, and then leaves.
"""

import random
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import click
import httpx
import psutil

from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.serving import MIB, Served, serving
from benchmarks.common.suite import part
from isogi_core.frame.card.blocks import CHUNKS

LOOK = "a token that may look alone"
ADMIN = "a token that may do anything"
TOKENS = f"""
[looker]
token = "{LOOK}"
scopes = ["look"]
[admin]
token = "{ADMIN}"
scopes = ["admin"]
"""
MOST_MIB = 1500.0
"""Memory that the server may have with requests of one route at work."""

SCENE = "/v1/scenes/{scene}"
LARGEST = "width=2048&height=2048"
LONGEST = "width=16383&height=256"
MIDDLE = "width=1024&height=1024"
ANYWHERE = "azimuth={turn}"
NEAR = f"distance=0.9&{ANYWHERE}"
"""Parameters of pictures: the largest, the longest of as many pixels, the largest of those that are
drawn several at once; from any side, and from so near that every pixel shows the surface.
"""

COSTLIEST: dict[str, tuple[str, ...]] = {
    "/livez": ("",),
    "/readyz": ("",),
    "/bakez": ("",),
    "/metrics": ("",),
    "/v1/scenes": ("",),
    SCENE: ("?cut=x>{cut}",),
    f"{SCENE}/sky": ("?width=512&environment=studio",),
    f"{SCENE}/frame": (
        f"?{LARGEST}&f=npy&{ANYWHERE}",
        f"?{LARGEST}&f=npy&{NEAR}",
        f"?{LARGEST}&f=png&antialias=on&{NEAR}",
        f"?{MIDDLE}&f=npy&{NEAR}",
        f"?{MIDDLE}&f=png&antialias=on&{NEAR}",
        f"?{LONGEST}&f=webp&shading=lambert_shadow&{ANYWHERE}",
        f"?{LARGEST}&f=npy&shading=path_traced&samples=16&{NEAR}",
        f"?{MIDDLE}&f=npy&shading=path_traced&samples=64&{NEAR}",
    ),
    f"{SCENE}/coverage": (f"?{LARGEST}&{NEAR}",),
    f"{SCENE}/fit": (f"?width=1&height=16383&{ANYWHERE}", f"?{LARGEST}&{ANYWHERE}"),
    f"{SCENE}/point": (f"?{LARGEST}&x=1024&y=1024&{ANYWHERE}",),
    f"{SCENE}/size": ("?cut=x>{cut}",),
    f"{SCENE}/slice": ("?axis=x&at={cut}&f=npy", "?axis=x&at={cut}"),
    f"{SCENE}/events": (f"?{LARGEST}&{NEAR}", f"?{MIDDLE}&{NEAR}"),
    f"{SCENE}/card": (f"?{LARGEST}&cut=x>{{cut}}",),
    f"{SCENE}/card/volume/{{layers}}": ("?cut=x>{cut}",),
    f"{SCENE}/card/colours/{{layers}}": ("?cut=x>{cut}",),
    f"{SCENE}/card/surroundings": ("?cut=x>{cut}",),
    f"{SCENE}/card/chunks": (f"?{LARGEST}&{NEAR}", f"?{LONGEST}&{ANYWHERE}"),
    f"{SCENE}/card/light/{{chunks}}": ("?yaw={turn}",),
    f"{SCENE}/card/transfer/{{chunks}}": ("?cut=x>{cut}",),
    f"{SCENE}/prewarm": ("",),
    f"{SCENE}/export": ("?f=glb",),
    "/v1/jobs": ("",),
    "/v1/jobs/{job}": ("",),
    "/v1/jobs/{job}/results": ("",),
    "/v1/jobs/{job}/file": ("",),
    "/v1/volumes": ("",),
    "/v1/volumes/{volume}": ("",),
    "/v1/environments": ("",),
    "/v1/environments/{environment}": ("",),
}
"""The costliest queries of each path, of which each request has another view, or another cut."""


@dataclass(frozen=True)
class Cost:
    """What requests of an operation took: the time of the ``processor`` of one, seconds, how far
    memory rose for it, and the ``peak`` of the server with several at once, both in MiB; and what
    was ``answered`` then, by status.
    """

    processor: float
    memory: float
    peak: float
    answered: Counter[int]


class Asking:
    """A client that asks a server for what costs most, each time for something else."""

    def __init__(self, served: Served, seconds: float) -> None:
        """Ask ``served``, and wait so many ``seconds`` for an answer."""
        self.served = served
        self.process = psutil.Process(served.process.pid)
        self.seconds = seconds
        self.chance = random.Random(4)
        facts = served.client.get(served.path).json()
        self.depth = facts["volume"]["size"][0] - 1
        card = served.client.get(f"{served.path}/card").json()
        (slab, *_) = card["scene"]["volume"]["slabs"]
        chunks = [f"{z}.{y}.{x}" for z in range(4) for y in range(4) for x in range(4)]
        self.places = {
            "scene": facts["id"],
            "layers": f"{slab['first']}-{slab['last']}",
            "chunks": ",".join(chunks[:CHUNKS]),
            **dict.fromkeys(("job", "volume", "environment"), "0" * 12),
        }

    def address(self, path: str, query: str) -> str:
        """A request of a path, like none before it."""
        places = {
            **self.places,
            "turn": f"{self.chance.uniform(0.0, 359.0):.4f}",
            "cut": f"{self.chance.uniform(0.1, 0.4) * self.depth:.4f}",
        }
        return (path + query).format(**places)

    def ask(self, method: str, address: str) -> int:
        """The status of an answer, which is read whole unless it is endless; 0 where none came."""
        with (
            suppress(httpx.TransportError),
            httpx.Client(base_url=self.served.url, timeout=self.seconds) as client,
            client.stream(method, address, headers=bearer(LOOK)) as answer,
        ):
            for _ in answer.iter_raw(1 << 20):
                if answer.headers["content-type"].startswith("text/event-stream"):
                    break
            return answer.status_code
        return 0

    def cost(self, method: str, path: str, query: str, at_once: int) -> Cost:
        """What a request takes, and several ``at_once``."""
        self.quiet()
        before = self.process.memory_info().rss / MIB
        reset_peak(self.process.pid)
        used = processor_time(self.process)
        self.ask(method, self.address(path, query))
        self.quiet()
        processor = processor_time(self.process) - used
        memory = max(peak_of(self.process.pid) - before, 0.0)
        reset_peak(self.process.pid)
        addresses = [self.address(path, query) for _ in range(at_once)]
        with ThreadPoolExecutor(at_once) as threads:
            answered = Counter(threads.map(lambda each: self.ask(method, each), addresses))
        return Cost(processor, memory, peak_of(self.process.pid), answered)

    def quiet(self, longest: float = 60.0) -> None:
        """Return once the server does nothing more."""
        deadline = time.monotonic() + longest
        used = -1.0
        while time.monotonic() < deadline and (now := processor_time(self.process)) - used > 0.02:
            used = now
            time.sleep(0.3)


def bearer(token: str) -> dict[str, str]:
    """The header that shows a token."""
    return {"Authorization": f"Bearer {token}"}


def processor_time(process: psutil.Process) -> float:
    """Seconds of the processor that a process has used."""
    times = process.cpu_times()
    return float(times.user + times.system)


def reset_peak(pid: int) -> None:
    """Have the system count a process's highest memory from now on."""
    Path(f"/proc/{pid}/clear_refs").write_text("5", encoding="ascii")


def peak_of(pid: int) -> float:
    """The highest memory of a process, MiB, since it was counted from."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return float(next(each for each in lines if each.startswith("VmHWM")).split()[1]) / 1024.0


def operations(served: Served) -> Iterator[tuple[str, str]]:
    """Method and path of each operation in the API's document. Raises ValueError for a path that
    has no costliest request here.
    """
    document = served.client.get("/openapi.json").json()
    for path, methods in document["paths"].items():
        if path not in COSTLIEST:
            raise ValueError(f"Name the costliest requests of {path} in benchmarks/service/routes.")
        for method in methods:
            yield method.upper(), path


def table(costs: dict[tuple[str, str, str], Cost], at_once: int) -> str:
    """A row for each operation and request."""
    head = ("route", "request", "processor, s", "memory of one, MiB", f"server with {at_once}, MiB")
    rows = (
        (
            f"`{method} {path}`",
            f"`{query}`" if query else "",
            f"{cost.processor:.2f}",
            f"{cost.memory:.0f}",
            f"{cost.peak:.0f}",
            ", ".join(
                f"{count} × {status or 'none'}" for status, count in sorted(cost.answered.items())
            ),
        )
        for (method, path, query), cost in costs.items()
    )
    return markdown((*head, "answers"), rows, left=2)


def in_words(answered: Counter[int]) -> str:
    """How often each status came; none where the client left before."""
    return ", ".join(f"{count} × {status or 'none'}" for status, count in sorted(answered.items()))


@part()
@click.argument("target", default="demo:casting")
@click.option("--at-once", default=12, show_default=True, help="Requests at once.")
@click.option("--seconds", default=60.0, show_default=True, help="Time that a client waits.")
@click.option("--only", multiple=True, help="Only paths that end so; may be given again.")
def routes(target: str, at_once: int, seconds: float, only: tuple[str, ...]) -> Measurement:
    """The most that one request of each route takes, and several at once."""
    with tempfile.TemporaryDirectory() as folder:
        tokens = Path(folder) / "tokens.toml"
        tokens.write_text(TOKENS, encoding="utf-8")
        settings = {
            "ISOGI_TOKENS_FILE": str(tokens),
            "ISOGI_HAND_OUT_VOXELS": "true",
            "ISOGI_UPLOADS_MB": "0",
        }
        with serving(target, f"{folder}/light", 1, environment=settings) as served:
            served.client.headers.update(bearer(LOOK))
            asking = Asking(served, seconds)
            costs = {
                (method, path, query): asking.cost(method, path, query, at_once)
                for method, path in operations(served)
                if path.endswith(only or ("",))
                for query in COSTLIEST[path]
            }
    highest = max(cost.peak for cost in costs.values())
    failed = sum(
        count for cost in costs.values() for status, count in cost.answered.items() if status >= 500
    )
    figures = {
        "requests": len(costs),
        "highest memory of the server, MiB": highest,
        "most memory of one request, MiB": max(cost.memory for cost in costs.values()),
        "most time of the processor of one request, s": max(
            cost.processor for cost in costs.values()
        ),
        "answered 5xx": failed,
    }
    wrong = ""
    if highest > MOST_MIB:
        wrong = f"The server took {highest:.0f} MiB, and {MOST_MIB:.0f} are allowed."
    title = f"What requests of each route take at most, {at_once} at once"
    about = (
        f"A server of {target} that asks for a token, and a client that may look. Time and memory "
        "are of one request alone, memory above what the server had before; the highest memory is "
        f"of the whole server with {at_once} such requests at once."
    )
    return Measurement(title, figures, f"{about}\n\n{table(costs, at_once)}", wrong=wrong)
