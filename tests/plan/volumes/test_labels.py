"""Segmentations as volumes: the field of their labels, the colours, what hidden ones change, and
mistakes.
"""

from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.cache.scene_assets import receive_assets, receive_colours, send_assets
from isogi_core.errors import IsogiError, SceneError, VolumeError
from isogi_core.files import grid as grids
from isogi_core.files import mappings
from isogi_core.files.scene_file import read_hidden
from isogi_core.kernels.transport.colours import colours_of as kernel_colours
from isogi_core.kernels.transport.colours import fill_albedos
from isogi_core.model.colours import SurfaceColours
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import cut_open, with_hidden
from isogi_core.plan.volumes import labels as module
from isogi_core.plan.volumes.colours import stride_of, weighed
from isogi_core.plan.volumes.labels import smooth
from isogi_core.storage.store import Store
from tests.loaded import load_scene

Z, Y, X = np.indices((17, 18, 19)).astype(float)
RADIUS = np.sqrt((X - 9) ** 2 + (Y - 8) ** 2 + (Z - 8) ** 2)
HALVES = np.where(RADIUS < 6.2, np.where(X < 9, 3, 5), 0).astype(np.int16)
RED = [0.8, 0.1, 0.1]
GREEN = [0.1, 0.6, 0.1]


def scene_of(
    folder: Path, labels: Any = "all", volume: np.ndarray = HALVES, **settings: Any
) -> Scene:
    """The scene of a segmentation in a folder."""
    header: dict[str, Any] = settings.pop("header", {})
    nrrd.write(str(folder / "seg.nrrd"), np.ascontiguousarray(volume), header, index_order="C")
    (folder / "s.toml").write_text('volume = "seg.nrrd"\n')
    return load_scene(folder / "s.toml", labels=labels, **settings)


def table(value: int, **more: Any) -> dict[str, Any]:
    """An entry of [[labels]]."""
    return {"value": value, **more}


def colours_of(scene: Scene) -> SurfaceColours:
    """The colours that it has."""
    assert scene.surfaces.colours is not None
    return scene.surfaces.colours


def albedos(scene: Scene, points: np.ndarray) -> np.ndarray:
    """The albedos at points x, y, z (n, 3) in voxels."""
    colours = colours_of(scene)
    found = np.empty((len(points), 3), np.float32)
    places = kernel_colours(colours.places, colours.step, colours.table)
    fill_albedos(places, points.astype(np.float32), found)
    return found


def test_the_field_is_that_of_scipy() -> None:
    """Where nothing is thin: the Gaussian of the parts that are shown."""
    filters = pytest.importorskip("scipy.ndimage")
    expected = filters.gaussian_filter((RADIUS < 6.2).astype(float), 1.0, mode="nearest", radius=3)
    found = np.concatenate(list(smooth(RADIUS < 6.2)))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_ball_has_its_radius_without_stairs() -> None:
    """But for the curvature's share, σ² / r: by the slope of a smoothed edge, each voxel tells
    where the surface is.
    """
    z, y, x = np.indices((33, 33, 33)) - 16.0
    far = np.sqrt(x**2 + y**2 + z**2)
    field = np.concatenate(list(smooth(far < 12.3)))
    near = (np.abs(field - 0.5) < 0.25) & (far > 0)
    placed = far[near] + (field[near] - 0.5) * np.sqrt(2 * np.pi)
    assert near.sum() > 1000 and abs(placed.mean() - 12.3 + 1 / 12.3) < 0.06 and placed.std() < 0.17


def test_slabs_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    part = (RADIUS < 5.0) | (Z == 15)
    whole = np.concatenate(list(smooth(part)))
    monkeypatch.setattr(grids, "SLAB_BYTES", 3 * 4 * part[0].size)
    slabs = list(smooth(part))
    assert len(slabs) == 6
    np.testing.assert_array_equal(np.concatenate(slabs), whole)


@pytest.mark.parametrize("thin", [(Z == 8), (Z == 8) & (Y == 8), (Z == 8) & (Y == 8) & (X == 9)])
def test_thin_parts_do_not_vanish(thin: np.ndarray) -> None:
    """A sheet, a rod and a voxel, which the Gaussian alone would take away."""
    field = np.concatenate(list(smooth(thin)))
    assert (field[thin] > 0.5).all() and (field[~thin] < 0.5).all()


def test_a_sheet_reaches_what_it_stands_on() -> None:
    part = (Z < 6) | (Y == 9)
    field = np.concatenate(list(smooth(part)))
    assert (field[(Y == 9)] > 0.5).all() and field[15, 5, 9] < 0.5


