"""The command line: one module for each command."""

from server.cli.command import main

__all__ = ["main"]
