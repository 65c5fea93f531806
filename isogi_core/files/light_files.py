"""Meshes with their light as colours of vertices, in files of other tools: .ply, .glb and .obj."""

import io
import json
import struct
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import srgb_bytes


@dataclass(frozen=True, eq=False)
class LitMesh:
    """A mesh in the world: ``vertices``, outward unit ``normals`` and linear RGB ``colours`` (n, 3), ``quads`` (m, 4).

    Corners of quadrilaterals are numbered anticlockwise from outside. The ``unit`` of length is empty where unknown.
    """

    vertices: np.ndarray
    normals: np.ndarray
    colours: np.ndarray
    quads: np.ndarray
    unit: str = ""

    @property
    def triangles(self) -> np.ndarray:
        """Two for each quadrilateral, (2m, 3)."""
        return np.concatenate([self.quads[:, [0, 1, 2]], self.quads[:, [0, 2, 3]]])


def ply_bytes(mesh: LitMesh) -> bytes:
    """A binary PLY file; its colours are sRGB bytes, as its readers take them."""
    fields: list[Any] = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    fields += [(name, "u1") for name in ("red", "green", "blue")]
    points = np.empty(len(mesh.vertices), fields)
    values = np.column_stack([mesh.vertices, mesh.normals])
    for (name, _), column in zip(fields[:6], values.T, strict=True):
        points[name] = column
    for (name, _), column in zip(fields[6:], srgb_bytes(mesh.colours).T, strict=True):
        points[name] = column
    faces = np.empty(2 * len(mesh.quads), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.triangles
    names = {"<f4": "float", "u1": "uchar"}
    lines = [f"element vertex {len(points)}", *(f"property {names[kind]} {name}" for name, kind in fields)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines]).encode() + points.tobytes() + faces.tobytes()


def obj_bytes(mesh: LitMesh) -> bytes:
    """A Wavefront OBJ file with normals; its colours are sRGB from 0 to 1 behind each vertex, as many readers take."""
    points = np.column_stack([mesh.vertices, srgb_bytes(mesh.colours) / 255.0]).tolist()
    lines = [f"v {x:.9g} {y:.9g} {z:.9g} {r:.4g} {g:.4g} {b:.4g}" for x, y, z, r, g, b in points]
    lines += [f"vn {x:.5g} {y:.5g} {z:.5g}" for x, y, z in mesh.normals.tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in (mesh.triangles + 1).tolist()]
    return "\n".join(["# isogi", *lines, ""]).encode()


GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
UPRIGHT_ROTATION = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""The rotation x, y, z, w that brings z up to glTF's y up."""


def glb_bytes(mesh: LitMesh) -> bytes:
    """A binary glTF 2.0 file: linear COLOR_0, and no other light (KHR_materials_unlit).

    Vertices are floats about the mesh's middle, whose place is that of the node.
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
        {"buffer": 0, "byteOffset": start, "byteLength": part.nbytes, "target": 34963 if part.ndim == 1 else 34962}
        for start, part in zip(starts, parts, strict=False)
    ]
    accessors: list[dict[str, Any]] = [
        {"bufferView": n, "componentType": 5126, "count": len(part), "type": "VEC3"} for n, part in enumerate(parts[:3])
    ]
    accessors[0] |= {"min": parts[0].min(axis=0).tolist(), "max": parts[0].max(axis=0).tolist()}
    accessors.append({"bufferView": 3, "componentType": 5125, "count": parts[3].size, "type": "SCALAR"})
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
    chunks = [_chunk(JSON_CHUNK, text, b" "), _chunk(BINARY_CHUNK, b"".join(part.tobytes() for part in parts), b"\0")]
    size = 12 + sum(map(len, chunks))
    return np.array([GLB_MAGIC, 2, size], "<u4").tobytes() + b"".join(chunks)


def _chunk(kind: int, data: bytes, filler: bytes) -> bytes:
    """A chunk of a binary glTF file, filled up to whole words."""
    padded = data + filler * (-len(data) % 4)
    return np.array([len(padded), kind], "<u4").tobytes() + padded


METRES_OF_UNITS = {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9, "Å": 1e-10}
"""Metres of the units that volumes have; those of others are taken for USD's own, centimetres."""

