"""What the fork server imports, once for all workers: their code, and the kernels of their
bakes.
"""

import gc
import os

os.environ.update(
    OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1"
)  # a fork has no other threads

from isogi_core.allocation import keep_memory_small
from isogi_core.kernels._jit import entries_of, load
from worker.tasks import OPENING_KERNELS, PLAIN_LAYER_KINDS, attempt, bake_kernels


def load_what_is_stored() -> None:
    """Load the kernels of bakes that are compiled; the others are left to the workers, which say
    so.
    """
    load(
        [
            entry
            for entry in entries_of((*bake_kernels(PLAIN_LAYER_KINDS), *OPENING_KERNELS))
            if entry.stored
        ]
    )


keep_memory_small()
attempt(load_what_is_stored)
gc.freeze()  # workers share what is here as long as none writes to it, as a look for garbage does
