"""Use a wheel of this tree with the lowest and with the highest versions that ``pyproject.toml``
permits, on each Python: ``python -m tests.package.check_wheel [VERSION OF PYTHON …]``.

Each pair has an environment of its own, which is removed before the next is made. Versions are
chosen among wheels alone, for isogi needs no compiler: if the lowest version of a library has no
wheel for a Python, the next that has one takes its place.
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
PYTHONS = ("3.11", "3.12", "3.13")
VERSIONS = {"lowest": "lowest-direct", "highest": "highest"}
"""Names of the two choices, and what uv calls them."""

USES = Path(__file__).with_name("use_wheel.py")
UV = (sys.executable, "-m", "uv")


def build(folder: Path) -> Path:
    """Build a wheel of this tree into a ``folder``, by way of a source archive: files of former
    builds do not get into it.
    """
    run(*UV, "build", "--quiet", "--out-dir", str(folder), str(ROOT), cwd=folder)
    (wheel,) = folder.glob("isogi-*.whl")
    return wheel


def check(wheel: Path, python: str, versions: str, folder: Path) -> None:
    """Install a wheel for a Python with the ``versions`` in an empty ``folder``, and use it."""
    environment = folder / "environment"
    run(*UV, "venv", "--quiet", "--python", python, str(environment), cwd=folder)
    program = environment / "bin" / "python"
    install = (*UV, "pip", "install", "--python", str(program))
    # The wheel's dependencies are the lowest only if they are asked for by themselves.
    chosen = ("--only-binary", ":all:", "--resolution", VERSIONS[versions])
    run(*install, *chosen, "--requirements", str(ROOT / "pyproject.toml"), cwd=folder)
    run(*install, "--quiet", "--no-deps", str(wheel), cwd=folder)
    run(*UV, "pip", "check", "--quiet", "--python", str(program), cwd=folder)
    run(str(program), str(USES), cwd=folder, ISOGI_KERNEL_CACHE=str(folder / "kernels"))


def run(*command: str, cwd: Path, **variables: str) -> None:
    """Run a command that sees nothing of this tree, nor of settings of isogi."""
    ours = ("ISOGI_", "PYTHONPATH", "VIRTUAL_ENV")
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    subprocess.run(command, cwd=cwd, env={**inherited, **variables}, check=True)


def say(sentence: str) -> None:
    """Print a sentence at once."""
    sys.stdout.write(f"{sentence}\n")
    sys.stdout.flush()


def main(pythons: list[str]) -> int:
    """Check all pairs, and return the number of those that failed."""
    failed = []
    with TemporaryDirectory(prefix="isogi-wheel-") as built:
        wheel = build(Path(built))
        for python in pythons or PYTHONS:
            for versions in VERSIONS:
                began = time.monotonic()
                say(f"Python {python}, {versions} versions:")
                try:
                    with TemporaryDirectory(prefix="isogi-wheel-") as folder:
                        check(wheel, python, versions, Path(folder))
                except subprocess.CalledProcessError as error:
                    failed.append(f"Python {python}, {versions} versions")
                    say(f"  failed: {error}")
                else:
                    say(f"  the wheel works ({time.monotonic() - began:.0f} s)")
    say(f"failed: {'; '.join(failed)}" if failed else "all of them work")
    return len(failed)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
