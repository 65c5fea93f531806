"""Scenes and pictures of the Python interface: see ``isogi.open``."""

import io
import json
import shutil
import tempfile
import tomllib
import weakref
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from PIL import Image

from isogi_core.errors import SceneError, VolumeError
from isogi_core.files.coordinates import along, direction_of, is_even, role_of, roles_of
from isogi_core.files.scene_file import SceneSource, as_written, find_source
from isogi_core.model.lights import ENVIRONMENTS
from isogi_core.plan.scene import Scene as CoreScene
from isogi_core.storage.atomic_file import write_whole
from isogi_server.cli import export as exporting
from isogi_server.cli import publish, publish_live
from isogi_server.cli.render import Drawn, draw, format_of, working
from isogi_server.parameters import FrameParams, read
from isogi_server.progress import open_scene as load
from isogi_server.render.engine import RenderEngine
from isogi_server.render.scene_variant import Change, SceneVariant
from isogi_server.render.variants import Variants
from isogi_server.settings import Settings
from isogi_server.views import turn_baked, with_first_view

if TYPE_CHECKING:
    from isogi.client import Isogi

Value = float | str | Sequence[float]
"""A parameter of a view: a number, a word, or numbers such as ``target=(10, 20, 5)``."""


def open_scene(
    source: Any,
    light: str | Path | Mapping[str, Any] | Sequence[Mapping[str, Any]] | None,
    spacing: Sequence[float] | None,
    store: str | Path | None,
    workers: int | None,
    keys: Mapping[str, Any],
) -> "Scene":
    """Open a scene: see ``isogi.open``."""
    given = {key: plain(value) for key, value in keys.items()}
    folder = None
    if not isinstance(source, str | Path):
        folder, source, found = kept_array(source)
        spacing = spacing or found
    if spacing is not None:
        given["spacing"] = [float(length) for length in spacing]
    given.update(light_keys(light))
    work: dict[str, Any] = {"store": None if store is None else str(store), "workers": workers}
    settings = Settings(**{name: value for name, value in work.items() if value is not None})
    try:
        return Scene(find_source(source, given), settings, folder)
    except BaseException:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def kept_array(source: Any) -> tuple[str, str, Sequence[float] | None]:
    """Write an array to a file in a new folder; return the folder, the file, and the spacing of
    its voxels if the array has coordinates.

    An xarray is written with its axes as z, y, x, along coordinates that grow, so that it is no
    mirror image. Raises VolumeError if it is no array of three dimensions.
    """
    array = np.asarray(source)
    if array.ndim != 3 or array.dtype.kind not in "biuf":
        raise VolumeError(
            f"isogi opens arrays of three dimensions (z, y, x) and plain numbers; this one has the "
            f"shape {array.shape} and the type {array.dtype}."
        )
    spacing = None
    if hasattr(source, "coords") and hasattr(source, "dims"):
        spacing = spacing_of(source)
        names = axes_of(source)
        array = np.transpose(array, [source.dims.index(name) for name in names])
        array = np.flip(array, tuple(n for n, name in enumerate(names) if falls(source, name)))
    folder = tempfile.mkdtemp(prefix="isogi-array-")
    path = Path(folder) / "array.npy"
    np.save(path, array.astype(np.uint8) if array.dtype.kind == "b" else array)
    return folder, str(path), spacing


def spacing_of(array: Any) -> list[float] | None:
    """Return the spacing (x, y, z) of an xarray from its coordinates; None if it has none.

    Raises VolumeError if the coordinates of a dimension are not even.
    """
    steps = []
    for name in reversed(axes_of(array)):
        if name not in array.coords or array.sizes[name] < 2:
            return None
        places = np.asarray(array.coords[name], np.float64)
        if not is_even(places):
            raise VolumeError(
                f"The coordinates '{name}' are not evenly spaced: resample the array, or give "
                "spacing=(x, y, z)."
            )
        steps.append(abs(float(places[-1] - places[0])) / (places.size - 1))
    return steps


