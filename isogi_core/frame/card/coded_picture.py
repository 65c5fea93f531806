"""Pictures as cards draw them from transfer in few bits, and their error, by control pixels."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.frame.card.blocks import normals_of, raw_numbers, raw_scale
from isogi_core.frame.card.coding import Coding
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import (
    ControlPixels,
    TotalError,
    draw_places,
    measure_total,
    paths_for,
    trace_controls,
)
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.shading import (
    carry_irradiance_ratios,
    carry_texel_light,
    fill_texel_records,
    filter_texel_light,
)
from isogi_core.frame.texel_reading import read_texels
from isogi_core.frame.view_texels import carries_irradiance_ratios
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.kernels.shading.lattice import LIGHT_NUMBERS, light_texels
from isogi_core.kernels.shading.lobes import add_lobes
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View

DARKEST = 1e-150
"""Least mean luminance that errors are relative to: its square is still a number."""

CONTROLS = 256
"""Number of control pixels of a picture."""


def draw_coded(renderer: Renderer, view: View, coding: Coding, goal: Goal) -> Framebuffer:
    """Draw the picture of a ``view`` as a card does from all texels' transfer in few bits, with
    lobes as at rest.

    Light is final by the ``goal``. Raises the errors of ``Loader.ensure``.
    """
    tiles = renderer.tiles
    loader = renderer.caches.of("gi")
    scene = renderer.prepared.scene
    gbuffer = renderer.gbuffer(view)
    light = RotatedLight(renderer.caches.spec("gi"), view)
    texels = renderer.surface.texels(view, gbuffer)
    loader.ensure(texels.chunks, tiles.check)
    # Read the numbers that a page would get.
    with loader.pool.hold(texels.chunks) as held:
        reading = read_texels(texels, held.slots, loader.pool, goal, tiles)
        numbers = raw_numbers(reading, loader.pool)
    about = normals_of(renderer.surface, texels, tiles)
    # Encode and decode them, and go on as a card does: light, filter, interpolation, lobes,
    # colours.
    lit = fold(coding.numbers(coding.codes(numbers)), light)
    if reading.grainy.any():
        reading, lit = filter_texel_light(texels, reading, lit, about, light, tiles)
    points = gbuffer.shown(tiles)
    if carries_irradiance_ratios(scene, "gi", False):
        records = fill_texel_records(reading.grade, lit, about, light, tiles)
        picture = carry_irradiance_ratios(texels, records, points, light, tiles)
    else:
        picture = carry_texel_light(texels, reading, lit, points, light, tiles)
    if light.spec.lobes:
        add_lobes(
            gbuffer.pixels, renderer.surface.lobes(light, gbuffer).lit, light.spec.unit, picture
        )
    if light.coloured:
        picture.radiance[gbuffer.pixels] *= light.tints(gbuffer, tiles)
    return picture


def fold(numbers: np.ndarray, light: RotatedLight) -> np.ndarray:
    """Return the light of texels by their ``raw_numbers`` (m, n), under a ``light``; (m,
    LIGHT_NUMBERS).
    """
    spec = light.spec
    lit = np.zeros((len(numbers), LIGHT_NUMBERS), np.float32)
    kept = numbers[:, :-2].reshape(len(numbers), spec.channels, spec.columns)
    scatter = np.exp2(numbers[:, -2])
    transfer = np.float32(raw_scale(spec)) * kept
    light_texels(np.arange(len(numbers), dtype=np.int32), transfer, scatter, *light.in_units, lit)
    return lit


@dataclass(frozen=True, eq=False)
class Control:
    """Control pixels of a ``view``: its G-buffer, and ``pixels`` with the luminance of two
    halves of paths.
    """

    view: View
    gbuffer: GBuffer
    pixels: ControlPixels


class ControlPictures:
    """Pictures of several views whose control pixels are traced once, and then measure the
    light of texels as it grows.
    """

    def __init__(
        self,
        renderer: Renderer,
        views: Iterable[View],
        goal: Goal,
        report: Callable[[int], None] = lambda _: None,
    ) -> None:
        """Trace paths for pictures of about the error of a ``goal``.

        ``report`` is called with the number of views that are done, here and whenever they are
        measured.
        """
        self._renderer = renderer
        self._goal = goal
        self._report = report
        self._controls = []
        for number, view in enumerate(views):
            if each := self._control(number, view):
                self._controls += [each]
            report(number + 1)

    def __len__(self) -> int:
        return len(self._controls)

    def _control(self, number: int, view: View) -> Control | None:
        """Trace the control pixels of a view; return None if no surface is seen."""
        renderer = self._renderer
        gbuffer = self._renderer.gbuffer(view)
        if not (points := len(gbuffer.points)):
            return None
        light = RotatedLight(renderer.caches.spec("gi"), view)
        # Without uncertainty controls are drawn evenly, so that each has the weight 1.
        places = draw_places(gbuffer, np.zeros(points), (number, 0), CONTROLS)
        halves = trace_controls(
            light, gbuffer, places, (0, paths_for(self._goal.error)), number, renderer.tiles
        )
        return Control(view, gbuffer, ControlPixels(places, np.ones(len(places)), halves))

    def measure(self, coding: Coding) -> TotalError:
        """Draw all pictures anew, from the light that their texels hold now, rounded by a
        ``coding``; return one total error of them all.

        The errors of each picture are relative to its own mean luminance, and all pictures count
        alike. If no view shows a surface, the error is 0. Raises the errors of ``Loader.ensure``.
        """
        if not self._controls:
            return TotalError(0.0, 0.0, 0.0)
        squares = []
        for number, each in enumerate(self._controls):
            squares.append(self._squares(each, coding))
            self._report(number + 1)
        # ``_squares`` has divided by the mean luminance of each picture, so that of all is 1.
        return measure_total(np.concatenate(squares), 1.0)

    def _squares(self, control: Control, coding: Coding) -> np.ndarray:
        """Return estimates of the squared errors of a picture's control pixels over the
        square of its true mean luminance, so that those of several pictures can be averaged; (k,).
        They may be negative, as they come from two halves of paths.
        """
        framebuffer = draw_coded(self._renderer, control.view, coding, self._goal)
        picture = framebuffer.radiance[control.gbuffer.pixels] @ LUMINANCE_WEIGHTS
        shown = picture[control.pixels.places]
        mean = control.pixels.mean(shown, float(picture.mean()))
        # A black picture has no relative error: the floor keeps its square above underflow.
        return control.pixels.squares(shown) / max(mean, DARKEST) ** 2
