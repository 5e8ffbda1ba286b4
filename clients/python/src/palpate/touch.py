"""What the hand of a station feels, for simulators and trainings of your own: the sensor model as a library.

    from palpate.touch import Touch

    touch = Touch("assets/stations/xarm6_leap.toml", "sphere_50mm", "assets/models/demo_diagnosed.toml", envs=4096)
    readings = touch.step(time_s, joint_positions, object_poses)  # readings.active: envs x channels

The numbers are those of `palpate replay`, to the bit: the Rust library behind both is the same. It is built from the
checkout, with `cargo build --release -p palpate_touch`, and found by the environment variable PALPATE_TOUCH_LIBRARY or
beside this file. `docs/touch.md` says what goes in and what the readings mean.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.errors import PalpateError

if TYPE_CHECKING:
    from palpate.client import Model

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

ABI_VERSION = 1
"""The version of the library's interface that this module speaks."""

LIBRARY_VARIABLE = "PALPATE_TOUCH_LIBRARY"
"""Environment variable with the path of the library."""

POSE = 7
"""Numbers of a pose: x y z in m, then a unit quaternion, scalar first."""

_KINDS = {1: "bad argument", 2: "bad file", 3: "bad input", 4: "bug"}
_loaded: dict[str, ctypes.CDLL] = {}


@dataclass(frozen=True)
class Stream:
    """Channels that one board reads. `kind` is `proximity` or `pressure`; `channels` is a slice of the columns."""

    id: str
    kind: str
    rate_hz: float
    channels: slice


@dataclass(frozen=True)
class Readings:
    """What is felt, a row for each environment, or for each frame of a replay.

    Attributes:
        raw: The signal that is compared with the threshold: signed distance in m of proximity channels, pressure in
            Pa of pressure channels.
        active: Whether each channel is on.

    """

    raw: Floats
    active: Bools


