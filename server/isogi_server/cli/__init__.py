"""The command line: one module for each command."""

from isogi_server.cli.command import main

__all__ = ["main"]
