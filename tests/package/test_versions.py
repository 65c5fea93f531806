"""Versions that isogi promises, locks and checks agree."""

import re
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.package.check_wheel import PYTHONS

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_wheel_is_checked_on_each_promised_python() -> None:
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert list(PYTHONS) == promised
    workflow = (ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
    matrices = re.findall(r"python: \[(.*)\]", workflow)
    assert matrices and all(re.findall(r"3\.\d+", each) == promised for each in matrices)


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-dev.lock"])
def test_locked_versions_are_within_bounds(lock: str) -> None:
    locked = defaultdict(set)
    for name, version in re.findall(r"(?m)^([\w.-]+)==(\S+)", (ROOT / lock).read_text()):
        locked[name].add(version)
    extras = PROJECT["optional-dependencies"]
    asked = [Requirement(each) for group in extras.values() for each in group]
    asked += [Requirement(each) for each in PROJECT["dependencies"]]
    outside = [
        f"{each} is locked at {version}"
        for each in asked
        for version in locked[canonicalize_name(each.name)]
        if not each.specifier.contains(version)
    ]
    assert outside == []
    own = {canonicalize_name(Requirement(each).name) for each in PROJECT["dependencies"]}
    assert own <= {name for name, versions in locked.items() if versions}
