"""Files of pages as browsers get them: modules joined into one script, style sheets into one,
shaders into one; each compressed once.
"""

import hashlib
import json
import mimetypes
import posixpath
import re
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import isogi_web

WEB_FOLDER = Path(isogi_web.__file__).resolve().parent
FIRST_MODULE = "main.js"
"""The first module of the server's page."""

SHADERS = "card/shaders.json"
"""The file with the source of all shaders, by name."""

SUFFIXES = {".js", ".css", ".glsl", ".svg", ".html"}
"""Suffixes of files that browsers may ask for."""

LEVEL = 9
GZIP_BITS = 31
"""Level of gzip, as each file is compressed only once; and what zlib takes for gzip's form, with
its largest window.
"""

MODULE_IMPORT = re.compile(r'^(?:import|export) [^;]*?from "(\.[^"]+)";$', re.MULTILINE)
"""Imports and re-exports of a module, as the page's modules write them."""

IMPORT = re.compile(r'^import (\{[^}]*\}) from "(\.[^"]+)";\n', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:async )?(?:class|const|function)\b\*? ?(\w+))", re.MULTILINE)
COMMENT = re.compile(r"^[ \t]*/\*\*(?:[^*]|\*(?!/))*\*/[ \t]*\n|^[ \t]*//[^\n]*\n", re.MULTILINE)
STYLE_LINK = re.compile(r'^ *<link rel="stylesheet" href="web/([^"]+)">\n', re.MULTILINE)
SCRIPT = re.compile(r'(?<=<script type="module" src=")web/[^"]+')


@dataclass(frozen=True)
class PageFile:
    """The ``content`` of a file, and its media type. The name of a ``lasting`` file contains
    the digest of its content.
    """

    content: bytes
    media_type: str
    lasting: bool = False

    @cached_property
    def packed(self) -> bytes:
        """Return the content compressed by gzip."""
        return compressed(self.content)

    @cached_property
    def digest(self) -> str:
        """Return a digest of the content."""
        return digest_of(self.content)


def compressed(content: bytes, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> bytes:
    """Compress a file by gzip, without its time, so that equal content gives equal bytes.

    ``strategy`` is one of zlib's: Z_FILTERED for noisy numbers, as most repetitions of their bytes
    happen by chance and cost more than they save.
    """
    packing = zlib.compressobj(LEVEL, wbits=GZIP_BITS, strategy=strategy)
    return packing.compress(content) + packing.flush()


def digest_of(content: bytes) -> str:
    """Return a digest of some content, 16 hexadecimal digits."""
    return hashlib.blake2b(content, digest_size=8).hexdigest()


def viewer_files() -> dict[str, PageFile]:
    """Return the files of the server's page by their addresses, ``index.html`` included.

    They are read again if one has changed since the last call. A file that was added meanwhile is
    left out until the server restarts.
    """
    return prepared(tuple((name, stamp_of(WEB_FOLDER / name)) for name in names_of(WEB_FOLDER)))


@lru_cache(maxsize=1)
def names_of(folder: Path) -> tuple[str, ...]:
    """Return the relative paths of the files of a folder that browsers may ask for, as they were
    at the first call.
    """
    found = (path for path in folder.rglob("*") if path.suffix in SUFFIXES)
    return tuple(sorted(path.relative_to(folder).as_posix() for path in found))


def stamp_of(path: Path) -> tuple[int, int]:
    """Return a value that changes if the file does: its time and size."""
    facts = path.stat()
    return facts.st_mtime_ns, facts.st_size


@lru_cache(maxsize=1)
def prepared(stamps: tuple[tuple[str, tuple[int, int]], ...]) -> dict[str, PageFile]:
    """Return the files of the server's page by their addresses, ``index.html`` included.

    ``stamps`` are pairs of the relative path of a file to read and its ``stamp_of``. The result of
    the last call is kept, and returned again for equal stamps.
    """
    files = {f"web/{name}": file_of(name, (WEB_FOLDER / name).read_bytes()) for name, _ in stamps}
    files[f"web/{SHADERS}"] = file_of(SHADERS, json.dumps(shaders()).encode())
    page = (WEB_FOLDER / "index.html").read_text(encoding="utf-8")
    # A joined file has its digest in its name, so that browsers keep it for ever.
    style = joined_styles(STYLE_LINK.findall(page)).encode()
    script = joined_modules(FIRST_MODULE).encode()
    style_name = f"web/page-{digest_of(style)}.css"
    script_name = f"web/page-{digest_of(script)}.js"
    files[style_name] = file_of(style_name, style, lasting=True)
    files[script_name] = file_of(script_name, script, lasting=True)
    # The page names these in place of the files that they are joined from. The first link becomes
    # that of the joined style sheet; then all other links are removed.
    link = f'  <link rel="stylesheet" href="{style_name}">\n'
    page = STYLE_LINK.sub(link, page, count=1)
    page = STYLE_LINK.sub(lambda found: link if found[0] == link else "", page)
    page = SCRIPT.sub(script_name, page)
    files["index.html"] = file_of("index.html", page.encode())
    return files


def file_of(name: str, content: bytes, lasting: bool = False) -> PageFile:
    """Return a file with the media type of its name."""
    kind = mimetypes.guess_type(name)[0] or "text/plain"
    if kind.startswith("text/"):
        kind += "; charset=utf-8"
    return PageFile(content, kind, lasting)


def shaders() -> dict[str, str]:
    """Return the source of all shaders of the card, by name."""
    folder = WEB_FOLDER / "card" / "shaders"
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(folder.iterdir())}


