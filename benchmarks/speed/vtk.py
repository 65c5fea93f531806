"""VTK's pipeline from a volume to a picture: flying edges, then Phong, shadow maps or ambient
occlusion.
"""

import importlib.util
import os
import sys
from typing import Any

import numpy as np

from benchmarks.common.mesh import Mesh
from isogi_core.model.view import View
from isogi_core.model.volume import Volume

PASSES = ("phong", "shadow map", "ssao")
SHADOW_MAP = 1024
SSAO_SAMPLES = 32


def installed() -> bool:
    """Whether VTK is there."""
    return importlib.util.find_spec("vtk") is not None


def use_threads(threads: int) -> None:
    """Let VTK's filters and Mesa's software renderer have so many threads; before any picture is
    made.
    """
    import vtk  # noqa: PLC0415

    os.environ["LP_NUM_THREADS"] = str(threads)
    if sys.platform == "linux" and "DISPLAY" not in os.environ:
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    vtk.vtkSMPTools.SetBackend("STDThread")
    vtk.vtkSMPTools.Initialize(threads)


def image(volume: Volume) -> Any:
    """The volume as vtkImageData, of the type that its file has."""
    import vtk  # noqa: PLC0415
    from vtk.util.numpy_support import numpy_to_vtk  # noqa: PLC0415

    own = volume.voxels.astype(np.float64) * volume.scale + volume.offset
    data = vtk.vtkImageData()
    data.SetDimensions(*volume.size)
    data.SetSpacing(*volume.spacing)
    data.GetPointData().SetScalars(numpy_to_vtk(own.astype(volume.dtype).ravel(), deep=True))
    return data


class Edges:
    """The flying-edges filter on a volume."""

    def __init__(self, data: Any, normals: bool) -> None:
        """Make the filter; it runs when its mesh is asked for."""
        import vtk  # noqa: PLC0415

        self.filter = vtk.vtkFlyingEdges3D()
        self.filter.SetInputData(data)
        self.filter.SetComputeNormals(normals)
        self.filter.ComputeGradientsOff()
        self.filter.ComputeScalarsOff()

    def mesh(self, isovalue: float) -> Mesh:
        """The mesh at an isovalue, in world units."""
        from vtk.util.numpy_support import vtk_to_numpy  # noqa: PLC0415

        self.filter.SetValue(0, isovalue)
        self.filter.Update()
        surface = self.filter.GetOutput()
        corners = vtk_to_numpy(surface.GetPolys().GetConnectivityArray())
        return vtk_to_numpy(surface.GetPoints().GetData()), corners.reshape(-1, 3).astype(np.uint32)


class Window:
    """An offscreen window on the isosurface, lit by one light, drawn by one of PASSES."""

    def __init__(self, data: Any, view: View, towards: tuple[float, float, float], by: str) -> None:
        """Set the scene up as ``view`` sees it; ``towards`` is the direction of the light."""
        import vtk  # noqa: PLC0415

        self.edges = Edges(data, normals=True)
        mapper = vtk.vtkPolyDataMapper()
        actor = vtk.vtkActor()
        light = vtk.vtkLight()
        mapper.SetInputConnection(self.edges.filter.GetOutputPort())
        mapper.ScalarVisibilityOff()
        actor.SetMapper(mapper)
        actor.GetProperty().SetAmbient(0.3)
        focus = np.array(view.camera.target)
        light.SetFocalPoint(*focus)
        light.SetPosition(*(focus + 3.0 * data.GetLength() * np.array(towards)))
        self.renderer = vtk.vtkRenderer()
        self.window = vtk.vtkRenderWindow()
        self.renderer.AddActor(actor)
        self.renderer.AddLight(light)
        self._look(view)
        self.renderer.SetPass(render_pass(by, data.GetLength()))
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(0)
        self.window.SetSize(view.width, view.height)
        self.window.AddRenderer(self.renderer)

    def _look(self, view: View) -> None:
        camera = self.renderer.GetActiveCamera()
        camera.SetPosition(*view.camera.eye)
        camera.SetFocalPoint(*view.camera.target)
        camera.SetViewUp(*view.camera.up)
        camera.SetViewAngle(view.camera.fov)

    def picture(self, isovalue: float) -> np.ndarray:
        """The picture at an isovalue, read back; (h, w, 3) uint8, row 0 at the top."""
        import vtk  # noqa: PLC0415
        from vtk.util.numpy_support import vtk_to_numpy  # noqa: PLC0415

        self.edges.filter.SetValue(0, isovalue)
        self.edges.filter.Update()
        self.renderer.ResetCameraClippingRange()
        self.window.Render()
        width, height = self.window.GetSize()
        pixels = vtk.vtkUnsignedCharArray()
        self.window.GetPixelData(0, 0, width - 1, height - 1, 1, pixels, 0)
        picture: np.ndarray = vtk_to_numpy(pixels).reshape(height, width, 3)[::-1]
        return picture


def render_pass(by: str, length: float) -> Any:
    """The pass that draws a picture; None for VTK's own, which shades by Phong. ``length`` is the
    box's diagonal.
    """
    import vtk  # noqa: PLC0415

    if by == "phong":
        return None
    if by == "ssao":
        occlusion = vtk.vtkSSAOPass()
        occlusion.SetDelegatePass(vtk.vtkRenderStepsPass())
        occlusion.SetRadius(0.1 * length)
        occlusion.SetBias(0.001 * length)
        occlusion.SetKernelSize(SSAO_SAMPLES)
        occlusion.BlurOn()
        return occlusion
    shadows = vtk.vtkShadowMapPass()
    passes = vtk.vtkRenderPassCollection()
    shadows.GetShadowMapBakerPass().SetResolution(SHADOW_MAP)
    passes.AddItem(shadows.GetShadowMapBakerPass())
    passes.AddItem(shadows)
    sequence = vtk.vtkSequencePass()
    camera = vtk.vtkCameraPass()
    sequence.SetPasses(passes)
    camera.SetDelegatePass(sequence)
    return camera
