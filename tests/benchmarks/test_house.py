"""The counts of ``benchmarks.house`` follow their rules on source."""

import ast
from pathlib import Path

import pytest

from benchmarks import house


def test_fields_methods_and_names_are_counted_from_source() -> None:
    record = ast.parse(
        "class A:\n    one: int\n    two: str = ''\n    ONE = 1\n    def step(self) -> bool: ..."
    ).body[0]
    assert isinstance(record, ast.ClassDef)
    assert house.fields_of(record) == ["one", "two"] and list(house.methods_of(record)) == ["step"]
    names = [
        house.names_given(each) for each in ast.parse("A, B = 1, 2\ndef c(): ...\nd.e = 3").body
    ]
    assert names == [["A", "B"], ["c"], []]


def test_names_in_three_modules_are_counted_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3):
        (tmp_path / f"m{number}.py").write_text(
            f"FAR = 1\ndef same(): ...\ndef only_{number}(): ...\n"
        )
    monkeypatch.setattr(house, "ROOT", tmp_path)
    monkeypatch.setattr(house, "PRODUCT", (".",))
    assert (
        house.shared_names(),
        house.common_constants(),
        house.modules(),
        house.lines_of("."),
    ) == (1, 1, 3, 9)


def test_constants_and_private_attributes_in_tests_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tests").mkdir()
    for number in range(2):
        (tmp_path / "tests" / f"test_{number}.py").write_text(
            "from isogi_core.one import MOST, Some, some\nfrom numpy import PI\n"
            "some._kept.other\nself._mine\nsome.__class__\n"
        )
    monkeypatch.setattr(house, "ROOT", tmp_path)
    assert (house.imported_constants(), house.private_attributes()) == (1, 2)
