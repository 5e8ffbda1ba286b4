"""Takes and live frames as NumPy arrays."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import ClientConnection

from palpate import control_pb2, trace_pb2
from palpate.errors import PalpateError
from palpate.station import Station

if TYPE_CHECKING:
    import pandas as pd
    from _typeshed import DataclassInstance

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
M = TypeVar("M", bound=Message)


@dataclass(frozen=True)
class Span:
    """A marked span of a take, s. `kind` is `baseline`, `repetition` or `note`."""

    kind: str
    start_s: float
    end_s: float
    label: str


@dataclass(frozen=True)
class StreamSamples:
    """A tactile stream at its native rate.

    Attributes:
        channels: Channel ids, in the order of columns.
        times_s: n; seconds since the take began.
        raw: n x channels; readings less their value at rest, raw units. None for a take without readings.
        active: n x channels.
        axes: n x channels x axes; what the axes (x, y, z) of each taxel measured, raw units, NaN where a sample has
            none. None for a stream of one axis.

    """

    channels: tuple[str, ...]
    times_s: Floats
    raw: Singles | None
    active: Bools
    axes: Singles | None = None

    def to_pandas(self) -> pd.DataFrame:
        """Readings (or activations, where there are none) by time."""
        return _frame(self.times_s, self.channels, self.active if self.raw is None else self.raw)


@dataclass(frozen=True)
class Trace:
    """A recorded take.

    Attributes:
        joints: Joint names, in the order of columns.
        channels: Channel ids, in the order of columns.
        times_s: n; times of the joint frames, seconds since the take began.
        joint_positions: n x joints, rad or m.
        active: n x channels; activations in effect at each frame.
        streams: Every stream at its native rate, by id.
        spans: What was marked while it was recorded.
        object_poses: n x 7; x, y, z in m, then w, x, y, z in the robot's base frame, of an object that moves. None for
            one that stands still, at the take's `summary.object_pose`.

    """

    joints: tuple[str, ...]
    channels: tuple[str, ...]
    times_s: Floats
    joint_positions: Singles
    active: Bools
    streams: dict[str, StreamSamples]
    spans: list[Span]
    object_poses: Singles | None = None

    def to_pandas(self) -> pd.DataFrame:
        """Joint positions and activations by time, a column each."""
        joints = _frame(self.times_s, self.joints, self.joint_positions)
        table: pd.DataFrame = joints.join(_frame(self.times_s, self.channels, self.active))
        return table

    def raw_at_frames(self) -> Singles | None:
        """The newest reading of every channel at or before each joint frame, n x channels; None without readings."""
        columns = []
        for stream in self.streams.values():
            if stream.raw is None:
                return None
            newest = np.searchsorted(stream.times_s, self.times_s, side="right") - 1
            before = newest < 0
            newest[before] = 0
            readings = stream.raw[newest] if len(stream.raw) else np.zeros((len(newest), len(stream.channels)))
            columns.append(np.where(before[:, None], 0.0, readings))
        return np.concatenate(columns, axis=1).astype(np.float32)


@dataclass(frozen=True)
class Replay:
    """A take as a sensor model feels it.

    Attributes:
        model: The model's name.
        channels: Channel ids, in the order of columns.
        times_s: n; times of the joint frames, as in the take's trace.
        active: n x channels.
        raw: n x channels; signed distance in m (proximity) or pressure in Pa (pressure).
        thresholds: What `raw` is compared with, one a channel.

    """

    model: str
    channels: tuple[str, ...]
    times_s: Floats
    active: Bools
    raw: Singles
    thresholds: Singles

    def to_pandas(self) -> pd.DataFrame:
        """Activations by time, a column a channel."""
        return _frame(self.times_s, self.channels, self.active)


@dataclass(frozen=True)
class Frame:
    """The newest state of the live station.

    Attributes:
        time_s: Seconds since the station started.
        joints: Joint names, in the order of `joint_positions`.
        channels: Channel ids, in the order of `active` and `raw`.
        joint_positions: rad or m; NaN as long as they have not been read.
        active: Which channels feel something.
        raw: Readings less their value at rest; zeros where the hardware gives events only.
        expected: What the simulator beside the hardware feels; None while it simulates nothing.
        phase: `disarmed`, `arming`, `armed`, `holding`, `disarming` or `stopped`.
        reason: Why it holds, stopped or cannot be armed; empty when all is well.
        holder: Who has control; empty for nobody.
        dropped: Messages that were dropped so far because this client read too slowly.
        message: The whole message, for what is not above.

    """

    time_s: float
    joints: tuple[str, ...]
    channels: tuple[str, ...]
    joint_positions: Singles
    active: Bools
    raw: Singles
    expected: Bools | None
    phase: str
    reason: str
    holder: str
    dropped: int
    message: trace_pb2.LiveFrame

    def position(self, joint: str) -> float:
        """Position of a joint, rad or m."""
        return float(self.joint_positions[self.joints.index(joint)])

    def felt(self) -> list[str]:
        """Ids of the channels that feel something."""
        return [channel for channel, active in zip(self.channels, self.active, strict=True) if active]


def trace_of(data: bytes, station: Station) -> Trace:
    """A `TakeTrace` message as arrays."""
    message = parse(trace_pb2.TakeTrace, data)
    num_frames = len(message.frame_times_s)
    streams = {}
    for stream in message.streams:
        if stream.stream not in station.streams:
            raise PalpateError("Damaged answer", f"the take has a stream {stream.stream!r} that its station lacks")
        span = station.streams[stream.stream].channels
        shape = (len(stream.times_s), len(span))
        raw = np.asarray(stream.raw, np.float32)
        streams[stream.stream] = StreamSamples(
            station.channels[span.start : span.stop],
            np.asarray(stream.times_s, np.float64),
            _reshape(raw, shape) if len(raw) else None,
            _bits(stream.active, shape),
            _axes(np.asarray(stream.axes, np.float32), (*shape, station.streams[stream.stream].axes)),
        )
    return Trace(
        station.joints,
        station.channels,
        np.asarray(message.frame_times_s, np.float64),
        _reshape(np.asarray(message.joint_positions, np.float32), (num_frames, len(station.joints))),
        _bits(message.real_active, (num_frames, len(station.channels))),
        streams,
        [Span(span.kind, span.start_s, span.end_s, span.label) for span in message.spans],
        _reshape(np.asarray(message.object_poses, np.float32), (num_frames, 7)) if message.object_poses else None,
    )


def replay_of(data: bytes, station: Station, times_s: Floats) -> Replay:
    """A `ReplayTrace` message as arrays."""
    message = parse(trace_pb2.ReplayTrace, data)
    shape = (len(times_s), len(station.channels))
    return Replay(
        message.model,
        station.channels,
        times_s,
        _bits(message.active, shape),
        _reshape(np.asarray(message.raw, np.float32), shape),
        np.asarray(message.thresholds, np.float32),
    )


class NewestFrame:
    """The newest live frame of a stream socket, which a thread reads: whoever is slow gets no old ones."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._changed = threading.Condition()
        self._newest: trace_pb2.StreamMessage | None = None
        self._skipped = 0
        self._has_ended = False
        self._error: PalpateError | None = None
        threading.Thread(target=self._read, name="palpate-stream", daemon=True).start()

    def wait(self) -> tuple[trace_pb2.StreamMessage, int] | None:
        """Waits for a frame that was not given yet; gives it and how many were left out so far, or None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._has_ended)
            newest, self._newest = self._newest, None
            if newest is None and self._error is not None:
                raise self._error
            return None if newest is None else (newest, self._skipped)

    def _read(self) -> None:
        error = None
        try:
            for data in self._socket:
                message = parse(trace_pb2.StreamMessage, data if isinstance(data, bytes) else data.encode())
                if message.HasField("live"):
                    with self._changed:
                        self._skipped += self._newest is not None
                        self._newest = message
                        self._changed.notify_all()
        except PalpateError as damaged:
            error = damaged
        except ConnectionClosedError as closed:
            error = PalpateError("Stream ended", str(closed))
        with self._changed:
            self._has_ended, self._error = True, error
            self._changed.notify_all()


def frame_of(message: trace_pb2.StreamMessage, station: Station, skipped: int = 0) -> Frame:
    """The live frame of a `StreamMessage`; `skipped` others were left out here."""
    live = message.live
    num_channels = (len(station.channels),)
    phase = control_pb2.ControlState.Phase.Name(live.control.phase).lower()
    twin = live.control.twin.active
    return Frame(
        live.time_s,
        station.joints,
        station.channels,
        np.asarray(live.joint_positions, np.float32) if live.joint_positions else np.full(len(station.joints), np.nan),
        _bits(live.active, num_channels) if live.active else np.zeros(num_channels, np.bool_),
        np.asarray(live.raw, np.float32) if live.raw else np.zeros(num_channels, np.float32),
        _bits(twin, num_channels) if twin else None,
        "disarmed" if phase == "phase_unspecified" else phase,
        live.control.reason,
        live.control.holder,
        message.dropped + skipped,
        live,
    )


def to_pandas(documents: Iterable[DataclassInstance] | Mapping[str, DataclassInstance]) -> pd.DataFrame:
    """Documents (dataclasses) as a table: a row each, nested fields as columns such as `nominal.f1`.

    A mapping, such as `report.by_channel`, gives its keys as index.
    """
    pandas = _pandas()
    rows = list(documents.values()) if isinstance(documents, Mapping) else list(documents)
    tables: list[dict[str, Any]] = [dataclasses.asdict(row) for row in rows]
    table: pd.DataFrame = pandas.json_normalize(tables)
    if isinstance(documents, Mapping):
        table.index = pandas.Index(list(documents))
    return table


def parse(kind: type[M], data: bytes) -> M:
    """A protobuf message."""
    try:
        return kind.FromString(data)
    except DecodeError as error:
        raise PalpateError(
            "Damaged answer", f"{len(data)} bytes are no {kind.DESCRIPTOR.full_name}: {error}"
        ) from error


def _bits(data: bytes, shape: tuple[int, ...]) -> Bools:
    """The first bits of `data`, least significant first, in `shape`."""
    count = int(np.prod(shape))
    bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")
    if len(bits) < count:
        raise PalpateError("Damaged answer", f"{len(bits)} activations came, expected {count} as {shape}")
    return bits[:count].reshape(shape).astype(np.bool_)


def _reshape(values: Singles, shape: tuple[int, int]) -> Singles:
    if values.size != shape[0] * shape[1]:
        raise PalpateError("Damaged answer", f"{values.size} numbers came, expected {shape[0]} x {shape[1]}")
    return values.reshape(shape)


def _axes(values: Singles, shape: tuple[int, int, int]) -> Singles | None:
    return _reshape(values, (shape[0], shape[1] * shape[2])).reshape(shape) if len(values) else None


def _frame(times_s: Floats, columns: tuple[str, ...], values: Singles | Bools) -> pd.DataFrame:
    pandas = _pandas()
    frame: pd.DataFrame = pandas.DataFrame(values, index=pandas.Index(times_s, name="time_s"), columns=list(columns))
    return frame


def _pandas() -> Any:  # noqa: ANN401
    try:
        import pandas
    except ImportError as error:
        raise PalpateError("No pandas", "tables need pandas: pip install 'palpate[pandas]'") from error
    return pandas
