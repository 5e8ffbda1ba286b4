from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ControlRequest(_message.Message):
    __slots__ = ("sequence", "lease", "acquire", "release", "heartbeat", "arm", "disarm", "stop", "reset_stop", "targets", "lead_through", "clear_fault", "tare", "reflex", "object_pose")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    ACQUIRE_FIELD_NUMBER: _ClassVar[int]
    RELEASE_FIELD_NUMBER: _ClassVar[int]
    HEARTBEAT_FIELD_NUMBER: _ClassVar[int]
    ARM_FIELD_NUMBER: _ClassVar[int]
    DISARM_FIELD_NUMBER: _ClassVar[int]
    STOP_FIELD_NUMBER: _ClassVar[int]
    RESET_STOP_FIELD_NUMBER: _ClassVar[int]
    TARGETS_FIELD_NUMBER: _ClassVar[int]
    LEAD_THROUGH_FIELD_NUMBER: _ClassVar[int]
    CLEAR_FAULT_FIELD_NUMBER: _ClassVar[int]
    TARE_FIELD_NUMBER: _ClassVar[int]
    REFLEX_FIELD_NUMBER: _ClassVar[int]
    OBJECT_POSE_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    lease: int
    acquire: Acquire
    release: Release
    heartbeat: Heartbeat
    arm: Arm
    disarm: Disarm
    stop: Stop
    reset_stop: ResetStop
    targets: Targets
    lead_through: LeadThrough
    clear_fault: ClearFault
    tare: Tare
    reflex: Reflex
    object_pose: ObjectPose
    def __init__(self, sequence: _Optional[int] = ..., lease: _Optional[int] = ..., acquire: _Optional[_Union[Acquire, _Mapping]] = ..., release: _Optional[_Union[Release, _Mapping]] = ..., heartbeat: _Optional[_Union[Heartbeat, _Mapping]] = ..., arm: _Optional[_Union[Arm, _Mapping]] = ..., disarm: _Optional[_Union[Disarm, _Mapping]] = ..., stop: _Optional[_Union[Stop, _Mapping]] = ..., reset_stop: _Optional[_Union[ResetStop, _Mapping]] = ..., targets: _Optional[_Union[Targets, _Mapping]] = ..., lead_through: _Optional[_Union[LeadThrough, _Mapping]] = ..., clear_fault: _Optional[_Union[ClearFault, _Mapping]] = ..., tare: _Optional[_Union[Tare, _Mapping]] = ..., reflex: _Optional[_Union[Reflex, _Mapping]] = ..., object_pose: _Optional[_Union[ObjectPose, _Mapping]] = ...) -> None: ...

class Acquire(_message.Message):
    __slots__ = ("operator", "take_over")
    OPERATOR_FIELD_NUMBER: _ClassVar[int]
    TAKE_OVER_FIELD_NUMBER: _ClassVar[int]
    operator: str
    take_over: bool
    def __init__(self, operator: _Optional[str] = ..., take_over: bool = ...) -> None: ...

