"""Grids of chemistry and crystals, written here as their programs write them: the letter F where it
lies in the world, in its unit, in any of a file's data sets.
"""

import gzip
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.chemistry import text
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import Affine, Grid, on_right_angles
from isogi_core.model.volume import make_volume
from tests.files.formats.phantom import STEPS, letter

F = letter().astype(float) / 8.0
NZ, NY, NX = F.shape
CELL = np.array([[4.0, 0.0, 0.0], [-2.0, 3.5, 0.0], [0.5, 0.25, 6.0]])
"""A cell without right angles: its vectors a, b, c as rows, Å."""


def numbers(array: np.ndarray, form: str = "%13.5E", each: int = 6) -> str:
    """An ``array``'s numbers in its own order, as Fortran writes them."""
    flat = [form % value for value in array.ravel()]
    return "".join("".join(flat[n : n + each]) + "\n" for n in range(0, len(flat), each))


def cube(field: np.ndarray, steps: Any, counts: Any, atoms: int = 1, more: str = "") -> str:
    """A cube of a ``field`` (x, y, z), or of several, the last index being the field."""
    header = f" made for a test\n{more.partition('|')[0]}\n{atoms:5d}{-1:12.6f}{2:12.6f}{3:12.6f}\n"
    for count, step in zip(counts, steps, strict=True):
        header += f"{count:5d}" + "".join(f"{part:12.6f}" for part in step) + "\n"
    header += "    6    6.000000    0.000000    0.000000    0.000000\n" * abs(atoms)
    return header + more.partition("|")[2] + numbers(field.reshape(len(field), -1))


def crystal(*fields: np.ndarray, scale: str = "  1.0", between: str = "") -> str:
    """A file of VASP with data sets (z, y, x)."""
    header = f"made for a test\n{scale}\n"
    header += "".join(f" {x:12.6f} {y:12.6f} {z:12.6f}\n" for x, y, z in CELL)
    header += "  B N\n  1  1\nDirect\n  0 0 0\n  0.5 0.5 0.5\n\n"
    sizes = f"{NX:5d}{NY:5d}{NZ:5d}\n"
    return header + between.join(sizes + numbers(each, " %.11E", 5) for each in fields)


def opendx(field: np.ndarray, items: str, comment: str = "# Data from APBS 3.4\n") -> str:
    """The head of an OpenDX file, and ``items``."""
    nx, ny, nz = field.shape[:3]
    return (
        f"{comment}object 1 class gridpositions counts {nx} {ny} {nz}\norigin -7 31.5 -4.25\n"
        f"delta {STEPS[0]} 0 0\ndelta 0 {STEPS[1]} 0\ndelta 0 0 {STEPS[2]}\n"
        f"object 2 class gridconnections counts {nx} {ny} {nz}\n"
        f"object 3 class array type {items}"
    )


