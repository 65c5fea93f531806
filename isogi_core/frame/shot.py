"""A shot: all that each stage of a picture takes besides what the stage before it has made."""

from dataclasses import dataclass, field

from isogi_core.bake.noise import Goal
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene


@dataclass(frozen=True, eq=False)
class Shot:
    """The surface points of a view in a ``gbuffer``, the ``light`` as the view turns it, the
    ``goal`` of its picture, and what runs the stages: the threads of ``tiles``, which may be
    cancelled, and the ``watch`` that times them.

    No result that is kept holds a shot: its tiles and its watch are those of one request.
    """

    gbuffer: GBuffer
    light: RotatedLight
    goal: Goal
    tiles: Tiles
    watch: Stopwatch = field(default_factory=Stopwatch)

    @property
    def view(self) -> View:
        """The view that is drawn."""
        return self.light.view

    @property
    def prepared(self) -> PreparedScene:
        """The prepared scene that is drawn."""
        return self.light.spec.prepared

    @property
    def scene(self) -> Scene:
        """The scene that is drawn."""
        return self.prepared.scene

    @property
    def plain(self) -> bool:
        """True if nothing but texels, lobes and paths from pixels lights the picture: the scene has
        one surface, which does not shine, no pixel shows a wall, and nothing glows.

        Other light may change a picture while its texels and its check stay the same.
        """
        scene = self.scene
        return not (
            self.light.shine is not None
            or len(self.gbuffer.walls.pixels)
            or scene.surfaces.several
            or scene.lighting.glowing.any
        )
