"""The parameters of a view and of a frame, and the view that they make in a scene."""

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any, NamedTuple, Self, TypeVar

from fastapi import Depends, Request
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
from server.errors import ParameterError, UnknownPartError
from server.knobs import KNOBS, LONGEST_SIDE
from server.values import LONGEST_SECONDS, Choice, Rows, Span

FORMATS = ("png", "jpeg", "webp", "npy")
VERSION_PATTERN = r"^[0-9a-f]{32}$"

ORBIT = ("azimuth", "elevation", "distance")
ANGLES = ("yaw", "pitch", "roll")


def knob(name: str, **changes: Any) -> Any:
    """The field of a model that a row of KNOBS makes, with ``changes`` of the row's fields."""
    row = replace(KNOBS[name], **changes)
    field = Field(row.default, description=row.text)
    field.metadata.append(row.kind)
    return field


class NoParams(BaseModel):
    """A resource that reads no parameters."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class LightParams(NoParams):
    """The light that a scene is shown in."""

    environment: str | None = knob("environment")


class VariantParams(LightParams):
    """The light that a scene is shown in, what is taken away of it, when, of what, and which
    surfaces are beside.
    """

    cut: str | None = knob("cut")
    time: int | None = knob("time")
    smooth: float | None = knob("smooth")
    surfaces: str | None = knob("surfaces")
    hide: str | None = knob("hide")
    material: str | None = knob("material")


class ViewParams(VariantParams):
    """What to look at, from where and in which light; what is left out takes the scene's
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
        """Refuses two ways of saying the same thing, and samples that nothing reads."""
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
        if some and others:
            one, other = ", ".join(some), ", ".join(others)
            raise ValueError(f"The {what} is given twice, by {one} and by {other}: keep one.")


class FitParams(NoParams):
    """The surface that a camera is to show whole, from where, and in a picture of which size."""

    isovalue: float | str | None = knob("isovalue")
    azimuth: float | None = knob("azimuth", default=None, otherwise="from three quarters")
    elevation: float | None = knob("elevation", default=None, otherwise="from somewhat above")
    fov: float = knob("fov")
    projection: str | None = knob("projection")
    width: int = knob("width")
    height: int = knob("height")

    @property
    def view(self) -> ViewParams:
        """What of it is of a view, in perspective: see ``frame.fitting``."""
        own = self.model_dump(include={"isovalue", "fov", "width", "height"})
        return ViewParams.model_validate(own | {"projection": PROJECTIONS[0]})


class UploadParams(NoParams):
    """What to call an uploaded volume."""

    name: str = Field(
        "", max_length=80, description="A name for people; default: one made of the volume's id."
    )

    @field_validator("name")
    @classmethod
    def one_line(cls, name: str) -> str:
        """The name without blanks around it; refuses what does not show in a line of text."""
        if not name.isprintable():
            raise ValueError("must be one line of text.")
        return name.strip()


class FrameParams(ViewParams):
    """A view and the picture to make of it."""

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
    """The parameters as ``model``; ParameterError, in one sentence, on the first thing that is
    wrong.
    """
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise ParameterError(f"{name} is given more than once: give it once.", name)
        values[name] = value
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise complaint(model, error) from None


def complaint(model: type[BaseModel], error: ValidationError) -> ParameterError:
    """The first finding of pydantic as one sentence about one parameter."""
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
    """The model's fields as query parameters of an OpenAPI operation; None is no default that a
    query can spell.
    """
    document = model.model_json_schema()
    described: Mapping[str, dict[str, Any]] = document["properties"]
    needed = {name: {"required": True} for name in document.get("required", ())}
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


def reader(model: type[Model]) -> Any:
    """What gives a route the query as a ``model``; ParameterError where that says something is
    wrong.
    """

    async def query(request: Request) -> Model:
        return read(model, request.query_params.multi_items())

    return Depends(query)


NoParamsDep = reader(NoParams)
VariantParamsDep = Annotated[VariantParams, reader(VariantParams)]
ViewParamsDep = Annotated[ViewParams, reader(ViewParams)]
UploadParamsDep = Annotated[UploadParams, reader(UploadParams)]
FrameParamsDep = Annotated[FrameParams, reader(FrameParams)]
FitParamsDep = Annotated[FitParams, reader(FitParams)]
SkyParamsDep = Annotated[SkyParams, reader(SkyParams)]


EXPORTS = ("glb", "usdz", "ply", "obj", "vti", "nrrd")