def xsf(*fields: np.ndarray, kind: str = "CRYSTAL", names: tuple[str, ...] = ("rho",)) -> str:
    """A file of XCrySDen with general grids (z, y, x) over the CELL."""
    cell = "".join(f" {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in CELL)
    head = (
        f"# made\n{kind}\nPRIMVEC\n{cell}PRIMCOORD\n1 1\n6 0 0 0\nBEGIN_BLOCK_DATAGRID_3D\n made\n"
    )
    for field, name in zip(fields, names, strict=True):
        nz, ny, nx = field.shape
        head += f" BEGIN_DATAGRID_3D_{name}\n {nx} {ny} {nz}\n 0 0 0\n{cell}{numbers(field)}"
        head += " END_DATAGRID_3D\n"
    return head + "END_BLOCK_DATAGRID_3D\n"


def bands(fermi: float, *fields: np.ndarray) -> str:
    """Bands (x, y, z) over a reciprocal cell."""
    nx, ny, nz = fields[0].shape
    head = f" BEGIN_INFO\n  # made\n  Fermi Energy: {fermi}\n END_INFO\n BEGIN_BLOCK_BANDGRID_3D\n"
    head += f" made\n BEGIN_BANDGRID_3D\n {len(fields)}\n {nx} {ny} {nz}\n 0 0 0\n 1 0 0\n 0 1 0\n"
    head += " 0 0 1\n"
    for number, field in enumerate(fields, 5):
        head += f" BAND:  {number}\n{numbers(field)}"
    return head + " END_BANDGRID_3D\n END_BLOCK_BANDGRID_3D\n"


def opened(folder: Path, content: str | bytes, name: str, **chosen: Any) -> Grid:
    """The grid in a file of this ``content``: packed and unpacked, by its path and as an upload, it
    is the same.
    """
    data = content if isinstance(content, bytes) else content.encode()
    path = folder / name
    path.write_bytes(data)
    grid = open_file(path, chosen)
    found = grid.whole()
    assert found.shape == grid.shape
    (folder / f"{name}.gz").write_bytes(gzip.compress(data))
    np.testing.assert_array_equal(open_file(folder / f"{name}.gz", chosen).whole(), found)
    if not chosen:
        upload = open_upload(io.BytesIO(gzip.compress(data)), name, 1 << 16)
        np.testing.assert_array_equal(upload.whole(), found)
    return grid


def lies_at(grid: Grid, index: tuple[int, int, int]) -> np.ndarray:
    """Where a voxel of a ``grid`` lies in the world; its index is x, y, z."""
    assert grid.affine is not None
    return grid.affine.array @ (*index, 1.0)


STRAIGHT = np.diag((0.2, 0.25, 0.4))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_cube_has_z_fastest_in_bohr_or_angstrom(tmp_path: Path, sign: int) -> None:
    counts = (sign * NX, sign * NY, sign * NZ)
    grid = opened(tmp_path, cube(F.T, STRAIGHT, counts), "f.cube")
    np.testing.assert_allclose(grid.whole(), F, rtol=1e-5)
    np.testing.assert_allclose(grid.spacing, (0.2, 0.25, 0.4))
    assert grid.unit == ("bohr" if sign > 0 else "Å")
    np.testing.assert_allclose(lies_at(grid, (1, 2, 3)), (-0.8, 2.5, 4.2))
    assert not any(grid.periodic)


def test_a_cube_keeps_oblique_axes(tmp_path: Path) -> None:
    axes = np.array([[0.2, 0.0, 0.0], [0.1, 0.1732, 0.0], [0.0, 0.0, 0.4]])
    grid = opened(tmp_path, cube(F.T, axes, (NX, NY, NZ)), "f.cube")
    np.testing.assert_allclose(lies_at(grid, (2, 3, 1)), (-0.3, 2.5196, 3.4))
    straight = on_right_angles(grid)
    assert straight.notes and straight.shape[2] > NX


def test_orbitals_of_a_cube_are_chosen_by_name(tmp_path: Path) -> None:
    both = cube(np.stack([F.T, -F.T], -1), STRAIGHT, (NX, NY, NZ), -1, "|    2   12   13\n")
    first = opened(tmp_path, both, "mo.cube")
    np.testing.assert_allclose(first.whole(), F, rtol=1e-5)
    assert "12, 13: 12 is shown, and #13" in first.notes[0]
    for chosen in ({"part": "13"}, {"channel": 1}):
        grid = opened(tmp_path, both, "mo.cube", **chosen)
        np.testing.assert_allclose(grid.whole(), -F, rtol=1e-5)
        assert not grid.notes
    with pytest.raises(VolumeError, match="choose one of 12, 13"):
        open_file(tmp_path / "mo.cube", {"part": "14"})


def test_negative_atoms_need_no_list_of_orbitals(tmp_path: Path) -> None:
    grid = opened(tmp_path, cube(F.T, STRAIGHT, (NX, NY, NZ), -1), "mo.cube")
    np.testing.assert_allclose(grid.whole(), F, rtol=1e-5)


def test_a_cube_names_its_isovalue(tmp_path: Path) -> None:
    said = "Property: HOMO. Isocontour range for 85% of the density: (0.0300541,-0.030054)"
    grid = opened(tmp_path, cube(F.T, STRAIGHT, (NX, NY, NZ), more=said), "f.cube")
    assert grid.level == 0.0300541
    assert opened(tmp_path, cube(F.T, STRAIGHT, (NX, NY, NZ)), "g.cube").level is None


def test_vasp_divides_densities_and_no_potentials(tmp_path: Path) -> None:
    volume = np.linalg.det(CELL)
    for name, scale in (("CHGCAR", volume), ("PARCHG", volume), ("LOCPOT", 1.0), ("ELFCAR", 1.0)):
        grid = opened(tmp_path, crystal(F), name)
        np.testing.assert_allclose(grid.whole(), F / scale, rtol=1e-9)
        assert (grid.unit, grid.periodic) == ("Å", (True, True, True))
        np.testing.assert_allclose(lies_at(grid, (NX, 0, 0)), CELL[0])
        np.testing.assert_allclose(lies_at(grid, (0, NY, NZ)), CELL[1] + CELL[2])


def test_a_density_without_a_name_says_what_it_is_taken_for(tmp_path: Path) -> None:
    grid = opened(tmp_path, crystal(F), "data")
    np.testing.assert_allclose(grid.whole(), F / np.linalg.det(CELL), rtol=1e-9)
    assert "LOCPOT" in grid.notes[-1]


def test_magnetization_is_a_set_of_its_own(tmp_path: Path) -> None:
    spins = crystal(F, -2.0 * F, between="augmentation occupancies   1  2\n  0.1E+00 0.2E+00\n")
    total = opened(tmp_path, spins, "CHGCAR")
    assert "total, magnetization" in total.notes[0]
    chosen = opened(tmp_path, spins, "CHGCAR", part="magnetization")
    np.testing.assert_allclose(chosen.whole(), -2.0 * total.whole(), rtol=1e-9)


def test_a_negative_scale_of_vasp_is_the_volume(tmp_path: Path) -> None:
    grid = opened(tmp_path, crystal(F, scale=" -100.0"), "CHGCAR")
    assert grid.affine is not None
    volume = abs(np.linalg.det(np.array(grid.affine.matrix))) * F.size
    np.testing.assert_allclose(volume, 100.0)
    np.testing.assert_allclose(grid.whole(), F / 100.0, rtol=1e-9)


def test_atoms_without_a_grid_are_named(tmp_path: Path) -> None:
    (tmp_path / "POSCAR").write_text(crystal())
    with pytest.raises(VolumeError, match="holds the atoms of a crystal and no grid"):
        open_file(tmp_path / "POSCAR", {})


def test_opendx_is_read_as_text_and_binary(tmp_path: Path) -> None:
    field = F.T
    said = f"double rank 0 items {F.size} data follows\n"
    grid = opened(tmp_path, opendx(field, said) + numbers(field, " %.6e", 3), "f.dx")
    np.testing.assert_allclose(grid.whole(), F, rtol=1e-6)
    assert grid.unit == "Å"
    np.testing.assert_allclose(lies_at(grid, (1, 1, 1)), (-6.0, 32.75, -2.75))
    packed = opendx(field, f"float rank 0 items {F.size} msb ieee data follows\n", "").encode()
    binary = opened(tmp_path, packed + field.astype(">f4").tobytes(), "b.dx")
    np.testing.assert_array_equal(binary.whole(), F.astype(np.float32))
    assert (binary.unit, len(binary.notes)) == ("", 1)


def test_opendx_of_vectors_chooses_a_number(tmp_path: Path) -> None:
    both = np.stack([F.T, 2.0 * F.T], -1)
    said = f"float rank 1 shape 2 items {F.size} data follows\n"
    content = opendx(both, said) + numbers(both, " %.6e", 2)
    second = opened(tmp_path, content, "f.dx", channel=1)
    np.testing.assert_allclose(second.whole(), 2.0 * F, rtol=1e-6)


def test_long_comments_do_not_hide_a_kind(tmp_path: Path) -> None:
    said = f"double rank 0 items {F.size} follows\n"
    comments = "# fpocket parameters used to create this file, and what they mean\n" * 12
    content = opendx(F.T, said, comments) + numbers(F.T)
    np.testing.assert_allclose(opened(tmp_path, content, "f.dx").whole(), F, rtol=1e-5)


def test_a_general_grid_repeats_its_faces_once(tmp_path: Path) -> None:
    closed = np.pad(F, ((0, 1),) * 3, mode="wrap")
    grid = opened(tmp_path, xsf(closed), "f.xsf")
    np.testing.assert_allclose(grid.whole(), F, rtol=1e-5)
    assert (grid.periodic, grid.unit) == ((True, True, True), "Å")
    np.testing.assert_allclose(lies_at(grid, (NX, NY, 0)), CELL[0] + CELL[1], atol=1e-6)


def test_a_molecule_or_a_slab_is_not_periodic_everywhere(tmp_path: Path) -> None:
    slab = opened(tmp_path, xsf(F, kind="SLAB"), "f.xsf")
    assert slab.shape == (NZ, NY - 1, NX - 1)
    assert slab.periodic == (True, True, False)
    alone = opened(tmp_path, xsf(F).replace("PRIMVEC", "OTHER"), "g.xsf")
    assert (alone.shape, alone.periodic) == (F.shape, (False, False, False))


def test_grids_of_xsf_are_chosen_by_name(tmp_path: Path) -> None:
    closed = np.pad(F, ((0, 1),) * 3, mode="wrap")
    both = xsf(closed, 3.0 * closed, names=("up", "down"))
    assert "up, down: up is shown" in opened(tmp_path, both, "f.xsf").notes[0]
    down = opened(tmp_path, both, "f.xsf", part="down")
    np.testing.assert_allclose(down.whole(), 3.0 * F, rtol=1e-5)


def test_bands_are_shown_at_the_fermi_energy(tmp_path: Path) -> None:
    closed = np.pad(F, ((0, 1),) * 3, mode="wrap").T
    content = bands(30.0, closed - 1000.0, closed, closed + 1000.0)
    grid = opened(tmp_path, content, "f.bxsf")
    np.testing.assert_allclose(grid.whole(), F, rtol=1e-5)
    assert (grid.level, grid.periodic) == (30.0, (True, True, True))
    assert "Band 6 is shown" in grid.notes[0]
    other = opened(tmp_path, content, "f.bxsf", part="7")
    np.testing.assert_allclose(other.whole(), F + 1000.0, rtol=1e-5)


def test_numbers_of_fortran_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text, "BLOCK_BYTES", 16)
    lines = b"1.5D-03 -0.25d+2 0.15-103 -1.5E+00-2.5E-01 12.25-3.5 -.5E-100-.5E-101\n7 end\n"
    reading = text.Text(io.BytesIO(lines), "lines")
    found = np.concatenate(list(reading.numbers(10)))
    expected = [1.5e-3, -25.0, 0.15e-103, -1.5, -0.25, 12.25, -3.5, -0.5e-100, -0.5e-101, 7.0]
    np.testing.assert_array_equal(found, expected)
    assert reading.line() == "end"
    with pytest.raises(VolumeError, match=r"holds '\*\*\*\*\*' instead of a number"):
        list(text.Text(io.BytesIO(b"1.0 ***** 2.0\n"), "lines").numbers(3))


