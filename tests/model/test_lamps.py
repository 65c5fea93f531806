"""The lamps of a scene: what the kernels take, how they look from afar, and what they mean for the
scene.
"""

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import sph_harm_y

from isogi_core.errors import SceneError
from isogi_core.kernels.transport.lights import AREA, DIRECTIONAL, POINT
from isogi_core.model.environment import LUMINANCE_WEIGHTS, gather_lamps
from isogi_core.model.lights import AreaLight, ConstantLight, DirectionalLight, Lamp, PointLight
from isogi_core.model.scene_plan import Layer
from isogi_core.plan.scene import Scene
from tests.loaded import load_scene

SUN = DirectionalLight(90.0, 30.0, (3.0, 2.0, 1.0), 60.0)
BULB = PointLight((1.0, 2.0, 8.0), (9.0, 0.0, 18.0))
PANEL = AreaLight((-1.0, 0.0, 5.0), (0.0, 4.0, 0.0), (2.0, 0.0, 0.0), (0.5, 0.25, 1.0))
CENTRE = (1.0, 2.0, 2.0)
LAMP = {"type": "point", "position": [9, 9, 9], "intensity": 50.0}


def test_arrays_hold_each_lamp_in_turn() -> None:
    kinds, places, edges, colours = gather_lamps([SUN, ConstantLight(), BULB, PANEL]).arrays
    assert kinds.tolist() == [DIRECTIONAL, POINT, AREA] and kinds.dtype == np.int8
    np.testing.assert_allclose(places[0], (0.0, math.sqrt(0.75), 0.5), atol=1e-15)
    assert places[1:].tolist() == [[1.0, 2.0, 8.0], [-1.0, 0.0, 5.0]]
    assert not edges[1].any() and edges[2].tolist() == [[0.0, 4.0, 0.0], [2.0, 0.0, 0.0]]
    np.testing.assert_allclose(
        math.pi * colours, [(3.0, 2.0, 1.0), (9.0, 0.0, 18.0), (0.5, 0.25, 1.0)]
    )


@pytest.mark.parametrize("elevation", [-90.0, -20.0, 0.0, 60.0, 90.0])
def test_a_directional_lamp_has_a_disc_across_its_direction(elevation: float) -> None:
    arrays = gather_lamps([DirectionalLight(40.0, elevation, angle=60.0)]).arrays
    frame = np.vstack([arrays.places, 2.0 * arrays.edges[0]])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)


def test_no_lamps() -> None:
    lamps = gather_lamps([ConstantLight()])
    assert (
        not lamps.any
        and lamps.arrays.places.shape == (0, 3)
        and lamps.arrays.edges.shape == (0, 2, 3)
    )
    assert lamps.brightest(CENTRE, 1.0) == 0.0 and not lamps.approximate(3, CENTRE, 1.0).any()


def test_lamps_seen_from_a_point() -> None:
    lamps = gather_lamps([SUN, BULB, PANEL])
    directions, irradiances = lamps.seen_from(CENTRE)
    np.testing.assert_allclose(directions[0], (0.0, math.sqrt(0.75), 0.5), atol=1e-15)
    np.testing.assert_allclose(irradiances[0], (3.0, 2.0, 1.0))
    np.testing.assert_allclose(directions[1], (0.0, 0.0, 1.0), atol=1e-15)
    np.testing.assert_allclose(irradiances[1], (0.25, 0.0, 0.5))
    away = np.array([0.0, 2.0, 5.0]) - CENTRE
    r = np.linalg.norm(away)
    np.testing.assert_allclose(directions[2], away / r)
    np.testing.assert_allclose(
        irradiances[2], np.array([0.5, 0.25, 1.0]) * 8.0 * (away[2] / r) / r**2
    )


def test_a_lamp_is_dark_from_behind_and_from_within() -> None:
    _, irradiances = gather_lamps([PANEL, BULB]).seen_from((1.0, 2.0, 8.0))
    assert np.isfinite(irradiances).all() and not irradiances.any()


@pytest.mark.parametrize(
    "away", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.01), (1.0, 0.0, 0.0), (0.0, -2.9, 0.0)]
)
def test_a_lamp_nearer_than_the_least_distance_is_moved_there(
    away: tuple[float, float, float],
) -> None:
    x, y, z = np.add(CENTRE, away)
    behind = AreaLight((x - 1.0, y - 2.0, z), (2.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.5, 0.25, 1.0))
    directions, irradiances = gather_lamps(
        [PointLight((x, y, z), (9.0, 0.0, 18.0)), behind]
    ).seen_from(CENTRE, 3.0)
    np.testing.assert_allclose(
        directions, [np.array(away) / max(math.hypot(*away), 1e-9)] * 2, atol=1e-12
    )
    np.testing.assert_allclose(
        irradiances, np.array([[9.0, 0.0, 18.0], [4.0, 2.0, 8.0]]) / 9.0, rtol=1e-12
    )


