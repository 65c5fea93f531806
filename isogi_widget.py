"""Former name of ``isogi.widget``, which this module is; it goes with version 0.3."""

import sys
import warnings

import isogi.widget

warnings.warn("isogi_widget is isogi.widget now: import that.", DeprecationWarning, stacklevel=2)
sys.modules[__name__] = isogi.widget