class Release(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Heartbeat(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Arm(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Disarm(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Stop(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ResetStop(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class LeadThrough(_message.Message):
    __slots__ = ("on",)
    ON_FIELD_NUMBER: _ClassVar[int]
    on: bool
    def __init__(self, on: bool = ...) -> None: ...

class Tare(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Reflex(_message.Message):
    __slots__ = ("on", "config_toml")
    ON_FIELD_NUMBER: _ClassVar[int]
    CONFIG_TOML_FIELD_NUMBER: _ClassVar[int]
    on: bool
    config_toml: str
    def __init__(self, on: bool = ..., config_toml: _Optional[str] = ...) -> None: ...

class ClearFault(_message.Message):
    __slots__ = ("device",)
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    device: str
    def __init__(self, device: _Optional[str] = ...) -> None: ...

class Targets(_message.Message):
    __slots__ = ("dofs", "positions")
    DOFS_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    dofs: _containers.RepeatedScalarFieldContainer[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, dofs: _Optional[_Iterable[int]] = ..., positions: _Optional[_Iterable[float]] = ...) -> None: ...

class ObjectPose(_message.Message):
    __slots__ = ("position_m", "quaternion_wxyz", "time_s")
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    QUATERNION_WXYZ_FIELD_NUMBER: _ClassVar[int]
    TIME_S_FIELD_NUMBER: _ClassVar[int]
    position_m: _containers.RepeatedScalarFieldContainer[float]
    quaternion_wxyz: _containers.RepeatedScalarFieldContainer[float]
    time_s: float
    def __init__(self, position_m: _Optional[_Iterable[float]] = ..., quaternion_wxyz: _Optional[_Iterable[float]] = ..., time_s: _Optional[float] = ...) -> None: ...

class ControlReply(_message.Message):
    __slots__ = ("sequence", "accepted", "problem", "lease", "stop_confirmed")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    STOP_CONFIRMED_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    accepted: bool
    problem: str
    lease: int
    stop_confirmed: bool
    def __init__(self, sequence: _Optional[int] = ..., accepted: bool = ..., problem: _Optional[str] = ..., lease: _Optional[int] = ..., stop_confirmed: bool = ...) -> None: ...

class ControlState(_message.Message):
    __slots__ = ("phase", "reason", "holder", "lease_left_s", "stop_confirmed", "lead_through", "commanded", "loop_hz", "loop_mean_hz", "loop_worst_hz", "latency_ms", "latency_p95_ms", "devices", "taxels", "recording", "twin", "reflex")
    class Phase(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        PHASE_UNSPECIFIED: _ClassVar[ControlState.Phase]
        DISARMED: _ClassVar[ControlState.Phase]
        ARMING: _ClassVar[ControlState.Phase]
        ARMED: _ClassVar[ControlState.Phase]
        HOLDING: _ClassVar[ControlState.Phase]
        DISARMING: _ClassVar[ControlState.Phase]
        STOPPED: _ClassVar[ControlState.Phase]
    PHASE_UNSPECIFIED: ControlState.Phase
    DISARMED: ControlState.Phase
    ARMING: ControlState.Phase
    ARMED: ControlState.Phase
    HOLDING: ControlState.Phase
    DISARMING: ControlState.Phase
    STOPPED: ControlState.Phase
    PHASE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    HOLDER_FIELD_NUMBER: _ClassVar[int]
    LEASE_LEFT_S_FIELD_NUMBER: _ClassVar[int]
    STOP_CONFIRMED_FIELD_NUMBER: _ClassVar[int]
    LEAD_THROUGH_FIELD_NUMBER: _ClassVar[int]
    COMMANDED_FIELD_NUMBER: _ClassVar[int]
    LOOP_HZ_FIELD_NUMBER: _ClassVar[int]
    LOOP_MEAN_HZ_FIELD_NUMBER: _ClassVar[int]
    LOOP_WORST_HZ_FIELD_NUMBER: _ClassVar[int]
    LATENCY_MS_FIELD_NUMBER: _ClassVar[int]
    LATENCY_P95_MS_FIELD_NUMBER: _ClassVar[int]
    DEVICES_FIELD_NUMBER: _ClassVar[int]
    TAXELS_FIELD_NUMBER: _ClassVar[int]
    RECORDING_FIELD_NUMBER: _ClassVar[int]
    TWIN_FIELD_NUMBER: _ClassVar[int]
    REFLEX_FIELD_NUMBER: _ClassVar[int]
    phase: ControlState.Phase
    reason: str
    holder: str
    lease_left_s: float
    stop_confirmed: bool
    lead_through: bool
    commanded: _containers.RepeatedScalarFieldContainer[float]
    loop_hz: float
    loop_mean_hz: float
    loop_worst_hz: float
    latency_ms: float
    latency_p95_ms: float
    devices: _containers.RepeatedCompositeFieldContainer[DeviceStatus]
    taxels: _containers.RepeatedCompositeFieldContainer[TaxelWarning]
    recording: RecordingStatus
    twin: TwinStatus
    reflex: ReflexStatus
    def __init__(self, phase: _Optional[_Union[ControlState.Phase, str]] = ..., reason: _Optional[str] = ..., holder: _Optional[str] = ..., lease_left_s: _Optional[float] = ..., stop_confirmed: bool = ..., lead_through: bool = ..., commanded: _Optional[_Iterable[float]] = ..., loop_hz: _Optional[float] = ..., loop_mean_hz: _Optional[float] = ..., loop_worst_hz: _Optional[float] = ..., latency_ms: _Optional[float] = ..., latency_p95_ms: _Optional[float] = ..., devices: _Optional[_Iterable[_Union[DeviceStatus, _Mapping]]] = ..., taxels: _Optional[_Iterable[_Union[TaxelWarning, _Mapping]]] = ..., recording: _Optional[_Union[RecordingStatus, _Mapping]] = ..., twin: _Optional[_Union[TwinStatus, _Mapping]] = ..., reflex: _Optional[_Union[ReflexStatus, _Mapping]] = ...) -> None: ...

class ReflexStatus(_message.Message):
    __slots__ = ("digits",)
    DIGITS_FIELD_NUMBER: _ClassVar[int]
    digits: _containers.RepeatedCompositeFieldContainer[DigitReflex]
    def __init__(self, digits: _Optional[_Iterable[_Union[DigitReflex, _Mapping]]] = ...) -> None: ...

class DigitReflex(_message.Message):
    __slots__ = ("digit", "phase", "offset_rad")
    DIGIT_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    OFFSET_RAD_FIELD_NUMBER: _ClassVar[int]
    digit: str
    phase: str
    offset_rad: float
    def __init__(self, digit: _Optional[str] = ..., phase: _Optional[str] = ..., offset_rad: _Optional[float] = ...) -> None: ...

class DeviceStatus(_message.Message):
    __slots__ = ("id", "kind", "link", "problem", "rate_hz", "rate_mean_hz", "rate_worst_hz", "gaps", "bad_frames", "reconnects", "clock_skew_ppm", "motors")
    class Link(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        LINK_UNSPECIFIED: _ClassVar[DeviceStatus.Link]
        CONNECTING: _ClassVar[DeviceStatus.Link]
        READY: _ClassVar[DeviceStatus.Link]
        FAULT: _ClassVar[DeviceStatus.Link]
        LOST: _ClassVar[DeviceStatus.Link]
    LINK_UNSPECIFIED: DeviceStatus.Link
    CONNECTING: DeviceStatus.Link
    READY: DeviceStatus.Link
    FAULT: DeviceStatus.Link
    LOST: DeviceStatus.Link
    ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    RATE_MEAN_HZ_FIELD_NUMBER: _ClassVar[int]
    RATE_WORST_HZ_FIELD_NUMBER: _ClassVar[int]
    GAPS_FIELD_NUMBER: _ClassVar[int]
    BAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    RECONNECTS_FIELD_NUMBER: _ClassVar[int]
    CLOCK_SKEW_PPM_FIELD_NUMBER: _ClassVar[int]
    MOTORS_FIELD_NUMBER: _ClassVar[int]
    id: str
    kind: str
    link: DeviceStatus.Link
    problem: str
    rate_hz: float
    rate_mean_hz: float
    rate_worst_hz: float
    gaps: int
    bad_frames: int
    reconnects: int
    clock_skew_ppm: float
    motors: _containers.RepeatedCompositeFieldContainer[MotorStatus]
    def __init__(self, id: _Optional[str] = ..., kind: _Optional[str] = ..., link: _Optional[_Union[DeviceStatus.Link, str]] = ..., problem: _Optional[str] = ..., rate_hz: _Optional[float] = ..., rate_mean_hz: _Optional[float] = ..., rate_worst_hz: _Optional[float] = ..., gaps: _Optional[int] = ..., bad_frames: _Optional[int] = ..., reconnects: _Optional[int] = ..., clock_skew_ppm: _Optional[float] = ..., motors: _Optional[_Iterable[_Union[MotorStatus, _Mapping]]] = ...) -> None: ...

class MotorStatus(_message.Message):
    __slots__ = ("joint", "temperature_c", "supply_v", "current_a", "problem")
    JOINT_FIELD_NUMBER: _ClassVar[int]
    TEMPERATURE_C_FIELD_NUMBER: _ClassVar[int]
    SUPPLY_V_FIELD_NUMBER: _ClassVar[int]
    CURRENT_A_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    joint: str
    temperature_c: float
    supply_v: float
    current_a: float
    problem: str
    def __init__(self, joint: _Optional[str] = ..., temperature_c: _Optional[float] = ..., supply_v: _Optional[float] = ..., current_a: _Optional[float] = ..., problem: _Optional[str] = ...) -> None: ...

class TaxelWarning(_message.Message):
    __slots__ = ("channel", "kind", "text")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    channel: int
    kind: str
    text: str
    def __init__(self, channel: _Optional[int] = ..., kind: _Optional[str] = ..., text: _Optional[str] = ...) -> None: ...

class RecordingStatus(_message.Message):
    __slots__ = ("revision", "phase", "countdown_s", "fraction", "elapsed_s", "covered", "activity", "lost_samples", "free_bytes")
    REVISION_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    COUNTDOWN_S_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_S_FIELD_NUMBER: _ClassVar[int]
    COVERED_FIELD_NUMBER: _ClassVar[int]
    ACTIVITY_FIELD_NUMBER: _ClassVar[int]
    LOST_SAMPLES_FIELD_NUMBER: _ClassVar[int]
    FREE_BYTES_FIELD_NUMBER: _ClassVar[int]
    revision: int
    phase: str
    countdown_s: float
    fraction: float
    elapsed_s: float
    covered: bytes
    activity: str
    lost_samples: int
    free_bytes: int
    def __init__(self, revision: _Optional[int] = ..., phase: _Optional[str] = ..., countdown_s: _Optional[float] = ..., fraction: _Optional[float] = ..., elapsed_s: _Optional[float] = ..., covered: _Optional[bytes] = ..., activity: _Optional[str] = ..., lost_samples: _Optional[int] = ..., free_bytes: _Optional[int] = ...) -> None: ...

class TwinStatus(_message.Message):
    __slots__ = ("model", "active", "agreement", "time_s", "problem")
    MODEL_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    AGREEMENT_FIELD_NUMBER: _ClassVar[int]
    TIME_S_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    model: str
    active: bytes
    agreement: _containers.RepeatedScalarFieldContainer[float]
    time_s: float
    problem: str
    def __init__(self, model: _Optional[str] = ..., active: _Optional[bytes] = ..., agreement: _Optional[_Iterable[float]] = ..., time_s: _Optional[float] = ..., problem: _Optional[str] = ...) -> None: ...
