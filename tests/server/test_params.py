"""The parameters of a view: what is read, what is refused and with which sentence, and the camera
that they make.
"""

from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import ViewError
from isogi_core.model.material import DULL, Shine
from isogi_core.plan.scene import Scene
from isogi_server.answers import scene_schema
from isogi_server.errors import ParameterError
from isogi_server.parameters import FrameParams, NoParams, ViewParams, documented, read
from isogi_server.prewarm.order import Views, order_of
from isogi_server.settings import Settings
from isogi_server.values import Choice, Span
from isogi_server.views import camera_of, view_of
from tests.loaded import load_scene

NUMBERS = [
    *("azimuth", "elevation", "distance", "fov", "yaw", "pitch", "roll"),
    *("roughness", "strength", "glow", "width", "height", "wait_ms", "max_error", "exposure"),
]


def refusal(*pairs: tuple[str, str]) -> ParameterError:
    with pytest.raises(ParameterError) as caught:
        read(FrameParams, pairs)
    return caught.value


def test_nothing_given_takes_the_defaults() -> None:
    params = read(FrameParams, [])
    assert (params.width, params.height, params.shading, params.wait_ms) == (512, 512, "gi", 0)
    assert not params.model_fields_set


def test_everything_is_read() -> None:
    text = "eye=1,2,3 light=1,0,0,0 width=7 shading=path_traced samples=3 f=npy max_error=0.1"
    params = read(FrameParams, (pair.split("=") for pair in text.split()))
    assert params.eye == (1, 2, 3)
    assert params.light == (1, 0, 0, 0)
    assert (params.width, params.samples, params.f, params.max_error) == (7, 3, "npy", 0.1)


@pytest.mark.parametrize("name", NUMBERS)
def test_hostile_numbers_name_parameter_range_and_value(name: str) -> None:
    for text in ("nan", "inf", "-inf", "1e999", "1_0", "", "x", "-1e6"):
        error = refusal((name, text))
        assert error.parameter == name
        assert str(error).startswith(f"{name} must be a")
        assert " from " in str(error)
        assert str(error).endswith(f"not '{text}'.")


def test_zero_size() -> None:
    assert str(refusal(("width", "0"))) == "width must be a whole number from 1 to 16383, not '0'."


def test_a_misspelt_parameter_is_answered_with_the_nearest() -> None:
    error = refusal(("isovalu", "1"))
    assert error.parameter == "isovalu"
    assert str(error) == "There is no parameter 'isovalu' here: did you mean 'isovalue'?"


def test_an_unknown_parameter_is_named_and_the_known_ones_listed() -> None:
    error = refusal(("qqq", "1"))
    assert error.parameter == "qqq"
    assert "'qqq'" in str(error)
    assert "isovalue, azimuth" in str(error)


def test_a_resource_without_parameters() -> None:
    with pytest.raises(ParameterError, match="There is no parameter 'x' here: leave it out"):
        read(NoParams, [("x", "1")])


@pytest.mark.parametrize("model", [ViewParams, FrameParams])
def test_the_document_has_the_bounds_of_each_parameter(model: type[ViewParams]) -> None:
    """Those of an isovalue are the scene's."""
    schemas = {each["name"]: each["schema"] for each in documented(model)["parameters"]}
    assert list(schemas) == list(model.model_fields)
    for name, field in model.model_fields.items():
        schema = schemas[name]
        for known in field.metadata:
            if isinstance(known, Span):
                kind = "integer" if known.whole else "number"
                assert (schema["type"], schema["minimum"], schema["maximum"]) == (
                    kind,
                    known.low,
                    known.high,
                )
            if isinstance(known, Choice):
                assert schema["enum"] == list(known.words)
        assert (
            {"minimum", "maximum"} <= set(schema)
            or schema["type"] == "string"
            or name == "isovalue"
        )
        assert schema.get("default", "none") is not None


