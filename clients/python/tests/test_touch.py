"""The sensor model as a library feels what `palpate replay` does, and refuses what cannot be felt."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from takes import MODELS, STATION, RecordedTake

from palpate import PalpateError
from palpate.touch import LIBRARY_VARIABLE, Touch

HOME = np.zeros(22)
AWAY = np.array([0.0, 0.0, 9.0, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def touch(touch_library: Path) -> Touch:
    return Touch(STATION, "sphere_50mm", envs=3, library=touch_library)


@pytest.mark.parametrize("model", MODELS)
def test_readings_have_the_bits_of_a_replay(
    model: str, demo_replays: dict[str, list[RecordedTake]], touch_library: Path
) -> None:
    events = 0
    for take in demo_replays[model]:
        touch = Touch(STATION, take.object, MODELS[model], envs=2, library=touch_library)
        whole = touch.replay(take.times_s, take.positions, take.pose)
        # Takes hold readings in single precision.
        assert whole.raw.astype(np.float32).tobytes() == take.raw.tobytes()
        assert np.array_equal(whole.active, take.active)
        # Frame by frame, in one environment from the start and in one that begins again on the way.
        again = len(take.times_s) // 3
        for frame, (time_s, positions) in enumerate(zip(take.times_s, take.positions, strict=True)):
            later = frame - again
            if later == 0:
                touch.restart(np.array([False, True]))
            second = frame if later < 0 else later
            readings = touch.step(
                [time_s, take.times_s[second]], np.stack([positions, take.positions[second]]), take.pose
            )
            for env, known in [(0, frame), (1, second)]:
                assert readings.raw[env].tobytes() == whole.raw[known].tobytes(), (model, frame, env)
                assert np.array_equal(readings.active[env], whole.active[known]), (model, frame, env)
        events += int(np.count_nonzero(np.diff(whole.active, axis=0)))
    assert events > 500, "the session is full of touches"


def test_a_scene_says_what_it_is_made_of(touch: Touch, touch_library: Path) -> None:
    assert (touch.station, touch.object, touch.envs) == ("xarm6-leap", "sphere_50mm", 3)
    assert touch.joints[:2] == ("joint1", "joint2")
    assert len(touch.joints) == len(HOME)
    assert [(stream.id, stream.kind) for stream in touch.streams] == [("twintac", "pressure"), ("fsr", "proximity")]
    columns = range(len(touch.channels))
    assert [column for stream in touch.streams for column in columns[stream.channels]] == list(columns)
    assert touch.thresholds[touch.streams[0].channels] == pytest.approx(28000.0)
    assert (touch.effects, touch.looks_ahead) == ((), ())
    diagnosed = Touch(STATION, "sphere_50mm", MODELS["diagnosed"], library=touch_library)
    assert sorted(set(diagnosed.effects)) == [
        "latency",
        "sensitivity_spread",
        "sensor_mount_offset",
        "viscoelastic_release",
    ]
    numbers = touch.numbers()
    assert len(numbers["patches"]) > 10
    assert numbers["names"]["channels"] == list(touch.channels)


def test_one_row_stands_for_all_environments(touch: Touch) -> None:
    readings = touch.step(0.0, HOME, AWAY)
    assert readings.raw.shape == readings.active.shape == (3, len(touch.channels))
    assert readings.active.dtype == np.bool_
    assert not readings.active.any()
    again = touch.step(0.1, [HOME] * 3, np.array([AWAY] * 3, dtype=np.float32))
    assert np.array_equal(again.raw, readings.raw)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ((0.0, np.zeros(21), AWAY), r"joint_positions has shape \(21,\), expected \(3, 22\)"),
        ((0.0, np.zeros((2, 22)), AWAY), r"joint_positions has shape \(2, 22\), expected \(3, 22\)"),
        ((0.0, HOME, AWAY[:6]), r"object_pose has shape \(6,\), expected \(3, 7\)"),
        (([0.0, 1.0], HOME, AWAY), r"time_s has shape \(2,\), expected \(3,\)"),
        (
            (0.0, np.where(np.arange(22) == 8, math.nan, 0.0), AWAY),
            'environment 0: position of joint "index_pip" is NaN',
        ),
        ((math.inf, HOME, AWAY), "environment 0: time is inf s"),
        ((0.0, HOME, AWAY * 0.0), "environment 0: .*quaternion of norm 0, expected 1"),
        ((0.0, HOME, [AWAY, AWAY, np.full(7, math.inf)]), "environment 2: pose .* must be finite"),
        ((0.0, "home", AWAY), "joint_positions must be numbers"),
    ],
)
def test_what_cannot_be_felt_is_refused(touch: Touch, step: tuple[Any, Any, Any], words: str) -> None:
    with pytest.raises(PalpateError, match=words):
        touch.step(*step)
    touch.step(0.0, HOME, AWAY)
    with pytest.raises(PalpateError, match="0 s after 0 s, expected finite times that increase until a restart"):
        touch.step(0.0, HOME, AWAY)
    touch.restart()
    touch.step(0.0, HOME, AWAY)


@pytest.mark.parametrize(
    ("take", "words"),
    [
        (([[0.0]], [HOME], AWAY), r"times_s has shape \(1, 1\)"),
        (([0.0, 0.1], [HOME], AWAY), r"joint_positions has shape \(1, 22\), expected \(2, 22\)"),
        (([0.1, 0.1], [HOME, HOME], AWAY), "frame 1: time is 0.1 s after 0.1 s"),
        (([0.0, 0.1], [HOME, HOME * math.nan], AWAY), "frame 1: .*joint1"),
        (([0.0], [HOME], AWAY[1:]), "object_pose has shape"),
    ],
)
def test_takes_that_cannot_be_replayed_are_refused(touch: Touch, take: tuple[Any, Any, Any], words: str) -> None:
    with pytest.raises(PalpateError, match=words):
        touch.replay(*take)
    assert touch.replay([], np.zeros((0, 22)), AWAY).raw.shape == (0, len(touch.channels))


@pytest.mark.parametrize("mask", [[1, 0, 1], [True, False], [[True, False, True]]])
def test_restarts_want_a_mask(touch: Touch, mask: Any) -> None:  # noqa: ANN401
    with pytest.raises(PalpateError, match="expected a mask of 3 bools"):
        touch.restart(mask)


def test_files_that_are_not_there_or_do_not_fit_are_named(touch_library: Path, tmp_path: Path) -> None:
    def problem(station: str | Path, object: str, model: Path | None = None) -> str:
        with pytest.raises(PalpateError) as caught:
            Touch(station, object, model, library=touch_library)
        return str(caught.value)

    assert "'xarm9' is no file" in problem("xarm9", "sphere_50mm")
    assert "sphere_50mm" in problem(STATION, "teapot")
    assert "teapot.toml" in problem(STATION, "sphere_50mm", tmp_path / "teapot.toml")
    model = tmp_path / "model.toml"
    model.write_text("format = 1\nname = 3\n")
    assert "model.toml: line 2" in problem(STATION, "sphere_50mm", model)
    model.write_text(MODELS["diagnosed"].read_text().replace('"latency"', '"lateness"'))
    assert 'no effect "lateness"' in problem(STATION, "sphere_50mm", model)
    station = tmp_path / "station.toml"
    station.write_text("id = 'bare'")
    assert "station.toml" in problem(station, "sphere_50mm")


def test_numbers_of_environments_and_threads_are_looked_at(touch_library: Path) -> None:
    with pytest.raises(PalpateError, match="envs is 0"):
        Touch(STATION, "sphere_50mm", envs=0, library=touch_library)
    with pytest.raises(PalpateError, match="threads is 0"):
        Touch(STATION, "sphere_50mm", threads=0, library=touch_library)
    with pytest.raises(PalpateError, match="a fixed body"):
        Touch(STATION, "sphere_50mm", fixed=[("sphere_50mm", [0.0])], library=touch_library)


def test_what_stands_still_is_felt(touch_library: Path) -> None:
    beside = Touch(
        STATION, "sphere_50mm", fixed=[("sphere_50mm", [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])], library=touch_library
    )
    alone = Touch(STATION, "sphere_50mm", library=touch_library)
    at_origin = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert np.array_equal(beside.step(0.0, HOME, AWAY).raw, alone.step(0.0, HOME, at_origin).raw)
    with pytest.raises(PalpateError, match="fixed bodies"):
        beside.replay([0.0], [HOME], AWAY)


def test_a_closed_one_says_so(touch: Touch) -> None:
    with touch:
        touch.step(0.0, HOME, AWAY)
    with pytest.raises(PalpateError, match="was closed"):
        touch.step(1.0, HOME, AWAY)
    with pytest.raises(PalpateError, match="was closed"):
        touch.numbers()
    touch.close()


def test_a_library_that_is_missing_or_another_is_explained(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    nothing = tmp_path / "libpalpate_touch.so"
    monkeypatch.setenv(LIBRARY_VARIABLE, str(nothing))
    with pytest.raises(PalpateError, match=r"no .*libpalpate_touch.so.*cargo build --release -p palpate_touch"):
        Touch(STATION, "sphere_50mm")
    monkeypatch.delenv(LIBRARY_VARIABLE)
    with pytest.raises(PalpateError, match="beside the module"):
        Touch(STATION, "sphere_50mm")
    nothing.write_text("no library")
    with pytest.raises(PalpateError, match="is no library of palpate touch"):
        Touch(STATION, "sphere_50mm", library=nothing)


def test_the_client_does_not_need_the_library() -> None:
    program = "import palpate, sys; sys.exit('palpate.touch' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
