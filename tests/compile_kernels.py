"""Compile every entry kernel on all cores, so that no test waits for one: ``python -m
tests.compile_kernels``.
"""

from importlib import import_module
from pkgutil import walk_packages

from isogi_core import kernels
from isogi_core.kernels._compilation import warm
from isogi_core.kernels._jit import Entry


def entry_kernels() -> list[Entry]:
    """Find the entry kernels of all modules, each once."""
    modules = [
        import_module(each.name) for each in walk_packages(kernels.__path__, f"{kernels.__name__}.")
    ]
    found = {
        id(each): each
        for module in modules
        for each in vars(module).values()
        if isinstance(each, Entry)
    }
    return list(found.values())


def compile_all() -> None:
    """Have every entry kernel on this machine, and in this process."""
    warm(entry_kernels())


if __name__ == "__main__":
    compile_all()
