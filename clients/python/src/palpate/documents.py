"""JSON documents of the API as dataclasses. Field names are those of the server, whose documentation says more."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from dataclasses import dataclass, field
from typing import Any, TypeVar

from palpate.errors import PalpateError

T = TypeVar("T")


def decode(kind: type[T], value: object) -> T:
    """`value`, as JSON gives it, as a `kind`: a dataclass, a container of them, or what JSON knows itself.

    Unknown fields are left out, so that an older client reads a newer studio.
    """
    try:
        return typing.cast(T, _decode(kind, value))
    except (TypeError, AttributeError, ValueError) as error:
        raise PalpateError("Unexpected answer", f"no {kind}: {error}; are studio and client of one version?") from error


def _decode(kind: Any, value: Any) -> Any:  # noqa: ANN401
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if value is None or kind is Any:
        return value
    if origin in (types.UnionType, typing.Union):
        return _decode(next(option for option in arguments if option is not type(None)), value)
    if origin is list:
        return [_decode(arguments[0], item) for item in value]
    if origin is tuple:
        return tuple(_decode(arguments[0], item) for item in value)
    if origin is dict:
        return {key: _decode(arguments[1], item) for key, item in value.items()}
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        known = _fields(kind)
        return kind(**{name: _decode(hint, value[key]) for name, (key, hint) in known.items() if key in value})
    return float(value) if kind is float else value


@functools.cache
def _fields(kind: Any) -> dict[str, tuple[str, object]]:  # noqa: ANN401
    """Key in JSON and type of each field. A name that Python keeps for itself has an underscore at its end."""
    hints = typing.get_type_hints(kind)
    return {item.name: (item.name.rstrip("_"), hints[item.name]) for item in dataclasses.fields(kind)}


@dataclass(frozen=True)
class Info:
    """What a studio says of itself. `source` is `real`, `emulated` or `replay`."""

    name: str
    version: str
    station: str | None
    source: str
    insecure: bool = False


@dataclass(frozen=True)
class SessionSummary:
    """An entry in the list of sessions. `error` says why one cannot be opened."""

    id: str
    station: str
    takes: int
    frames: int
    duration_s: float
    objects: list[str]
    recorded: str
    error: str | None = None


@dataclass(frozen=True)
class TakeSummary:
    """One take. `object_pose` is x, y, z in m, then w, x, y, z, in the robot's base frame."""

    id: str
    object: str
    object_pose: list[float]
    primitive: str
    frames: int
    duration_s: float
    accepted: bool
    has_raw: bool


@dataclass(frozen=True)
class SessionDetail:
    """A session with its takes."""

    summary: SessionSummary
    takes: list[TakeSummary]


@dataclass(frozen=True)
class StreamCheck:
    """Rates (Hz) and gaps (s) of one stream in one take."""

    stream: str
    samples: int
    rate_hz: float
    nominal_rate_hz: float
    longest_gap_s: float
    gaps: int
    clock_steps_back: int


@dataclass(frozen=True)
class TakeCheck:
    """The streams of one take."""

    id: str
    streams: list[StreamCheck]


@dataclass(frozen=True)
class ChannelCoverage:
    """How often a channel was touched."""

    channel: str
    touches: int
    touches_by_half: list[int]
    active_s: float


@dataclass(frozen=True)
class Problem:
    """Something wrong with a session. `severity` is `error`, `warning` or `info`."""

    severity: str
    place: str
    message: str


@dataclass(frozen=True)
class CheckReport:
    """Whether a session can be used, and what is wrong with it."""

    session: str
    ok: bool
    frames: int
    duration_s: float
    takes: list[TakeCheck]
    coverage: list[ChannelCoverage]
    problems: list[Problem]


@dataclass(frozen=True)
class ThetaReport:
    """The three parameters of a sensor model: m, 1/m, Pa."""

    lambda_con_m: float
    alpha_per_m: float
    lambda_pre_pa: float


@dataclass(frozen=True)
class StreamThetaReport:
    """The parameters that a stream has of its own: m for proximity streams, 1/m and Pa for pressure streams."""

    lambda_con_m: float | None = None
    alpha_per_m: float | None = None
    lambda_pre_pa: float | None = None


