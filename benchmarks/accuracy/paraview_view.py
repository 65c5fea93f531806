"""Contours an exported volume by its value, coloured by its light: run by ParaView's own
``pvpython``, in batch.

Its only argument is a JSON object of what ``draw`` takes.
"""

import json
import sys
from collections.abc import Sequence

from paraview.simple import Contour, CreateView, Render, SaveScreenshot, Show, XMLImageDataReader

Row = Sequence[float]


def draw(
    file: str, isovalue: float, eye: Row, target: Row, up: Row, fov: float, size: int, out: str
) -> None:
    """Draw the isosurface to a picture; light is emitted as it is."""
    volume = XMLImageDataReader(FileName=[file])
    surface = Contour(Input=volume, ContourBy=["POINTS", "value"], Isosurfaces=[isovalue])
    view = CreateView("RenderView")
    view.ViewSize = [size, size]
    view.OrientationAxesVisibility = 0
    view.UseColorPaletteForBackground = 0
    view.Background = [0.0, 0.0, 0.0]
    shown = Show(surface, view)
    shown.ColorArrayName = ["POINTS", "colour"]
    shown.MapScalars = 0
    shown.Ambient = 1.0
    shown.Diffuse = 0.0
    shown.Specular = 0.0
    Render(view)  # the first one places the camera anew
    view.CameraPosition = eye
    view.CameraFocalPoint = target
    view.CameraViewUp = up
    view.CameraViewAngle = fov
    Render(view)
    SaveScreenshot(out, view, ImageResolution=[size, size])
    sys.stdout.write(str(surface.GetDataInformation().GetNumberOfPoints()))


draw(**json.loads(sys.argv[1]))