def test_a_repeated_parameter() -> None:
    assert (
        str(refusal(("width", "5"), ("width", "5")))
        == "width is given more than once: give it once."
    )


@pytest.mark.parametrize(
    "text",
    [
        *("eye=1,2,3 azimuth=0", "eye=1,2,3 target=4,5,6 distance=2 elevation=0"),
        *("light=1,0,0,0 yaw=0", "light=1,0,0,0 roll=5 pitch=1"),
    ],
)
def test_two_ways_of_saying_one_thing(text: str) -> None:
    pairs = [(name, value) for name, _, value in (pair.partition("=") for pair in text.split())]
    sentence = str(refusal(*pairs))
    assert "is given twice" in sentence
    assert all(name in sentence for name, _ in pairs if name != "target")


@pytest.mark.parametrize("name", ["target", "up"])
def test_an_orbit_has_a_target_and_an_up(name: str) -> None:
    assert read(ViewParams, [("azimuth", "10"), (name, "0,1,3")]).model_fields_set == {
        "azimuth",
        name,
    }


def test_samples_are_for_path_tracing() -> None:
    assert "shading=path_traced" in str(refusal(("samples", "4")))
    assert read(FrameParams, [("samples", "4"), ("shading", "path_traced")]).samples == 4


@pytest.mark.parametrize("name", ["f", "overlay", "exposure"])
def test_coverage_does_not_read_what_only_a_picture_reads(name: str) -> None:
    with pytest.raises(ParameterError, match=f"There is no parameter '{name}'"):
        read(ViewParams, [(name, "png")])


def test_every_parameter_is_documented() -> None:
    listed = documented(FrameParams)["parameters"]
    assert [each["name"] for each in listed] == list(FrameParams.model_fields)
    assert all(each["description"] and each["in"] == "query" for each in listed)


def test_shine_is_asked_for_where_the_scene_shines() -> None:
    scene = load_scene("demo:casting", shine={"kind": "plastic", "roughness": 0.4})
    settings = Settings()
    given = [("shine", "metal"), ("roughness", "0.1")]
    assert view_of(scene, read(ViewParams, given), settings).shine == Shine("metal", 0.1, 1.0)
    assert view_of(scene, read(ViewParams, [("strength", "0.5")]), settings).shine == Shine(
        "plastic", 0.4, 0.5
    )
    assert view_of(scene, read(ViewParams, [("roughness", "0.4")]), settings).shine is None
    assert str(refusal(("shine", "glass"))).startswith("shine must be")


@pytest.mark.parametrize(
    ("name", "value"), [("shine", "metal"), ("roughness", "0.3"), ("strength", "0")]
)
def test_a_diffuse_scene_refuses_to_shine(name: str, value: str) -> None:
    with pytest.raises(ParameterError) as caught:
        view_of(load_scene("demo:casting"), read(ViewParams, [(name, value)]), Settings())
    assert caught.value.parameter == name
    assert (
        str(caught.value)
        == f"{name} is for scenes that shine: leave it out, or give the scene a [shine] table."
    )


def test_scenes_that_shine_say_as_what_views_may_ask_for() -> None:
    shining = load_scene("demo:casting", shine={"roughness": 0.5})
    dull = load_scene("demo:casting")
    document = scene_schema(shining)
    assert document.shines == ["plastic", "metal"]
    defaults = {"shine": "plastic", "roughness": 0.5, "strength": 1.0}
    assert document.defaults | defaults == document.defaults
    assert (document.ranges["roughness"].min, document.ranges["roughness"].max) == (0.02, 1.0)
    assert scene_schema(dull).shines == []
    assert not {"shine", "roughness", "strength"} & {*scene_schema(dull).defaults}


