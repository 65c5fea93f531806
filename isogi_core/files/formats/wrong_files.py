"""What a file that is no volume seems to be, and what to do then."""

PICTURE_HINT = "a picture, and a volume is many slices: give the folder of a stack of TIFFs, or one NRRD"
MESH_HINT = "a mesh of triangles, which has no values inside: give the volume that it was made from"
BARE_VOXELS_HINT = (
    "bare voxels without a header: say what they are by --raw 256x256x128,uint8,little, or in the name of the file"
)
LIGHT_PROBE_HINT = "a light probe: give it as --environment, or name it in a scene, environment = 'file.hdr'"

KINDS: tuple[tuple[bytes, str], ...] = (
    (b"\x89PNG", PICTURE_HINT),
    (b"\xff\xd8\xff", PICTURE_HINT),
    (b"GIF8", PICTURE_HINT),
    (b"#?R", LIGHT_PROBE_HINT),
    (b"%PDF", "a PDF document: give the file of the volume itself"),
    (b"solid ", MESH_HINT),
    (b"ply\n", MESH_HINT),
    (b"ply\r", MESH_HINT),
    (b"glTF", MESH_HINT),
    (b"<!DOCTYPE html", "a web page, as of a download that went wrong: fetch the file again"),
    (b"<html", "a web page, as of a download that went wrong: fetch the file again"),
    (b"version https://git-lfs", "a pointer of Git LFS, not the file: fetch that by git lfs pull"),
)
"""How files begin, and what they are."""

WRONG_SUFFIXES = {
    ".stl": MESH_HINT,
    ".obj": MESH_HINT,
    ".ply": MESH_HINT,
    ".raw": BARE_VOXELS_HINT,
    ".gz": BARE_VOXELS_HINT,
    ".bin": BARE_VOXELS_HINT,
}
"""What the endings of names say of files that begin as nothing that is known."""


def sort_of(head: bytes, suffix: str = "") -> str:
    """What a file that begins with ``head`` seems to be, and what to do then; empty where nothing tells."""
    return next((words for mark, words in KINDS if head.startswith(mark)), WRONG_SUFFIXES.get(suffix, ""))
