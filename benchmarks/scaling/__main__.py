"""``python -m benchmarks.scaling``."""

from benchmarks.common.suite import suite
from benchmarks.scaling.cluster import cluster
from benchmarks.scaling.compose import compose
from benchmarks.scaling.damage import damage
from benchmarks.scaling.kills import kills
from benchmarks.scaling.kinds import kinds
from benchmarks.scaling.large import large
from benchmarks.scaling.prewarm import prewarm
from benchmarks.scaling.public import public
from benchmarks.scaling.simulate import simulate
from benchmarks.scaling.time_left import time_left
from benchmarks.scaling.together import together

main = suite(
    "Many workers, large volumes, faults, and what is foretold of long bakes.",
    cluster,
    simulate,
    large,
    kinds,
    public,
    prewarm,
    time_left,
    together,
    kills,
    damage,
    compose,
)

if __name__ == "__main__":
    main(prog_name="python -m benchmarks.scaling")