def test_glow_is_asked_for_where_something_glows() -> None:
    glowing = load_scene("demo:casting", glow=[{"sphere": [84, 64, 70, 8]}])
    assert view_of(glowing, read(ViewParams, [("glow", "2.5")]), Settings()).glow == 2.5
    assert scene_schema(glowing).defaults["glow"] == 1.0
    assert (scene_schema(glowing).ranges["glow"].min, scene_schema(glowing).ranges["glow"].max) == (
        0.0,
        16.0,
    )
    assert str(refusal(("glow", "17"))).startswith("glow must be")
    dark = load_scene("demo:casting")
    assert (
        "glow" not in scene_schema(dark).defaults
        and view_of(dark, read(ViewParams, []), Settings()).glow == 1.0
    )
    with pytest.raises(
        ParameterError, match="glow is for scenes in which something glows: leave it out"
    ) as caught:
        view_of(dark, read(ViewParams, [("glow", "2")]), Settings())
    assert caught.value.parameter == "glow"


def test_prewarms_look_at_the_diffuse_surface() -> None:
    scene = load_scene("demo:casting", shine={})
    views = Views(order_of({"isovalues": ["70"], "views": 2}), scene, Settings())
    assert {view.shine for view in views} == {DULL}


@pytest.fixture(scope="module")
def scene(small_scene: Path) -> Scene:
    return load_scene(small_scene)


def given(text: str) -> ViewParams:
    return read(ViewParams, (pair.split("=") for pair in text.split()))


def test_an_orbit_goes_round_its_target(scene: Scene) -> None:
    about = camera_of(scene, given("azimuth=110 elevation=-25 distance=2 target=3,4,5"))
    middle = camera_of(scene, given("azimuth=110 elevation=-25 distance=2"))
    assert about.target == (3.0, 4.0, 5.0) and middle.target == scene.volume.centre
    assert np.subtract(about.eye, about.target) == pytest.approx(
        np.subtract(middle.eye, middle.target)
    )
    assert (about.up, about.fov) == (middle.up, middle.fov)
    assert np.linalg.norm(np.subtract(about.eye, about.target)) == pytest.approx(
        2.0 * scene.volume.radius
    )


def test_a_target_alone_is_looked_at_from_where_the_scene_starts(scene: Scene) -> None:
    alone = camera_of(scene, given("target=3,4,5"))
    assert alone == camera_of(scene, given("azimuth=30 elevation=20 distance=3.4 target=3,4,5"))


def test_an_orbit_may_be_rolled_by_its_up(scene: Scene) -> None:
    rolled = camera_of(scene, given("azimuth=0 up=0,1,0"))
    level = camera_of(scene, given("azimuth=0"))
    assert (rolled.eye, rolled.target, rolled.up) == (level.eye, level.target, (0.0, 1.0, 0.0))
    with pytest.raises(ViewError, match="along the view"):
        camera_of(scene, given("azimuth=90 elevation=0 up=0,1,0"))


def test_an_eye_looks_at_the_middle_with_z_up(scene: Scene) -> None:
    camera = camera_of(scene, given("eye=50,60,70"))
    assert (camera.eye, camera.target, camera.up) == (
        (50.0, 60.0, 70.0),
        scene.volume.centre,
        (0.0, 0.0, 1.0),
    )
    assert camera_of(scene, given("eye=50,60,70 target=0,0,0")).target == (0.0, 0.0, 0.0)


def test_a_view_is_in_the_projection_that_it_or_its_scene_names(scene: Scene) -> None:
    flat = scene.with_settings(projection="orthographic")
    usual = camera_of(scene, given("azimuth=10"))
    parallel = camera_of(flat, given("azimuth=10"))
    assert parallel.fov < 1e-4 < usual.fov == 30.0
    assert camera_of(scene, given("azimuth=10 projection=orthographic")) == parallel
    assert camera_of(flat, given("azimuth=10 projection=perspective")) == usual
    assert camera_of(scene, given("azimuth=10 projection=perspective")) == usual
    with pytest.raises(ParameterError, match="projection"):
        given("projection=fisheye")
