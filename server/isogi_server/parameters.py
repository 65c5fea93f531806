"""The query parameters of all resources, as models that are checked when they are read."""

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any, NamedTuple, Self, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from isogi_core.errors import advice
from isogi_core.files.vector import Vector
from isogi_core.frame.card.blocks import CHUNKS
from isogi_core.frame.card.chunk_texels import is_inside
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.view import Quaternion
from isogi_core.prepared.prepared_scene import Index
from isogi_server.errors import ParameterError, UnknownPartError
from isogi_server.knobs import KNOBS, LONGEST_SIDE
from isogi_server.values import LONGEST_SECONDS, Choice, Rows, Span

FORMATS = ("png", "jpeg", "webp", "npy")
VERSION_PATTERN = r"^[0-9a-f]{32}$"

ORBIT = ("azimuth", "elevation", "distance")
ANGLES = ("yaw", "pitch", "roll")


def knob(name: str, **changes: Any) -> Any:
    """Return the model field of a row of KNOBS, with ``changes`` to the row."""
    row = replace(KNOBS[name], **changes)
    field = Field(row.default, description=row.text)
    field.metadata.append(row.kind)
    return field


class NoParams(BaseModel):
    """Parameters of a resource that reads none; any parameter is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class LightParams(NoParams):
    """The environment that a scene is shown in."""

    environment: str | None = knob("environment")


class VariantParams(LightParams):
    """The variant of a scene: environment, cut, time step, smoothing, pinned surfaces, hidden
    labels, material.
    """

    cut: str | None = knob("cut")
    time: int | None = knob("time")
    smooth: float | None = knob("smooth")
    surfaces: str | None = knob("surfaces")
    hide: str | None = knob("hide")
    material: str | None = knob("material")


class ViewParams(VariantParams):
    """A view: surface, camera, light and picture. Parameters that are left out take the scene's
    defaults.
    """

    isovalue: float | str | None = knob("isovalue")
    azimuth: float = knob("azimuth")
    elevation: float = knob("elevation")
    distance: float = knob("distance")
    fov: float = knob("fov")
    projection: str | None = knob("projection")
    eye: Vector | None = knob("eye")
    target: Vector | None = knob("target")
    up: Vector | None = knob("up")
    light: Quaternion | None = knob("light")
    yaw: float = knob("yaw")
    pitch: float = knob("pitch")
    roll: float = knob("roll")
    albedo: Vector | None = knob("albedo")
    shine: str | None = knob("shine")
    roughness: float | None = knob("roughness")
    strength: float | None = knob("strength")
    glow: float = knob("glow")
    window: str | None = knob("window")
    width: int = knob("width")
    height: int = knob("height")
    shading: str = knob("shading")
    samples: int = knob("samples")
    wait_ms: int = knob("wait_ms")
    max_error: float | None = knob("max_error")

    @model_validator(mode="after")
    def one_of_each(self) -> Self:
        """Refuse two cameras, two rotations of the light, and samples for a shading that reads
        none.
        """
        given = self.model_fields_set
        self._exclusive(sorted(given & {"eye"}), sorted(given & set(ORBIT)), "camera")
        self._exclusive(sorted(given & {"light"}), sorted(given & set(ANGLES)), "light rotation")
        if "samples" in given and self.shading != "path_traced":
            raise ValueError(
                f"samples is for shading=path_traced, {self.shading} does not read it: leave "
                "it out."
            )
        return self

    @staticmethod
    def _exclusive(some: list[str], others: list[str], what: str) -> None:
        """Raise ValueError if both lists name parameters."""
        if some and others:
            one, other = ", ".join(some), ", ".join(others)
            raise ValueError(f"The {what} is given twice, by {one} and by {other}: keep one.")


class FitParams(NoParams):
    """The surface that a camera is to show whole, its direction, and the size of the picture."""

    isovalue: float | str | None = knob("isovalue")
    azimuth: float | None = knob("azimuth", default=None, otherwise="from three quarters")
    elevation: float | None = knob("elevation", default=None, otherwise="from somewhat above")
    fov: float = knob("fov")
    projection: str | None = knob("projection")
    width: int = knob("width")
    height: int = knob("height")

    @property
    def view(self) -> ViewParams:
        """Return a view of that surface, in perspective: see ``frame.fitting``."""
        own = self.model_dump(include={"isovalue", "fov", "width", "height"})
        return ViewParams.model_validate(own | {"projection": PROJECTIONS[0]})


class UploadParams(NoParams):
    """The name of an upload."""

    name: str = Field(
        "", max_length=80, description="A name for people; default: one made of the volume's id."
    )

    @field_validator("name")
    @classmethod
    def one_line(cls, name: str) -> str:
        """Strip the name; refuse characters that cannot be printed in a line."""
        if not name.isprintable():
            raise ValueError("must be one line of text.")
        return name.strip()


class FrameParams(ViewParams):
    """A view and the picture that is made of it."""

    f: Annotated[str | None, Choice(FORMATS)] = Field(
        None, description="Picture format; default: by Accept, else png."
    )
    overlay: str = knob("overlay")
    exposure: float | None = knob("exposure")
    background: str = knob("background")
    antialias: str | None = knob("antialias")
    strip: Annotated[tuple[int, int] | None, Rows()] = Field(
        None,
        description=(
            "The rows of the picture to draw, first,last: from the first up to before the last."
        ),
    )
    version: Annotated[
        str | None, WithJsonSchema({"type": "string", "pattern": VERSION_PATTERN})
    ] = Field(
        None,
        pattern=VERSION_PATTERN,
        description=(
            "An ETag without its quotes: the final picture that has it may be kept for ever."
        ),
    )


class SkyParams(LightParams):
    """A picture of the light around a scene."""

    width: Annotated[int, Span(16, 512, whole=True)] = Field(
        256, description="Pixels; the height is half of it."
    )
    f: Annotated[str, Choice(FORMATS[:3])] = Field("png", description="Picture format.")
    version: str | None = Field(
        None,
        pattern=VERSION_PATTERN,
        description="An ETag without its quotes: the picture that has it may be kept for ever.",
    )


Model = TypeVar("Model", bound=NoParams)


def read(model: type[Model], pairs: Iterable[tuple[str, Any]]) -> Model:
    """Return parameters as a ``model``. Raises ParameterError, one sentence about the first
    that is wrong.
    """
    values: dict[str, Any] = {}
    for name, value in pairs:
        # A repeated name is ambiguous, and never intended.
        if name in values:
            raise ParameterError(f"{name} is given more than once: give it once.", name)
        values[name] = value
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise complaint(model, error) from None


def complaint(model: type[BaseModel], error: ValidationError) -> ParameterError:
    """Return the first finding of pydantic as one sentence about one parameter."""
    # Later findings are often consequences of the first one.
    first = error.errors(include_url=False)[0]
    name = ".".join(map(str, first["loc"]))
    if first["type"] == "extra_forbidden" and len(first["loc"]) == 1:
        return ParameterError(
            f"There is no parameter '{name[:40]}' here: {advice(name, model.model_fields)}", name
        )
    if first["type"] == "missing":
        return ParameterError(f"{name} is missing: give it.", name)
    reason = first["msg"].removeprefix("Value error, ").rstrip(".")
    return ParameterError(f"{name} {reason}.".strip(), name)


def documented(model: type[BaseModel]) -> dict[str, Any]:
    """Return the fields of a model as query parameters of an OpenAPI operation."""
    document = model.model_json_schema()
    described: Mapping[str, dict[str, Any]] = document["properties"]
    needed = {name: {"required": True} for name in document.get("required", ())}
    # None is no default that a query can spell.
    for schema in described.values():
        if schema.get("default", 0) is None:
            del schema["default"]
    return {
        "parameters": [
            {
                "name": name,
                "in": "query",
                "description": schema.pop("description"),
                "schema": schema,
            }
            | needed.get(name, {})
            for name, schema in described.items()
        ]
    }


EXPORTS = ("glb", "usdz", "ply", "obj", "vti", "nrrd")


class ExportParams(VariantParams):
    """A file with the light of a scene: on the isosurface, or in the volume around it."""

    f: Annotated[str, Choice(EXPORTS)] = Field(
        "glb", description="Kind of file: a mesh, or a volume (vti, nrrd)."
    )
    isovalue: float | str | None = knob("isovalue")
    light: Quaternion | None = knob("light")
    yaw: float = knob("yaw")
    pitch: float = knob("pitch")
    roll: float = knob("roll")
    albedo: Vector | None = knob("albedo")
    exposure: float | None = knob("exposure")
    max_error: float | None = knob("max_error")
    deadline: Annotated[float | None, Span(0, LONGEST_SECONDS)] = Field(
        None,
        description=(
            "Seconds of baking after which the file is made with the light that is "
            "there; default: none."
        ),
    )

    coefficients: Annotated[str, Choice(("off", "on"))] = Field(
        "off", description="on: harmonics of the light too, into a vti: see docs/export.md."
    )

    @property
    def view(self) -> ViewParams:
        """Return the view of the export. Raises ParameterError if the rotation of the light is
        given twice.
        """
        names = self.model_fields_set - {"f", "exposure", "deadline", "coefficients"}
        return read(ViewParams, self.model_dump(include=names).items())


AXIS_NAMES = ("x", "y", "z")
LARGEST_VALUE = sys.float_info.max


class PointParams(ViewParams):
    """A view, and a place in its picture."""

    x: Annotated[float, Span(0, LONGEST_SIDE)] = Field(
        description="From the left edge of the picture, in pixels; a pixel's middle is at a half."
    )
    y: Annotated[float, Span(0, LONGEST_SIDE)] = Field(description="From the top edge, likewise.")
    exposure: float | None = knob("exposure")

    @property
    def pixel(self) -> tuple[int, int]:
        """Return column and row of the pixel at that place. Raises ParameterError outside the
        picture.
        """
        for name, place, pixels in (("x", self.x, self.width), ("y", self.y, self.height)):
            if place >= pixels:
                raise ParameterError(
                    f"{name}={place:g} is outside a picture of {pixels} pixels that way.", name
                )
        return int(self.x), int(self.y)


class SliceParams(NoParams):
    """A plane of a scene's volume, as values or as a grey picture with the values that are
    black and white.
    """

    axis: Annotated[str, Choice(AXIS_NAMES)] = Field(
        description="The voxel axis that the plane is across: x, y or z."
    )
    at: Annotated[float, Span(0, 1e9)] = Field(
        description="Where it is, as a voxel index; linear between voxels."
    )
    low: Annotated[float | None, Span(-LARGEST_VALUE, LARGEST_VALUE)] = Field(
        None,
        description=(
            "The value, in the volume's units, that is black; default: its least one, "
            "outliers aside."
        ),
    )
    high: Annotated[float | None, Span(-LARGEST_VALUE, LARGEST_VALUE)] = Field(
        None, description="The value that is white; default: its greatest one, outliers aside."
    )
    time: int | None = knob("time")
    smooth: float | None = knob("smooth")
    f: Annotated[str, Choice(("png", "npy"))] = Field(
        "png", description="A grey picture; or npy, the values themselves, in the volume's units."
    )

    @property
    def is_picture(self) -> bool:
        """Return True if a picture is asked for. Raises ParameterError if values are, together
        with ``low`` or ``high``.
        """
        given = sorted({"low", "high"} & self.model_fields_set)
        if self.f == "npy" and given:
            names = " and ".join(given)
            raise ParameterError(
                f"npy holds the values themselves and does not read {names}: leave that out.",
                given[0],
            )
        return self.f == "png"

    def window(self, core: tuple[float, float]) -> tuple[float, float]:
        """Return the values that are black and white, by default the ends of ``core``. Raises
        ParameterError if low is not below high.
        """
        low, high = (
            own if given is None else given
            for given, own in zip((self.low, self.high), core, strict=True)
        )
        if not low < high and (self.low, self.high) != (None, None):
            raise ParameterError(f"low={low:g} is not below high={high:g}: widen the range.", "low")
        return low, high


class SizeParams(VariantParams):
    """A surface that is to be measured."""

    isovalue: float | str | None = knob("isovalue")

    @property
    def view(self) -> ViewParams:
        """Return a view of that surface."""
        return ViewParams.model_validate({"isovalue": self.isovalue})


CHUNK = re.compile(r"(\d{1,6})\.(\d{1,6})\.(\d{1,6})(?:-([0-9a-f]{16}))?", re.ASCII)
"""A chunk by its index z.y.x, and the version that is asked for."""

LAYERS = re.compile(r"(\d{1,9})-(\d{1,9})", re.ASCII)
"""The first layer of voxels, and the one after the last."""


class ChunkName(NamedTuple):
    """A chunk of texels, and the version of it that an address names; None if it names none."""

    at: Index
    version: bytes | None

    @classmethod
    def of(cls, text: str, shape: Index) -> "ChunkName":
        """Read a chunk's name. ``shape`` is the number of chunks of the lattice along z, y, x.
        Raises ParameterError if the text is malformed, and UnknownPartError outside the
        lattice.
        """
        found = CHUNK.fullmatch(text)
        if found is None:
            raise ParameterError(
                f"'{text[:40]}' names no chunk: write z.y.x, or z.y.x-version, of /card/chunks."
            )
        z, y, x = (int(place) for place in found.groups()[:3])
        if not is_inside((z, y, x), shape):
            most = " × ".join(map(str, shape))
            raise UnknownPartError(
                f"There is no chunk {z}.{y}.{x}: this scene has {most} along z, y, x."
            )
        return cls((z, y, x), None if found[4] is None else bytes.fromhex(found[4]))


def chunk_names(text: str, shape: Index) -> list[ChunkName]:
    """Read the chunks in a path, separated by commas; ``shape`` is the number of chunks of the
    lattice along z, y, x. Raises ParameterError and UnknownPartError.
    """
    parts = text.split(",")
    if len(parts) > CHUNKS:
        raise ParameterError(f"{len(parts)} chunks are named: ask for {CHUNKS} at most.")
    return [ChunkName.of(part, shape) for part in parts]


def layers_of(text: str, depth: int, most: int) -> tuple[int, int]:
    """Read a range of the ``depth`` layers of a volume from a path. Raises UnknownPartError if
    it is empty, outside, or longer than ``most``.
    """
    found = LAYERS.fullmatch(text)
    if found:
        first, last = map(int, found.groups())
    else:
        first, last = (0, 0)
    # Text that is no range becomes an empty one, which is refused too.
    if not first < last <= depth or last - first > most:
        raise UnknownPartError(
            f"There are no layers '{text[:40]}': name up to {most} from 0 to {depth}, as "
            "first-last."
        )
    return first, last


class VoxelParams(VariantParams):
    """The volume whose voxels are asked for."""

    version: str | None = Field(
        None,
        pattern=VERSION_PATTERN,
        description="What the document says: voxels of that version may be kept for ever.",
    )


class TransferParams(VariantParams):
    """The scene whose light is asked for."""

    max_error: float | None = knob("max_error")


class FoldParams(TransferParams):
    """The light that chunks are shown under, and the isovalue, which light of pinned surfaces
    depends on.
    """

    isovalue: float | str | None = knob("isovalue")
    light: Quaternion | None = knob("light")
    yaw: float = knob("yaw")
    pitch: float = knob("pitch")
    roll: float = knob("roll")
    albedo: Vector | None = knob("albedo")

    @property
    def view(self) -> ViewParams:
        """Return a view in that light. Raises ParameterError if the rotation of the light is
        given twice.
        """
        return read(
            ViewParams, self.model_dump(include=self.model_fields_set - {"max_error"}).items()
        )
