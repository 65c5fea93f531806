"""``isogi inspect``: what isogi knows about a volume or a scene, as text."""

import math
from collections.abc import Iterator

from isogi_core.model.scene import Scene
from server.facts import SceneFacts, scene_facts

BINS = 24
BAR = 48


def report(scene: Scene) -> str:
    """Facts, histogram and plan of a scene, for a person."""
    facts = scene_facts(scene)
    rows = [f"{name:<14}{text}" for name, text in summary(facts)]
    omissions = [f"  {each.what}: {each.why}" for each in facts.plan.left_out]
    return "\n".join([*rows, "left out", *omissions, "histogram (bars are logarithmic)", *histogram(scene)])


def summary(facts: SceneFacts) -> Iterator[tuple[str, str]]:
    """Name and text of each fact."""
    volume, plan, low_high = facts.volume, facts.plan, facts.ranges["isovalue"]
    yield "scene", facts.name
    yield "volume", f"{volume.name}, {by(volume.size)} voxels of {volume.dtype}, spacing {by(volume.spacing)}"
    yield "values", f"{volume.value_range[0]:.10g} to {volume.value_range[1]:.10g}, {volume.holes} not finite"
    yield "isovalue", f"{facts.defaults['isovalue']:.10g}, from {low_high.min:.10g} to {low_high.max:.10g}"
    yield "solid", facts.solid
    yield "albedo", ", ".join(f"{channel:g}" for channel in facts.albedo)
    yield "lights", ", ".join(light.name for light in facts.lights)
    yield "target error", f"{facts.target_error:g}"
    yield (
        "plan",
        f"{plan.representation}, order {plan.order}, {plan.channels} channel(s), {plan.bounces} bounces",
    )
    yield "texel", f"{plan.bytes_per_texel} bytes"


def by(numbers: tuple[float, ...]) -> str:
    """Numbers with × between them."""
    return " × ".join(f"{number:g}" for number in numbers)


def histogram(scene: Scene) -> Iterator[str]:
    """One line per bin: its lower edge, a bar, its count."""
    counts, edges = scene.volume.histogram(BINS)
    longest = math.log1p(counts.max())
    for count, edge in zip(counts, edges, strict=False):
        yield f"{edge:>12.5g} {'█' * round(BAR * math.log1p(count) / longest):<{BAR}} {count}"