@dataclass(frozen=True)
class ModelEffect:
    """An effect of a model. `where` has one key that says what it is: `{"stream": "fsr"}`."""

    id: str
    where: dict[str, Any]
    parameters: dict[str, float]


@dataclass(frozen=True)
class ModelSummary:
    """A saved sensor model."""

    id: str
    name: str
    theta: ThetaReport
    provenance: list[str]
    streams: dict[str, StreamThetaReport] = field(default_factory=dict)
    effects: list[ModelEffect] = field(default_factory=list)
    earlier_versions: int = 0


@dataclass(frozen=True)
class TrashEntry:
    """Something that was deleted and can be taken out of the trash again.

    `sort` is `session` or `model`; `deleted` is when, RFC 3339.
    """

    sort: str
    id: str
    deleted: str


@dataclass(frozen=True)
class DocSummary:
    """A document of the manual. `title` is its first heading, `sentence` the first one below it."""

    name: str
    title: str
    sentence: str


@dataclass(frozen=True)
class Metrics:
    """How well simulated events match real ones; None where there is nothing to average over."""

    onset_error_ms: float | None = None
    offset_error_ms: float | None = None
    f1: float | None = None
    fpr: float | None = None
    l1: int = 0
    onset_coverage: float | None = None
    real_contacts: int = 0
    simulated_contacts: int = 0


@dataclass(frozen=True)
class MetricsPair:
    """Both models on the same data."""

    nominal: Metrics
    calibrated: Metrics


@dataclass(frozen=True)
class HeldOut:
    """Both models on takes that the fit has not seen."""

    nominal: Metrics
    calibrated: Metrics


@dataclass(frozen=True)
class TakeMetrics:
    """Both models on one take."""

    nominal: Metrics
    calibrated: Metrics
    held_out: bool


@dataclass(frozen=True)
class MetricIntervals:
    """`[low, high]` of each metric."""

    onset_error_ms: list[float] | None = None
    offset_error_ms: list[float] | None = None
    f1: list[float] | None = None
    fpr: list[float] | None = None


@dataclass(frozen=True)
class Intervals:
    """95 % intervals of the metrics and of their change, from resampling takes."""

    nominal: MetricIntervals
    calibrated: MetricIntervals
    change: MetricIntervals
    resamples: int
    seed: int


@dataclass(frozen=True)
class Objective:
    """The objective around the optimum: heat map over alpha (1/m) and lambda_pre (Pa), curve over lambda_con (m)."""

    alphas_per_m: list[float]
    lambda_pres_pa: list[float]
    pressure_l1: list[list[int]]
    lambda_cons_m: list[float]
    proximity_l1: list[int]


@dataclass(frozen=True)
class StreamFit:
    """The search for the parameters of one stream."""

    theta: StreamThetaReport
    nominal_theta: StreamThetaReport
    objective: Objective


@dataclass(frozen=True)
class CalibrationReport:
    """The result of a calibration."""

    nominal: Metrics
    calibrated: Metrics
    held_out: HeldOut
    theta: ThetaReport
    nominal_theta: ThetaReport
    frames: int
    channels: int
    evaluations: int
    seconds: float
    method: str
    by_modality: dict[str, MetricsPair]
    by_take: dict[str, TakeMetrics]
    by_channel: dict[str, MetricsPair]
    intervals_95: Intervals | None
    objective: Objective
    held_out_takes: list[str]
    streams: dict[str, StreamFit] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Rival:
    """An effect that explains the data nearly as well as the one that was named."""

    id: str
    where: dict[str, Any]
    gap_after: float


@dataclass(frozen=True)
class NamedEffect:
    """An effect that a diagnosis named. `class_` lists what the data cannot tell apart from it."""

    id: str
    where: dict[str, Any]
    parameters: dict[str, float]
    interval: dict[str, list[float]]
    gap_before: float
    gap_after: float
    evidence: float
    takes_improved: str
    class_: list[str]
    rivals: list[Rival]
    explanation: str
    p_value: float | None = None


@dataclass(frozen=True)
class Doubt:
    """A measure that speaks against an effect: it is above its limit."""

    check: str
    measured: float
    limit: float