class Touch:
    """A station's hand, an object and a sensor model; `envs` environments of them that feel side by side.

    Args:
        station: Path of a station's TOML, such as `assets/stations/xarm6_leap.toml`.
        object: Id of an object of the station, or the path of an object's TOML.
        model: Path of a sensor model's TOML, a `palpate.Model`, or None for the station's nominal model.
        envs: Number of environments.
        fixed: What else can be felt and stands still, such as a table: pairs of an object, as above, and its pose.
        threads: Threads that `step` uses; None for one on each core. Readings do not depend on it.
        library: Path of the library; None to look for it as the module says.

    """

    def __init__(
        self,
        station: str | os.PathLike[str],
        object: str | os.PathLike[str],
        model: str | os.PathLike[str] | Model | None = None,
        *,
        envs: int = 1,
        fixed: Sequence[tuple[str | os.PathLike[str], ArrayLike]] = (),
        threads: int | None = None,
        library: str | os.PathLike[str] | None = None,
    ) -> None:
        self._handles: list[int] = []
        self._library = load_library(library)
        self._closing = weakref.finalize(self, _close_all, self._library, self._handles)
        if not Path(station).is_file():
            raise PalpateError(
                "Unknown station",
                f"{os.fspath(station)!r} is no file, expected the path of a station's TOML, such as "
                "assets/stations/xarm6_leap.toml of the checkout",
            )
        if envs < 1:
            raise PalpateError("Bad input", f"envs is {envs}, expected at least 1")
        if threads is not None and threads < 1:
            raise PalpateError("Bad input", f"threads is {threads}, expected at least 1, or None for one on each core")
        name, text = _model_text(model)
        poses = np.ascontiguousarray([_floats("the pose of a fixed body", pose, (POSE,)) for _, pose in fixed])
        objects = (ctypes.c_char_p * len(fixed))(*(os.fsencode(body) for body, _ in fixed))
        scene = self._open(
            "palpate_touch_open",
            os.fsencode(station),
            name,
            text,
            os.fsencode(object),
            ctypes.c_size_t(len(fixed)),
            objects,
            _pointer(poses),
        )
        self._scene = scene
        names = json.loads(self._describe(with_numbers=False))
        self.station: str = names["station"]
        """Id of the station."""
        self.model: str = names["model"]
        """Name of the sensor model."""
        self.object: str = names["object"]
        """Id of the object."""
        self.joints: tuple[str, ...] = tuple(names["joints"])
        """Names of the joints, in the order of positions."""
        self.channels: tuple[str, ...] = tuple(names["channels"])
        """Ids of the channels, in the order of readings."""
        self.streams: tuple[Stream, ...] = tuple(
            Stream(of["id"], of["kind"], of["rate_hz"], slice(*of["channels"])) for of in names["streams"]
        )
        """Streams of the layout."""
        self.thresholds: Floats = np.array(names["thresholds"])
        """Per channel, what the raw reading is compared with: m or Pa."""
        self.effects: tuple[str, ...] = tuple(names["effects"])
        """Ids of the model's effects."""
        self.looks_ahead: tuple[str, ...] = tuple(names["looks_ahead"])
        """Those effects for which a replay also looks at the next frame; `step` takes the change since the last one."""
        self.envs = envs
        """Number of environments."""
        self._batch = self._open(
            "palpate_touch_batch", ctypes.c_uint64(scene), ctypes.c_size_t(envs), ctypes.c_size_t(threads or 0)
        )

    def step(self, time_s: ArrayLike, joint_positions: ArrayLike, object_pose: ArrayLike) -> Readings:
        """The next frame of every environment. One time, row of positions or pose may stand for all of them.

        Args:
            time_s: Time since the episode began, s, one for each environment. It goes up until `restart`.
            joint_positions: envs x joints, rad or m, in the order of `joints`.
            object_pose: envs x 7, the object in the robot's base: x y z in m, then a unit quaternion, scalar first (as
                MuJoCo has it).

        """
        rows = (self.envs, len(self.joints))
        times_s = _floats("time_s", time_s, (self.envs,))
        positions = _floats("joint_positions", joint_positions, rows)
        poses = _floats("object_pose", object_pose, (self.envs, POSE))
        raw, active = self._room(self.envs)
        self._call(
            "palpate_touch_step",
            ctypes.c_uint64(self._batch),
            _pointer(times_s),
            _pointer(positions),
            _pointer(poses),
            _pointer(raw),
            _pointer(active),
        )
        return Readings(raw, active.view(np.bool_))

    def restart(self, envs: ArrayLike | None = None) -> None:
        """Begins new episodes, which remember nothing: in all environments, or where `envs`, a mask, is true."""
        which = None
        if envs is not None:
            mask = np.asarray(envs)
            if mask.dtype != np.bool_ or mask.shape != (self.envs,):
                raise PalpateError(
                    "Bad input",
                    f"envs is an array of {mask.dtype} with shape {mask.shape}, expected a mask of {self.envs} bools",
                )
            which = np.ascontiguousarray(mask)
        self._call("palpate_touch_restart", ctypes.c_uint64(self._batch), None if which is None else _pointer(which))

    def replay(self, times_s: ArrayLike, joint_positions: ArrayLike, object_pose: ArrayLike) -> Readings:
        """A whole take at once, as `palpate replay` computes it; environments and what they remember do not matter.

        Args:
            times_s: n; time of each frame, s, going up.
            joint_positions: n x joints.
            object_pose: 7; where the object stands throughout.

        """
        times = np.asarray(times_s, dtype=np.float64)
        if times.ndim != 1:
            raise PalpateError("Bad input", f"times_s has shape {times.shape}, expected one time for each frame")
        times = np.ascontiguousarray(times)
        positions = _floats("joint_positions", joint_positions, (len(times), len(self.joints)), widen=False)
        pose = _floats("object_pose", object_pose, (POSE,))
        raw, active = self._room(len(times))
        self._call(
            "palpate_touch_replay",
            ctypes.c_uint64(self._scene),
            ctypes.c_size_t(len(times)),
            _pointer(times),
            _pointer(positions),
            _pointer(pose),
            _pointer(raw),
            _pointer(active),
        )
        return Readings(raw, active.view(np.bool_))

    def numbers(self) -> dict[str, Any]:
        """All that readings are computed from, as one document: what `palpate.touch_jax` is made from."""
        document: dict[str, Any] = json.loads(self._describe(with_numbers=True))
        return document

    def close(self) -> None:
        """Frees environments and scene; nothing can be asked afterwards."""
        self._closing()

    def __enter__(self) -> Touch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _room(self, rows: int) -> tuple[Floats, NDArray[np.uint8]]:
        shape = (rows, len(self.channels))
        return np.empty(shape), np.empty(shape, dtype=np.uint8)

    def _open(self, function: str, *arguments: object) -> int:
        handle = ctypes.c_uint64()
        self._call(function, *arguments, ctypes.byref(handle))
        self._handles.append(handle.value)
        return handle.value

    def _describe(self, *, with_numbers: bool) -> bytes:
        room, length = 0, ctypes.c_size_t()
        while True:
            buffer = ctypes.create_string_buffer(max(room, 1))
            self._call(
                "palpate_touch_describe",
                ctypes.c_uint64(self._scene),
                ctypes.c_int32(with_numbers),
                buffer,
                ctypes.c_size_t(room),
                ctypes.byref(length),
            )
            if length.value <= room:
                return buffer.raw[: length.value]
            room = length.value

    def _call(self, function: str, *arguments: object) -> None:
        if not self._handles and function != "palpate_touch_open":
            raise PalpateError("Closed", "this Touch was closed; make a new one")
        code = getattr(self._library, function)(*arguments)
        if code != 0:
            room = self._library.palpate_touch_last_error(None, ctypes.c_size_t(0))
            buffer = ctypes.create_string_buffer(max(room, 1))
            self._library.palpate_touch_last_error(buffer, ctypes.c_size_t(room))
            kind = _KINDS.get(code, f"error {code}")
            raise PalpateError(kind.capitalize(), buffer.raw[:room].decode("utf-8", "replace"))


