from palpate import control_pb2 as _control_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class TakeTrace(_message.Message):
    __slots__ = ("frame_times_s", "joint_positions", "real_active", "streams", "spans", "object_poses", "surroundings")
    FRAME_TIMES_S_FIELD_NUMBER: _ClassVar[int]
    JOINT_POSITIONS_FIELD_NUMBER: _ClassVar[int]
    REAL_ACTIVE_FIELD_NUMBER: _ClassVar[int]
    STREAMS_FIELD_NUMBER: _ClassVar[int]
    SPANS_FIELD_NUMBER: _ClassVar[int]
    OBJECT_POSES_FIELD_NUMBER: _ClassVar[int]
    SURROUNDINGS_FIELD_NUMBER: _ClassVar[int]
    frame_times_s: _containers.RepeatedScalarFieldContainer[float]
    joint_positions: _containers.RepeatedScalarFieldContainer[float]
    real_active: bytes
    streams: _containers.RepeatedCompositeFieldContainer[StreamTrace]
    spans: _containers.RepeatedCompositeFieldContainer[SpanTrace]
    object_poses: _containers.RepeatedScalarFieldContainer[float]
    surroundings: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, frame_times_s: _Optional[_Iterable[float]] = ..., joint_positions: _Optional[_Iterable[float]] = ..., real_active: _Optional[bytes] = ..., streams: _Optional[_Iterable[_Union[StreamTrace, _Mapping]]] = ..., spans: _Optional[_Iterable[_Union[SpanTrace, _Mapping]]] = ..., object_poses: _Optional[_Iterable[float]] = ..., surroundings: _Optional[_Iterable[float]] = ...) -> None: ...

class StreamTrace(_message.Message):
    __slots__ = ("stream", "times_s", "raw", "active", "axes")
    STREAM_FIELD_NUMBER: _ClassVar[int]
    TIMES_S_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    AXES_FIELD_NUMBER: _ClassVar[int]
    stream: str
    times_s: _containers.RepeatedScalarFieldContainer[float]
    raw: _containers.RepeatedScalarFieldContainer[float]
    active: bytes
    axes: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, stream: _Optional[str] = ..., times_s: _Optional[_Iterable[float]] = ..., raw: _Optional[_Iterable[float]] = ..., active: _Optional[bytes] = ..., axes: _Optional[_Iterable[float]] = ...) -> None: ...

class SpanTrace(_message.Message):
    __slots__ = ("kind", "start_s", "end_s", "label")
    KIND_FIELD_NUMBER: _ClassVar[int]
    START_S_FIELD_NUMBER: _ClassVar[int]
    END_S_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    kind: str
    start_s: float
    end_s: float
    label: str
    def __init__(self, kind: _Optional[str] = ..., start_s: _Optional[float] = ..., end_s: _Optional[float] = ..., label: _Optional[str] = ...) -> None: ...

class ReplayTrace(_message.Message):
    __slots__ = ("model", "active", "raw", "thresholds")
    MODEL_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    THRESHOLDS_FIELD_NUMBER: _ClassVar[int]
    model: str
    active: bytes
    raw: _containers.RepeatedScalarFieldContainer[float]
    thresholds: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, model: _Optional[str] = ..., active: _Optional[bytes] = ..., raw: _Optional[_Iterable[float]] = ..., thresholds: _Optional[_Iterable[float]] = ...) -> None: ...

class StreamMessage(_message.Message):
    __slots__ = ("live", "job", "changed", "dropped")
    LIVE_FIELD_NUMBER: _ClassVar[int]
    JOB_FIELD_NUMBER: _ClassVar[int]
    CHANGED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    live: LiveFrame
    job: JobUpdate
    changed: Changed
    dropped: int
    def __init__(self, live: _Optional[_Union[LiveFrame, _Mapping]] = ..., job: _Optional[_Union[JobUpdate, _Mapping]] = ..., changed: _Optional[_Union[Changed, _Mapping]] = ..., dropped: _Optional[int] = ...) -> None: ...

class LiveFrame(_message.Message):
    __slots__ = ("time_s", "joint_positions", "active", "raw", "activity", "object", "object_pose", "rates_hz", "control")
    TIME_S_FIELD_NUMBER: _ClassVar[int]
    JOINT_POSITIONS_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    ACTIVITY_FIELD_NUMBER: _ClassVar[int]
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    OBJECT_POSE_FIELD_NUMBER: _ClassVar[int]
    RATES_HZ_FIELD_NUMBER: _ClassVar[int]
    CONTROL_FIELD_NUMBER: _ClassVar[int]
    time_s: float
    joint_positions: _containers.RepeatedScalarFieldContainer[float]
    active: bytes
    raw: _containers.RepeatedScalarFieldContainer[float]
    activity: str
    object: str
    object_pose: _containers.RepeatedScalarFieldContainer[float]
    rates_hz: _containers.RepeatedScalarFieldContainer[float]
    control: _control_pb2.ControlState
    def __init__(self, time_s: _Optional[float] = ..., joint_positions: _Optional[_Iterable[float]] = ..., active: _Optional[bytes] = ..., raw: _Optional[_Iterable[float]] = ..., activity: _Optional[str] = ..., object: _Optional[str] = ..., object_pose: _Optional[_Iterable[float]] = ..., rates_hz: _Optional[_Iterable[float]] = ..., control: _Optional[_Union[_control_pb2.ControlState, _Mapping]] = ...) -> None: ...

class JobUpdate(_message.Message):
    __slots__ = ("job", "state", "fraction", "stage", "seconds_left", "error")
    JOB_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    SECONDS_LEFT_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    job: str
    state: str
    fraction: float
    stage: str
    seconds_left: float
    error: str
    def __init__(self, job: _Optional[str] = ..., state: _Optional[str] = ..., fraction: _Optional[float] = ..., stage: _Optional[str] = ..., seconds_left: _Optional[float] = ..., error: _Optional[str] = ...) -> None: ...

class Changed(_message.Message):
    __slots__ = ("list", "id")
    LIST_FIELD_NUMBER: _ClassVar[int]
    ID_FIELD_NUMBER: _ClassVar[int]
    list: str
    id: str
    def __init__(self, list: _Optional[str] = ..., id: _Optional[str] = ...) -> None: ...
