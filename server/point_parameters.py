"""The parameters of points of a picture, of slices through a volume, and of the size of a surface."""

import sys
from typing import Annotated

from pydantic import Field

from server.errors import ParameterError
from server.parameters import LONGEST_SIDE, MOST_STEPS, Isovalue, NoParams, VariantParams, ViewParams, reader
from server.values import Choice, Span

AXIS_NAMES, LARGEST_VALUE = ("x", "y", "z"), sys.float_info.max


class PointParams(ViewParams):
    """A view, and the place in its picture that is asked about."""

    x: Annotated[float, Span(0, LONGEST_SIDE)] = Field(
        description="From the left edge of the picture, in pixels; a pixel's middle is at a half."
    )
    y: Annotated[float, Span(0, LONGEST_SIDE)] = Field(description="From the top edge, likewise.")
    exposure: Annotated[float | None, Span(1e-36, 1e36)] = Field(
        None, description="Factor on radiance before the tone curve; default: the scene's."
    )

    @property
    def pixel(self) -> tuple[int, int]:
        """Column and row of the pixel at that place; ParameterError outside the picture."""
        for name, place, pixels in (("x", self.x, self.width), ("y", self.y, self.height)):
            if place >= pixels:
                raise ParameterError(f"{name}={place:g} is outside a picture of {pixels} pixels that way.", name)
        return int(self.x), int(self.y)


class SliceParams(NoParams):
    """A plane of a scene's volume, as values or as a picture, and the values that are black and white in that."""

    axis: Annotated[str, Choice(AXIS_NAMES)] = Field(description="The voxel axis that the plane is across: x, y or z.")
    at: Annotated[float, Span(0, 1e9)] = Field(description="Where it is, as a voxel index; linear between voxels.")
    low: Annotated[float | None, Span(-LARGEST_VALUE, LARGEST_VALUE)] = Field(
        None, description="The value, in the volume's units, that is black; default: its least one, outliers aside."
    )
    high: Annotated[float | None, Span(-LARGEST_VALUE, LARGEST_VALUE)] = Field(
        None, description="The value that is white; default: its greatest one, outliers aside."
    )
    time: Annotated[int | None, Span(0, MOST_STEPS, whole=True)] = Field(
        None, description="Which step of a series in time, from 0 on; default: the scene's."
    )
    f: Annotated[str, Choice(("png", "npy"))] = Field(
        "png", description="A grey picture; or npy, the values themselves, in the volume's units."
    )

    @property
    def is_picture(self) -> bool:
        """Whether a picture is asked for; ParameterError where values are, with what black and white are in one."""
        given = sorted({"low", "high"} & self.model_fields_set)
        if self.f == "npy" and given:
            names = " and ".join(given)
            raise ParameterError(
                f"npy holds the values themselves and does not read {names}: leave that out.", given[0]
            )
        return self.f == "png"

    def window(self, core: tuple[float, float]) -> tuple[float, float]:
        """What is black and white, by default the ends of the ``core``; ParameterError where low is not below high."""
        low, high = (own if given is None else given for given, own in zip((self.low, self.high), core, strict=True))
        if not low < high and (self.low, self.high) != (None, None):
            raise ParameterError(f"low={low:g} is not below high={high:g}: widen the range.", "low")
        return low, high


class SizeParams(VariantParams):
    """A surface that is measured."""

    isovalue: Isovalue = None

    @property
    def view(self) -> ViewParams:
        """A view of that surface."""
        return ViewParams.model_validate({"isovalue": self.isovalue})


PointParamsDep = Annotated[PointParams, reader(PointParams)]
SliceParamsDep = Annotated[SliceParams, reader(SliceParams)]
SizeParamsDep = Annotated[SizeParams, reader(SizeParams)]
