"""The split of an error: its parts lead from the frame to the reference."""

from collections.abc import Callable

import pytest

from isogi_core.report.bench import Bench
from isogi_core.report.points import cuts_harmonics, own_light, short_light
from isogi_core.report.split import Split, split_error, study

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


def test_the_noise_part_is_what_the_frame_tells(under_sky: Bench) -> None:
    split = split_error(under_sky)
    told = under_sky.planned.frame().estimated_error
    assert 0.4 < split.spread(split.parts[0]).rmse / told < 2.5


def test_constant_light_has_no_harmonics_and_single_floats_are_not_rounded(calm: Bench) -> None:
    section = study(calm)
    assert names(split_error(calm)) == ["Monte Carlo noise", "interpolation", "bounces cut off"]
    assert not cuts_harmonics(calm.scene)
    assert own_light(calm).light is not None
    assert (own_light(calm).light == short_light(calm).light).all()
    assert "single floats" in section.about
    assert "no harmonics" in section.about
    assert len(section.pictures) == 5


def test_transfer_at_points_agrees_with_paths_under_soft_light(make_bench: Callable[..., Bench]) -> None:
    """Of two lights in one: order 6 holds a constant whole, and paths meet it as it is."""
    bench = make_bench(lights=[CONSTANT], representation="transfer", order=2)
    split = split_error(bench)
    exact = own_light(bench).light.mean() / short_light(bench).light.mean()
    assert exact == pytest.approx(1.0, abs=0.01)
    assert "harmonics cut off" not in names(split)
