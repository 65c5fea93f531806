"""Changes of a scene's document as parameters spell them: materials and their numbers."""

import pytest

from isogi_core.errors import SceneError
from isogi_core.files.scene_file import put_material, read_material_text, write_material_text

SPELLED = [
    ("diffuse", {"material": "diffuse"}),
    ("glass", {"material": "glass"}),
    ("glass,index=1.3", {"material": "glass", "index": 1.3}),
    ("glass,absorption=0.1,0.2,0.3", {"material": "glass", "absorption": [0.1, 0.2, 0.3]}),
    ("glass,index=2.0,absorption=0.5", {"material": "glass", "index": 2.0, "absorption": 0.5}),
    ("subsurface,mean_free_path=1e20", {"material": "subsurface", "mean_free_path": 1e20}),
]


@pytest.mark.parametrize(("text", "settings"), SPELLED)
def test_a_text_says_a_material_and_its_numbers(text: str, settings: dict[str, object]) -> None:
    assert read_material_text(text) == settings
    assert write_material_text(settings) == text


def test_equal_settings_are_spelled_alike() -> None:
    texts = ["glass, absorption = 0.5 ,index=2", "glass,index=2.0,absorption=.5"]
    assert len({write_material_text(read_material_text(text)) for text in texts}) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "give a word"),
        ("glass@noon", "give a word"),
        ("1.5", "give a word"),
        ("glass,1.5", "give a word"),
        ("glass,index", "give a word"),
        ("glass,index=", "give a word"),
        ("glass,index=thick", "give a word"),
        ("glass,colour=3", "index, absorption, mean_free_path"),
        ("glass,", "give a word"),
        ("glass,mean_free_path=3", "mean_free_path is of subsurface, not of glass: leave it out"),
    ],
)
def test_texts_that_say_no_material_are_refused(text: str, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        read_material_text(text)


def test_what_only_reflects_is_left_behind() -> None:
    paint = {"volume": "a.nrrd", "albedo": 0.9, "albedos": [0, 0.9]}
    assert put_material(paint, {"material": "glass", "index": 1.3}) == {
        "volume": "a.nrrd",
        "material": "glass",
        "index": 1.3,
    }
    wax = {"volume": "a.nrrd", "albedo": 0.9, "material": "subsurface"}
    assert put_material(paint, {"material": "subsurface"}) == wax
    assert put_material(paint, {"material": "diffuse"}) == paint
    assert put_material({**wax, "mean_free_path": 2.0}, {"material": "diffuse"}) == {
        **wax,
        "material": "diffuse",
    }


def test_numbers_of_the_same_material_stay() -> None:
    glass = {"material": "glass", "index": 1.3, "absorption": 0.2}
    assert put_material(glass, {"material": "glass", "index": 1.5}) == {**glass, "index": 1.5}
