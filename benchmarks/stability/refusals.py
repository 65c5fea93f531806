"""Cases of what is refused: lights, settings, isovalues and rotations without meaning, each in a sentence."""

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.lighting import HEIGHT, ball, lit, plane, spot
from benchmarks.stability.stage import CONSTANT
from isogi_core.errors import IsogiError
from isogi_core.files.radiance import write_hdr
from isogi_core.model.scene import Scene
from server.params import ViewParams, read
from server.views import isovalue_of, light_of

GROUP = "what is refused"

Table = Mapping[str, Any]


def sentence(do: Callable[..., object], *told: Any, **settings: Any) -> str:
    """The sentence with which something that is told is refused; "" where it is not."""
    try:
        do(*told, **settings)
    except IsogiError as error:
        return str(error) if str(error).endswith(".") else ""
    return ""


def outcome(taken: list[Any], of: int) -> Outcome:
    """How many were taken that should not be, and which."""
    return Outcome(len(taken), f"of {of}{': ' if taken else ''}{'; '.join(map(str, taken))}")


@case(GROUP, "lights", "lights without meaning are refused in a sentence", 0, "lights")
def lights(_: Size) -> Outcome:
    """When they are told, or when the scene is planned."""
    told = list(senseless_lights())
    return outcome([light for light in told if not sentence(lit, plane(), -HEIGHT, light)], len(told))


def senseless_lights() -> Iterator[Table]:
    """Lights without meaning: no numbers, negative, beyond what frames hold, beyond their ranges."""
    for value in (math.nan, math.inf, -1.0, 1e31, 1e300, [1.0, math.nan, 1.0]):
        yield {"type": "constant", "radiance": value}
        yield {"type": "directional", "irradiance": value}
        yield {"type": "point", "position": [0.0, 0.0, 0.0], "intensity": value}
    yield {"type": "constant", "radiance": 1e-40}
    yield {"type": "point", "position": [0.0, 0.0, 1e200], "intensity": 1.0}
    yield {"type": "area", "corner": [0.0, 0.0, 0.0], "u": [1e200, 0.0, 0.0], "v": [0.0, 1e200, 0.0]}
    yield {"type": "area", "corner": [0.0, 0.0, 0.0], "u": [0.0, 0.0, 0.0], "v": [0.0, 1.0, 0.0]}
    yield {"type": "sky", "sun_elevation": -0.1}
    yield {"type": "sky", "turbidity": 1.8}
    yield {"type": "sky", "turbidity": 10.1}


@case(
    GROUP, "pixels of probes", "negative and non-finite radiance is refused, with a count where it is read", 0, "probes"
)
def pixels(_: Size) -> Outcome:
    """RGBE holds none: it is refused when it is written, and where EXPOSURE makes it when it is read."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "probe.hdr"
        values = (-1.0, math.nan, math.inf)
        taken = [value for value in values if not sentence(write_hdr, path, spot(4, 8, 1, 2, value))]
        write_hdr(path, spot(4, 8, 1, 2, 1e30) + spot(4, 8, 2, 2, 1e30))
        path.write_bytes(path.read_bytes().replace(b"\n\n", b"\nEXPOSURE=1e-20\n\n", 1))
        told = sentence(lit, plane(), -HEIGHT, {"type": "probe", "file": str(path)})
    return outcome(taken if "2 pixels" in told else [*taken, "overflow"], len(values) + 1)


@case(GROUP, "settings", "settings beyond their ends are refused in a sentence", 0, "settings")
def settings(_: Size) -> Outcome:
    """In a scene."""
    told = list(senseless_settings())
    return outcome([each for each in told if not sentence(lit, ball(), 0.0, CONSTANT, **each)], len(told))


def senseless_settings() -> Iterator[Table]:
    """Settings that are no numbers, or a little beyond their ends."""
    beyond: Mapping[str, tuple[Any, ...]] = {
        "albedo": (-1e-9, 1.0 + 1e-9, math.nan, [0.5, 0.5], "white"),
        "albedos": ([0.9, 0.1], [-1e-9, 0.9], [0.0, 1.0 + 1e-9], [0.8, 0.9], [0.5], math.nan),
        "bounces": (-1, 1001, 2.5, math.inf),
        "lattice": (0.1249, 4.001, 0.0, -1.0, math.nan),
        "offset": (-1e-9, 2.1, math.nan),
        "target_error": (0.0, 9e-5, 1.1, math.nan),
        "order": (0, 11, 2.5),
        "isovalues": ([0.7, 0.2], [0.1, 2.0], [0.5], [0.5, math.nan]),
    }
    for name, values in beyond.items():
        yield from ({name: value} for value in values)


@case(GROUP, "isovalues", "isovalues outside the range, even by a digit, are refused in a sentence", 0, "isovalues")
def isovalues(_: Size) -> Outcome:
    """As a query has them: 422."""
    scene = lit(ball(), 0.0, CONSTANT)
    low, high = scene.isovalues
    numbers = (math.nextafter(low, -math.inf), math.nextafter(high, math.inf), -1e300, 1e300)
    return by_query(scene, isovalue_of, "isovalue", [*map(repr, numbers), "nan", "inf", "-inf", "1_0", "", "1e999"])


@case(GROUP, "rotations", "quaternions without length or meaning are refused in a sentence", 0, "quaternions")
def rotations(_: Size) -> Outcome:
    """As a query has them: 422."""
    texts = ["0,0,0,0", "nan,0,0,1", "inf,0,0,1", "1e-4,0,0,0", "1e4,0,0,0", "1e300,0,0,0", "1e-300,1e-300,0,0"]
    texts += ["1,0,0", "1,0,0,0,0", "", ",,,", "1,0,0,x", "-0,0,-0,0", "１,0,0,0"]
    return by_query(lit(ball(), 0.0, CONSTANT), light_of, "light", texts)


def by_query(scene: Scene, ask: Callable[[Scene, ViewParams], object], name: str, texts: list[str]) -> Outcome:
    """Those of some ``texts`` for one parameter that ``ask`` takes."""

    def query(text: str) -> object:
        return ask(scene, read(ViewParams, [(name, text)]))

    taken = [text for text in texts if not sentence(query, text)]
    return outcome(taken, len(texts))
