"""Meshes with their light as colours of vertices, in files of other tools: .ply, .glb and .obj."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np


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


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    """Linear RGB as sRGB bytes (IEC 61966-2-1)."""
    share = np.clip(linear, 0.0, 1.0)
    curve = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1.0 / 2.4) - 0.055)
    return np.asarray(curve * 255.0 + 0.5, np.uint8)


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
