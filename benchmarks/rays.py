"""Rays per second of the scalar kernel, of the lanes and of Embree on the mesh of the same isosurface.

    python -m benchmarks.rays [TARGET] [--isovalue 70] [--size 512] [--repeats 9] [--json]

Primary rays of the benchmarks' view, cosine rays from what they hit, cosine rays from what those hit.
All candidates take the same rays in turn in one process; figures are medians and their ratios. Embree
(optional packages ``embreex`` and ``scikit-image``) traces the marching-cubes mesh.
"""

import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np

from benchmarks.common import benchmark_scene, show, view_of
from isogi_core.bake.recipe import Recipe
from isogi_core.frame.gbuffer import pinhole
from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import FIELD
from isogi_core.kernels.integrator import about, facing_normal, launch, to_index
from isogi_core.kernels.intersect import UNKNOWN
from isogi_core.kernels.rays import ORIGINS, SIDES, T, cast_each
from isogi_core.kernels.sampling import sample_cosine_hemisphere
from isogi_core.kernels.vec import madd
from isogi_core.model.scene import Scene

Rays = tuple[np.ndarray, np.ndarray, np.ndarray]
