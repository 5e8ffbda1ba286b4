"""Messages and documents become what they say; places of taxels are those of the server."""

from __future__ import annotations

import base64
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palpate import PalpateError, Station, documents, to_pandas
from palpate.control_pb2 import ControlState, TwinStatus
from palpate.documents import CalibrationReport, Metrics, MetricsPair, ModelSummary, NamedEffect, ObjectEntry, decode
from palpate.station import Pose, taxels
from palpate.trace_pb2 import LiveFrame, ReplayTrace, SpanTrace, StreamMessage, StreamTrace, TakeTrace
from palpate.traces import frame_of, replay_of, trace_of

STATION = """
id = "finger"
label = "Finger"
robot = "../robots/finger.urdf"
layout = "../layouts/pad.toml"
objects = ["../objects/ball.toml"]
joints = ["slide", "bend"]
[[stream]]
stream = "gel"
on_threshold = 10.0
[[stream]]
stream = "film"
on_threshold = 5.0
"""
# The patch of the second stream comes first in the file.
LAYOUT = """
[[stream]]
id = "gel"
label = "Gel"
[[stream]]
id = "film"
label = "Film"
[[patch]]
id = "back"
label = "Back"
stream = "film"
link = "base"
pose = { position_m = [0.0, 0.0, -0.01], rpy_rad = [3.141592653589793, 0.0, 0.0] }
shape = { kind = "rectangle", length_m = 0.02, width_m = 0.01 }
[[patch]]
id = "pad"
label = "Pad"
stream = "gel"
link = "tip"
pose = { position_m = [0.1, 0.0, 0.0] }
shape = { kind = "arc", radius_m = 0.01, arc_rad = 2.0, length_m = 0.02, dome_rad = 1.0 }
taxels_m = [[-0.005, 0.0], [0.005, 0.003], [0.016, 0.004]]
"""
BALL = 'id = "ball"\nlabel = "Ball"\nshape = { kind = "sphere", radius_m = 0.03 }\n'


@pytest.fixture
def station() -> Station:
    files = {"../layouts/pad.toml": LAYOUT, "../objects/ball.toml": BALL, "../robots/finger.urdf": "<robot/>"}
    encoded = {path: base64.b64encode(text.encode()).decode() for path, text in files.items()}
    return Station({"station_toml": STATION, "files_base64": encoded})


def test_channels_go_by_stream_then_patch_then_taxel(station: Station) -> None:
    assert station.channels == ("pad.0", "pad.1", "pad.2", "back")
    assert station.streams["gel"].channels == range(3)
    assert station.streams["film"].channels == range(3, 4)
    assert [patch.id for patch in station.patches] == ["pad", "back"]
    assert list(station.objects) == ["ball"]


def test_taxels_lie_on_their_surface_with_unit_normals(station: Station) -> None:
    pad, back = station.patches
    axis_end = np.array([0.11, 0.0, -0.01])
    straight, dome = pad.points_m[:2], pad.points_m[2]
    np.testing.assert_allclose(np.hypot(straight[:, 1], straight[:, 2] + 0.01), 0.01, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(dome - axis_end), 0.01, atol=1e-12)
    np.testing.assert_allclose(pad.points_m[:, 0], [0.095, 0.105, 0.116], atol=1e-12)
    np.testing.assert_allclose(pad.normals[2], (dome - axis_end) / 0.01, atol=1e-9)
    np.testing.assert_allclose(back.points_m, [[0.0, 0.0, -0.01]], atol=1e-12)
    np.testing.assert_allclose(back.normals, [[0.0, 0.0, -1.0]], atol=1e-12)
    cap = {"id": "c", "pose": {}, "shape": {"kind": "cap", "radius_m": 0.04}, "taxels_m": [[0.0, 0.0], [0.024, 0.0]]}
    points, normals = taxels(cap)
    np.testing.assert_allclose(points, [[0.0, 0.0, 0.0], [0.024, 0.0, -0.008]], atol=1e-12)
    np.testing.assert_allclose(normals, [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]], atol=1e-12)
    with pytest.raises(PalpateError, match="unknown shape 'spline'"):
        taxels({**cap, "shape": {"kind": "spline"}})


