"""Documents beside the light: kept whole, listed, and told where they are damaged."""

import re
from pathlib import Path

import pytest

from isogi_core.errors import StoreError
from isogi_core.storage.documents import Documents


@pytest.mark.parametrize("scheme", ["", "file://"])
def test_what_is_written_is_read_and_listed(tmp_path: Path, scheme: str) -> None:
    documents = Documents(f"{scheme}{tmp_path}", "papers")
    assert (documents.read("one"), documents.names()) == (None, [])
    documents.write("one", {"a": 1})
    documents.write("two", {"b": [2.5, None, "é"]})
    documents.write("one", {"a": 3})
    assert documents.read("one") == {"a": 3}
    assert documents.read("two") == {"b": [2.5, None, "é"]}
    assert documents.names() == ["one", "two"]
    assert documents.path_of("one") == f"{tmp_path}/papers/one.json"
    assert sorted(path.name for path in (tmp_path / "papers").iterdir()) == ["one.json", "two.json"]


@pytest.mark.parametrize("content", ["", "{", "[1]"])
def test_damaged_files_are_errors(tmp_path: Path, content: str) -> None:
    (tmp_path / "papers").mkdir()
    (tmp_path / "papers" / "one.json").write_text(content)
    with pytest.raises(StoreError, match="damaged"):
        Documents(tmp_path, "papers").read("one")


def test_a_place_that_is_none_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StoreError, match=re.escape(str(tmp_path))):
        Documents(str(tmp_path / "file"), "papers").write("one", {})