def test_a_lamp_at_the_centre_shines_from_all_sides_alike() -> None:
    lamps = gather_lamps([PointLight(CENTRE, (9.0, 0.0, 18.0))])
    expected = np.zeros((3, 16))
    expected[:, 0] = np.array([9.0, 0.0, 18.0]) / 9.0 / math.sqrt(4.0 * math.pi)
    np.testing.assert_allclose(lamps.approximate(4, CENTRE, 3.0), expected)
    assert lamps.brightest(CENTRE, 3.0) == pytest.approx(
        np.array([1.0, 0.0, 2.0]) @ LUMINANCE_WEIGHTS / math.pi
    )


def harmonic(l: int, m: int, theta: float, phi: float) -> float:
    """Y_lm, real and without the Condon-Shortley phase, by SciPy."""
    y = (-1.0) ** m * sph_harm_y(l, abs(m), theta, phi)
    return float(y.real if m == 0 else math.sqrt(2.0) * (y.real if m > 0 else y.imag))


def test_approximation_is_a_sum_of_directions() -> None:
    """Coefficient (l, m) of a distant light of irradiance E is E Y_lm of its direction."""
    found = gather_lamps([SUN, BULB]).approximate(4, CENTRE, 1.0)
    for l in range(4):
        for m in range(-l, l + 1):
            sun = harmonic(l, m, math.radians(60.0), math.pi / 2)
            bulb = harmonic(l, m, 0.0, 0.0)
            expected = np.array([3.0, 2.0, 1.0]) * sun + np.array([0.25, 0.0, 0.5]) * bulb
            np.testing.assert_allclose(found[:, l * (l + 1) + m], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("lamps", "expected"),
    [
        ([DirectionalLight()], 1.0),
        ([DirectionalLight(), DirectionalLight(-45.0, -45.0)], 1.0),
        ([DirectionalLight(0.0, 0.0), DirectionalLight(60.0, 0.0)], 1.5),
    ],
)
def test_brightest_is_what_faces_the_best_lamp(lamps: list[Lamp], expected: float) -> None:
    assert gather_lamps(lamps).brightest(CENTRE, 1.0) == pytest.approx(expected)


def test_digest_names_the_lamps_and_nothing_else() -> None:
    many = [
        gather_lamps(each)
        for each in ([], [SUN], [BULB], [PANEL], [SUN, BULB], [BULB, SUN], [DirectionalLight()])
    ]
    assert len({lamps.digest for lamps in many}) == len(many)
    assert gather_lamps([ConstantLight(), SUN]).digest == many[1].digest


# --- scenes
# --------------------------------------------------------------------------------------------------


def scene(*lights: dict[str, Any], **settings: Any) -> Scene:
    return load_scene("demo:orbital", lights=list(lights), **settings)


def test_lamps_change_the_irradiance_and_not_the_transfer() -> None:
    plain = scene({"type": "constant"})
    lit = scene({"type": "constant"}, LAMP)
    assert lit.lighting.lamps.any and not plain.lighting.lamps.any
    assert lit.plan.representation == "irradiance" and lit.digest != plain.digest
    brighter = scene({"type": "constant"}, {**LAMP, "intensity": 60.0})
    for layer, same in ((Layer("irradiance"), False), (Layer("direct", 5), True)):
        assert (lit.layer_digest(layer) == brighter.layer_digest(layer)) == same


def test_lamps_do_not_turn() -> None:
    assert not scene(LAMP).lighting.rotating and not scene(LAMP, rotating=False).lighting.rotating
    assert scene({"type": "sky"}).lighting.rotating
    with pytest.raises(SceneError, match="stay where they are"):
        scene({"type": "sky"}, LAMP, rotating=True)


def test_exposure_knows_of_lamps() -> None:
    sun = {"type": "directional", "irradiance": 4.0 * math.pi}
    assert scene(sun).default_exposure == pytest.approx(0.25, rel=0.04), (
        "98 % of what is seen faces it less"
    )
    assert scene({"type": "constant"}, sun).default_exposure == pytest.approx(0.2, rel=0.04)


def lit_from(kind: str, offset: float) -> Scene:
    """A scene with one lamp ``offset`` radii of its volume beside the centre; an area light faces
    away from it.
    """
    volume = scene(LAMP).volume
    x, y, z = (float(c) for c in np.add(volume.centre, (offset * volume.radius, 0.0, 0.0)))
    if kind == "point":
        return scene({"type": "point", "position": [x, y, z], "intensity": 2000.0})
    edges = {"u": [0.0, 4.0, 0.0], "v": [0.0, 0.0, 4.0]}
    return scene({"type": "area", "corner": [x, y - 2.0, z - 2.0], **edges, "radiance": 100.0})


@pytest.mark.parametrize("kind", ["point", "area"])
@pytest.mark.parametrize("offset", [0.0, 1e-4, -1e-4, 0.3, -0.3])
def test_exposure_and_unit_do_not_depend_on_a_lamps_place(kind: str, offset: float) -> None:
    """An area light on the side of -x faces the centre from the volume's radius, and others face
    away from it.
    """
    here = lit_from(kind, offset)
    there = lit_from(kind, -1.0)
    assert 0.25 <= here.default_exposure / there.default_exposure <= 4.0
    assert 0.25 <= here.plan.layers[0].scale / there.plan.layers[0].scale <= 4.0
