"""What all tests of kernels share."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.scale import PYTHON


@pytest.fixture(autouse=PYTHON)
def silence() -> Iterator[None]:
    """Kernels that Python runs say no more of a division by zero than compiled ones do."""
    with np.errstate(all="ignore"):
        yield