def axes_of(array: Any) -> list[Any]:
    """Return the names of an xarray's dimensions in the order z, y, x, as names and attributes of
    coordinates tell; dimensions that tell nothing are in this order already.
    """
    roles = roles_of([role_of(str(name), attributes_of(array, name)) for name in array.dims])
    if sorted(roles) != ["x", "y", "z"]:
        return list(array.dims)
    return [array.dims[roles.index(role)] for role in "zyx"]


def attributes_of(array: Any, name: Any) -> Mapping[str, Any]:
    """Return the attributes of the coordinates along a dimension; none without coordinates."""
    return getattr(array.coords[name], "attrs", {}) if name in array.coords else {}


def falls(array: Any, name: Any) -> bool:
    """Return True if voxels go back along a dimension, by its coordinates and their direction."""
    if name not in array.coords:
        return False
    axis = along(array.coords[name], attributes_of(array, name))
    return direction_of(axis) < 0.0


def light_keys(light: Any) -> dict[str, Any]:
    """Return the keys of a scene file for a ``light``: see ``isogi.open``."""
    if light is None:
        return {}
    if isinstance(light, Mapping):
        return {"lights": [plain(light)]}
    if not isinstance(light, str | Path):
        return {"lights": [plain(each) for each in light]}
    if str(light) in ENVIRONMENTS:
        return {"environment": str(light)}
    return {"environment": str(Path(light).expanduser().resolve())}