def library_name() -> str:
    """What the library's file is called on this system."""
    if sys.platform == "win32":
        return "palpate_touch.dll"
    return "libpalpate_touch.dylib" if sys.platform == "darwin" else "libpalpate_touch.so"


def load_library(path: str | os.PathLike[str] | None = None) -> ctypes.CDLL:
    """The library at `path`, or where PALPATE_TOUCH_LIBRARY says, or beside this module; loaded once."""
    variable = os.environ.get(LIBRARY_VARIABLE)
    beside = Path(__file__).with_name(library_name())
    found = Path(path) if path is not None else Path(variable) if variable else beside
    how = (
        f"build it in the checkout with `cargo build --release -p palpate_touch`, and set {LIBRARY_VARIABLE} to "
        f"target/release/{library_name()}"
    )
    if not found.is_file():
        where = "library" if path is not None else LIBRARY_VARIABLE if variable else "no variable, so beside the module"
        raise PalpateError("Library missing", f"there is no {str(found)!r} ({where}); {how}")
    key = str(found.resolve())
    if key not in _loaded:
        try:
            library = ctypes.CDLL(key)
            version = library.palpate_touch_abi_version
        except (OSError, AttributeError) as error:
            raise PalpateError("Library unusable", f"{key!r} is no library of palpate touch: {error}; {how}") from error
        version.restype = ctypes.c_uint32
        if version() != ABI_VERSION:
            raise PalpateError(
                "Library unusable",
                f"{key!r} speaks version {version()} of the interface, this module {ABI_VERSION}; {how}",
            )
        library.palpate_touch_last_error.restype = ctypes.c_size_t
        _loaded[key] = library
    return _loaded[key]


def _close_all(library: ctypes.CDLL, handles: list[int]) -> None:
    while handles:
        library.palpate_touch_close(ctypes.c_uint64(handles.pop()))


def _model_text(model: str | os.PathLike[str] | Model | None) -> tuple[bytes | None, bytes | None]:
    if model is None:
        return None, None
    if isinstance(model, str | os.PathLike):
        try:
            text = Path(model).read_bytes()
        except OSError as error:
            raise PalpateError("Unknown model", f"failed to read the sensor model: {error}") from error
        name = os.fsencode(model)
    else:
        text, name = model.toml().encode(), model.id.encode()
    if b"\0" in text:
        raise PalpateError("Bad file", f"{os.fsdecode(name)}: a sensor model is TOML, and holds no zero byte")
    return name, text


def _floats(name: str, values: ArrayLike, shape: tuple[int, ...], *, widen: bool = True) -> Floats:
    """`values` as a contiguous array of this shape; with `widen`, a part of it is repeated for all rows."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PalpateError("Bad input", f"{name} must be numbers, with shape {shape}: {error}") from error
    if array.shape != shape:
        fits = array.ndim < len(shape) and array.shape == shape[len(shape) - array.ndim :]
        if not (widen and fits):
            raise PalpateError("Bad input", f"{name} has shape {array.shape}, expected {shape}")
        array = np.broadcast_to(array, shape)
    return np.ascontiguousarray(array)


def _pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