@dataclass(frozen=True)
class EffectInDoubt:
    """An effect that was identified and not added."""

    id: str
    where: dict[str, Any]
    parameters: dict[str, float]
    doubt: list[Doubt]


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried and not named."""

    id: str
    where: dict[str, Any]
    parameters: dict[str, float]
    evidence: float
    share_removed: float
    explanation: str


@dataclass(frozen=True)
class Cell:
    """A part of the data in which simulation and measurement disagree."""

    stream: str | None
    channels: list[str]
    joints: list[str]
    phase: str
    takes: list[str]
    excess: float
    effect_size: float
    p_value: float


@dataclass(frozen=True)
class Gap:
    """Mean L1 mismatch a channel-second of several models on the same data."""

    nominal: float
    calibrated: float
    diagnosed: float
    noise_floor: float | None = None


@dataclass(frozen=True)
class WaterfallStep:
    """The gap after one more effect, with its 95 % interval."""

    step: str
    gap: float
    interval_95: list[float] | None = None


@dataclass(frozen=True)
class TooMuchLeft:
    """A measure of what is left after naming that is above its limit."""

    check: str
    measured: float
    limit: float
    sentence: str
    where: dict[str, Any] | None = None


@dataclass(frozen=True)
class Unexplained:
    """What no named effect accounts for."""

    fraction: float
    significant: bool
    where: list[Cell]
    because: list[TooMuchLeft] = field(default_factory=list)
    touch_to_touch: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class NextExperiment:
    """What to record next: to ``separate`` effects, to ``repeat`` a motion, or to ``show_more`` of what has no name."""

    primitive: str
    object: str
    separates: list[str]
    expected_gain: float
    sentence: str
    purpose: str = "separate"


@dataclass(frozen=True)
class ChannelResidual:
    """Mismatch of one channel by phase: L1 a second."""

    channel: str
    calibrated: dict[str, float]
    diagnosed: dict[str, float]


@dataclass(frozen=True)
class Bar:
    """The evidence that an effect must reach to be named."""

    evidence: float
    null_sessions: int
    null_maxima: list[float]


@dataclass(frozen=True)
class DiagnosisReport:
    """The result of a diagnosis.

    `verdict`: `explained`, `partly_explained`, `unexplained`, `no_discrepancy` or `cannot_be_judged`. `gap` and
    `held_out` are of the takes that were kept for judging, `fitted` is of the others. `reference_sessions` is how many
    sessions set the limits; None if the shipped ones apply.
    """

    verdict: str
    sentence: str
    effects: list[NamedEffect]
    in_doubt: list[EffectInDoubt]
    candidates: list[Candidate]
    where: list[Cell]
    gap: Gap
    held_out: Gap
    fitted: Gap
    waterfall: list[WaterfallStep]
    metrics: dict[str, Metrics]
    unexplained: Unexplained
    next_experiment: NextExperiment | None
    residual_map: list[ChannelResidual]
    takes: dict[str, list[str]]
    bar: Bar
    notes: list[str]
    seconds: float
    reference_sessions: int | None = None


@dataclass(frozen=True)
class Resources:
    """What a job needs of the machine. 0 cores are all of them; a `short` job does not wait for long ones.

    Work that is divided into `shards` has `at_once` of them at work at most (0: as many as there is room for).
    """

    cores: int = 0
    gpu: bool = False
    station: bool = False
    memory_mib: int | None = None
    short: bool = False
    shards: int = 0
    at_once: int = 0


@dataclass(frozen=True)
class JobSpec:
    """Everything that a job's result depends on; `inputs` are SHA-256 by path in the data folder."""

    kind: str
    request: Any
    software: str
    inputs: dict[str, str] = field(default_factory=dict)
    seed: int = 0
    priority: int = 0
    resources: Resources = field(default_factory=Resources)


@dataclass(frozen=True)
class Job:
    """Where a job stands, without its outcome. Times are RFC 3339."""

    id: str
    kind: str
    state: str
    created: str
    started: str | None
    ended: str | None
    attempts: int
    owner: str
    runner: str
    fraction: float
    stage: str
    seconds_left: float | None
    problem: str | None
    saved_as: str | None
    spec: JobSpec
    cancel_requested: bool = False