class ExportParams(VariantParams):
    """A file with the light of a scene in it: of the isosurface, or of the volume around it."""

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
        """What of it is of a view. Raises ParameterError where the light's turn is given twice."""
        names = self.model_fields_set - {"f", "exposure", "deadline", "coefficients"}
        return read(ViewParams, self.model_dump(include=names).items())


ExportParamsDep = Annotated[ExportParams, reader(ExportParams)]


AXIS_NAMES = ("x", "y", "z")
LARGEST_VALUE = sys.float_info.max


class PointParams(ViewParams):
    """A view, and the place in its picture that is asked about."""

    x: Annotated[float, Span(0, LONGEST_SIDE)] = Field(
        description="From the left edge of the picture, in pixels; a pixel's middle is at a half."
    )
    y: Annotated[float, Span(0, LONGEST_SIDE)] = Field(description="From the top edge, likewise.")
    exposure: float | None = knob("exposure")

    @property
    def pixel(self) -> tuple[int, int]:
        """Column and row of the pixel at that place; ParameterError outside the picture."""
        for name, place, pixels in (("x", self.x, self.width), ("y", self.y, self.height)):
            if place >= pixels:
                raise ParameterError(
                    f"{name}={place:g} is outside a picture of {pixels} pixels that way.", name
                )
        return int(self.x), int(self.y)


class SliceParams(NoParams):
    """A plane of a scene's volume, as values or as a picture, and the values that are black and
    white in that.
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
        """Whether a picture is asked for; ParameterError where values are, with what black and
        white are in one.
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
        """What is black and white, by default the ends of the ``core``; ParameterError where low is
        not below high.
        """
        low, high = (
            own if given is None else given
            for given, own in zip((self.low, self.high), core, strict=True)
        )
        if not low < high and (self.low, self.high) != (None, None):
            raise ParameterError(f"low={low:g} is not below high={high:g}: widen the range.", "low")
        return low, high


class SizeParams(VariantParams):
    """A surface that is measured."""

    isovalue: float | str | None = knob("isovalue")

    @property
    def view(self) -> ViewParams:
        """A view of that surface."""
        return ViewParams.model_validate({"isovalue": self.isovalue})


PointParamsDep = Annotated[PointParams, reader(PointParams)]
SliceParamsDep = Annotated[SliceParams, reader(SliceParams)]
SizeParamsDep = Annotated[SizeParams, reader(SizeParams)]


CHUNK = re.compile(r"(\d{1,6})\.(\d{1,6})\.(\d{1,6})(?:-([0-9a-f]{16}))?", re.ASCII)
"""A chunk by its place z.y.x, and the version that is asked for."""

LAYERS = re.compile(r"(\d{1,9})-(\d{1,9})", re.ASCII)
"""The first layer of voxels, and the first after the last."""


class ChunkName(NamedTuple):
    """A chunk of texels, and the version of it that an address names; None where it names none."""

    at: Index
    version: bytes | None

    @classmethod
    def of(cls, text: str, shape: Index) -> "ChunkName":
        """The chunk that a ``text`` names in a lattice of so many. Raises ParameterError and
        UnknownPartError.
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
    """The chunks that a path names, with commas between. Raises ParameterError, and
    UnknownPartError where one is not in a lattice of so many chunks.
    """
    parts = text.split(",")
    if len(parts) > CHUNKS:
        raise ParameterError(f"{len(parts)} chunks are named: ask for {CHUNKS} at most.")
    return [ChunkName.of(part, shape) for part in parts]


def layers_of(text: str, depth: int, most: int) -> tuple[int, int]:
    """The layers that a path names, of so many. Raises UnknownPartError where there are none, or
    more than ``most``.
    """
    found = LAYERS.fullmatch(text)
    if found:
        first, last = map(int, found.groups())
    else:
        first, last = (0, 0)
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
    """The light that chunks are lit by."""

    light: Quaternion | None = knob("light")
    yaw: float = knob("yaw")
    pitch: float = knob("pitch")
    roll: float = knob("roll")
    albedo: Vector | None = knob("albedo")

    @property
    def view(self) -> ViewParams:
        """A view in that light; ParameterError where the light is turned in two ways."""
        return read(
            ViewParams, self.model_dump(include=self.model_fields_set - {"max_error"}).items()
        )


VoxelParamsDep = Annotated[VoxelParams, reader(VoxelParams)]
TransferParamsDep = Annotated[TransferParams, reader(TransferParams)]
FoldParamsDep = Annotated[FoldParams, reader(FoldParams)]
