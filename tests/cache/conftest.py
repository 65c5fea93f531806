"""What tests of the cache share besides the helpers in ``chunks``."""

import pytest

from isogi_core.bake.bake_spec import BakeSpec
from tests.cache.chunks import spec_of


@pytest.fixture(scope="module")
def spec() -> BakeSpec:
    """A look of two layers."""
    return spec_of()