def test_two_halves_have_two_colours(tmp_path: Path) -> None:
    """Each its own but for half a voxel beside the seam, where both have as much."""
    scene = scene_of(tmp_path, [table(3, colour=RED), table(5, colour=GREEN)])
    y, z = np.meshgrid(np.linspace(5, 11, 13), np.linspace(5, 11, 13))
    for x, expected in (
        (8.0, RED),
        (9.0, GREEN),
        (8.5, np.mean([RED, GREEN], axis=0)),
        (4.3, RED),
        (14.9, GREEN),
    ):
        points = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)
        np.testing.assert_allclose(
            albedos(scene, points), np.tile(expected, (y.size, 1)), atol=0.01
        )


def test_seams_between_labels_have_no_stairs(tmp_path: Path) -> None:
    """A plane between two labels, oblique to the voxels: the colours change a tenth of a voxel from
    it.
    """
    slope = np.array([1.0, 0.23, -0.11])
    offset = (X - 9) * slope[0] + (Y - 8) * slope[1] + (Z - 8) * slope[2]
    volume = np.where(RADIUS < 7.5, np.where(offset < 0, 3, 5), 0).astype(np.int16)
    scene = scene_of(tmp_path, [table(3, colour=RED), table(5, colour=GREEN)], volume)
    x, y, z = np.meshgrid(
        np.linspace(5, 13, 161), np.linspace(5, 11, 25), np.linspace(5, 11, 25), indexing="ij"
    )
    found = albedos(scene, np.stack([x, y, z], axis=-1).reshape(-1, 3))[:, 0].reshape(x.shape)
    seam = 5 + 0.05 * (found > np.mean([RED[0], GREEN[0]])).sum(axis=0) - 0.025
    plane = 9 - ((y[0] - 8) * slope[1] + (z[0] - 8) * slope[2]) / slope[0]
    assert np.abs(seam - plane).max() < 0.25 and (seam - plane).std() < 0.1


