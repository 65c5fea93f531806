"""Former name of ``isogi.client``, which this module is; it goes with version 0.3."""

import sys
import warnings

import isogi.client

warnings.warn("isogi_client is isogi.client now: import that.", DeprecationWarning, stacklevel=2)
sys.modules[__name__] = isogi.client
