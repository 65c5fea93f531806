"""The split of an error: its parts lead from the frame to the reference."""

from collections.abc import Callable

import numpy as np
import pytest

from isogi_report.bench import Bench
from isogi_report.exact import cuts_harmonics, lit_by_paths, own_light, reference_difference, short_paths
from isogi_report.metrics import mean_of, spread_of
from isogi_report.studies import Split, split_error, study_split, true_surface

CONSTANT = {"type": "constant", "radiance": 1.0}


@pytest.fixture(scope="module")
def calm(make_bench: Callable[..., Bench]) -> Bench:
    """The orbital under constant light, in single floats."""
    return make_bench(lights=[CONSTANT], precision="single")


def names(split: Split) -> list[str]:
    return [part.name for part in split.parts]


def test_parts_lead_from_the_frame_to_the_reference(under_sky: Bench) -> None:
    split = split_error(under_sky)
    biases = sum(split.spread(part).bias for part in split.parts)
    assert biases == pytest.approx(split.spread(split.whole).bias, abs=1e-6)
    assert 0.5 < split.together / split.spread(split.whole).rmse < 2.0


def test_each_cause_is_there_where_it_acts(under_sky: Bench) -> None:
    split = split_error(under_sky)
    assert names(split) == [
        "Monte Carlo noise",
        "quantization",
        "interpolation",
        "harmonics cut off",
        "bounces cut off",
    ]
    sizes = dict(zip(names(split), (split.spread(part) for part in split.parts), strict=True))
    assert 0.0 < sizes["quantization"].rmse < 0.02
    assert sizes["harmonics cut off"].rmse > 0.02
    assert sizes["bounces cut off"].bias <= 0.0


@pytest.mark.slow
def test_the_noise_part_is_what_the_frame_tells(make_bench: Callable[..., Bench]) -> None:
    """At 2 %: where 64 samples are far more than enough, less is left than is told."""
    bench = make_bench(target_error=0.02)
    split = split_error(bench)
    told = bench.planned.frame().noise
    assert 0.67 < split.spread(split.parts[0]).rmse / told < 1.5


def test_what_is_cut_off_beside_a_lobe_is_little(make_bench: Callable[..., Bench]) -> None:
    """The same view by harmonics alone, and with the sun as a lobe of the same orders."""
    orders = {"order": 3, "indirect_order": 3, "bounces": 1}
    cut = {}
    for lobes in (0, 1):
        bench = make_bench(lobes=lobes, **orders)
        own, lights = own_light(bench), lit_by_paths(short_paths(bench))
        cut[lobes] = spread_of(own.light - lights.light, own.noise + lights.noise, mean_of(lights.light)).rmse
    assert cut[1] < 0.5 * cut[0] and cut[0] > 0.05


@pytest.mark.slow
def test_what_two_references_share_is_not_noise(make_bench: Callable[..., Bench]) -> None:
    """Of other normals' pictures with 64 paths, against the same with many more."""
    bench = make_bench()
    few, many = ((bench.reference(n), bench.reference(n, true_surface(bench.scene))) for n in (64, 4096))
    change, exact = reference_difference(*few), reference_difference(*many)
    met = ((change.light - exact.light) ** 2).mean()
    assert 0.5 < change.noise.mean() / met < 2.0
    assert change.noise.mean() < sum(lit_by_paths(each).noise.mean() for each in few)


def test_normals_and_offset_are_told_apart(under_sky: Bench) -> None:
    split = split_error(under_sky)
    wrong = split.beyond.wrong - split.whole.wrong
    assert np.allclose(split.surface.wrong, wrong, atol=1e-5)
    assert split.spread(split.surface).rmse > 0.005
    assert np.mean(split.surface.noise) < 0.1 * np.mean(split.surface.wrong**2)


def test_constant_light_has_no_truncation_and_no_rounding(calm: Bench) -> None:
    section = study_split(calm)
    assert names(split_error(calm)) == ["Monte Carlo noise", "interpolation", "bounces cut off"]
    assert not cuts_harmonics(calm.scene)
    assert own_light(calm).light is not None
    assert (own_light(calm).light == lit_by_paths(short_paths(calm)).light).all()
    assert "single floats" in section.about
    assert "no harmonics" in section.about
    assert len(section.pictures) == 5


def test_transfer_at_points_agrees_with_paths_under_soft_light(make_bench: Callable[..., Bench]) -> None:
    """Of two lights in one: order 6 holds a constant whole, and paths meet it as it is."""
    bench = make_bench(lights=[CONSTANT], representation="transfer", order=2)
    split = split_error(bench)
    exact = own_light(bench).light.mean() / lit_by_paths(short_paths(bench)).light.mean()
    assert exact == pytest.approx(1.0, abs=0.01)
    assert "harmonics cut off" not in names(split)
