"""Import the workers' code and load the kernels of their bakes,
once for all workers: the fork server imports this module.
"""

import gc
import os

# A forked process has only the thread that forked it, so libraries must not start threads here.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

from isogi_core.allocation import keep_memory_small
from isogi_core.kernels._jit import entries_of, load
from isogi_worker.tasks import OPENING_KERNELS, PLAIN_LAYER_KINDS, attempt, bake_kernels


def load_what_is_stored() -> None:
    """Load the kernels that open a scene and those that bake plain layers, as far as this machine
    has stored their compiled code.

    The others are left to the workers, which compile them while the server tells users of it.
    """
    # ``load`` would compile a kernel that is not stored, so leave those out.
    load(
        [
            entry
            for entry in entries_of((*bake_kernels(PLAIN_LAYER_KINDS), *OPENING_KERNELS))
            if entry.stored
        ]
    )


keep_memory_small()
attempt(load_what_is_stored)
# Workers share this memory as long as none of them writes to it, as the garbage collector would.
gc.freeze()
