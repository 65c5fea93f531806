"""What tests of the cache share besides the helpers in ``chunks``."""

import pytest

from isogi_core.bake.look import Look
from tests.cache.chunks import look_of


@pytest.fixture(scope="module")
def look() -> Look:
    """A look of two layers."""
    return look_of()
