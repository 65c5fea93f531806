"""``python -m benchmarks.speed``."""

from benchmarks.common.suite import suite
from benchmarks.speed.cold import cold
from benchmarks.speed.cutting import cutting
from benchmarks.speed.edges import edges
from benchmarks.speed.film import film
from benchmarks.speed.first_view import first_view
from benchmarks.speed.frames import frames
from benchmarks.speed.growth import growth
from benchmarks.speed.isovalue import isovalue
from benchmarks.speed.paths import paths
from benchmarks.speed.points import points
from benchmarks.speed.rays import rays
from benchmarks.speed.rooms import rooms

main = suite(
    "How fast isogi is, beside its peers where they are installed.",
    frames,
    cold,
    isovalue,
    first_view,
    rays,
    paths,
    growth,
    points,
    edges,
    film,
    cutting,
    rooms,
)

if __name__ == "__main__":
    main(prog_name="python -m benchmarks.speed")