@pytest.mark.parametrize("name", ["f.cube", "CHGCAR", "f.dx", "f.xsf", "f.bxsf"])
def test_a_file_that_ends_early_is_refused(tmp_path: Path, name: str) -> None:
    said = f"double rank 0 items {F.size} data follows\n"
    whole = {
        "f.cube": cube(F.T, STRAIGHT, (NX, NY, NZ)),
        "CHGCAR": crystal(F),
        "f.dx": opendx(F.T, said) + numbers(F.T),
        "f.xsf": xsf(F),
        "f.bxsf": bands(30.0, F.T),
    }[name]
    path = tmp_path / name
    for share in (0.3, 0.7, 0.98):
        path.write_text(whole[: int(share * len(whole))])
        with pytest.raises(VolumeError):
            open_file(path, {}).whole()


@pytest.mark.parametrize("decimals", [1, 5, 11, 14])
def test_numbers_written_alike_are_read_exactly(decimals: int) -> None:
    rng = np.random.default_rng(decimals)
    values = rng.normal(size=3000) * 10.0 ** rng.integers(-90, 90, 3000)
    values[::7] = 0.0
    words = [f"{value:.{decimals}E}" for value in values]
    lines = "\n".join(" ".join(words[n : n + 6]) for n in range(0, len(words), 6)).encode()
    for each in (lines, b" " + lines, lines + b"\n"):
        found = text.scientific_numbers(each)
        assert found is not None
        np.testing.assert_array_equal(found, np.array(words, float))


