"""``python -m benchmarks.house``: print counts of concepts, names, lines and prose of the source.

Each count has a rule that needs no list kept by hand, so that the same command shows the effect of
a change. Counts are thermometers: no test asserts them.
"""

import ast
import io
import re
import sys
import tempfile
import tokenize
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from functools import cache, partial
from itertools import chain, pairwise
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parents[1]

PRODUCT = ("isogi_core", "worker", "server", "isogi_report", "isogi")
"""Folders and files of the product that Python runs."""

KNOB_FOLDERS = ("isogi_core/model", "isogi_core/plan", "server", "web", "isogi")
"""Where a knob may stand between a scene file and the picture: not what computes with its value,
nor file formats.
"""

RENDER_SIZE = 64
"""Pixels along each side of the picture whose render is traced."""


TEXT_PACKAGES = ("isogi_core", "worker", "server", "isogi_report", "tests")
"""Packages whose text is measured."""

LONGEST_LINE = 100


def main() -> None:
    """Print the counts, and a table of the text."""
    for name, count in COUNTS.items():
        sys.stdout.write(f"{name:<52} {count()}\n")
    sys.stdout.write(f"\n{'per 1,000 lines, or words of docstrings':<42}")
    sys.stdout.write("".join(f"{package:>14}" for package in TEXT_PACKAGES) + "\n")
    found = [text_gauges(package) for package in TEXT_PACKAGES]
    for name in found[0]:
        values = "".join(f"{each[name]:>14.1f}" for each in found)
        sys.stdout.write(f"{name:<42}{values}\n")


def text_gauges(package: str) -> dict[str, float]:
    """Gauges of how a package reads: per 1,000 lines, or per 1,000 words of its docstrings."""
    counts: Counter[str] = Counter()
    words: Counter[str] = Counter()
    for path in files_of(package):
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        counts["lines"] += len(lines)
        counts["long"] += sum(len(line) > LONGEST_LINE for line in lines)
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        counts["comments"] += sum(token.type == tokenize.COMMENT for token in tokens)
        for node in ast.walk(parsed(path)):
            counts["packed"] += is_packed(node)
            counts["conditional"] += isinstance(node, ast.IfExp)
            if isinstance(node, DOCUMENTED_NODES):
                words.update(re.findall("[a-z']+", (ast.get_docstring(node) or "").lower()))
    per_line = 1000.0 / max(counts["lines"], 1)
    per_word = 1000.0 / max(words.total(), 1)
    return {
        "assignments that pack several values": per_line * counts["packed"],
        "comment lines": per_line * counts["comments"],
        "conditional expressions": per_line * counts["conditional"],
        "lines over 100 columns": per_line * counts["long"],
        "docstrings: where": per_word * words["where"],
        "docstrings: if": per_word * words["if"],
        "docstrings: what, who, whether": per_word
        * sum(words[word] for word in ("what", "who", "whether")),
    }


DOCUMENTED_NODES = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
"""Nodes that may have a docstring."""


def is_packed(node: ast.AST) -> bool:
    """Return whether an assignment gives several values to several targets: ``a, b = x, y``."""
    return (
        isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Tuple)
        and isinstance(node.targets[0], ast.Tuple)
    )


def files_of(*places: str, suffixes: tuple[str, ...] = (".py",)) -> list[Path]:
    """The files at these ``places``, a folder's with all that are in it."""
    roots = [ROOT / place for place in places]
    found = [path for root in roots for path in ([root] if root.is_file() else root.rglob("*"))]
    return sorted(
        path for path in found if path.suffix in suffixes and "__pycache__" not in path.parts
    )


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text())


def classes_in(*places: str) -> Iterator[ast.ClassDef]:
    """All classes at these ``places``."""
    for path in files_of(*places):
        yield from (node for node in ast.walk(parsed(path)) if isinstance(node, ast.ClassDef))


def fields_of(record: ast.ClassDef) -> list[str]:
    """The names of the annotated fields of a class."""
    given = (each.target for each in record.body if isinstance(each, ast.AnnAssign))
    return [target.id for target in given if isinstance(target, ast.Name)]


def methods_of(record: ast.ClassDef) -> dict[str, ast.FunctionDef]:
    """The methods of a class by name."""
    return {each.name: each for each in record.body if isinstance(each, ast.FunctionDef)}


def bounce_loops() -> int:
    """Loops of kernels over the bounces of paths: their variable is ``bounce``, or their range ends
    at ``bounces``.
    """
    loops = (node for path in files_of("isogi_core/kernels") for node in ast.walk(parsed(path)))
    return sum("bounce" in ast.unparse(each.target) for each in loops if isinstance(each, ast.For))


def point_records() -> int:
    """Classes whose fields hold both points and normals: records of points on surfaces."""
    records = [fields_of(each) for each in classes_in("isogi_core")]
    return sum(
        any("normal" in each for each in names) and any(map(POINTS.match, names))
        for names in records
    )


POINTS = re.compile("(points?|positions?|origins?|places?)$")
"""Names of fields that hold points."""


def converging() -> int:
    """Classes of frames with a ``step`` that answers whether the picture changed: machines that
    converge.
    """
    steps = (methods_of(each).get("step") for each in classes_in("isogi_core/frame"))
    return sum(
        step is not None and step.returns is not None and ast.unparse(step.returns) == "bool"
        for step in steps
    )


