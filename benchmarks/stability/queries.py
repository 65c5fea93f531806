"""Cases of what may be asked for: the knobs' ends, and views without meaning."""

from benchmarks.stability.cameras import FURTHEST, NARROWEST, WIDEST
from benchmarks.stability.case import Outcome, Size, case
from benchmarks.stability.views import GROUP
from isogi_core.errors import ViewError
from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import Camera
from server.params import ViewParams, read
from server.views import camera_of

REFUSED = (
    *("eye=9,9,9 target=9,9,9", "eye=0,0,0 target=0,0,5 up=0,0,1", "eye=0,0,0 target=0,0,5", "up=0,0,0 eye=1,2,3"),
    *("eye=nan,0,0", "target=0,inf,0", "eye=1e13,0,0", "eye=0,0", "eye=1,2,3 azimuth=4", "azimuth=361"),
    *(
        "elevation=90.1",
        f"distance={2.0 * FURTHEST:g}",
        "distance=0",
        "distance=-1",
        "width=0",
        "height=0",
        "width=2.5",
    ),
    *(f"fov={0.5 * NARROWEST:g}", f"fov={WIDEST + 0.5:g}", "fov=180", "fov=0", "fov=-30", "fov=nan"),
)
"""Queries for views that mean nothing, or that are out of range."""

ENDS = (f"fov={NARROWEST}", f"fov={WIDEST}", f"distance={FURTHEST}", "distance=0.01", "azimuth=-360")
"""Queries that are at the ends of their ranges."""


def asked(scene: Scene, query: str) -> Camera:
    """The camera that a query asks for, its pairs apart by blanks; ViewError where it is refused."""
    pairs = (pair.partition("=") for pair in query.split())
    return camera_of(scene, read(ViewParams, ((name, value) for name, _, value in pairs)))


@case(GROUP, "views without meaning", "a view that shows nothing for certain is refused, with a sentence", 0, "views")
def refused(size: Size) -> Outcome:
    """Eye at the target, up along the view, and knobs out of range."""
    scene, taken = load_scene("demo:orbital"), []
    for query in REFUSED:
        try:
            asked(scene, query)
            taken.append(query)
        except ViewError as error:
            taken += [query] if not str(error) else []
    return Outcome(len(taken), f"of {len(REFUSED)}" + f": {', '.join(taken)}" * bool(taken))


@case(GROUP, "allowed extremes", "the narrowest and widest fields and the farthest eye may be asked for", 0, "views")
def allowed(size: Size) -> Outcome:
    """The knobs' ends."""
    scene, wrong = load_scene("demo:orbital"), []
    for query in ENDS:
        try:
            asked(scene, query)
        except ViewError as error:
            wrong.append(str(error))
    return Outcome(len(wrong), f"of {len(ENDS)}" + f": {' '.join(wrong)}" * bool(wrong))
