"""Documents beside the light: kept whole, listed, and told where they are damaged."""

import re
from pathlib import Path
from typing import Any

import pytest

from isogi_core.errors import ChangedError, StoreError
from isogi_core.storage.store import MAX_TRIES, Documents, Store


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


@pytest.mark.parametrize("others", [0, 1, MAX_TRIES - 1, MAX_TRIES])
def test_a_document_that_others_write_too_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, others: int
) -> None:
    documents, put, tried = Documents(tmp_path, "papers"), Store.put, list[str]()

    def contested(store: Store, key: str, *what: Any) -> None:
        tried.append(key)
        if len(tried) <= others:
            raise ChangedError("Another writer was here.")
        put(store, key, *what)

    documents.write("one", {"a": 1})
    monkeypatch.setattr(Store, "put", contested)
    if others < MAX_TRIES:
        documents.write("one", {"a": 2})
    else:
        with pytest.raises(StoreError, match="Others keep writing"):
            documents.write("one", {"a": 2})
    assert documents.read("one") == {"a": 2 if others < MAX_TRIES else 1}
    assert len(tried) == min(others + 1, MAX_TRIES)