def test_places_have_the_two_labels_that_weigh_most() -> None:
    """Against sums by NumPy over all places around, those without a label left out."""
    rng = np.random.default_rng(3)
    codes = (rng.integers(1, 5, (7, 8, 9)) * (rng.random((7, 8, 9)) < 0.4)).astype(np.uint8)
    codes[:, :, 5:] = 0
    bell = np.rint(1024 * np.exp(-0.5 * np.arange(-3.0, 4.0) ** 2))
    box = np.einsum("i,j,k->ijk", bell, bell, bell)
    around = np.pad(codes, 3, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(around, box.shape)
    sums = np.stack(
        [(box * (windows == label)).sum(axis=(3, 4, 5)) for label in range(1, 5)], axis=-1
    )
    order = np.sort(sums, axis=-1)
    found = weighed(codes).astype(int)
    there = sums.sum(axis=-1) > 0
    assert (found[~there] == 0).all() and there.sum() > 100
    first, second = (
        np.take_along_axis(sums, found[..., n, None] - 1, axis=-1)[..., 0] for n in (0, 1)
    )
    np.testing.assert_array_equal(first[there], order[there, -1])
    np.testing.assert_array_equal(np.where(found[..., 1] > 0, second, 0)[there], order[there, -2])
    share = order[there, -2] / order[there, -2:].sum(axis=-1)
    np.testing.assert_allclose(found[there, 2] / 510, share, atol=0.5 / 510 + 1e-9)


def test_mirrored_axes_keep_colours_in_place(tmp_path: Path) -> None:
    """The volume is read the other way round along x, and so are its labels."""
    rows = {"space directions": np.diag([-1.0, 1.0, 1.0]), "space origin": np.zeros(3)}
    header = {"space": "right-anterior-superior", **rows}
    scene = scene_of(tmp_path, [table(3, colour=RED), table(5, colour=GREEN)], header=header)
    plain = scene_of(tmp_path, [table(3, colour=RED), table(5, colour=GREEN)])
    np.testing.assert_array_equal(scene.volume.voxels[..., ::-1], plain.volume.voxels)
    np.testing.assert_array_equal(colours_of(scene).places[:, :, ::-1], colours_of(plain).places)


def test_all_labels_are_shown_where_none_is_listed(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, volume=HALVES.astype(np.float32))
    found = colours_of(scene).scale.labels
    assert [(label.value, label.name, label.shown) for label in found] == [
        (3, "label 3", True),
        (5, "label 5", True),
    ]
    assert found[0].colour != found[1].colour and (scene.isovalue, scene.presets) == (0.5, ())


def test_hex_and_linear_colours_agree(tmp_path: Path) -> None:
    named = scene_of(tmp_path, [table(3, colour="#bc4080", name="liver")])
    linear = scene_of(tmp_path, [table(3, colour=list(colours_of(named).scale.labels[0].colour))])
    np.testing.assert_allclose(
        colours_of(named).scale.labels[0].colour, [0.5029, 0.0513, 0.2159], atol=1e-4
    )
    assert (
        colours_of(named).digest == colours_of(linear).digest
        and named.bake_digest == linear.bake_digest
    )


def test_a_hidden_label_is_another_volume(tmp_path: Path) -> None:
    """It is taken out of the field, so all light has another key; another colour changes reflected
    light alone.
    """
    scene = scene_of(tmp_path)
    hidden = scene_of(tmp_path, [table(3, hidden=True)])
    painted = scene_of(tmp_path, [table(3, colour=RED)])
    direct = scene.plan.layers[0]
    reflected = scene.plan.layers[-1]
    assert (direct.kind, reflected.kind) == ("direct", "indirect")
    assert hidden.layer_digest(direct) != scene.layer_digest(direct) == painted.layer_digest(direct)
    assert painted.layer_digest(reflected) != scene.layer_digest(reflected)
    alone = scene_of(tmp_path, volume=np.where(HALVES == 5, 5, 0))
    np.testing.assert_array_equal(hidden.volume.voxels, alone.volume.voxels)
    assert not any(label.shown for label in colours_of(hidden).scale.labels if label.value == 3)


def test_a_view_hides_labels_as_a_scene_does(tmp_path: Path) -> None:
    liver = table(3, name="liver", colour="#b5523a")
    scene = scene_of(tmp_path, [liver, table(5, hidden=True)])
    seen = with_hidden(scene, read_hidden(" 3"), "seen")
    alone = scene_of(tmp_path, [table(3, hidden=True)])
    np.testing.assert_array_equal(seen.volume.voxels, alone.volume.voxels)
    np.testing.assert_array_equal(colours_of(seen).places, colours_of(alone).places)
    told = [(label.value, label.name, label.shown) for label in colours_of(seen).scale.labels]
    assert told == [(3, "liver", False), (5, "label 5", True)] and seen.id == "seen"
    again = with_hidden(scene, (3,), "again", like=seen)
    assert again.volume is seen.volume and again.bake_digest == seen.bake_digest
    every = load_scene(f"{tmp_path / 's.toml'}#hide=none", labels=[table(3, hidden=True)])
    assert all(label.shown for label in colours_of(every).scale.labels)


def test_cuts_keep_the_labels(tmp_path: Path) -> None:
    scene = scene_of(tmp_path)
    written = scene_of(tmp_path, cut="z>8")
    assert cut_open(scene, "z>8", "cut").bake_digest == written.bake_digest != scene.bake_digest


def test_workers_elsewhere_get_the_labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    scene = scene_of(tmp_path, [table(5, name="lung")])
    store = Store(tmp_path / "store")
    assets = send_assets(scene, store)
    source, volume = receive_assets(scene.source, assets, store)
    made = build_scene(source, volume=volume, colours=receive_colours(assets, store))
    assert made.bake_digest == scene.bake_digest and made.isovalue == scene.isovalue
    assert colours_of(made).scale.labels == colours_of(scene).scale.labels


def test_large_segmentations_have_labels_farther_apart() -> None:
    assert [stride_of((n, n, n)) for n in (64, 355, 356, 512, 1024)] == [1, 1, 2, 2, 3]


MANY = np.arange(8 * 8 * 8).reshape(8, 8, 8)
MISTAKES = [
    (HALVES * 0.5, "all", VolumeError, "holds 1.5: labels are whole numbers"),
    (np.where(HALVES == 3, np.nan, HALVES), "all", VolumeError, "holds nan"),
    (HALVES, [table(4)], SceneError, "no voxel of label 4: it has 3, 5"),
    (HALVES, [table(3, hidden=True), table(5, hidden=True)], SceneError, "are hidden: show one"),
    (HALVES * 0, "all", VolumeError, "has no label"),
    (MANY, "all", VolumeError, "has 511 labels, and 255 can be shown"),
    (HALVES, [table(3), table(3)], SceneError, "lists label 3 twice"),
    (HALVES, [table(0)], SceneError, "not a whole number other than 0"),
    (HALVES, [{"name": "liver"}], SceneError, "value = None"),
    (HALVES, [table(3, colour="red")], SceneError, "neither '#rrggbb' nor linear"),
    (HALVES, [table(3, colour=[2, 0, 0])], SceneError, "colour = "),
    (HALVES, [table(3, tint=1)], SceneError, "sets tint, unknown here"),
    (HALVES, "some", SceneError, r"\[\[labels\]\]"),
]


@pytest.mark.parametrize(("volume", "labels", "error", "message"), MISTAKES)
def test_mistakes_with_labels_are_told(
    tmp_path: Path, volume: np.ndarray, labels: Any, error: type[IsogiError], message: str
) -> None:
    with pytest.raises(error, match=message):
        scene_of(tmp_path, labels, volume)


@pytest.mark.parametrize("key", [{"solid": "below"}, {"missing": 3}, {"albedo": 0.5}])
def test_keys_that_labels_do_not_take(tmp_path: Path, key: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match=r"leave (it|out)"):
        scene_of(tmp_path, **key)


def test_labels_need_a_file_and_no_other_colours(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"leave out .*'labels'"):
        load_scene("demo:orbital", labels="all")
    with pytest.raises(SceneError, match="leave the other volume out"):
        scene_of(tmp_path, volumes=[{"use": "colour", "of": "gradient"}])


def test_large_segmentations_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mappings, "budget", lambda: 100)
    with pytest.raises(VolumeError, match=r"The segmentation takes .* give a coarser one"):
        scene_of(tmp_path)


