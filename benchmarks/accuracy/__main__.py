"""``python -m benchmarks.accuracy``."""

from benchmarks.accuracy.albedo import albedo
from benchmarks.accuracy.branching import branching
from benchmarks.accuracy.calibration import calibration
from benchmarks.accuracy.card import card
from benchmarks.accuracy.checking import checking
from benchmarks.accuracy.choices import choices
from benchmarks.accuracy.colours import colours
from benchmarks.accuracy.cuts import cuts
from benchmarks.accuracy.equal_error import equal_error
from benchmarks.accuracy.filtering import filtering
from benchmarks.accuracy.furnace import furnace
from benchmarks.accuracy.glass import glass
from benchmarks.accuracy.interpolation import interpolation
from benchmarks.accuracy.lobes import lobes
from benchmarks.accuracy.looks import looks
from benchmarks.accuracy.plans import plans
from benchmarks.accuracy.projected import projected
from benchmarks.accuracy.reports import reports
from benchmarks.accuracy.room import room
from benchmarks.accuracy.roulette import roulette
from benchmarks.accuracy.sampling import sampling
from benchmarks.accuracy.sequences import sequences
from benchmarks.accuracy.sliding import sliding
from benchmarks.accuracy.stiffness import stiffness
from benchmarks.accuracy.surfaces import surfaces
from benchmarks.accuracy.table import table
from benchmarks.accuracy.tools import tools
from benchmarks.accuracy.totals import totals
from benchmarks.common.suite import suite

main = suite(
    "How wrong pictures are, by cause, and what that costs.",
    table,
    totals,
    furnace,
    checking,
    card,
    cuts,
    colours,
    surfaces,
    room,
    looks,
    glass,
    sliding,
    sampling,
    reports,
    equal_error,
    plans,
    branching,
    calibration,
    filtering,
    interpolation,
    projected,
    choices,
    sequences,
    lobes,
    albedo,
    stiffness,
    roulette,
    tools,
)

if __name__ == "__main__":
    main(prog_name="python -m benchmarks.accuracy")
