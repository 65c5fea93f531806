"""What the report is of, and its headline: how wrong the frame is, what it took, and where it differs (S1, fig. 11)."""

from isogi_core.model.scene_plan import Layer
from isogi_report.bench import Bench
from isogi_report.metrics import SCORE_COLUMNS, error_map, score_cells
from isogi_report.sections import Cell, Column, Picture, Section, Table

SUMMARY_KEY, SUMMARY_TITLE = "summary", "Summary"

SUMMARY_TEXT = """\
One view of a scene, each of its texels baked to the target error by the scene's plan, against a reference: paths from \
each pixel to the lights themselves, with the scene's own normals and offset. Errors are of the luminance, over the \
surface pixels, relative to the reference's mean: the root mean square (less the reference's own noise), what 99 % of \
pixels stay below, the signed mean (bias); FLIP is of the pictures as a screen shows them. Random numbers belong to \
texels and pixels, so that light of as many samples has the same bits again; how many the reference has may hang on \
the time that there was. Seconds are of the processor, all threads together."""


def study(bench: Bench) -> Section:
    """The headline, the facts, and the pictures."""
    planned, best = bench.planned, bench.best
    frame = planned.frame()
    own = score_cells(bench.score(frame.leaving))
    columns = (*SCORE_COLUMNS, Column("estimated noise", "share"), Column("bake", "seconds"))
    headline = Table("The frame", columns, ((*own, frame.noise, planned.seconds),))
    measured = (Column("reference's noise", "share"), Column("paths per pixel", "count"), Column("time", "seconds"))
    reference = Table("Its reference", measured, ((best.noise, best.samples, best.seconds),))
    scene = Table("The scene", (Column("what"), Column("is")), measured_facts(bench))
    pictures = (
        Picture("the frame", "radiance", frame.radiance),
        Picture(f"the reference, {best.samples} paths per pixel", "radiance", best.mean),
        Picture("the frame's error", "error", error_map(frame.leaving, best)),
    )
    return Section(SUMMARY_KEY, SUMMARY_TITLE, SUMMARY_TEXT, (headline, reference, scene), (), pictures)


def measured_facts(bench: Bench) -> tuple[tuple[Cell, ...], ...]:
    """What is measured, in words."""
    scene, view, planned = bench.scene, bench.view, bench.planned
    lights = " + ".join(light.name for light in scene.lighting.lights) or "no light"
    layers = " + ".join(map(layer_in_words, scene.plan.layers))
    size = " × ".join(map(str, scene.volume.size))
    texels = f"{len(planned.texels):,} texels, {planned.samples:,.0f} samples each on average"
    return (
        (
            "volume",
            f"{scene.volume.name}, {size} voxels, isovalue {view.isovalue:g}",
        ),
        ("lights", f"{lights}, {'may turn' if scene.lighting.rotating else 'stay where they are'}"),
        ("picture", f"{view.width} × {view.height}, {int(bench.best.on.sum()):,} surface pixels, {texels}"),
        ("plan", f"{scene.plan.representation}: {layers}; {scene.plan.bytes_per_texel} bytes per texel"),
        ("bounces", f"{scene.bounces} of the plan, {bench.whole.bounces} of the reference"),
        ("target error", f"{scene.target_error:.1%} of noise, at most, in pixels of final texels"),
    )


def layer_in_words(layer: Layer) -> str:
    """A layer in words."""
    order = f" of order {layer.order}" if layer.kind != "irradiance" else ""
    return f"{layer.kind} light{order}, {layer.channels} × {layer.order**2} in {layer.precision}"
