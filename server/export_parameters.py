"""The parameters of exports: a file with the light of a scene in it."""

from typing import Annotated

from pydantic import Field

from isogi_core.model.view import Vec3
from server.parameters import Isovalue, LightTurn, Pitch, Roll, VariantParams, ViewParams, Yaw, read, reader
from server.values import LONGEST_SECONDS, Choice, Colour, Span

EXPORTS = ("glb", "usdz", "ply", "obj", "vti", "nrrd")


class ExportParams(VariantParams):
    """A file with the light of a scene in it: of the isosurface, or of the volume around it."""

    f: Annotated[str, Choice(EXPORTS)] = Field("glb", description="Kind of file: a mesh, or a volume (vti, nrrd).")
    isovalue: Isovalue = None
    light: LightTurn = None
    yaw: Yaw = 0.0
    pitch: Pitch = 0.0
    roll: Roll = 0.0
    albedo: Annotated[Vec3 | None, Colour()] = Field(
        None, description="One number or r,g,b, within the scene's albedos; default: the scene's albedo."
    )
    exposure: Annotated[float | None, Span(1e-36, 1e36)] = Field(
        None, description="Factor on radiance; default: the scene's."
    )
    max_error: Annotated[float | None, Span(0.0001, 1)] = Field(
        None, description="Relative error at which light is final; default: the scene's target_error."
    )
    deadline: Annotated[float | None, Span(0, LONGEST_SECONDS)] = Field(
        None, description="Seconds of baking after which the file is made with the light that is there; default: none."
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
