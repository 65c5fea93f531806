"""Kernels of vectors again, compiled for other processors than this: tests of them in a process of
their own.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from isogi_core.kernels.simd.types import REGISTER_LANES
from tests.scale import COMPILED

KERNELS = Path(__file__).parents[1]

RAYS = ["simd/test_ray_vectors.py", "tracing/test_cast.py"] if REGISTER_LANES else []
"""Tests of rays in vectors, which not every processor has."""

PROCESSORS = {
    "haswell": ({}, ["simd/test_path_vectors.py", *RAYS]),
    "nehalem": ({"NUMBA_CPU_FEATURES": "+sse4.2"}, ["simd/test_path_vectors.py"]),
}
"""What else Numba is told of each, and the tests."""


@pytest.mark.slow
@COMPILED
@pytest.mark.long
@pytest.mark.parametrize("processor", ["haswell", "nehalem"])
def test_all_of_it_again_for_other_processors(processor: str) -> None:
    """Eight lanes and rays by AVX2, four lanes without it."""
    told, tests = PROCESSORS[processor]
    files = [str(KERNELS / each) for each in tests]
    options = [
        "-q",
        "-x",
        "-m",
        "not data",
        "-p",
        "no:cacheprovider",
        "--noconftest",
        "-c",
        os.devnull,
    ]
    command = [sys.executable, "-m", "pytest", *options, *files]
    environment = {
        **os.environ,
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        "NUMBA_CPU_NAME": processor,
        **told,
    }
    run = subprocess.run(
        command,
        env=environment,
        cwd=KERNELS.parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