@dataclass(frozen=True)
class JobPage:
    """A page of the list of jobs, newest first; `next_cursor` leads to the next one."""

    jobs: list[Job]
    next_cursor: str | None = None


@dataclass(frozen=True)
class JobKindDocument:
    """A kind of job, and whether the studio can do it; `problem` says why not."""

    kind: str
    resources: dict[str, Any]
    is_available: bool
    problem: str | None


@dataclass(frozen=True)
class RestPoseDocument:
    """A stable pose of an object on a table, up to place and yaw."""

    quaternion_wxyz: list[float]
    origin_height_m: float
    com_height_m: float
    weight: float
    barrier_m: float | None = None


@dataclass(frozen=True)
class ObjectDocument:
    """An object that can be used; meshes that its file names are base64."""

    label: str
    group: str | None
    size_m: list[float]
    volume_m3: float
    mass_kg: float | None
    com_m: list[float]
    rest_poses: list[RestPoseDocument]
    object_toml: str
    meshes_base64: dict[str, str]


@dataclass(frozen=True)
class ObjectTake:
    """A take that touched an object."""

    session: str
    take: str


@dataclass(frozen=True)
class ObjectEntry:
    """An object. `content` is what it is under the key `Ok`, or why it cannot be used under `Err`."""

    id: str
    own: bool
    content: dict[str, Any]
    takes: list[ObjectTake]

    @property
    def document(self) -> ObjectDocument | None:
        """What the object is; None for one that cannot be used."""
        return decode(ObjectDocument, self.content["Ok"]) if "Ok" in self.content else None


@dataclass(frozen=True)
class LiveDevice:
    """A device of a live station. `rate_hz`: over the last second, mean, and of the worst second."""

    id: str
    link: str
    problem: str
    rate_hz: list[float]
    gaps: int
    bad_frames: int
    reconnects: int


@dataclass(frozen=True)
class LiveDocument:
    """The newest state of the live station: joints in rad or m, rates in Hz, latency in ms."""

    time_s: float
    joints: dict[str, float]
    commanded: dict[str, float]
    active: list[str]
    phase: str
    reason: str
    holder: str
    stop_confirmed: bool
    loop_hz: list[float]
    latency_ms: list[float]
    devices: list[LiveDevice]


@dataclass(frozen=True)
class PlanSummary:
    """A plan that the live station has."""

    id: str
    label: str
    takes: int
    duration_s: float


@dataclass(frozen=True)
class WantedTake:
    """A take to record besides those of a plan."""

    object: str
    primitive: str
    because: str = ""


@dataclass(frozen=True)
class TakeVerdict:
    """The automatic quality check of a take."""

    good: bool
    summary: str
    problems: list[str]
    covered: list[str]
    missed: list[str]
    rates_hz: list[list[Any]]


@dataclass(frozen=True)
class RecordingStep:
    """One take of the checklist. `state` is `open`, `review` or `accepted`."""

    object: str
    object_label: str
    primitive: str
    primitive_label: str
    instruction: str
    touches: list[str]
    duration_s: float
    state: str
    take: str | None
    verdict: TakeVerdict | None
    added_because: str | None = None
    object_pose: list[float] = field(default_factory=list)
    start: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class RecordingSession:
    """A session that is being recorded; `phase` says what the step under way waits for."""

    session: str
    plan: str
    operator: str
    steps: list[RecordingStep]
    current: int | None
    phase: str
    problem: str
    untouched: list[str]
    can_undo: bool


@dataclass(frozen=True)
class FreeTake:
    """A take outside guided sessions. `state` is `recording`, `checking`, `accepted`, `set_aside` or `lost`."""

    session: str
    take: str | None
    object: str
    primitive: str
    state: str
    problem: str
    verdict: TakeVerdict | None


@dataclass(frozen=True)
class RecordingDocument:
    """Plans, the session under way if there is one, and the newest take outside guided sessions."""

    revision: int
    plans: list[PlanSummary]
    session: RecordingSession | None
    wanted: list[WantedTake] = field(default_factory=list)
    free: FreeTake | None = None