def test_a_table_of_volumes_may_name_the_labels(tmp_path: Path) -> None:
    own = scene_of(tmp_path, [table(3, name="liver")])
    named = '[[volumes]]\nfile = "seg.nrrd"\nuse = "labels"\n'
    (tmp_path / "t.toml").write_text(named)
    scene = load_scene(tmp_path / "t.toml", labels=[table(3, name="liver")])
    assert (
        scene.digest == own.digest
        and colours_of(scene).scale.labels == colours_of(own).scale.labels
    )
    assert colours_of(load_scene(tmp_path / "t.toml")).digest == colours_of(own).digest
    (tmp_path / "t.toml").write_text(f'volume = "seg.nrrd"\n{named}')
    with pytest.raises(SceneError, match="labels are the volume itself"):
        load_scene(tmp_path / "t.toml")


def test_a_copy_of_labels_is_that_of_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a volume so large that its voxels are mapped; other hidden labels make another
    copy.
    """
    large = np.repeat(np.repeat(HALVES, 3, axis=0), 3, axis=1)
    own = scene_of(tmp_path, volume=large)
    monkeypatch.setenv("ISOGI_VOLUME_CACHE", str(tmp_path / "copies"))
    monkeypatch.setenv("ISOGI_VOLUME_MB", "1")
    copied = scene_of(tmp_path, volume=large)
    assert list((tmp_path / "copies").glob("*.voxels")) and copied.bake_digest == own.bake_digest
    assert scene_of(tmp_path, [table(3, hidden=True)], large).volume.digest != own.volume.digest


SLICER = {
    "Segment0_Name": "front",
    "Segment0_Color": "0.8 0.2 0.2",
    "Segment0_LabelValue": "3",
    "Segment1_Name": "back",
    "Segment1_LabelValue": "5",
}


def by_itself(folder: Path, text: str = "", volume: np.ndarray = HALVES) -> Scene:
    """The scene of a segmentation of 3D Slicer that says nothing of labels."""
    nrrd.write(str(folder / "v.seg.nrrd"), volume, dict(SLICER), index_order="C")
    (folder / "s.toml").write_text(f'volume = "v.seg.nrrd"\n{text}')
    return load_scene(folder / "s.toml")


def test_a_segmentation_that_says_so_shows_its_labels(tmp_path: Path) -> None:
    scene = by_itself(tmp_path)
    labels = colours_of(scene).scale.labels
    assert [(label.value, label.name) for label in labels] == [(3, "front"), (5, "back")]
    assert colours_of(scene).scale.anchors[0] == "#cc3333"
    assert (scene.isovalue, scene.volume.segmented) == (0.5, True)
    assert module.BY_ITSELF in scene.volume.orientation.notes
    asked = scene_of(tmp_path, "all")
    assert scene.volume.digest == asked.volume.digest
    np.testing.assert_array_equal(colours_of(scene).places, colours_of(asked).places)


def test_labels_of_a_file_are_hidden_and_listed_by_their_values(tmp_path: Path) -> None:
    scene = with_hidden(by_itself(tmp_path), (3,), "hidden")
    assert [(each.name, each.shown) for each in colours_of(scene).scale.labels] == [
        ("front", False),
        ("back", True),
    ]
    listed = by_itself(
        tmp_path, '[[labels]]\nvalue = 5\ncolour = "#00ff00"\n[[labels]]\nvalue = 3\nname = "bow"\n'
    )
    assert [each.name for each in colours_of(listed).scale.labels] == ["bow", "back"]
    assert colours_of(listed).scale.anchors == ["#cc3333", "#00ff00"]


@pytest.mark.parametrize(
    "text", ["isovalue = 2\n", "albedo = 0.5\n", 'solid = "below"\n', "missing = 5\n"]
)
def test_a_scene_of_values_shows_the_values_of_labels(tmp_path: Path, text: str) -> None:
    scene = by_itself(tmp_path, text)
    assert scene.surfaces.colours is None and not scene.volume.segmented
    assert scene.volume.value_range[1] > 1.0


def test_a_nifti_file_may_say_that_it_is_a_segmentation(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    image = nib.Nifti1Image(HALVES.T, np.eye(4))
    nib.save(image, tmp_path / "v.nii")
    assert load_scene(tmp_path / "v.nii").surfaces.colours is None
    image.header.set_intent("label")
    nib.save(image, tmp_path / "v.nii")
    assert [each.name for each in colours_of(load_scene(tmp_path / "v.nii")).scale.labels] == [
        "label 3",
        "label 5",
    ]


@pytest.mark.parametrize(
    ("kind", "value"), [("u8", 2**53), ("u8", 2**64 - 1), ("i8", -(2**60)), ("f8", 2.0**53)]
)
def test_labels_that_cannot_be_told_apart_are_refused(
    tmp_path: Path, kind: str, value: float
) -> None:
    large = np.where(HALVES == 3, np.array(value, kind), HALVES.astype(kind))
    np.save(tmp_path / "v.npy", large)
    with pytest.raises(
        VolumeError, match=rf"has the label {int(value)}: give its labels numbers below 2\^53"
    ):
        load_scene(tmp_path / "v.npy", labels="all")


def test_labels_of_64_bits_are_kept_apart(tmp_path: Path) -> None:
    """Two whose difference 32 bits of a float do not hold."""
    large = np.where(HALVES == 3, 2**53 - 2, np.where(HALVES == 5, 2**53 - 1, 0)).astype(np.uint64)
    np.save(tmp_path / "v.npy", large)
    scene = load_scene(tmp_path / "v.npy", labels="all")
    assert [each.value for each in colours_of(scene).scale.labels] == [2**53 - 2, 2**53 - 1]
    np.testing.assert_array_equal(colours_of(scene).places, colours_of(scene_of(tmp_path)).places)


NESTED = np.where(RADIUS < 7.2, np.where(Y < 8, 7, np.where(Z < 8, 2000, 8)), 0)


def is_proposed(scene: Scene) -> bool:
    """That a note says that values look like labels."""
    words = module.PROPOSED.rpartition("}")[2]
    return any(words in note for note in scene.volume.orientation.notes)


@pytest.mark.parametrize("kind", ["u2", "i4", "u8"])
def test_values_that_look_like_labels_are_proposed_as_such(tmp_path: Path, kind: str) -> None:
    np.save(tmp_path / "v.npy", NESTED.astype(kind))
    assert (
        module.PROPOSED.format(count=4) in load_scene(tmp_path / "v.npy").volume.orientation.notes
    )
    scene = load_scene(f"{tmp_path / 'v.npy'}#labels=all")
    assert [each.value for each in colours_of(scene).scale.labels] == [7, 8, 2000]
    assert not is_proposed(scene)


@pytest.mark.parametrize(
    "field",
    [
        (RADIUS < 6.2) * np.uint8(255),
        RADIUS < 6.2,
        NESTED.astype(np.float32),
        np.clip(90 - 9 * RADIUS, 0, 90).astype(np.uint8),
    ],
)
def test_masks_and_ramps_do_not_look_like_labels(tmp_path: Path, field: np.ndarray) -> None:
    np.save(tmp_path / "v.npy", field)
    assert not is_proposed(load_scene(tmp_path / "v.npy"))


@pytest.mark.data
def test_no_shared_volume_looks_like_labels(shared_data: Path) -> None:
    for path in sorted(shared_data.glob("*uint8.nhdr")):
        if path.name.startswith(("boston", "carp", "bucky", "fuel", "nucleon")):
            assert not is_proposed(load_scene(path)), path.name


@pytest.mark.parametrize(
    ("high", "kind"), [(255, "u1"), (1, "?"), (1, "u1"), (1, "f4"), (2000, "i2")]
)
def test_a_mask_starts_half_way_between_its_two_values(
    tmp_path: Path, high: int, kind: str
) -> None:
    np.save(tmp_path / "v.npy", (high * (RADIUS < 6.2)).astype(kind))
    assert load_scene(tmp_path / "v.npy").isovalue == high / 2