@pytest.mark.parametrize(
    "words",
    [
        *(b"1.25E-05 2.5", b"1.25E-05 2.50E-100", b"1.25E-05 12.5E-01", b"1.2E-05-1.2E-05"),
        *(b"", b"E", b".E", b"1.2E5", b"1.2E+0", b"1.2D-05"),
        *(b"1.25E-05 *.**E-05", b"1.25E-05 x1.25E-05"),
    ],
)
def test_numbers_written_otherwise_are_left_to_the_parser(words: bytes) -> None:
    assert text.scientific_numbers(words) is None


def test_skewed_values_of_few_steps_are_no_outliers() -> None:
    """Half-way between two steps that cancel, rounding leaves 1e-17: 0 is meant."""
    rng = np.random.default_rng(2)
    steps = (rng.integers(-50, 51, (9, 40, 40)) * 0.020358).astype(np.float32)
    angles = np.radians([90.0, 210.0])
    rows = 0.58 * np.array([[*np.cos(angles), 0.0, 0.0], [*np.sin(angles), 0.0, 0.0], [0, 0, 1, 0]])
    grid = Grid(steps.shape, steps.dtype, (1.0, 1.0, 1.0), lambda: iter((steps,)))
    skewed = on_right_angles(replace(grid, affine=Affine.of(rows))).whole()
    tiny = np.abs(skewed) < 1e-6
    assert np.count_nonzero(tiny) > 20
    assert not skewed[tiny].any()
    low, high = make_volume(skewed).core
    assert (low, high) == (np.nanmin(skewed), np.nanmax(skewed))
