"""Ignore Ctrl-C, which a terminal sends to the fork server and its workers, too: the process that
started them handles it.

The fork server imports this module first, as it would otherwise end with a traceback while it
imports the rest.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_IGN)
