"""Light in files of other tools: meshes with colours (.ply, .glb), and volumes with values and light (.vti, .nrrd)."""

import json
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np


@dataclass(frozen=True, eq=False)
class LitMesh:
    """A mesh in the world: ``vertices``, outward unit ``normals`` and linear RGB ``colours`` (n, 3), ``triangles``."""

    vertices: np.ndarray
    normals: np.ndarray
    colours: np.ndarray
    triangles: np.ndarray


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
    faces = np.empty(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.triangles
    names = {"<f4": "float", "u1": "uchar"}
    lines = [f"element vertex {len(points)}", *(f"property {names[kind]} {name}" for name, kind in fields)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines]).encode() + points.tobytes() + faces.tobytes()


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """Linear RGB as sRGB bytes (IEC 61966-2-1)."""
    share = np.clip(linear, 0.0, 1.0)
    curve = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1.0 / 2.4) - 0.055)
    return np.asarray(curve * 255.0 + 0.5, np.uint8)


MAGIC, JSON, BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
UPRIGHT = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
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
        "nodes": [{"mesh": 0, "rotation": UPRIGHT, "translation": [x, z, -y]}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{"doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = [_chunk(JSON, text, b" "), _chunk(BINARY, b"".join(part.tobytes() for part in parts), b"\0")]
    size = 12 + sum(map(len, chunks))
    return np.array([MAGIC, 2, size], "<u4").tobytes() + b"".join(chunks)


def _chunk(kind: int, data: bytes, filler: bytes) -> bytes:
    """A chunk of a binary glTF file, filled up to whole words."""
    padded = data + filler * (-len(data) % 4)
    return np.array([len(padded), kind], "<u4").tobytes() + padded


def vti_bytes(arrays: dict[str, np.ndarray], affine: np.ndarray) -> bytes:
    """An image file of VTK with arrays (nz, ny, nx) or (nz, ny, nx, k) of points, little-endian, raw at its end.

    ``affine`` (3, 4) brings indices to the world. Format: VTK's XML image data, version 1.0.
    """
    steps = np.linalg.norm(affine[:, :3], axis=0)
    nz, ny, nx = next(iter(arrays.values())).shape[:3]
    extent = f"0 {nx - 1} 0 {ny - 1} 0 {nz - 1}"
    place = {
        "WholeExtent": extent,
        "Origin": _numbers(affine[:, 3]),
        "Spacing": _numbers(steps),
        "Direction": _numbers((affine[:, :3] / steps).ravel()),
    }
    rows, blocks, offset = [], [], 0
    for name, array in arrays.items():
        block = np.ascontiguousarray(array, "<f4").tobytes()
        parts = array.shape[3] if array.ndim == 4 else 1
        described = f'type="Float32" Name={quoteattr(name)} NumberOfComponents="{parts}" format="appended"'
        rows.append(f'<DataArray {described} offset="{offset}"/>')
        blocks.append(np.array([len(block)], "<u8").tobytes() + block)
        offset += len(blocks[-1])
    attributes = " ".join(f'{name}="{value}"' for name, value in place.items())
    kind = 'type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    points = f"<PointData Scalars={quoteattr(next(iter(arrays)))}>{''.join(rows)}</PointData>"
    piece = f'<ImageData {attributes}><Piece Extent="{extent}">{points}</Piece></ImageData>'
    head = f'<?xml version="1.0"?>\n<VTKFile {kind}>{piece}<AppendedData encoding="raw">_'
    return head.encode() + b"".join(blocks) + b"</AppendedData></VTKFile>\n"


def nrrd_bytes(arrays: dict[str, np.ndarray], affine: np.ndarray) -> bytes:
    """A NRRD file of arrays of points together: a vector of floats at each voxel, such as value, red, green, blue.

    ``arrays`` and ``affine`` are as for ``vti_bytes``.
    """
    parts = [array if array.ndim == 4 else array[..., None] for array in arrays.values()]
    block = np.concatenate(parts, axis=-1, dtype="<f4", casting="same_kind")
    directions = " ".join(f"({','.join(repr(float(x)) for x in column)})" for column in affine[:, :3].T)
    origin = ",".join(repr(float(x)) for x in affine[:, 3])
    lines = ["NRRD0005", "type: float", "dimension: 4", f"sizes: {' '.join(map(str, block.shape[::-1]))}"]
    lines += ["space dimension: 3", f"space directions: none {directions}", f"space origin: ({origin})"]
    lines += ["kinds: list domain domain domain", "endian: little", "encoding: raw", "", ""]
    return "\n".join(lines).encode() + block.tobytes()


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
