"""Embree's C interface, out of the library that the package ``embreex`` brings, called from
compiled loops.

Layouts and constants are those of Embree 4's ``rtcore_ray.h``, ``rtcore_common.h`` and
``rtcore_buffer.h``.
"""

import ctypes
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

MEDIUM = 1
LOW = 0
"""Build qualities: Embree's default, and its Morton-order builder."""

TRIANGLE = 0
INDEX = 0
VERTEX = 1
UINT3 = 0x5003
FLOAT3 = 0x9003
PACKET = 16
Trace = Callable[..., None]


def libraries() -> list[Path]:
    """Embree 4 and then what it needs, beside the package ``embreex`` of a Linux wheel; empty where
    there is none.
    """
    package = importlib.util.find_spec("embreex")
    if package is None or package.origin is None:
        return []
    folder = Path(package.origin).parents[1] / "embreex.libs"
    return [*folder.glob("libembree4*"), *folder.glob("libtbb*")]


def installed() -> bool:
    """Whether the package is there, with the library."""
    return bool(libraries())


def library() -> ctypes.CDLL:
    """The library, with the types of what is called."""
    path, *needed = libraries()
    for helper in needed:
        ctypes.CDLL(str(helper), ctypes.RTLD_GLOBAL)
    lib = ctypes.CDLL(str(path))
    pointer = ctypes.c_void_p
    size = ctypes.c_size_t
    for name in ("rtcNewDevice", "rtcNewScene", "rtcNewGeometry"):
        getattr(lib, name).restype = pointer
    lib.rtcNewDevice.argtypes = [ctypes.c_char_p]
    lib.rtcNewScene.argtypes = [pointer]
    lib.rtcNewGeometry.argtypes = [pointer, ctypes.c_int]
    lib.rtcSetSharedGeometryBuffer.argtypes = [
        pointer,
        *[ctypes.c_int] * 2,
        ctypes.c_int,
        pointer,
        size,
        size,
        size,
    ]
    lib.rtcSetSceneBuildQuality.argtypes = [pointer, ctypes.c_int]
    lib.rtcAttachGeometry.argtypes = [pointer, pointer]
    lib.rtcSetDeviceMemoryMonitorFunction.argtypes = [pointer, MONITOR, pointer]
    for name in (
        "rtcCommitGeometry",
        "rtcReleaseGeometry",
        "rtcCommitScene",
        "rtcReleaseScene",
        "rtcReleaseDevice",
    ):
        getattr(lib, name).argtypes = [pointer]
    lib.rtcIntersect1.argtypes = [size] * 3
    lib.rtcIntersect1.restype = None
    lib.rtcIntersect16.argtypes = [size] * 4
    lib.rtcIntersect16.restype = None
    return lib


MONITOR = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_bool)


class Device:
    """Embree on so many threads; ``bytes`` is what its trees take now."""

    def __init__(self, threads: int) -> None:
        """Start the library."""
        self.lib = library()
        self.bytes = 0
        self.handle = self.lib.rtcNewDevice(f"threads={threads},user_threads={threads}".encode())
        self._monitor = MONITOR(self._count)
        self.lib.rtcSetDeviceMemoryMonitorFunction(self.handle, self._monitor, None)
        self.one, self.sixteen = (
            trace_one(self.lib.rtcIntersect1),
            trace_packets(self.lib.rtcIntersect16),
        )

    def _count(self, _: Any, added: int, __: bool) -> bool:
        self.bytes += added
        return True


class Tree:
    """A tree over a mesh: ``points`` (n, 3) float32 and ``triangles`` (m, 3) uint32."""

    def __init__(
        self, device: Device, points: np.ndarray, triangles: np.ndarray, quality: int = MEDIUM
    ) -> None:
        """Build it; ``bytes`` is what it takes besides the mesh."""
        lib = device.lib
        before = device.bytes
        self.device = device
        self.triangles = np.ascontiguousarray(triangles, np.uint32)
        self.points = np.empty(
            (len(points) + 1, 3), np.float32
        )  # Embree reads 16 bytes of the last point
        self.points[:-1] = points
        self.points[-1] = 0.0
        self.handle = lib.rtcNewScene(device.handle)
        geometry = lib.rtcNewGeometry(device.handle, TRIANGLE)
        for kind, form, array in ((INDEX, UINT3, self.triangles), (VERTEX, FLOAT3, self.points)):
            lib.rtcSetSharedGeometryBuffer(
                geometry, kind, 0, form, array.ctypes.data, 0, 12, len(array)
            )
        lib.rtcCommitGeometry(geometry)
        lib.rtcAttachGeometry(self.handle, geometry)
        lib.rtcReleaseGeometry(geometry)
        lib.rtcSetSceneBuildQuality(self.handle, quality)
        lib.rtcCommitScene(self.handle)
        self.bytes = device.bytes - before

    def trace(self, by: Trace, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """First hits of rays (3, n) float32, on this thread: rows t (inf where none), Ng x, y, z;
        (4, n) float32.
        """
        hits = np.empty((4, origins.shape[1]), np.float32)
        by(self.handle, room(), origins, directions, hits)
        return hits

    def close(self) -> None:
        """Give its memory back."""
        self.device.lib.rtcReleaseScene(self.handle)


def room() -> np.ndarray:
    """Memory of one ray packet with its hits, aligned as Embree wants it."""
    words = np.zeros(21 * PACKET + 16, np.float32)
    first = -words.ctypes.data % 64 // 4
    return words[first : first + 21 * PACKET]


def trace_one(intersect: Any) -> Trace:
    """The compiled loop over ``rtcIntersect1``."""

    @njit(nogil=True)
    def trace(scene, ray, origins, directions, hits):  # type: ignore[no-untyped-def]
        bits = ray.view(np.int32)
        for m in range(origins.shape[1]):
            for axis in range(3):
                ray[axis] = origins[axis, m]
                ray[4 + axis] = directions[axis, m]
            ray[3] = 0.0
            ray[7] = 0.0
            ray[8] = np.inf
            bits[9] = -1
            bits[11] = 0
            bits[18] = -1
            intersect(scene, ray.ctypes.data, 0)
            hits[0, m] = ray[8] if bits[18] != -1 else np.inf
            for axis in range(3):
                hits[1 + axis, m] = ray[12 + axis]

    return trace


def trace_packets(intersect: Any) -> Trace:
    """The compiled loop over ``rtcIntersect16``."""

    @njit(nogil=True)
    def trace(scene, rays, origins, directions, hits):  # type: ignore[no-untyped-def]
        valid = np.empty(PACKET, np.int32)
        bits = rays.view(np.int32)
        fields = rays.reshape(21, PACKET)
        total = origins.shape[1]
        for first in range(0, total, PACKET):
            for lane in range(PACKET):
                m = min(first + lane, total - 1)
                valid[lane] = -1 if first + lane < total else 0
                for axis in range(3):
                    fields[axis, lane] = origins[axis, m]
                    fields[4 + axis, lane] = directions[axis, m]
                fields[3, lane] = 0.0
                fields[7, lane] = 0.0
                fields[8, lane] = np.inf
                bits[9 * PACKET + lane] = -1
                bits[11 * PACKET + lane] = 0
                bits[18 * PACKET + lane] = -1
            intersect(valid.ctypes.data, scene, rays.ctypes.data, 0)
            for lane in range(min(PACKET, total - first)):
                if bits[18 * PACKET + lane] != -1:
                    hits[0, first + lane] = fields[8, lane]
                else:
                    hits[0, first + lane] = np.inf
                for axis in range(3):
                    hits[1 + axis, first + lane] = fields[12 + axis, lane]

    return trace
