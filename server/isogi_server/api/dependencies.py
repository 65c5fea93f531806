"""The query parameters of routes, as dependencies of FastAPI.

The models of ``isogi_server.parameters`` are read by commands too, which load no web framework.
"""

from typing import Annotated, Any

from fastapi import Depends, Request

from isogi_server.parameters import (
    ExportParams,
    FitParams,
    FoldParams,
    FrameParams,
    Model,
    NoParams,
    PointParams,
    SizeParams,
    SkyParams,
    SliceParams,
    TransferParams,
    UploadParams,
    VariantParams,
    ViewParams,
    VoxelParams,
    read,
)


def reader(model: type[Model]) -> Any:
    """Return a dependency that reads the query of a request as a ``model``. It raises
    ParameterError.
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
ExportParamsDep = Annotated[ExportParams, reader(ExportParams)]
PointParamsDep = Annotated[PointParams, reader(PointParams)]
SliceParamsDep = Annotated[SliceParams, reader(SliceParams)]
SizeParamsDep = Annotated[SizeParams, reader(SizeParams)]
VoxelParamsDep = Annotated[VoxelParams, reader(VoxelParams)]
TransferParamsDep = Annotated[TransferParams, reader(TransferParams)]
FoldParamsDep = Annotated[FoldParams, reader(FoldParams)]
