"""Cases of the service: all specimens through every endpoint, and numbers that are none in every parameter."""

import io
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlencode

import numpy as np

from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.desk import ask, faults, is_sentence, save, scene_of_file, service, strict_json
from benchmarks.stability.specimen import SPECIMENS, Specimen, volumes
from isogi_core.model.view import SHADINGS
from server.cli import run
from server.params import FrameParams, ViewParams
from server.values import Row, Span

GROUP = "service"
SMALL = {"width": 12, "height": 12}
PAGES = ("/", "/v1/scenes", "/livez", "/docs")
"""Endpoints that are of no single scene."""

TOGETHER = 6
"""Specimens that one service shows."""

HOSTILE = (
    *("nan", "NaN", "-nan", "inf", "-inf", "Infinity", "1e999", "-1e999", "1e-", "e5", "1_0", "0x10", "0b1"),
    *("", " ", " 1", "1 ", "1,0", "1;2", "+", "--1", ".", "٣", "½", "None", "null", "true", "[]", "1e5e5", "9" * 70),
)
"""What is no number."""


def corpus(size: Size) -> list[Specimen]:
    """The specimens that are not refused; a few of them for the tests."""
    whole = volumes()
    return whole[:: size.pick(max(len(whole) // 4, 1), 1)]


def requests(number: int) -> Iterator[str]:
    """Every endpoint that shows a scene, in every shading, and the formats of pictures."""
    scene = f"/v1/scenes/s{number}"
    yield scene
    for shading in SHADINGS:
        yield f"{scene}/frame?{urlencode({**SMALL, 'shading': shading, 'f': 'npy'})}"
    for form in ("png", "jpeg", "webp"):
        yield f"{scene}/frame?{urlencode({**SMALL, 'f': form, 'wait_ms': 300, 'overlay': 'provisional'})}"
    yield f"{scene}/coverage?{urlencode(SMALL)}"


@case(GROUP, "every endpoint", "every specimen gets 200 and finite numbers from every endpoint", 0, "faults")
def endpoints(size: Size) -> Outcome:
    """Ask services of a few specimens each for all but /readyz, as they hire no workers, and look at each number."""
    wrong, asked = 0, 0
    whole = corpus(size)
    for first in range(0, len(whole), TOGETHER):
        few = whole[first : first + TOGETHER]
        with TemporaryDirectory() as folder:
            files = [save(each, Path(folder, f"s{number}.nrrd")) for number, each in enumerate(few)]
            scenes = [scene_of_file(*pair) for pair in zip(few, files, strict=True)]
            paths = [*PAGES, *(path for number in range(len(few)) for path in requests(number))]
            with service(scenes, Path(folder, "light")) as app:
                wrong += sum(faults(answer, 200) for answer in ask(app, paths))
            asked += len(paths)
    return Outcome(wrong, f"of {asked} answers")


def hostile_queries() -> Iterator[dict[str, str]]:
    """Each numeric parameter with each thing that is no number; of rows, one number among good ones."""
    for name, field in FrameParams.model_fields.items():
        rows = [part for part in field.metadata if isinstance(part, Row)]
        if name == "isovalue" or any(isinstance(part, Span) for part in field.metadata):
            yield from ({name: text} for text in HOSTILE)
        elif rows:
            others = ["0"] * (len(rows[0].names) - 1)
            yield from ({name: ",".join([text, *others])} for text in HOSTILE if text != "1,0")


@case(GROUP, "hostile numbers", "what is no number gets 422 and a sentence, in every parameter", 0, "answers")
def hostile_numbers(size: Size) -> Outcome:
    """Put what is no number into each parameter of frames and of coverage."""
    first = next(iter(SPECIMENS.values()))
    queries = [{**query, **({"shading": "path_traced"} if "samples" in query else {})} for query in hostile_queries()]
    paths = [f"/v1/scenes/s0/frame?{urlencode(query)}" for query in queries]
    own = set(ViewParams.model_fields)
    paths += [f"/v1/scenes/s0/coverage?{urlencode(query)}" for query in queries if own >= set(query)]
    with TemporaryDirectory() as folder:
        scene = scene_of_file(first, save(first, Path(folder, "s0.nrrd")))
        with service([scene], Path(folder, "light")) as app:
            answers = ask(app, paths[:: size.pick(3, 1)])
    return Outcome(sum(faults(answer, 422) > 0 for answer in answers), f"of {len(answers)}")


@case(GROUP, "isogi inspect", "every specimen is told of in JSON, or refused in a line with status 2", 0, "faults")
def inspected(size: Size) -> Outcome:
    """Run the command line on the file of each specimen."""
    poor = [each for each in SPECIMENS.values() if each.refused]
    wrong = sum(inspect(each) for each in (*corpus(size), *poor))
    return Outcome(wrong, f"of {len(corpus(size))} volumes and {len(poor)} that are none")


def inspect(specimen: Specimen) -> int:
    """What is wrong with ``isogi inspect`` of a specimen."""
    with TemporaryDirectory() as folder:
        status, out, said = command("inspect", str(save(specimen, Path(folder, "s.nrrd"))), "--json")
    if specimen.refused:
        return int(status != 2 or not is_sentence(said) or specimen.refused not in said)
    try:
        return int(status != 0 or not strict_json(out))
    except ValueError:
        return 1


def command(*arguments: str) -> tuple[int, str, str]:
    """Exit status, and what was said on both streams, of a command."""
    out, error = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(error):
        status = run(arguments)
    return status, out.getvalue(), error.getvalue().strip()


@case(GROUP, "isogi render", "specimens are rendered to files of finite numbers", 0, "numbers")
def rendered(size: Size) -> Outcome:
    """Run the command line, with a worker process of its own, on a few specimens."""
    few: Sequence[Specimen] = corpus(size)[:: size.pick(5, 16)]
    wrong = 0
    for each in few:
        with TemporaryDirectory() as folder:
            output = Path(folder, "frame.npy")
            where = ("--store", str(Path(folder, "light")), "--workers", "1", "--width", "32", "--height", "32")
            value = f"--isovalue={each.isovalues[0]!r}"
            status, _, _ = command("render", str(save(each, Path(folder, "s.nrrd"))), "-o", str(output), value, *where)
            wrong += int((~np.isfinite(np.load(output))).sum()) if status == 0 else 1
    return Outcome(wrong, f"of {len(few)} pictures")