def plain(value: Any) -> Any:
    """Return a value of Python as TOML would give it: dicts for mappings, lists for sequences and
    arrays, and texts for Paths, made absolute from the working directory.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, Path):
        return str(value.expanduser().resolve())
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value


def texts(view: Mapping[str, Value | None]) -> dict[str, str]:
    """Return the parameters of a view as the command line takes them; None leaves one out."""
    return {name: text_of(value) for name, value in view.items() if value is not None}


def text_of(value: Value) -> str:
    """Return a parameter as text: numbers with all their digits, several with commas."""
    if isinstance(value, str):
        return value
    return ",".join(repr(number) for number in np.atleast_1d(value).tolist())


class Scene:
    """A volume with its isosurface, material and light, made by ``isogi.open``.

    Its workers start with the first picture and end with ``close``, at the end of a ``with`` block,
    or when nobody holds the scene any more. Light that was baked stays in the store.
    """

    def __init__(self, source: SceneSource, settings: Settings, folder: str | None = None) -> None:
        """Open a ``source``; ``folder`` holds an array's file, and is removed at the end."""
        self._source = source
        self._settings = settings
        self._work = ExitStack()
        self._engine: RenderEngine | None = None
        self._variants: Variants | None = None
        self._scene: CoreScene = load(source, settings)
        if folder is not None:
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        weakref.finalize(self, self._work.close)

    @property
    def isovalue(self) -> float:
        """The isovalue that is shown if a picture names none, in the units of the file."""
        return float(self._scene.isovalue)

    @property
    def isovalues(self) -> tuple[float, float]:
        """The least and the greatest isovalue."""
        return self._scene.isovalues

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along z, y and x."""
        x, y, z = self._scene.volume.size
        return z, y, x

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Distance between voxels along x, y and z, in the unit of the file."""
        x, y, z = self._scene.volume.spacing
        return float(x), float(y), float(z)

    def render(
        self, *, error: float | None = None, time: float | None = None, **view: Value | None
    ) -> "Picture":
        """Draw a picture.

        ``view`` takes what ``isogi render`` does: ``isovalue``, ``azimuth``, ``elevation``,
        ``distance``, ``width``, ``height``, ``yaw``, ``albedo``, ``shading`` and so on. The camera
        shows the whole surface if nothing places it. The picture is done at the relative ``error``
        (default: that of the scene, usually 0.02), or after ``time`` seconds with what there is.

        Raises ViewError for parameters, StoreError and WorkersError if light cannot be baked. An
        interrupt ends the workers, and leaves nothing behind but light.
        """
        knobs = texts(view | ({} if error is None else {"max_error": error}))
        knobs = dict(with_first_view(self._scene, knobs))
        try:
            engine = self._started()
            shown = self._turned(engine, knobs)
            drawn = draw(engine, shown, knobs, self._settings, seconds=time)
        # After an error, and an interrupt above all, no worker is to go on; the next picture starts
        # others.
        except BaseException:
            self.close()
            raise
        return Picture(drawn)

    def export(
        self,
        path: str | Path,
        *,
        isovalue: float | None = None,
        error: float | None = None,
        coefficients: bool = False,
        **view: Value | None,
    ) -> Path:
        """Write the isosurface with its light (``.ply``, ``.glb``, ``.obj``, ``.usdz``), or values
        and light of the lattice (``.vti``, ``.nrrd``, ``.nii.gz``, ``.ome.zarr``); return the path.

        ``coefficients`` adds the harmonics of the light. ``view`` may turn the light and set the
        albedo. Raises ViewError, SceneError, VolumeError, StoreError, WorkersError and OSError.
        """
        # The export starts an engine with workers: two sets of workers would share the cores.
        self.close()
        request = exporting.ExportRequest(
            Path(path),
            () if isovalue is None else (repr(float(isovalue)),),
            None if error is None else repr(error),
            None,
            coefficients,
        )
        exporting.export(self._source, request, texts(view), self._settings)
        return Path(path)

    def publish(
        self,
        path: str | Path,
        *,
        isovalues: tuple[float, float] | None = None,
        error: float | None = None,
        caption: str | None = None,
        megabytes: float | None = None,
        **view: Value | None,
    ) -> Path:
        """Write a page that needs no server: a folder, or one file that ends in ``.html``; return
        its path.

        With ``isovalues=(first, last)``, or as one file, it draws by the visitor's graphics card,
        within ``megabytes``. Else it leafs through pictures of the parameters that are given as
        ``"first:last:step"``, by default around the object. Raises as ``export`` does.
        """
        self.close()
        interactive = isovalues is not None or Path(path).suffix.lower() in publish.PAGE_SUFFIXES
        knobs = texts(view)
        if isovalues is not None:
            first, last = isovalues
            knobs["isovalue"] = f"{float(first)!r}:{float(last)!r}"
        request = publish.PageRequest(
            output=Path(path), target_error=error, megabytes=megabytes, caption=caption
        )
        write = publish_live.publish if interactive else publish.publish
        write(self._source, request, knobs, self._settings)
        return Path(path)

    def serve(self, **settings: Any) -> "Isogi":
        """Start a server of this scene and return a client of it; ``close`` of the client ends it.

        ``settings`` are those of ``isogi serve``, such as ``port=8000``. The page is at the
        client's address. Needs ``pip install 'isogi[client]'``.
        """
        from isogi.client import Isogi  # noqa: PLC0415 (an optional dependency)

        self.close()
        folder = tempfile.mkdtemp(prefix="isogi-scene-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        path = Path(folder) / f"{self._source.name}.toml"
        path.write_text(toml_of(self._source), encoding="utf-8")
        given = {"store": self._settings.store, "workers": self._settings.workers, **settings}
        client = Isogi.serving(
            path, **{key: each for key, each in given.items() if each is not None}
        )
        # The server reads the scene's files: they go with the client, and not before.
        client._kept = self
        return client

    def close(self) -> None:
        """End the workers, once they have written their light; the next picture starts others."""
        self._engine = None
        self._variants = None
        self._work.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        """One line, such as ``Scene(engine, 256 × 256 × 128 voxels, isovalue 70)``."""
        size = " × ".join(map(str, self._scene.volume.size))
        isovalue = self._scene.volume.spell(self.isovalue)
        return f"Scene({self._source.name}, {size} voxels, isovalue {isovalue})"

    def _started(self) -> RenderEngine:
        """Return the engine; start it and its workers if there is none."""
        if self._engine is None:
            self._engine = self._work.enter_context(working(self._scene, self._settings))
        return self._engine

    def _turned(self, engine: RenderEngine, knobs: Mapping[str, str]) -> CoreScene:
        """Return the scene in the turned light that ``knobs`` ask for, if its light is baked for
        each turn; else the scene.
        """
        turn = turn_baked(self._scene, read(FrameParams, knobs.items()))
        variant = SceneVariant.of(self._scene, Change(turn=turn))
        if not variant.any:
            return self._scene
        if self._variants is None:
            self._variants = Variants(engine, lambda _: None)
        return self._variants.make(self._scene, variant, None)


class Picture:
    """A picture that was drawn, with its light and its error. Notebooks show it."""

    def __init__(self, drawn: Drawn) -> None:
        """Hold the picture ``drawn``."""
        self._drawn = drawn

    @property
    def error(self) -> float:
        """Relative error of the whole picture, root mean square over the surface: measured by
        control pixels if light is everywhere, else estimated.
        """
        return float(self._drawn.facts["error"])

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval of ``error``; None while it is not measured."""
        return self._drawn.facts["interval"]

    @property
    def final(self) -> bool:
        """True if the picture has reached the error that it was to have."""
        return self._drawn.facts["stopped"] == "target"

    @property
    def facts(self) -> dict[str, Any]:
        """The facts of the picture, as ``isogi render --json`` prints them."""
        return dict(self._drawn.facts)

    @cached_property
    def radiance(self) -> np.ndarray:
        """Linear radiance (height, width, 3) float32, row 0 at the top; 0 off the surface."""
        return np.asarray(self._drawn.frame.radiance)

    @cached_property
    def positions(self) -> np.ndarray:
        """Positions of the surface in the world (height, width, 3), in the file's unit; NaN off
        it.
        """
        frame = self._drawn.frame
        places = frame.positions(0, frame.state.shape[0])
        return np.where(self.mask[..., None], places, np.nan)

    @cached_property
    def errors(self) -> np.ndarray:
        """Estimated relative standard error of each pixel (height, width)."""
        return np.asarray(self._drawn.frame.total_error)

    @cached_property
    def mask(self) -> np.ndarray:
        """True for pixels that show the surface (height, width)."""
        return np.asarray(self._drawn.frame.state > 0)

    @cached_property
    def image(self) -> Image.Image:
        """The picture as Pillow has it: tone-mapped sRGB."""
        return Image.open(io.BytesIO(self._png))

    @cached_property
    def _png(self) -> bytes:
        return self._drawn.encoded("png")

    def save(self, path: str | Path) -> Path:
        """Write the picture as ``.png``, ``.jpg``, ``.webp`` or ``.npy`` (linear radiance, mask,
        state, error and position); return the path.

        Raises ViewError for other suffixes, and OSError.
        """
        path = Path(path)
        write_whole(path, self._drawn.encoded(format_of(path)))
        return path

    def _repr_png_(self) -> bytes:
        """The picture, as notebooks show it."""
        return self._png

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """The picture's pixels, for NumPy and Matplotlib."""
        return np.asarray(self.image, dtype)

    def __repr__(self) -> str:
        """One line, such as ``Picture(640 × 480, final, 1.8 % error)``."""
        height, width = self._drawn.frame.state.shape
        state = "final" if self.final else "provisional"
        note = self._drawn.facts["note"]
        return (
            f"Picture({width} × {height}, {note or f'{state}, {100.0 * self.error:.2g} % error'})"
        )


def toml_of(source: SceneSource) -> str:
    """Return a scene's document as the text of a scene file that may lie anywhere: paths of files
    that are there become absolute.
    """
    document = as_written(source.document)
    lines = [f"{key} = {toml_value(value, source.base)}" for key, value in document.items()]
    text = "\n".join(lines) + "\n"
    if tomllib.loads(text).keys() != document.keys():
        raise SceneError(f"The scene '{source.name}' cannot be written as a file.")
    return text


def toml_value(value: Any, base: Path) -> str:
    """Return a value of a document as TOML. A text that names a file or folder, as seen from the
    folder ``base`` of the scene file, becomes its absolute path.
    """
    if isinstance(value, Mapping):
        parts = ", ".join(
            f"{toml_text(str(key))} = {toml_value(each, base)}" for key, each in value.items()
        )
        return f"{{ {parts} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(each, base) for each in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    # A # and the choice of a part of the file may follow its name, as in "scan.h5#time=3"; a name
    # may have a # itself.
    text = str(value)
    for name, mark, part in ((text, "", ""), text.rpartition("#"), text.partition("#")):
        if name and (base / name).exists():
            text = f"{(base / name).resolve()}{mark}{part}"
            break
    return toml_text(text)


def toml_text(text: str) -> str:
    """Return a text as a basic string of TOML, which has the escapes of JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