def fields_in(name: str, place: str) -> int:
    """How many fields the class of this ``name`` has."""
    return max(len(fields_of(each)) for each in classes_in(place) if each.name == name)


def shared_names() -> int:
    """Names of functions at the top of three modules of the product or more."""
    return sum(len(files) >= 3 for files in top_names(ast.FunctionDef).values())


def common_constants() -> int:
    """Constants at the top of modules whose name is one word, in two modules or more: it does not
    say of what.
    """
    return sum(
        len(files) >= 2
        for name, files in top_names(ast.Assign).items()
        if re.fullmatch("[A-Z]+", name)
    )


def top_names(kind: type[ast.stmt]) -> dict[str, set[Path]]:
    """The modules of the product in which a name is given to a statement of this ``kind`` at the
    top.
    """
    found: dict[str, set[Path]] = defaultdict(set)
    for path in files_of(*PRODUCT):
        for node in parsed(path).body:
            if isinstance(node, kind):
                for name in names_given(node):
                    found[name].add(path)
    return found


def names_given(node: ast.stmt) -> list[str]:
    """The names that a definition or an assignment gives."""
    if isinstance(node, ast.Assign):
        parts = (
            target.elts if isinstance(target, ast.Tuple) else [target] for target in node.targets
        )
        return [each.id for each in chain.from_iterable(parts) if isinstance(each, ast.Name)]
    if isinstance(node, ast.FunctionDef):
        return [node.name]
    return []


def knob_places(knob: str) -> int:
    """Files between a scene file and a picture that name a ``knob``."""
    places = files_of(*KNOB_FOLDERS, suffixes=(".py", ".js", ".html", ".ts"))
    return sum(re.search(rf"\b{knob}\b", path.read_text()) is not None for path in places)


def imported_constants() -> int:
    """Constants of the product that tests import, each counted once."""
    return len(
        {
            (node.module, each.name)
            for path in files_of("tests")
            for node in ast.walk(parsed(path))
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("isogi")
            for each in node.names
            if re.fullmatch("_?[A-Z][A-Z0-9_]+", each.name)
        }
    )


def private_attributes() -> int:
    """Places in tests that touch an attribute whose name begins with one underscore, those of
    ``self`` and ``cls`` left out.
    """
    return sum(
        isinstance(node, ast.Attribute)
        and re.match("_[^_]", node.attr) is not None
        and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))
        for path in files_of("tests")
        for node in ast.walk(parsed(path))
    )


def modules() -> int:
    """Modules of the product, ``__init__`` left out."""
    return sum(path.name != "__init__.py" for path in files_of(*PRODUCT))


def lines_of(*places: str, suffixes: tuple[str, ...] = (".py",)) -> int:
    """Lines of all files at these ``places``."""
    return sum(path.read_bytes().count(b"\n") for path in files_of(*places, suffixes=suffixes))


def render_trace() -> str:
    """Files of the core that one render of a demo calls into, and how often a call leads back into
    one it had left.
    """
    calls = traced(render_demo())
    stays = [name for before, name in pairwise(["", *calls]) if name != before]
    return f"{len(stays) - len(set(stays))} returns, {len(set(stays))} files"


def render_demo() -> Callable[[], object]:
    """What renders a new view of a demo, after another one has loaded kernels and prepared the
    scene.
    """
    from isogi_core.cache.scene_caches import Caches  # noqa: PLC0415  kernels load when counts of source are printed
    from isogi_core.frame.renderer import Renderer  # noqa: PLC0415
    from isogi_core.frame.tiles import Tiles  # noqa: PLC0415
    from isogi_core.model.view import View  # noqa: PLC0415
    from isogi_core.plan.assembly import load_scene  # noqa: PLC0415
    from isogi_core.prepared.prepared_scene import PreparedScene  # noqa: PLC0415

    scene = load_scene("demo:orbital")
    renderer = Renderer(Caches(PreparedScene(scene), tempfile.mkdtemp(), 1 << 26), Tiles(1))
    views = [
        View(
            scene.isovalue,
            scene.camera(azimuth, 20.0, 3.0, 30.0),
            width=RENDER_SIZE,
            height=RENDER_SIZE,
        )
        for azimuth in (30.0, 60.0)
    ]
    renderer.render(views[0])
    return partial(renderer.render, views[1])


def traced(work: Callable[[], object]) -> list[str]:
    """The files of the core whose functions are called in this thread while ``work`` runs, in order
    of the calls.
    """
    calls: list[str] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and "/isogi_core/" in frame.f_code.co_filename:
            calls.append(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return calls


COUNTS: dict[str, Callable[[], object]] = {
    "loops over bounces": bounce_loops,
    "records of points with normals": point_records,
    "classes that converge step by step": converging,
    "fields of Frame": lambda: fields_in("Frame", "isogi_core/frame"),
    "fields of Scene": lambda: fields_in("Scene", "isogi_core/plan"),
    "calls of one render": render_trace,
    "function names in three modules or more": shared_names,
    "constants of one word in two modules or more": common_constants,
    "files that name the knob roughness": lambda: knob_places("roughness"),
    "constants of the product that tests import": imported_constants,
    "private attributes that tests touch": private_attributes,
    "modules of the product": modules,
    "lines of the product": lambda: lines_of(*PRODUCT),
    "lines of the page": lambda: lines_of("web", suffixes=(".js", ".css", ".html")),
    "lines of the tests": lambda: lines_of("tests", suffixes=(".py", ".mjs")),
}

if __name__ == "__main__":
    main()
