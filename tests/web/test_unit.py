"""The page's modules without a browser: what they compute, by Node's test runner, and their types,
by TypeScript.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
NODE = shutil.which("node")
TYPESCRIPT = HERE / "node_modules" / "typescript" / "bin" / "tsc"
SECONDS = 300

pytestmark = pytest.mark.skipif(NODE is None, reason="no node: install Node.js 20 or newer")


def run(*words: str) -> subprocess.CompletedProcess[str]:
    """What Node says to these words."""
    return subprocess.run(
        [str(NODE), *words], cwd=HERE, capture_output=True, text=True, timeout=SECONDS, check=False
    )


def test_modules_compute_what_they_should() -> None:
    files = sorted(str(path) for path in (HERE / "unit").glob("*.test.mjs"))
    assert files
    result = run("--test", "--test-reporter=tap", *files)
    assert result.returncode == 0, result.stdout
    assert "\n# fail 0\n" in result.stdout and "\n# pass 0\n" not in result.stdout


@pytest.mark.skipif(
    not TYPESCRIPT.exists() and shutil.which("npm") is None,
    reason="no npm to install TypeScript with: see package.json",
)
def test_modules_have_the_types_that_they_document() -> None:
    assert TYPESCRIPT.exists(), (
        "TypeScript is not installed: `make test` does it, or `npm ci` in tests/web"
    )
    result = run(str(TYPESCRIPT), "--project", "tsconfig.json", "--listFiles")
    assert result.returncode == 0, result.stdout
    web = HERE.parents[1] / "web"
    assert {str(path) for path in web.rglob("*.js")} <= set(result.stdout.splitlines()), (
        "all are checked"
    )
