"""What the fork server imports, once for all workers: their code, and the kernels of their bakes."""

import gc
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")  # a fork has no other threads

from isogi_core.allocation import keep_memory_small
from worker.tasks import KINDS, attempt, kernels_missing, load_kernels


def load_what_is_stored() -> None:
    """Load the kernels of bakes; where some are not compiled yet, leave that to the workers, which say so."""
    if not kernels_missing(KINDS):
        load_kernels(KINDS)


keep_memory_small()
attempt(load_what_is_stored)
gc.freeze()  # workers share what is here as long as none writes to it, as a look for garbage does
