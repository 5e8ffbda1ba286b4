"""A station's files, as far as names, places and shapes go: joints, channels, patches, objects."""

from __future__ import annotations

import base64
import sys
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.errors import PalpateError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """A pose: x, y, z in m, and a rotation as w, x, y, z."""

    position_m: Floats
    quaternion_wxyz: Floats

    @staticmethod
    def read(table: dict[str, Any]) -> Pose:
        """The pose of a file; without a rotation, or with one as `rpy_rad`."""
        quaternion = table.get("quaternion_wxyz")
        if quaternion is None:
            roll, pitch, yaw = np.asarray(table.get("rpy_rad", (0.0, 0.0, 0.0)), float) / 2
            turns = [((0, 0, 1), yaw), ((0, 1, 0), pitch), ((1, 0, 0), roll)]
            quaternion = np.array([1.0, 0.0, 0.0, 0.0])
            for axis, half in turns:
                quaternion = _times(quaternion, np.array([np.cos(half), *(np.sin(half) * np.asarray(axis, float))]))
        unit = np.asarray(quaternion, float)
        return Pose(np.asarray(table.get("position_m", (0.0, 0.0, 0.0)), float), unit / np.linalg.norm(unit))

    def matrix(self) -> Floats:
        """The pose as a 4 x 4 matrix."""
        w, x, y, z = self.quaternion_wxyz
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, 3] = self.position_m
        return matrix


def _times(a: Floats, b: Floats) -> Floats:
    w, v = a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([w, *v])


@dataclass(frozen=True)
class Patch:
    """A sensing patch: its taxels lie at `points_m` of its link's frame (n x 3), facing along `normals` (n x 3)."""

    id: str
    label: str
    stream: str
    link: str
    channels: range
    points_m: Floats
    normals: Floats


@dataclass(frozen=True)
class Stream:
    """Channels that arrive together. Readings above `on_threshold` (raw units over rest) count as touch.

    Each taxel measures so many `axes`, of which its reading is made.
    """

    id: str
    label: str
    channels: range
    on_threshold: float
    axes: int = 1


class Station:
    """A station: joints and channels in the order of all arrays, and what they belong to."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.files = {path: base64.b64decode(data) for path, data in document["files_base64"].items()}
        table = tomllib.loads(document["station_toml"])
        self.id: str = table["id"]
        self.label: str = table["label"]
        self.joints: tuple[str, ...] = tuple(table["joints"])
        self.robot_file: str = table["robot"]
        layout = tomllib.loads(self.text(table["layout"]))
        thresholds = {item["stream"]: float(item["on_threshold"]) for item in table["stream"]}
        patches: list[Patch] = []
        streams: list[Stream] = []
        channels: list[str] = []
        # Channels go by stream, then by patch, then by taxel, whatever the order of patches in the file.
        for stream in layout["stream"]:
            begin = len(channels)
            for patch in (patch for patch in layout["patch"] if patch["stream"] == stream["id"]):
                points, normals = taxels(patch)
                first, count = len(channels), len(points)
                ids = [patch["id"]] if count == 1 else [f"{patch['id']}.{taxel}" for taxel in range(count)]
                channels += ids
                span = range(first, first + count)
                patches.append(Patch(patch["id"], patch["label"], stream["id"], patch["link"], span, points, normals))
            span = range(begin, len(channels))
            axes = int(stream.get("axes", 1))
            streams.append(Stream(stream["id"], stream["label"], span, thresholds[stream["id"]], axes))
        self.channels: tuple[str, ...] = tuple(channels)
        self.patches: tuple[Patch, ...] = tuple(patches)
        self.streams: dict[str, Stream] = {stream.id: stream for stream in streams}
        tables = [(path, tomllib.loads(self.text(path))) for path in table.get("objects", [])]
        self.objects: dict[str, tuple[str, dict[str, Any]]] = {item["id"]: (path, item) for path, item in tables}
        """Path and content of each object's file, by the object's id."""

    def text(self, path: str) -> str:
        """A file that the station names, as text."""
        return self.file(path).decode()

    def file(self, path: str) -> bytes:
        """A file that the station names, by its path relative to the station file."""
        if path not in self.files:
            raise PalpateError("Incomplete station", f"the studio sent no {path!r}, which its station file names")
        return self.files[path]

    def object_mesh(self, object_id: str, file: str) -> bytes:
        """The bytes of a mesh that an object's file names, relative to that file."""
        beside = PurePosixPath(self.objects[object_id][0]).parent / file
        return self.file(str(beside))


def taxels(patch: dict[str, Any]) -> tuple[Floats, Floats]:
    """Places and outward normals of a patch's taxels in its link's frame, each n x 3.

    Files name taxels by where they appear from above (along -z of the patch); they lie on its flat, half-round or
    domed surface.
    """
    seen = np.asarray(patch.get("taxels_m") or [[0.0, 0.0]], float)
    x, y = seen[:, 0], seen[:, 1]
    shape, zero = patch["shape"], np.zeros(len(seen))
    if shape["kind"] == "rectangle":
        points, normals = np.column_stack([x, y, zero]), np.tile([0.0, 0.0, 1.0], (len(seen), 1))
    elif shape["kind"] in ("arc", "cap"):
        radius = float(shape["radius_m"])
        half = float(shape.get("length_m", 0.0)) / 2
        # Up to the end of its straight part an arc curves about its axis; beyond, and in a cap, about a point.
        centre = np.minimum(x, half) if shape["kind"] == "arc" else zero
        out = np.column_stack([x - centre, y, np.sqrt(np.maximum(radius**2 - (x - centre) ** 2 - y**2, 0.0))])
        normals = out / radius
        points = out + np.column_stack([centre, zero, zero - radius])
    else:
        raise PalpateError("Newer station", f"patch {patch['id']!r} has the unknown shape {shape['kind']!r}")
    link_from_patch = Pose.read(patch["pose"]).matrix()
    return points @ link_from_patch[:3, :3].T + link_from_patch[:3, 3], normals @ link_from_patch[:3, :3].T
