"""Lights: what a scene may say of them, the environment that they sum to, the analytic sky, and
skies by formula.
"""

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import LightError, SceneError
from isogi_core.files.radiance import write_hdr
from isogi_core.model.environment import (
    LUMINANCE_WEIGHTS,
    cumulative,
    environment_image,
    mean_radiance,
    pixel_directions,
    resample,
    sky_image,
    solid_angles,
    sun_direction,
)
from isogi_core.model.lights import (
    ENVIRONMENTS,
    AreaLight,
    ConstantLight,
    DirectionalLight,
    EnvironmentLight,
    PointLight,
    ProbeLight,
    SkyLight,
    light_from_mapping,
    light_named,
)
from isogi_core.plan.lighting import assemble_environment

HERE = Path("scenes")
BASE = HERE / "light"
RANDOM = np.random.default_rng(4)


def probe(folder: Path, image: np.ndarray, name: str = "p.hdr", scale: float = 1.0) -> ProbeLight:
    """A probe light of an image (h, w, 3) that RGBE holds exactly."""
    write_hdr(folder / name, image)
    return ProbeLight(folder / name, scale)


def small_sky(light: SkyLight, height: int = 128) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sky on a small grid: image, directions, solid angles."""
    directions = pixel_directions(height, 2 * height)
    angles = solid_angles(height, 2 * height)
    return sky_image(light, directions, angles), directions, angles


@pytest.mark.parametrize(
    ("mapping", "expected"),
    [
        ({"type": "constant"}, ConstantLight((1.0, 1.0, 1.0))),
        ({"type": "constant", "radiance": 2}, ConstantLight((2.0, 2.0, 2.0))),
        ({"type": "constant", "radiance": [1, 0.5, 0]}, ConstantLight((1.0, 0.5, 0.0))),
        ({"type": "probe", "file": "grace.hdr"}, ProbeLight(BASE / "grace.hdr")),
        ({"type": "probe", "file": "../p.hdr", "scale": 0.5}, ProbeLight(BASE / "../p.hdr", 0.5)),
        ({"type": "sky"}, SkyLight()),
        (
            {
                "type": "sky",
                "sun_azimuth": -30,
                "sun_elevation": 20,
                "turbidity": 4,
                "ground": 0.1,
                "scale": 2,
            },
            SkyLight(-30.0, 20.0, 4.0, (0.1, 0.1, 0.1), 2.0),
        ),
        ({"type": "directional"}, DirectionalLight(135.0, 45.0, (np.pi,) * 3, 0.0)),
        (
            {
                "type": "directional",
                "azimuth": -90,
                "elevation": -10,
                "irradiance": [1, 2, 3],
                "angle": 0.5,
            },
            DirectionalLight(-90.0, -10.0, (1.0, 2.0, 3.0), 0.5),
        ),
        (
            {"type": "point", "position": [1, -2, 3.5], "intensity": 4},
            PointLight((1.0, -2.0, 3.5), (4.0, 4.0, 4.0)),
        ),
        (
            {
                "type": "area",
                "corner": [0, 0, 9],
                "u": [0, 2, 0],
                "v": [2, 0, 0],
                "radiance": [3, 2, 1],
            },
            AreaLight((0.0, 0.0, 9.0), (0.0, 2.0, 0.0), (2.0, 0.0, 0.0), (3.0, 2.0, 1.0)),
        ),
    ],
)
def test_lights_of_a_scene(mapping: dict[str, Any], expected: object) -> None:
    assert light_from_mapping(mapping, BASE) == expected


@pytest.mark.parametrize(
    ("mapping", "error", "word"),
    [
        ({}, SceneError, "None"),
        ({"type": "lamp"}, SceneError, "lamp"),
        ({"type": ["sky"]}, SceneError, "sky"),
        ({"type": "constant", "colour": 1}, SceneError, "colour"),
        ({"type": "constant", "radiance": "bright"}, SceneError, "bright"),
        ({"type": "constant", "radiance": True}, SceneError, "True"),
        ({"type": "constant", "radiance": [1, 2]}, SceneError, r"\[r, g, b\]"),
        ({"type": "constant", "radiance": [1, 2, "x"]}, SceneError, "x"),
        ({"type": "constant", "radiance": -1}, LightError, "-1"),
        ({"type": "constant", "radiance": float("nan")}, SceneError, "nan"),
        ({"type": "constant", "radiance": float("inf")}, SceneError, "inf"),
        ({"type": "probe"}, SceneError, "file"),
        ({"type": "probe", "file": 3}, SceneError, "3"),
        ({"type": "probe", "file": ""}, SceneError, "file"),
        ({"type": "probe", "file": "p.hdr", "scale": -2}, LightError, "-2"),
        ({"type": "sky", "sun_elevation": -1}, LightError, "sun_elevation"),
        ({"type": "sky", "sun_elevation": 91}, LightError, "90"),
        ({"type": "sky", "sun_azimuth": float("inf")}, SceneError, "sun_azimuth"),
        ({"type": "sky", "turbidity": 1}, LightError, "turbidity"),
        ({"type": "sky", "ground": 1.5}, LightError, "ground"),
        ({"type": "directional", "elevation": 91}, LightError, "-90 to 90"),
        ({"type": "directional", "angle": -1}, LightError, "angle"),
        ({"type": "directional", "irradiance": -1}, LightError, "irradiance"),
        ({"type": "directional", "azimuth": float("nan")}, SceneError, "give a number"),
        ({"type": "constant", "radiance": 1.1e30}, LightError, "0 to 1e\\+30"),
        (
            {"type": "point", "intensity": 1, "position": [0, 0, -1e200]},
            LightError,
            "from -1e\\+30",
        ),
        ({"type": "point", "position": [0, 0, 0]}, SceneError, "intensity"),
        ({"type": "point", "intensity": 1}, SceneError, "position"),
        ({"type": "point", "intensity": 1, "position": [0, 0]}, SceneError, r"\[x, y, z\]"),
        ({"type": "point", "intensity": 1, "position": 3}, SceneError, r"\[x, y, z\]"),
        ({"type": "point", "intensity": 1, "position": [0, 0, "up"]}, SceneError, "up"),
        (
            {"type": "point", "intensity": 1, "position": [0, 0, float("inf")]},
            SceneError,
            "position",
        ),
        ({"type": "area", "corner": [0, 0, 0], "u": [1, 0, 0]}, SceneError, "'v'"),
        (
            {"type": "area", "corner": [0, 0, 0], "u": [1, 2, 0], "v": [2, 4, 0]},
            LightError,
            "no area",
        ),
        (
            {"type": "area", "corner": [0, 0, 0], "u": [1, 0, 0], "v": [0, 1, 0], "radiance": -2},
            LightError,
            "-2",
        ),
    ],
)
def test_refusals_name_the_key(mapping: dict[str, Any], error: type[Exception], word: str) -> None:
    with pytest.raises(error, match=word):
        light_from_mapping(mapping, BASE)


def test_constant_lights_add_up_without_an_image() -> None:
    light = assemble_environment(
        [ConstantLight((1.0, 0.0, 0.5)), ConstantLight((0.25, 0.25, 0.25))]
    )
    np.testing.assert_array_equal(light.constant, (1.25, 0.25, 0.75))
    assert light.image.shape == (1, 1, 3) and not light.image.any()
    np.testing.assert_array_equal(
        light.radiance(RANDOM.normal(size=(5, 7, 3))), np.full((5, 7, 3), light.constant)
    )
    np.testing.assert_array_equal(light.mean(), light.constant)


def test_no_light_is_darkness() -> None:
    light = assemble_environment([])
    assert not light.mean().any() and light.name == "no light"


def test_every_pixel_is_found_in_its_own_direction(tmp_path: Path) -> None:
    image = np.arange(6 * 10 * 3.0).reshape(6, 10, 3)
    light = assemble_environment([probe(tmp_path, image), ConstantLight((1.0, 1.0, 1.0))])
    for length in (1.0, 1e-3, 1e6):
        np.testing.assert_allclose(
            light.radiance(length * pixel_directions(6, 10)), light.image + 1.0
        )


def test_axes_of_the_image(tmp_path: Path) -> None:
    image = np.zeros((4, 8, 3))
    image[0] = 1.0
    image[3] = 2.0
    image[1:3, 0] = 3.0
    image[1:3, 2], image[1:3, 4], image[1:3, 6] = 4.0, 5.0, 6.0
    light = assemble_environment([probe(tmp_path, image)])
    tilt = 1e-3
    directions = [(0, 0, 1), (0, 0, -1), (1, tilt, 0), (-tilt, 1, 0), (-1, -tilt, 0), (tilt, -1, 0)]
    assert light.radiance(np.array(directions))[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


@pytest.mark.parametrize("azimuth", [0.0, -1e-300, -0.0, 2 * np.pi - 1e-16, -np.pi, np.pi])
@pytest.mark.parametrize("z", [0.0, 1.0, -1.0, 1e-300])
def test_lookup_stays_inside_at_seams_and_poles(tmp_path: Path, azimuth: float, z: float) -> None:
    light = assemble_environment([probe(tmp_path, np.ones((3, 7, 3)))])
    direction = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * (abs(z) != 1.0) + np.array(
        [0.0, 0.0, z]
    )
    np.testing.assert_array_equal(light.radiance(direction), np.ones(3))


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 2), (5, 3), (64, 128)])
def test_solid_angles_fill_the_sphere(height: int, width: int) -> None:
    angles = solid_angles(height, width)
    assert angles.sum() == pytest.approx(4 * np.pi, rel=1e-12)
    edges = np.cos(np.linspace(0, np.pi, height + 1))
    np.testing.assert_allclose(
        angles[:, 0], 2 * np.pi / width * (edges[:-1] - edges[1:]), rtol=1e-9
    )


def test_mean_radiance_against_a_closed_form() -> None:
    z = pixel_directions(256, 512)[..., 2]
    image = np.stack([np.maximum(z, 0.0), z * z, np.ones_like(z)], axis=-1)
    np.testing.assert_allclose(mean_radiance(image), (0.25, 1 / 3, 1.0), rtol=1e-4)


@pytest.mark.parametrize("size", [(8, 16), (7, 5), (31, 64), (4, 8), (1, 1)])
def test_resampling_keeps_energy_and_constants(size: tuple[int, int]) -> None:
    image = RANDOM.random((4, 8, 3)) ** 8
    np.testing.assert_allclose(
        mean_radiance(resample(image, *size)), mean_radiance(image), rtol=1e-12
    )
    np.testing.assert_allclose(resample(np.ones((4, 8, 3)), *size), 1.0, rtol=1e-12)


def test_resampling_to_a_multiple_repeats_pixels() -> None:
    image = RANDOM.random((4, 8, 3))
    np.testing.assert_allclose(
        resample(image, 12, 16), image.repeat(3, axis=0).repeat(2, axis=1), rtol=1e-12
    )


def test_probes_of_different_sizes_add_up(tmp_path: Path) -> None:
    fine = np.full((8, 16, 3), 0.5)
    coarse = np.full((3, 4, 3), 2.0)
    fine[0, 0] = 1e6
    light = assemble_environment(
        [probe(tmp_path, coarse, "a.hdr", 0.25), probe(tmp_path, fine, "b.hdr")]
    )
    assert light.image.shape == (8, 16, 3) and light.image.dtype == np.float32
    np.testing.assert_allclose(light.image[1:], 1.0, rtol=1e-6)
    np.testing.assert_allclose(light.mean(), mean_radiance(fine) + 0.5, rtol=1e-2)
    assert light.name == "probe a.hdr + probe b.hdr"


def test_black_probe_and_one_strong_pixel(tmp_path: Path) -> None:
    image = np.zeros((8, 16, 3))
    assert not assemble_environment([probe(tmp_path, image)]).mean().any()
    image[3, 5] = 2.0**20
    light = assemble_environment([probe(tmp_path, image)])
    np.testing.assert_allclose(
        light.mean(), 2.0**20 * solid_angles(8, 16)[3, 5] / (4 * np.pi), rtol=1e-6
    )


def test_light_that_overflows_is_refused_with_a_count(tmp_path: Path) -> None:
    image = np.zeros((4, 4, 3))
    image[0, :3] = 1e37
    with pytest.raises(LightError, match="3 pixels"):
        assemble_environment([probe(tmp_path, image, scale=1e3)])
    path = probe(tmp_path, image).file
    path.write_bytes(path.read_bytes().replace(b"\n\n", b"\nEXPOSURE=1e-9\n\n", 1))
    with pytest.raises(LightError, match=r"p\.hdr' has 3 pixels"):
        assemble_environment([ProbeLight(path)])


def test_missing_probe_is_named(tmp_path: Path) -> None:
    with pytest.raises(LightError, match=r"absent\.hdr"):
        assemble_environment([ProbeLight(tmp_path / "absent.hdr")])


def test_digest_names_the_light_and_nothing_else(tmp_path: Path) -> None:
    image = np.ones((2, 4, 3))
    lights = [
        [],
        [ConstantLight()],
        [ConstantLight((1.0, 1.0, 0.5))],
        [probe(tmp_path, image, "a.hdr")],
        [probe(tmp_path, image, "a.hdr", 2.0)],
        [probe(tmp_path, np.ones((4, 2, 3)), "c.hdr")],
    ]
    digests = [assemble_environment(each).digest for each in lights]
    assert len(set(digests)) == len(lights)
    assert assemble_environment([probe(tmp_path, image, "b.hdr")]).digest == digests[3]


def test_lamps_are_no_environment() -> None:
    lamps = [DirectionalLight(), PointLight((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))]
    assert (
        assemble_environment([*lamps, ConstantLight()]).digest
        == assemble_environment([ConstantLight()]).digest
    )
    assert (
        assemble_environment(lamps).name == "no light"
        and not assemble_environment(lamps).mean().any()
    )


def table_of(image: np.ndarray) -> tuple[bool, np.ndarray, np.ndarray]:
    """Densities per pixel (h, w) that a table says, and the excess of the luminance over its mean
    by solid angle.
    """
    light = replace(assemble_environment([]), image=image.astype(np.float32))
    table = light.table
    excess = np.maximum(
        light.image @ LUMINANCE_WEIGHTS - light.mean() @ LUMINANCE_WEIGHTS, 0.0
    ) * solid_angles(*image.shape[:2])
    return (
        light.sharp,
        np.diff(table.rows)[:, None] * np.diff(table.columns, axis=1),
        excess / max(excess.sum(), 1e-300),
    )


def test_a_sharp_environment_samples_light_above_its_mean() -> None:
    image = RANDOM.random((9, 16, 3)) ** 12
    image[4] = 0.0
    sharp, drawn, excess = table_of(image)
    assert sharp and 0.0 < (drawn == 0.0).mean() < 1.0
    np.testing.assert_allclose(drawn, excess, atol=1e-12)


def test_cumulative_shares_begin_at_0_and_end_at_1() -> None:
    weights = RANDOM.random((5, 7))
    weights[2], weights[4] = 0.0, 0.0
    marginal, conditional = cumulative(weights)
    assert marginal.shape == (6,) and conditional.shape == (5, 8)
    assert marginal[0] == 0.0 and marginal[-1] == 1.0 and (np.diff(marginal) >= 0.0).all()
    assert not conditional[:, 0].any() and (conditional[:, -1] == 1.0).all()
    shares = np.diff(marginal)[:, None] * np.diff(conditional, axis=1)
    np.testing.assert_allclose(shares, weights / weights.sum(), atol=1e-15)


@pytest.mark.parametrize("lobe", ["nothing", "constant", "gradient", "half"])
def test_a_soft_environment_draws_nothing(lobe: str) -> None:
    z = pixel_directions(32, 64)[..., 2:]
    images = {
        "nothing": 0.0 * z,
        "constant": 0.0 * z + 3.0,
        "gradient": 1.0 + z,
        "half": 0.01 + (z > 0.0),
    }
    light = replace(assemble_environment([]), image=(images[lobe] * np.ones(3)).astype(np.float32))
    assert not light.sharp and all(part.size == 0 for part in light.table)


def test_a_constant_softens_an_environment(tmp_path: Path) -> None:
    image = np.zeros((8, 16, 3))
    image[3, 4] = 64.0
    assert assemble_environment([probe(tmp_path, image)]).sharp
    assert not assemble_environment([probe(tmp_path, image), ConstantLight((8.0, 8.0, 8.0))]).sharp


SKIES = [
    SkyLight(200.0, e, t) for e, t in itertools.product((0.0, 10.0, 45.0, 90.0), (2.0, 4.0, 10.0))
]


@pytest.mark.parametrize("light", SKIES)
def test_sky_is_finite_and_has_the_mean_that_was_asked_for(light: SkyLight) -> None:
    image, _, _ = small_sky(light)
    assert np.isfinite(image).all() and image.min() >= 0.0
    assert mean_radiance(image) @ LUMINANCE_WEIGHTS == pytest.approx(1.0)


@pytest.mark.parametrize("light", SKIES[3:])
def test_sun_stands_where_it_was_put(light: SkyLight) -> None:
    image, directions, _ = small_sky(light)
    brightest = np.unravel_index((image @ LUMINANCE_WEIGHTS).argmax(), image.shape[:2])
    assert directions[brightest] @ sun_direction(light) > np.cos(np.sqrt(2.0) * np.pi / 128)


def test_sun_energy_does_not_depend_on_the_grid() -> None:
    light = SkyLight(77.0, 33.0, 3.0)
    shares = []
    for height in (64, 128, 256, 512):
        image, directions, angles = small_sky(light, height)
        near = directions @ sun_direction(light) > np.cos(np.radians(4.0))
        flux = angles[..., None] * image
        shares.append((flux[near].sum(axis=0) / flux.sum(axis=(0, 1))) @ LUMINANCE_WEIGHTS)
    assert np.ptp(shares) < 0.02 * np.mean(shares)
    assert np.mean(shares) > 0.3


def test_ratio_of_sun_to_sky_is_that_of_daylight() -> None:
    """On the ground at noon, a clear sky gives some 10 to 25 klx and the beam of the sun some 70 to
    110.
    """
    light = SkyLight(0.0, 60.0, 2.5, (0.0, 0.0, 0.0))
    image, directions, angles = small_sky(light, 256)
    falling = angles * np.maximum(directions[..., 2], 0.0) * (image @ LUMINANCE_WEIGHTS)
    disc = image @ LUMINANCE_WEIGHTS > 100.0
    ratio = falling[disc].sum() / falling[~disc].sum()
    assert 70 / 25 < ratio < 110 / 10


def test_ground_reflects_what_falls_on_it() -> None:
    light = SkyLight(10.0, 50.0, 3.0, (0.5, 0.25, 0.0))
    image, directions, angles = small_sky(light)
    falling = np.einsum("ij,ijc->c", angles * np.maximum(directions[..., 2], 0.0), image)
    np.testing.assert_allclose(image[-1, 0], light.ground * falling / np.pi, rtol=1e-9)
    assert (image[64:] == image[-1, 0]).all()


def test_zenith_of_the_paper() -> None:
    """Turbidity 3, sun at 45°: zenith luminance and chromaticity worked out by hand from appendix
    A.2.
    """
    light = SkyLight(0.0, 45.0, 3.0)
    image, _, _ = small_sky(light, 512)
    x, y = 0.24568, 0.25148
    rgb = np.array(
        [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    )
    zenith = rgb @ np.array([x / y, 1.0, (1.0 - x - y) / y])
    seen = image[0].mean(axis=0)
    np.testing.assert_allclose(seen / seen.sum(), zenith / zenith.sum(), atol=3e-3)


def test_a_sky_in_an_environment() -> None:
    light = assemble_environment([SkyLight(sun_azimuth=90.0, sun_elevation=30.0, scale=2.0)])
    assert light.mean() @ LUMINANCE_WEIGHTS == pytest.approx(2.0, rel=1e-5)
    up, down = (
        light.radiance(np.array([[0.0, np.cos(np.pi / 6), 0.5], [0.0, 0.5, -0.5]]))
        @ LUMINANCE_WEIGHTS
    )
    assert up > 1e4 * down > 0.0


@pytest.mark.data
def test_real_probes_have_the_light_that_their_list_says(shared_data: Path) -> None:
    known = {"grace_256x128": (0.19, 2177), "noon_grass_1024x512": (0.56, 63_700)}
    for name, (mean, peak) in known.items():
        light = assemble_environment([ProbeLight(shared_data / f"probe_{name}.hdr")])
        assert light.mean() @ LUMINANCE_WEIGHTS == pytest.approx(mean, abs=0.005)
        assert (light.image @ LUMINANCE_WEIGHTS).max() == pytest.approx(peak, rel=1e-3)
        assert light.sharp


# --- environments by formula
# ------------------------------------------------------------------------------------------


DIRECTIONS = pixel_directions(128, 256)
ANGLES = solid_angles(128, 256)


def seen(name: str) -> np.ndarray:
    """The luminance of an environment."""
    return environment_image(EnvironmentLight(name), DIRECTIONS, ANGLES) @ LUMINANCE_WEIGHTS


def towards(azimuth: float, elevation: float) -> np.ndarray:
    """A unit direction, from degrees."""
    turn = math.radians(azimuth)
    tilt = math.radians(elevation)
    return np.array(
        [math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt)]
    )


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_its_mean_luminance_is_one(name: str) -> None:
    image = environment_image(EnvironmentLight(name), DIRECTIONS, ANGLES)
    assert np.isfinite(image).all() and image.min() >= 0.0
    assert np.sum(ANGLES * (image @ LUMINANCE_WEIGHTS)) / (4.0 * np.pi) == pytest.approx(
        1.0, rel=1e-9
    )


def test_an_overcast_sky_is_three_times_as_bright_above() -> None:
    sky = seen("overcast")
    assert sky[0].mean() / sky[63].mean() == pytest.approx(
        3.0 / (1.0 + 2.0 * math.sin(math.pi / 256)), rel=2e-3
    )


def test_its_ground_reflects_what_falls_on_it() -> None:
    sky = seen("overcast")
    up = DIRECTIONS[..., 2] > 0.0
    falling = np.sum((ANGLES * DIRECTIONS[..., 2] * sky)[up])
    assert sky[~up].max() == sky[~up].min()
    assert 0.15 < sky[~up].max() * math.pi / falling < 0.6, "as soil, grass and concrete do"


def test_the_studio_has_two_boxes_where_they_stand() -> None:
    """A large one in front and above, and one at the side that is a quarter as bright."""
    image = seen("studio")
    bright = image > 2.0 * np.median(image)
    apart = [
        np.degrees(np.arccos(np.clip(DIRECTIONS @ towards(*place), -1.0, 1.0)))
        for place in ((5.0, 42.0), (125.0, 18.0))
    ]
    assert bright[apart[0] < 24.0].all() and bright[apart[1] < 16.0].all()
    assert not bright[np.minimum(*apart) > 45.0].any(), "nothing else is bright"
    front, side = (image[each < 5.0].mean() for each in apart)
    assert 3.0 < front / side < 4.5


def test_the_gallery_has_as_much_glass_as_it_should() -> None:
    """Of a ceiling of 6 by 4.4, one above the eye, two strips along the room are glass: 45 %."""
    across, along = np.meshgrid(np.linspace(-3.3, 3.3, 221), np.linspace(-2.2, 2.2, 441))
    points = np.stack([across, along, np.ones_like(across)], axis=-1)[1:-1]
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    image = environment_image(EnvironmentLight("gallery"), rays, np.ones(rays.shape[:2]))
    glass = image @ LUMINANCE_WEIGHTS > 0.5 * (image @ LUMINANCE_WEIGHTS).max()
    inside = np.abs(points[..., 0]) < 2.99
    assert glass[inside].mean() == pytest.approx(1.0 / 2.2, abs=0.01)
    assert not glass[np.abs(points[..., 0]) > 3.01].any(), "walls are there"
    assert not glass[np.abs(points[..., 1]) < 0.38].any(), "a strip of ceiling is between them"


def test_noon_is_brighter_above_and_bluer_than_the_evening() -> None:
    noon, evening = (
        environment_image(EnvironmentLight(name), DIRECTIONS, ANGLES)
        for name in ("noon", "evening")
    )
    colours = [np.sum(ANGLES[..., None] * image, axis=(0, 1)) for image in (noon, evening)]
    assert colours[0][2] / colours[0][0] > 1.0 > colours[1][2] / colours[1][0]
    heights = [
        np.sum(ANGLES * DIRECTIONS[..., 2] * (image @ LUMINANCE_WEIGHTS))
        for image in (noon, evening)
    ]
    assert heights[0] > heights[1]


def test_a_light_is_named_by_word_or_by_file() -> None:
    assert light_named("studio", Path("scenes")) == EnvironmentLight("studio")
    assert light_named("hall.HDR", Path("scenes")) == ProbeLight(Path("scenes/hall.HDR"))
    assert EnvironmentLight("studio").name == ENVIRONMENTS["studio"]
    with pytest.raises(SceneError, match=r"no environment 'moon': choose overcast, .*\.hdr"):
        light_named("moon", Path())
