"""The shaders in Mesa's compiler, a second one beside the browser's: in a context without window or
browser.
"""

import ctypes
import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.web.card.lab import WEB

SURFACELESS = 0x31DD
ES_API = 0x30A0
ES3 = 0x40
RENDERABLE = 0x3040
SURFACE = 0x3033
VERSION = 0x3098
END = 0x3038
VERTEX = 0x8B31
FRAGMENT = 0x8B30
COMPILED = 0x8B81
LINKED = 0x8B82
RENDERER = 0x1F01
HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\n"
SCREEN = f"{HEAD}void main() {{ gl_Position = vec4(float(gl_VertexID)); }}"

VIEW = {
    "VOXELS": "highp usampler3D",
    "SMOOTH": 1,
    "RATIOS": 1,
    "LOBES": 3,
    "SHINE": 0,
    "SHADING": 1,
    "COLOURS": 0,
}
LOCAL = {**VIEW, "LOBES": 0, "SHADING": 0, "SHADOW": 0, "FOG": 0, "HIGHLIGHT": 0}
FOLD = {"RATIOS": 1, "NUMBERS": 41, "COLUMNS": 41, "TERMS": 3, "STRAIGHT": 25, "WHOLE": 0}
SHADERS: dict[str, tuple[str, dict[str, Any]]] = {
    "light": ("view.frag.glsl", VIEW),
    "constant light": ("view.frag.glsl", {**VIEW, "RATIOS": 0, "LOBES": 0}),
    "plain gradient of floats": (
        "view.frag.glsl",
        {**VIEW, "VOXELS": "highp sampler3D", "SMOOTH": 0},
    ),
    "colours of values": ("view.frag.glsl", {**VIEW, "COLOURS": 1}),
    "colours of labels": ("view.frag.glsl", {**VIEW, "COLOURS": 2}),
    "shine": ("view.frag.glsl", {**VIEW, "SHINE": 1}),
    "energy of shine": ("energy.frag.glsl", {}),
    "several surfaces": ("view.frag.glsl", {**VIEW, "LOBES": 0, "SURFACES": 4}),
    "local model of several surfaces": ("view.frag.glsl", {**LOCAL, "SURFACES": 2}),
    "local model": ("view.frag.glsl", LOCAL),
    "local model with a shadow and a highlight": (
        "view.frag.glsl",
        {**LOCAL, "SHADOW": 1, "HIGHLIGHT": 1},
    ),
    "local model in fog": ("view.frag.glsl", {**LOCAL, "FOG": 1}),
    "fold": ("fold.frag.glsl", FOLD),
    "fold of irradiance": (
        "fold.frag.glsl",
        {**FOLD, "NUMBERS": 3, "COLUMNS": 1, "TERMS": 1, "STRAIGHT": 1, "WHOLE": 1},
    ),
    "filter": ("filter.frag.glsl", {**VIEW, "RATIOS": 1}),
    "filter of light as it is": ("filter.frag.glsl", {**VIEW, "RATIOS": 0}),
    "show": ("show.frag.glsl", {}),
    "show of several surfaces": ("show.frag.glsl", {"SURFACES": 2}),
}


def integers(*values: int) -> Any:
    return (ctypes.c_int * len(values))(*values)


def open_context() -> ctypes.CDLL | None:
    """OpenGL ES 3 in software with a context that is current; None where this machine has none."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
        gles = ctypes.CDLL("libGLESv2.so.2")
    except OSError:
        return None
    pointer = ctypes.c_void_p
    for function, kinds in (
        (egl.eglGetPlatformDisplay, [ctypes.c_uint, pointer, pointer]),
        (egl.eglCreateContext, [pointer] * 4),
    ):
        function.restype = pointer
        function.argtypes = kinds
    egl.eglInitialize.argtypes, egl.eglMakeCurrent.argtypes = [pointer] * 3, [pointer] * 4
    egl.eglChooseConfig.argtypes = [pointer, pointer, pointer, ctypes.c_int, pointer]
    display = egl.eglGetPlatformDisplay(SURFACELESS, None, None)
    config = pointer()
    count = ctypes.c_int()
    if not display or not egl.eglInitialize(display, None, None) or not egl.eglBindAPI(ES_API):
        return None
    wished = integers(RENDERABLE, ES3, SURFACE, 0, END)
    egl.eglChooseConfig(display, wished, ctypes.byref(config), 1, ctypes.byref(count))
    if count.value:
        context = egl.eglCreateContext(display, config, None, integers(VERSION, 3, END))
    else:
        context = None
    if context and egl.eglMakeCurrent(display, None, None, context):
        return gles
    return None


@pytest.fixture(scope="module")
def mesa() -> Iterator[ctypes.CDLL]:
    """OpenGL ES by llvmpipe."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
        gles = open_context()
        if gles is None:
            pytest.skip(
                "no OpenGL ES 3 without a window: install Debian's libegl1, libgles2 and "
                "libgl1-mesa-dri"
            )
        yield gles


def joined(name: str, seen: set[str]) -> str:
    """The text of a shader with what it includes, each file once."""
    if name in seen:
        return ""
    seen.add(name)
    text = (WEB / "card" / "shaders" / name).read_text()
    return re.sub(
        r'^#include "([^"]+)"$', lambda found: joined(found[1], seen), text, flags=re.MULTILINE
    )


def log_of(gles: ctypes.CDLL, kind: str, number: int) -> str:
    words = ctypes.create_string_buffer(4096)
    getattr(gles, f"glGet{kind}InfoLog")(number, len(words), None, words)
    return words.value.decode()


def shader_of(gles: ctypes.CDLL, kind: int, text: str) -> int:
    """A shader; fails with the compiler's words where it refuses the text."""
    shader = int(gles.glCreateShader(kind))
    done = ctypes.c_int()
    gles.glShaderSource(shader, 1, ctypes.byref(ctypes.c_char_p(text.encode())), None)
    gles.glCompileShader(shader)
    gles.glGetShaderiv(shader, COMPILED, ctypes.byref(done))
    assert done.value, log_of(gles, "Shader", shader)
    return shader


@pytest.mark.parametrize("name", SHADERS)
def test_mesa_compiles_what_browsers_do(mesa: ctypes.CDLL, name: str) -> None:
    file, defines = SHADERS[name]
    head = HEAD + "".join(f"#define {key} {value}\n" for key, value in defines.items())
    program = mesa.glCreateProgram()
    done = ctypes.c_int()
    for shader in (
        shader_of(mesa, VERTEX, SCREEN),
        shader_of(mesa, FRAGMENT, head + joined(file, set())),
    ):
        mesa.glAttachShader(program, shader)
    mesa.glLinkProgram(program)
    mesa.glGetProgramiv(program, LINKED, ctypes.byref(done))
    assert done.value, log_of(mesa, "Program", program)


def test_mesa_refuses_what_is_wrong(mesa: ctypes.CDLL) -> None:
    with pytest.raises(AssertionError, match="nowhere"):
        shader_of(mesa, FRAGMENT, HEAD + "out vec4 found; void main() { found = nowhere; }")