def test_rotations_are_roll_pitch_yaw_about_fixed_axes() -> None:
    roll, pitch, yaw = 0.3, -0.4, 1.1
    c, s = np.cos, np.sin
    about_x = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    about_y = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    about_z = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    matrix = Pose.read({"rpy_rad": [roll, pitch, yaw]}).matrix()
    np.testing.assert_allclose(matrix[:3, :3], about_z @ about_y @ about_x, atol=1e-12)


def take() -> TakeTrace:
    # Frames 0 and 1 of four channels: pad.1 at the first, pad.0 and back at the second; the first bit is the lowest.
    return TakeTrace(
        frame_times_s=[0.0, 0.1],
        joint_positions=[1.0, 2.0, 3.0, 4.0],
        real_active=bytes([0b1001_0010]),
        streams=[
            StreamTrace(
                stream="gel", times_s=[0.02, 0.05, 0.10], raw=list(range(9)), active=bytes([0b0000_1010, 0b0000_0001])
            ),
            StreamTrace(stream="film", times_s=[0.0], raw=[70.0], active=bytes([0])),
        ],
        spans=[SpanTrace(kind="repetition", start_s=0.0, end_s=0.1, label="tap")],
    )


def test_a_take_becomes_arrays(station: Station) -> None:
    trace = trace_of(take().SerializeToString(), station)
    np.testing.assert_array_equal(trace.joint_positions, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(trace.active, [[False, True, False, False], [True, False, False, True]])
    gel = trace.streams["gel"]
    np.testing.assert_array_equal(gel.raw, [[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    np.testing.assert_array_equal(gel.active, [[0, 1, 0], [1, 0, 0], [0, 0, 1]])
    assert trace.spans[0].label == "tap"
    # At the first frame no reading of the gel had come; at the second the newest is that of the same moment.
    np.testing.assert_array_equal(trace.raw_at_frames(), [[0, 0, 0, 70], [6, 7, 8, 70]])
    table = trace.to_pandas()
    assert list(table.columns) == ["slide", "bend", "pad.0", "pad.1", "pad.2", "back"]
    assert table["bend"].tolist() == [2.0, 4.0]
    assert table["pad.1"].tolist() == [True, False]
    assert gel.to_pandas().index.name == "time_s"


def test_a_take_without_readings_has_none(station: Station) -> None:
    message = take()
    for stream in message.streams:
        del stream.raw[:]
    trace = trace_of(message.SerializeToString(), station)
    assert trace.streams["gel"].raw is None
    assert trace.raw_at_frames() is None


def test_an_object_moves_where_a_take_says_so(station: Station) -> None:
    assert trace_of(take().SerializeToString(), station).object_poses is None
    message = take()
    message.object_poses.extend([0.1, 0.2, 0.3, 1, 0, 0, 0, 0.4, 0.2, 0.3, 0, 1, 0, 0])
    poses = trace_of(message.SerializeToString(), station).object_poses
    assert poses is not None
    np.testing.assert_allclose(poses, [[0.1, 0.2, 0.3, 1, 0, 0, 0], [0.4, 0.2, 0.3, 0, 1, 0, 0]], atol=1e-7)
    message.object_poses.pop()
    with pytest.raises(PalpateError, match="13 numbers came, expected 2 x 7"):
        trace_of(message.SerializeToString(), station)


def test_axes_become_one_array() -> None:
    layout = LAYOUT.replace('label = "Gel"', 'label = "Gel"\naxes = 3\nreading = "norm"', 1)
    files = {"../layouts/pad.toml": layout, "../objects/ball.toml": BALL, "../robots/finger.urdf": "<robot/>"}
    encoded = {path: base64.b64encode(text.encode()).decode() for path, text in files.items()}
    station = Station({"station_toml": STATION, "files_base64": encoded})
    assert [station.streams[stream].axes for stream in ("gel", "film")] == [3, 1]
    message = take()
    message.streams[0].axes.extend(range(27))
    streams = trace_of(message.SerializeToString(), station).streams
    assert streams["film"].axes is None
    axes = streams["gel"].axes
    assert axes is not None
    assert axes.shape == (3, 3, 3)
    np.testing.assert_array_equal(axes[1, 2], [15, 16, 17])
    message.streams[0].axes.pop()
    with pytest.raises(PalpateError, match="26 numbers came, expected 3 x 9"):
        trace_of(message.SerializeToString(), station)


def test_a_damaged_take_is_refused(station: Station) -> None:
    faults: list[tuple[Callable[[TakeTrace], object], str]] = [
        (lambda message: message.joint_positions.pop(), "3 numbers came, expected 2 x 2"),
        (lambda message: setattr(message, "real_active", b""), r"0 activations came, expected 8"),
        (lambda message: setattr(message.streams[0], "stream", "foil"), "a stream 'foil' that its station lacks"),
    ]
    for spoil, complaint in faults:
        message = take()
        spoil(message)
        with pytest.raises(PalpateError, match=complaint):
            trace_of(message.SerializeToString(), station)
    with pytest.raises(PalpateError, match=r"3 bytes are no palpate\.TakeTrace"):
        trace_of(b"\xff\xff\xff", station)


def test_a_replay_becomes_arrays(station: Station) -> None:
    message = ReplayTrace(
        model="m", active=bytes([0b0001_1000]), raw=[float(x) for x in range(8)], thresholds=[1, 1, 1, 0]
    )
    replay = replay_of(message.SerializeToString(), station, np.array([0.0, 0.1]))
    np.testing.assert_array_equal(replay.active, [[0, 0, 0, 1], [1, 0, 0, 0]])
    assert replay.raw.shape == (2, 4)
    assert replay.to_pandas()["pad.0"].tolist() == [False, True]


def test_a_live_frame_becomes_arrays(station: Station) -> None:
    control = ControlState(phase=ControlState.ARMED, holder="Ada", twin=TwinStatus(active=bytes([0b10])))
    live = LiveFrame(time_s=3.0, joint_positions=[0.5, 0.25], active=bytes([0b1001]), control=control)
    frame = frame_of(StreamMessage(live=live, dropped=4), station)
    assert (frame.phase, frame.holder, frame.dropped) == ("armed", "Ada", 4)
    assert frame.felt() == ["pad.0", "back"]
    assert frame.position("bend") == 0.25
    assert frame.expected is not None
    assert frame.expected.tolist() == [False, True, False, False]
    idle = frame_of(StreamMessage(live=LiveFrame()), station)
    assert (idle.phase, idle.expected, idle.felt()) == ("disarmed", None, [])
    assert np.isnan(idle.position("bend"))


def effect() -> dict[str, Any]:
    return {
        "id": "latency",
        "where": {"stream": "fsr"},
        "parameters": {"delay_s": 1},
        "interval": {"delay_s": [0.9, 1.1]},
        "gap_before": 2,
        "gap_after": 1,
        "p_value": 0.0,
        "evidence": 50,
        "takes_improved": "8/9",
        "class": ["latency", "low_pass"],
        "rivals": [{"id": "low_pass", "where": {"stream": "fsr"}, "gap_after": 1.5}],
        "explanation": "it is late",
        "of_a_later_version": True,
    }


def test_documents_are_dataclasses_all_the_way_down() -> None:
    named = decode(NamedEffect, effect())
    assert named.class_ == ["latency", "low_pass"]
    assert named.rivals[0].gap_after == 1.5
    assert isinstance(named.gap_before, float)
    with pytest.raises(dataclasses.FrozenInstanceError):
        named.id = "other"  # type: ignore[misc]
    theta = {"lambda_con_m": 0, "alpha_per_m": 1, "lambda_pre_pa": 2}
    older = decode(ModelSummary, {"id": "a", "name": "A", "theta": theta, "provenance": []})
    assert older.effects == []
    assert decode(CalibrationReport, None) is None


def test_an_object_is_a_document_or_says_why_not() -> None:
    broken = decode(ObjectEntry, {"id": "x", "own": True, "content": {"Err": "line 3"}, "takes": []})
    assert broken.document is None
    assert broken.content["Err"] == "line 3"


def test_documents_become_a_table() -> None:
    pair = MetricsPair(Metrics(f1=0.5), Metrics(f1=0.75))
    table = to_pandas({"pad.0": pair, "pad.1": pair})
    assert list(table.index) == ["pad.0", "pad.1"]
    assert table.loc["pad.1", "calibrated.f1"] == 0.75
    assert len(to_pandas([pair, pair])) == 2


def test_every_document_is_a_dataclass_that_cannot_change() -> None:
    kinds = [kind for kind in vars(documents).values() if dataclasses.is_dataclass(kind)]
    assert len(kinds) > 40
    assert all(kind.__dataclass_params__.frozen for kind in kinds)  # type: ignore[union-attr]
