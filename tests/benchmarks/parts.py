"""Parts of suites, run in this process on something tiny, and benches for them."""

import json
from pathlib import Path
from typing import Any

import click
from click.testing import CliRunner, Result

from isogi_core.plan.assembly import load_scene
from isogi_report.bench import Bench
from isogi_report.speed import view_of

SKY = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
CONSTANT = {"type": "constant", "radiance": 1.0}


def run(part: click.Command, *arguments: str) -> Result:
    """What a part says; it must succeed."""
    done = CliRunner().invoke(part, list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done


def figures(part: click.Command, *arguments: str) -> dict[str, Any]:
    """The figures of a part that measures one thing."""
    found: dict[str, Any] = json.loads(run(part, *arguments, "--json").stdout.splitlines()[-1])
    return found


def bench_of(folder: Path, size: int = 16, **settings: Any) -> Bench:
    """A bench of the orbital under a sky, or as settings say."""
    scene = load_scene(
        "demo:orbital", **{"lights": [SKY], "bounces": 2, "target_error": 0.1, **settings}
    )
    return Bench(scene, view_of(scene, size), folder)