BLOCK_TEXELS = 4
"""Texels a side of each quadrilateral's own part of the texture: its four corners, and a rim that repeats them."""

MAX_TEXTURE_SIDE = 16384
"""Texels a side of a texture, at most: what graphics processors take."""

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
    """The layer of a mesh that emits the light of the file ``texture`` and reflects none.

    Points are about the mesh's middle, whose place is that of the root; a turn brings z up to USD's y up.
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
    """The texture of a mesh, sRGB bytes (h, w, 3): a block of BLOCK_TEXELS × BLOCK_TEXELS for each quadrilateral.

    Its middle texels are the corners' colours, so that between them a bilinear filter interpolates the light.
    Raises VolumeError where it would be too large.
    """
    columns, rows = _texture_blocks(len(mesh.quads))
    if columns * BLOCK_TEXELS > MAX_TEXTURE_SIDE:
        most = (MAX_TEXTURE_SIDE // BLOCK_TEXELS) ** 2
        raise VolumeError(f"The texture of {len(mesh.quads):,} faces is too large, {most:,} fit: write .glb instead.")
    corners = srgb_bytes(mesh.colours)[mesh.quads[:, [[0, 1], [3, 2]]]]
    blocks = np.zeros((rows * columns, BLOCK_TEXELS, BLOCK_TEXELS, 3), np.uint8)
    blocks[: len(corners)] = corners.repeat(BLOCK_TEXELS // 2, axis=1).repeat(BLOCK_TEXELS // 2, axis=2)
    whole = blocks.reshape(rows, columns, BLOCK_TEXELS, BLOCK_TEXELS, 3).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(whole.reshape(rows * BLOCK_TEXELS, columns * BLOCK_TEXELS, 3))


def texture_places(quads: int) -> np.ndarray:
    """Where the corners of each of so many quadrilaterals are in their texture: u, v from its lower left (n, 4, 2)."""
    columns, rows = _texture_blocks(quads)
    row, column = np.divmod(np.arange(quads), columns)
    right, down = np.array([0, 1, 1, 0]), np.array([0, 0, 1, 1])
    middle = BLOCK_TEXELS / 2.0 - 0.5
    u = (column[:, None] * BLOCK_TEXELS + middle + right) / (columns * BLOCK_TEXELS)
    v = 1.0 - (row[:, None] * BLOCK_TEXELS + middle + down) / (rows * BLOCK_TEXELS)
    return np.stack([u, v], axis=-1)


FILE_ALIGNMENT, PADDING_FIELD, LOCAL_HEADER = 64, 0x1986, 30
"""Bytes that each file of a package begins at a multiple of; the extra field that fills up; a ZIP header's bytes."""


def usdz_package(files: dict[str, bytes]) -> bytes:
    """A usdz package: a ZIP archive of stored files whose bytes are aligned; the first is the layer to open."""
    package = io.BytesIO()
    with zipfile.ZipFile(package, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name)
            start = package.tell() + LOCAL_HEADER + len(name.encode()) + 4
            entry.extra = struct.pack("<HH", PADDING_FIELD, -start % FILE_ALIGNMENT) + bytes(-start % FILE_ALIGNMENT)
            archive.writestr(entry, data)
    return package.getvalue()


def _texture_blocks(quads: int) -> tuple[int, int]:
    """Columns and rows of a texture's blocks, as square as may be."""
    columns = max(int(np.ceil(np.sqrt(quads))), 1)
    return columns, max(-(-quads // columns), 1)


def _rows(values: np.ndarray) -> str:
    """Rows of numbers as USD's text has them; no digit more than a float32 tells."""
    one = "(" + ", ".join(["%.8g"] * values.shape[1]) + ")"
    return f"[{', '.join([one] * len(values)) % tuple(values.astype(np.float32).ravel().tolist())}]"
