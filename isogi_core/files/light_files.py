"""Light in files of other tools.

Meshes with their light as colours of vertices: .ply, .glb, .obj and .usdz. Volumes with values and
light: .vti, .nrrd, .nii.gz and OME-Zarr.
"""

import gzip
import io
import json
import struct
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.formats.source import library
from isogi_core.files.grid import srgb_bytes
from isogi_core.files.ome import UNIT_WORDS
from isogi_core.storage.atomic_file import whole_folder


@dataclass(frozen=True, eq=False)
class LitMesh:
    """A mesh in the world: ``vertices``, outward unit ``normals`` and linear RGB ``colours`` (n,
    3), ``quads`` (m, 4).

    Corners of quadrilaterals are numbered anticlockwise from outside. The ``unit`` of length is
    empty where unknown.
    """

    vertices: np.ndarray
    normals: np.ndarray
    colours: np.ndarray
    quads: np.ndarray
    unit: str = ""

    @property
    def triangles(self) -> np.ndarray:
        """Two triangles for each quadrilateral, (2m, 3)."""
        return np.concatenate([self.quads[:, [0, 1, 2]], self.quads[:, [0, 2, 3]]])


def ply_bytes(mesh: LitMesh) -> bytes:
    """Return a binary PLY file; its colours are sRGB bytes, as its readers take them."""
    fields: list[Any] = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    fields += [(name, "u1") for name in ("red", "green", "blue")]
    points = np.empty(len(mesh.vertices), fields)
    values = np.column_stack([mesh.vertices, mesh.normals])
    for (name, _), column in zip(fields[:6], values.T, strict=True):
        points[name] = column
    for (name, _), column in zip(fields[6:], srgb_bytes(mesh.colours).T, strict=True):
        points[name] = column
    faces = np.empty(2 * len(mesh.quads), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = mesh.triangles
    names = {"<f4": "float", "u1": "uchar"}
    lines = [
        f"element vertex {len(points)}",
        *(f"property {names[kind]} {name}" for name, kind in fields),
    ]
    lines += [
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    return (
        "\n".join(["ply", "format binary_little_endian 1.0", *lines]).encode()
        + points.tobytes()
        + faces.tobytes()
    )


def obj_bytes(mesh: LitMesh) -> bytes:
    """Return a Wavefront OBJ file with normals; its colours are sRGB from 0 to 1 behind each
    vertex, as many readers take.
    """
    points = np.column_stack([mesh.vertices, srgb_bytes(mesh.colours) / 255.0]).tolist()
    lines = [f"v {x:.9g} {y:.9g} {z:.9g} {r:.4g} {g:.4g} {b:.4g}" for x, y, z, r, g, b in points]
    lines += [f"vn {x:.5g} {y:.5g} {z:.5g}" for x, y, z in mesh.normals.tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (mesh.triangles + 1).tolist()]
    return "\n".join(["# isogi", *lines, ""]).encode()


GLB_MAGIC = 0x46546C67
JSON_CHUNK = 0x4E4F534A
BINARY_CHUNK = 0x004E4942
UPRIGHT_ROTATION = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""The rotation x, y, z, w that brings z up to glTF's y up."""


def glb_bytes(mesh: LitMesh) -> bytes:
    """Return a binary glTF 2.0 file: linear COLOR_0, and no other light (KHR_materials_unlit).
    Vertices are float32 relative to the middle of the mesh's bounding box, so that they keep their
    digits; the node is moved to that middle.
    """
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2.0
    parts = [
        (mesh.vertices - middle).astype("<f4"),
        mesh.normals.astype("<f4"),
        np.clip(mesh.colours, 0.0, 1.0).astype("<f4"),
        mesh.triangles.astype("<u4").reshape(-1),
    ]
    starts = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
    views = [
        {
            "buffer": 0,
            "byteOffset": start,
            "byteLength": part.nbytes,
            "target": 34963 if part.ndim == 1 else 34962,
        }
        for start, part in zip(starts, parts, strict=False)
    ]
    accessors: list[dict[str, Any]] = [
        {"bufferView": n, "componentType": 5126, "count": len(part), "type": "VEC3"}
        for n, part in enumerate(parts[:3])
    ]
    accessors[0] |= {"min": parts[0].min(axis=0).tolist(), "max": parts[0].max(axis=0).tolist()}
    accessors.append(
        {"bufferView": 3, "componentType": 5125, "count": parts[3].size, "type": "SCALAR"}
    )
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    x, y, z = middle.tolist()
    document = {
        "asset": {"version": "2.0", "generator": "isogi"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": UPRIGHT_ROTATION, "translation": [x, z, -y]}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{"doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = [
        _chunk(JSON_CHUNK, text, b" "),
        _chunk(BINARY_CHUNK, b"".join(part.tobytes() for part in parts), b"\0"),
    ]
    size = 12 + sum(map(len, chunks))
    return np.array([GLB_MAGIC, 2, size], "<u4").tobytes() + b"".join(chunks)


def _chunk(kind: int, data: bytes, filler: bytes) -> bytes:
    """Return a chunk of a binary glTF file, filled up to whole words."""
    padded = data + filler * (-len(data) % 4)
    return np.array([len(padded), kind], "<u4").tobytes() + padded


METRES_OF_UNITS = {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9, "Å": 1e-10}
"""Metres of the units that volumes have; those of others are taken for USD's own, centimetres."""

BLOCK_TEXELS = 4
"""Texels a side of each quadrilateral's own part of the texture: its four corners, and a rim that
repeats them.
"""

MAX_TEXTURE_SIDE = 16384
"""Largest side of a texture in texels, as graphics processors take it."""

LAYER = """\
#usda 1.0
(
    defaultPrim = "Isosurface"
    metersPerUnit = {metres!r}
    upAxis = "Y"
)

def Xform "Isosurface" (
    kind = "component"
)
{{
    double3 xformOp:translate = {middle}
    float xformOp:rotateX = -90
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]

    def Mesh "Surface" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        uniform bool doubleSided = 1
        float3[] extent = {extent}
        int[] faceVertexCounts = {counts}
        int[] faceVertexIndices = {corners}
        rel material:binding = </Isosurface/Light>
        point3f[] points = {points}
        texCoord2f[] primvars:st = {places} (
            interpolation = "faceVarying"
        )
        uniform token subdivisionScheme = "none"
    }}

    def Material "Light"
    {{
        token outputs:surface.connect = </Isosurface/Light/Surface.outputs:surface>

        def Shader "Surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0, 0, 0)
            color3f inputs:emissiveColor.connect = </Isosurface/Light/Texture.outputs:rgb>
            float inputs:roughness = 1
            color3f inputs:specularColor = (0, 0, 0)
            int inputs:useSpecularWorkflow = 1
            token outputs:surface
        }}

        def Shader "Texture"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{texture}@
            token inputs:sourceColorSpace = "sRGB"
            float2 inputs:st.connect = </Isosurface/Light/Places.outputs:result>
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float3 outputs:rgb
        }}

        def Shader "Places"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
    }}
}}
"""


def usd_layer(mesh: LitMesh, texture: str) -> bytes:
    """Return the USD layer, as text, of a mesh that emits the light of the file ``texture`` and
    reflects none.

    Points are relative to the middle of the mesh's bounding box, so that float32 keep their digits.
    The root turns z up to USD's y up, and then moves the mesh to that middle.
    """
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    x, y, z = ((low + high) / 2.0).tolist()
    half = (high - low) / 2.0
    text = LAYER.format(
        metres=METRES_OF_UNITS.get(mesh.unit, 0.01),
        middle=(x, z, -y),
        extent=_rows(np.stack([-half, half])),
        counts=[4] * len(mesh.quads),
        corners=mesh.quads.ravel().tolist(),
        points=_rows(mesh.vertices - (x, y, z)),
        places=_rows(texture_places(len(mesh.quads)).reshape(-1, 2)),
        texture=texture,
    )
    return text.encode()


def light_texture(mesh: LitMesh) -> np.ndarray:
    """Return the texture of a mesh, sRGB bytes (h, w, 3): a block of BLOCK_TEXELS × BLOCK_TEXELS
    for each quadrilateral.

    Its middle texels are the corners' colours, so that between them a bilinear filter interpolates
    the light. Raises VolumeError if it would be too large.
    """
    columns, rows = _texture_blocks(len(mesh.quads))
    if columns * BLOCK_TEXELS > MAX_TEXTURE_SIDE:
        most = (MAX_TEXTURE_SIDE // BLOCK_TEXELS) ** 2
        raise VolumeError(
            f"The texture of {len(mesh.quads):,} faces is too large, {most:,} fit: write .glb "
            "instead."
        )
    corners = srgb_bytes(mesh.colours)[mesh.quads[:, [[0, 1], [3, 2]]]]
    blocks = np.zeros((rows * columns, BLOCK_TEXELS, BLOCK_TEXELS, 3), np.uint8)
    blocks[: len(corners)] = corners.repeat(BLOCK_TEXELS // 2, axis=1).repeat(
        BLOCK_TEXELS // 2, axis=2
    )
    whole = blocks.reshape(rows, columns, BLOCK_TEXELS, BLOCK_TEXELS, 3).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(whole.reshape(rows * BLOCK_TEXELS, columns * BLOCK_TEXELS, 3))


def texture_places(quads: int) -> np.ndarray:
    """Return the places of the corners of each of ``quads`` quadrilaterals in their texture: u, v
    from its lower left (n, 4, 2).
    """
    columns, rows = _texture_blocks(quads)
    row, column = np.divmod(np.arange(quads), columns)
    right = np.array([0, 1, 1, 0])
    down = np.array([0, 0, 1, 1])
    middle = BLOCK_TEXELS / 2.0 - 0.5
    u = (column[:, None] * BLOCK_TEXELS + middle + right) / (columns * BLOCK_TEXELS)
    v = 1.0 - (row[:, None] * BLOCK_TEXELS + middle + down) / (rows * BLOCK_TEXELS)
    return np.stack([u, v], axis=-1)


FILE_ALIGNMENT = 64
"""Number of bytes of which the data of each file begin at a multiple in a usdz package."""

LOCAL_HEADER_BYTES = 30
"""Bytes of a ZIP archive's header of a file, before the file's name."""

PADDING_ID = 0x1986
"""Id of the extra field with which a header is filled up."""

FIELD_HEAD_BYTES = 4
"""Bytes of an extra field before its content: its id and its length."""


def usdz_package(files: dict[str, bytes]) -> bytes:
    """Return a usdz package: a ZIP archive of ``files``, the data of each by its name. The first is
    the layer to open.

    Nothing is compressed, and data are aligned to FILE_ALIGNMENT, as readers map them into memory.
    """
    package = io.BytesIO()
    with zipfile.ZipFile(package, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name)
            # Fill the extra field with zeros up to the next place where data may begin.
            head = LOCAL_HEADER_BYTES + len(name.encode()) + FIELD_HEAD_BYTES
            padding = -(package.tell() + head) % FILE_ALIGNMENT
            entry.extra = struct.pack("<HH", PADDING_ID, padding) + bytes(padding)
            archive.writestr(entry, data)
    return package.getvalue()


def _texture_blocks(quads: int) -> tuple[int, int]:
    """Return the columns and rows of a texture's blocks, as square as can be."""
    columns = max(int(np.ceil(np.sqrt(quads))), 1)
    return columns, max(-(-quads // columns), 1)


def _rows(values: np.ndarray) -> str:
    """Return rows of numbers as USD's text has them, without digits beyond those of a float32."""
    one = "(" + ", ".join(["%.8g"] * values.shape[1]) + ")"
    return f"[{', '.join([one] * len(values)) % tuple(values.astype(np.float32).ravel().tolist())}]"


@dataclass(frozen=True, eq=False)
class LitVolume:
    """``arrays`` of points by name, (nz, ny, nx) or (nz, ny, nx, k) each, in the world.

    ``affine`` (3, 4) brings indices to the world, whose ``unit`` of length is empty where unknown,
    and which is RAS in a ``patient``. ``fields`` are arrays (k, n) of no points, which VTK's files
    alone hold.
    """

    arrays: dict[str, np.ndarray]
    affine: np.ndarray
    unit: str = ""
    patient: bool = False
    fields: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def together(self) -> np.ndarray:
        """All arrays as one vector of floats at each point, (nz, ny, nx, k) float32."""
        parts = [array if array.ndim == 4 else array[..., None] for array in self.arrays.values()]
        return np.concatenate(parts, axis=-1, dtype="<f4", casting="same_kind")

    @property
    def names(self) -> list[str]:
        """A name for each component of the vectors of ``together``, in their order.

        Those of the light are red, green and blue; those of other vectors are numbered, as in
        "lobes 0". A scalar array has its own name.
        """
        known = {"light": ["red", "green", "blue"]}
        # A scalar array counts as a vector of 0 components: it has no numbered names.
        counts = {
            name: array.shape[3] if array.ndim == 4 else 0 for name, array in self.arrays.items()
        }
        return [
            each
            for name, count in counts.items()
            for each in known.get(name, [f"{name} {n}" for n in range(count)] or [name])
        ]


def vti_bytes(lit: LitVolume) -> bytes:
    """Return an image file of VTK with arrays of points, bytes or floats, little-endian, raw at its
    end. Format: VTK's XML image data, version 1.0.
    """
    arrays = lit.arrays
    affine = lit.affine
    steps = np.linalg.norm(affine[:, :3], axis=0)
    nz, ny, nx = next(iter(arrays.values())).shape[:3]
    extent = f"0 {nx - 1} 0 {ny - 1} 0 {nz - 1}"
    place = {
        "WholeExtent": extent,
        "Origin": _light_numbers(affine[:, 3]),
        "Spacing": _light_numbers(steps),
        "Direction": _light_numbers((affine[:, :3] / steps).ravel()),
    }
    rows: dict[str, str] = {}
    blocks: list[bytes] = []
    for name, array in (arrays | lit.fields).items():
        whole = array.dtype == np.uint8
        block = np.ascontiguousarray(array, "u1" if whole else "<f4").tobytes()
        if array.ndim in (2, 4):
            parts = array.shape[-1]
        else:
            parts = 1
        count = len(array)
        kind = (
            f'type="{"UInt8" if whole else "Float32"}" Name={quoteattr(name)} '
            f'NumberOfComponents="{parts}"'
        )
        if name in lit.fields:
            kind += f' NumberOfTuples="{count}"'
        rows[name] = f'<DataArray {kind} format="appended" offset="{sum(map(len, blocks))}"/>'
        blocks.append(np.array([len(block)], "<u8").tobytes() + block)
    attributes = " ".join(f'{name}="{value}"' for name, value in place.items())
    kind = 'type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    points = (
        "<PointData "
        f"Scalars={quoteattr(next(iter(arrays)))}>{''.join(map(rows.pop, arrays))}</PointData>"
    )
    if rows:
        fields = f"<FieldData>{''.join(rows.values())}</FieldData>"
    else:
        fields = ""
    piece = f'<ImageData {attributes}>{fields}<Piece Extent="{extent}">{points}</Piece></ImageData>'
    head = f'<?xml version="1.0"?>\n<VTKFile {kind}>{piece}<AppendedData encoding="raw">_'
    return head.encode() + b"".join(blocks) + b"</AppendedData></VTKFile>\n"


def nrrd_bytes(lit: LitVolume) -> bytes:
    """Return a NRRD file of arrays of points together: a vector of floats at each voxel, such as
    value, red, green, blue.
    """
    block = lit.together
    affine = lit.affine
    directions = " ".join(
        f"({','.join(repr(float(x)) for x in column)})" for column in affine[:, :3].T
    )
    origin = ",".join(repr(float(x)) for x in affine[:, 3])
    lines = [
        "NRRD0005",
        "type: float",
        "dimension: 4",
        f"sizes: {' '.join(map(str, block.shape[::-1]))}",
    ]
    lines += ["space: right-anterior-superior" if lit.patient else "space dimension: 3"]
    lines += [f"space directions: none {directions}", f"space origin: ({origin})"]
    lines += ["kinds: list domain domain domain", "endian: little", "encoding: raw", "", ""]
    return "\n".join(lines).encode() + block.tobytes()


MOST_NIFTI1 = 32767
"""Voxels along an axis of NIfTI-1, at most."""

NIFTI_UNITS = {"mm": "mm", "m": "meter", "µm": "micron"}


def nifti_bytes(lit: LitVolume) -> bytes:
    """Return a packed NIfTI file, one vector at each voxel (intent VECTOR), written by nibabel; its
    world is RAS. Raises VolumeError if nibabel is missing.
    """
    nib = nibabel()
    affine = np.vstack([lit.affine, [0.0, 0.0, 0.0, 1.0]])
    block = lit.together.transpose(2, 1, 0, 3)[:, :, :, None]
    if max(block.shape) <= MOST_NIFTI1:
        kind = nib.Nifti1Image
    else:
        kind = nib.Nifti2Image
    image = kind(block, affine)
    image.header.set_intent("vector")
    image.header.set_xyzt_units(NIFTI_UNITS.get(lit.unit, "unknown"))
    return gzip.compress(image.to_bytes(), 4, mtime=0)


def nibabel() -> Any:
    """Return the library that writes NIfTI. Raises VolumeError if it is missing."""
    return library("nibabel", "NIfTI")


def write_zarr(path: Path, lit: LitVolume) -> None:
    """Write an OME-Zarr image (NGFF 0.5) of one resolution, whose channels are the numbers of each
    point. Raises VolumeError as ``check_zarr`` does.
    """
    check_zarr(path, lit.affine)
    block, steps, origin = straightened(lit.together, lit.affine)
    space: dict[str, Any] = {
        "type": "space",
        **({"unit": UNIT_WORDS[lit.unit]} if lit.unit in UNIT_WORDS else {}),
    }
    axes: list[Any] = [
        {"name": "c", "type": "channel"},
        *({"name": name, **space} for name in "zyx"),
    ]
    placed: list[Any] = [
        {"type": "scale", "scale": [1.0, *steps[::-1]]},
        {"type": "translation", "translation": [0.0, *origin[::-1]]},
    ]
    image: dict[str, Any] = {
        "name": path.name,
        "axes": axes,
        "datasets": [{"path": "0", "coordinateTransformations": placed}],
    }
    chunks = (1, *(min(n, 128) for n in block.shape[:3]))
    with whole_folder(path) as partial:
        group = zarr.open_group(partial, mode="w", zarr_format=3)
        group.attrs["ome"] = {
            "version": "0.5",
            "multiscales": [image],
            "omero": {"channels": channels(lit)},
        }
        array = group.create_array(
            "0",
            shape=(block.shape[3], *block.shape[:3]),
            dtype="float32",
            chunks=chunks,
            dimension_names=tuple("czyx"),
        )
        array[:] = np.moveaxis(block, 3, 0)


def check_zarr(path: Path, affine: np.ndarray) -> None:
    """Raise VolumeError if a volume does not lie along the world's axes, or the folder is there
    already.
    """
    if path.exists():
        raise VolumeError(f"{path} is there already: delete it, or name another.")
    sizes = np.abs(affine[:, :3])
    if (sizes.sum(axis=0) - sizes.max(axis=0)).max() > 1e-6 * sizes.max():
        raise VolumeError(
            "OME-Zarr says no turns, and this volume lies obliquely: write .nii.gz, .vti or .nrrd."
        )


def channels(lit: LitVolume) -> list[dict[str, Any]]:
    """Return the channels as viewers take them: name, colour and the range to show."""
    colours = {"red": "FF0000", "green": "00FF00", "blue": "0000FF"}
    value = next(iter(lit.arrays.values()))
    low, high = float(np.nanmin(value)), float(np.nanmax(value))
    spans = [(0.0, 1.0) if name in colours else (low, high) for name in lit.names]
    windows = [{"min": a, "max": b, "start": a, "end": b} for a, b in spans]
    return [
        {"label": name, "color": colours.get(name, "FFFFFF"), "window": window, "active": True}
        for name, window in zip(lit.names, windows, strict=True)
    ]


def straightened(
    block: np.ndarray, affine: np.ndarray
) -> tuple[np.ndarray, list[float], list[float]]:
    """Return an array (nz, ny, nx, k) with its axes along the world's, the steps along x, y, z, and
    the first voxel's place. The ``affine`` turns by right angles.
    """
    matrix = affine[:, :3]
    origin = affine[:, 3].copy()
    steps = np.abs(matrix).max(axis=0)
    axes = np.abs(matrix).argmax(axis=0)
    order = [int(np.flatnonzero(axes == axis)[0]) for axis in range(3)]
    for column in range(3):
        if matrix[axes[column], column] < 0.0:
            block = np.flip(block, 2 - column)
            origin += matrix[:, column] * (block.shape[2 - column] - 1)
    turned = block.transpose(*(2 - order[axis] for axis in (2, 1, 0)), 3)
    return turned, [float(steps[each]) for each in order], [float(each) for each in origin]


def _light_numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
