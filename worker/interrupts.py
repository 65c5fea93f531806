"""Ctrl-C, which a terminal sends to the fork server and its workers too, is left to the process
that started them.

The fork server imports this first: it would end with a traceback while it imports the rest.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_IGN)