def joined_styles(names: Iterable[str]) -> str:
    """Return style sheets, one after the other."""
    return "\n".join((WEB_FOLDER / name).read_text(encoding="utf-8") for name in names)


def joined_modules(first: str) -> str:
    """Return a module and all that it imports as one script of type ``module``, to be placed at the
    root of the page's folder.

    Each module becomes a function that is called once, after those that it imports, and returns its
    exports. Comments above exports are left out.
    """
    parts = [wrapped(name) for name in module_order(first)]
    return "".join(parts)


def module_order(first: str) -> list[str]:
    """Return a module and all that it imports, each after its own imports."""
    order: list[str] = []

    def visit(name: str) -> None:
        if name in order:
            return
        # Depth first: imports come before the module.
        for each in imports(name):
            visit(each)
        order.append(name)

    visit(first)
    return order


def imports(name: str) -> list[str]:
    """Return the modules that a module of the page imports."""
    text = (WEB_FOLDER / name).read_text(encoding="utf-8")
    folder = posixpath.dirname(name)
    return [joined_path(folder, each) for each in MODULE_IMPORT.findall(text)]


def joined_path(folder: str, path: str) -> str:
    """Resolve a relative ``path`` in a module of a ``folder``."""
    return posixpath.normpath(posixpath.join(folder, path))


def wrapped(name: str) -> str:
    """Return a module as a constant that holds its exports, and reads those of other modules."""
    text = (WEB_FOLDER / name).read_text(encoding="utf-8")
    folder = posixpath.dirname(name)

    def constant(found: re.Match[str]) -> str:
        taken = found[1].replace(" as ", ": ")
        return f"const {taken} = {constant_of(joined_path(folder, found[2]))};\n"

    # Imports become destructured constants; exports become members of the returned object.
    text = IMPORT.sub(constant, COMMENT.sub("", text))
    text = text.replace("import.meta.url", f'new URL("{name}", import.meta.url).href')
    names = ", ".join(EXPORT.findall(text))
    body = EXPORT.sub("", text)
    return f"const {constant_of(name)} = (() => {{\n{body}return {{ {names} }};\n}})();\n"


def constant_of(name: str) -> str:
    """Return the name of the constant that holds a module's exports."""
    return "_" + re.sub(r"\W", "_", name.removesuffix(".js"))
