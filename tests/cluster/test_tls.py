"""A cluster that speaks TLS, with the commands of docs/cluster.md, refuses strangers.

That all processes speak to each other so is told by ``test_coming_and_going.py``.
"""

from pathlib import Path

import pytest

from tests.cluster.processes import DASK, DOCUMENTED, HEALTH, LONG, OWN, QUIET, Cluster, named, write_certificates


def test_the_commands_of_the_documentation_name_them_all() -> None:
    started = [line for line in DOCUMENTED.splitlines() if line.startswith(("dask ", "isogi serve"))]
    assert len(started) == 3
    assert all(f"export {name}='{value}'" in DOCUMENTED for name, value in HEALTH.items())
    for line, options in zip(started, (DASK, DASK, OWN), strict=True):
        assert " ".join(named(options, Path())) in line


@pytest.mark.cluster
def test_a_scheduler_refuses_strangers(tmp_path: Path) -> None:
    """A worker with the certificates of another authority, and one without any."""
    write_certificates(tmp_path)
    with Cluster() as running:
        running.scheduler()
        strangers = [running.worker(*known) for known in (named(DASK, tmp_path), QUIET)]
        assert all(stranger.wait(LONG) != 0 for stranger in strangers)
