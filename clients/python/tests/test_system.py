"""The client on a live emulated station."""

from __future__ import annotations

import itertools
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Studio, arm_and_move, until

from palpate import Palpate, PalpateError, to_pandas

JOINT = "index_mcp_forward"


def test_the_studio_says_what_it_is(p: Palpate) -> None:
    info = p.info()
    assert info.source == "emulated"
    assert "xarm6-leap" in p.stations()
    station = p.station()
    assert len(station.channels) == sum(len(patch.channels) for patch in station.patches)
    assert {entry.id for entry in p.objects() if entry.document is not None} >= set(station.objects)


def test_a_session_is_listed_checked_deleted_and_restored(p: Palpate) -> None:
    assert [session.id for session in p.sessions() if session.id == "small"] == ["small"]
    session = p.session("small")
    assert session.check().ok
    session.delete()
    with pytest.raises(PalpateError) as caught:
        p.session("small")
    assert caught.value.status == 404
    assert ("session", "small") in [(entry.sort, entry.id) for entry in p.trash()]
    assert p.restore_session("small").summary == session.summary
    assert "small" not in [entry.id for entry in p.trash()]
    with pytest.raises(PalpateError, match="has no take 'take-99'; it has"):
        session.take("take-99")


def test_the_manual_can_be_read(p: Palpate) -> None:
    docs = {doc.name: doc for doc in p.docs()}
    assert docs["learning"].title == "Learning"
    assert docs["learning"].sentence
    assert p.doc("learning").startswith("# Learning\n")
    with pytest.raises(PalpateError, match=r'no document "nothing"; there are api'):
        p.doc("nothing")


def test_folders_and_zips_are_uploaded(p: Palpate, recorded: Path, tmp_path: Path) -> None:
    copy = p.upload(recorded, "copy")
    assert copy.summary.takes == len(list(recorded.glob("take-*.mcap")))
    archive = shutil.make_archive(str(tmp_path / "zipped"), "zip", recorded)
    zipped = p.upload(archive)
    assert zipped.id == "zipped"
    with pytest.raises(PalpateError) as caught:
        p.upload(recorded, "copy")
    assert caught.value.status == 409
    (tmp_path / "junk.zip").write_bytes(b"no zip at all")
    with pytest.raises(PalpateError) as caught:
        p.upload(tmp_path / "junk.zip")
    assert caught.value.status == 422
    zipped.delete()
    copy.delete()


def test_a_session_is_taken_away_and_brought_back(p: Palpate, recorded: Path, tmp_path: Path) -> None:
    session = p.session("small")
    archive = session.download(tmp_path)
    assert archive == tmp_path / "small.zip"
    back = p.upload(archive, "back")
    assert back.summary.frames == session.summary.frames
    back.delete()
    take = session.takes[0].download(tmp_path / "first.mcap")
    assert take.read_bytes() == (recorded / f"{session.takes[0].id}.mcap").read_bytes()
    with pytest.raises(PalpateError) as caught:
        p.connection.download("GET", "/sessions/{session}/session.zip", tmp_path / "none.zip", session="nope")
    assert caught.value.status == 404
    with pytest.raises(PalpateError, match="failed to write"):
        session.download(tmp_path / "no folder" / "small.zip")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first.mcap", "small.zip"]


def test_a_take_is_arrays_and_a_replay_fits_to_it(p: Palpate) -> None:
    take = p.session("small").takes[0]
    trace = take.trace()
    assert trace.joint_positions.shape == (take.summary.frames, len(trace.joints))
    assert trace.active.shape == (take.summary.frames, len(trace.channels))
    assert trace.active.any()
    assert abs(trace.times_s[-1] - take.summary.duration_s) < 0.2
    assert set(trace.streams) == set(p.session("small").station().streams)
    stream = next(stream for stream in trace.streams.values() if stream.active.any())
    raw = trace.raw_at_frames()
    assert stream.raw is not None
    assert raw is not None
    # What is felt reads higher than what is not.
    assert stream.raw[stream.active].mean() > stream.raw[~stream.active].mean() + 50
    assert raw[trace.active].mean() > raw[~trace.active].mean() + 50
    replay = take.replay("nominal")
    assert replay.active.shape == trace.active.shape
    # Pressure counts as touch above its threshold, closeness below: either way `raw` explains `active`.
    above, below = replay.raw > replay.thresholds, replay.raw < replay.thresholds
    for channel in range(len(trace.channels)):
        felt = replay.active[:, channel]
        assert (above[:, channel] == felt).all() or (below[:, channel] == felt).all()
    assert trace.to_pandas().shape == (take.summary.frames, len(trace.joints) + len(trace.channels))


def without_name(model_toml: str) -> list[str]:
    """A model file but for the name, which people choose."""
    return [line for line in model_toml.splitlines() if not line.startswith("name = ")]


def test_a_calibration_shows_progress_and_its_model_is_kept(p: Palpate, capsys: pytest.CaptureFixture[str]) -> None:
    run = p.calibrate("small", method="exact")
    report = run.wait()
    assert "calibration of small: 100%" in capsys.readouterr().err
    assert report.calibrated.l1 < report.nominal.l1
    assert set(report.by_take) == {take.id for take in p.session("small").takes}
    assert len(to_pandas(report.by_channel)) == report.channels
    assert "<html" in run.html()
    take = p.session("small").takes[0]
    unsaved = take.replay(run)
    model = run.save("By a test")
    assert run.model_toml is not None
    assert without_name(model.toml()) == without_name(run.model_toml)
    assert model.summary.theta == report.theta
    np.testing.assert_array_equal(take.replay(model).active, unsaved.active)
    assert p.model(model.id).summary.name == "By a test"
    p.set_live_model(model.id)
    until("used by the live twin", lambda: next(p.stream()).message.control.twin.model == "By a test")
    p.set_live_model("nominal")
    model.delete()
    assert p.restore_model(model.id).id == model.id
    model.delete()
    assert run.id in [known.id for known in p.calibrations()]


def test_a_run_that_cannot_be_is_refused(p: Palpate) -> None:
    with pytest.raises(PalpateError) as caught:
        p.calibrate("nothing")
    assert caught.value.status == 404
    with pytest.raises(PalpateError):
        p.calibrate("small", method="guess").wait(progress=False)


def test_a_diagnosis_can_be_cancelled(p: Palpate) -> None:
    run = p.diagnose("small", max_effects=1)
    with pytest.raises(PalpateError, match="it goes on"):
        run.wait(progress=False, timeout_s=0.0)
    run.cancel()
    with pytest.raises(PalpateError, match="diagnosis cancelled"):
        run.wait(progress=False)
    assert p.diagnosis(run.id).state == "cancelled"


def test_a_diagnosis_names_what_is_missing(p: Palpate) -> None:
    run = p.diagnose("small", max_effects=1)
    report = run.wait(progress=False)
    assert report.verdict in ("explained", "partly_explained", "unexplained", "no_discrepancy")
    assert report.gap.diagnosed <= report.gap.calibrated <= report.gap.nominal
    assert report.sentence
    if report.effects:
        model = run.save("Diagnosed by a test")
        assert [effect.id for effect in model.summary.effects] == [effect.id for effect in report.effects]
        model.delete()


def test_jobs_are_submitted_followed_cancelled_and_begun_again(p: Palpate) -> None:
    job = p.jobs.submit("calibrate", {"session": "small"}, key="a test's calibration")
    assert p.jobs.submit("calibrate", {"session": "small"}, key="a test's calibration").id == job.id
    assert job.wait(progress=False).head.state == "done"
    assert b"held_out" in job.file("report.json")
    assert isinstance(job.log(), str)
    assert isinstance(job.metrics(), list)
    diagnosis = p.jobs.submit("diagnose", {"session": "small", "max_effects": 1})
    diagnosis.cancel()
    with pytest.raises(PalpateError, match="Job cancelled"):
        diagnosis.wait(progress=False)
    assert diagnosis.retry().is_unfinished
    diagnosis.cancel()
    until("cancelled", lambda: not diagnosis.refresh().is_unfinished)
    assert {job.id, diagnosis.id} <= {known.id for known in p.jobs}
    assert next(known.id for known in p.jobs.list(kind="diagnose", state="cancelled")) == diagnosis.id
    diagnosis.delete()
    with pytest.raises(PalpateError) as caught:
        p.jobs.get(diagnosis.id)
    assert caught.value.status == 404
    with pytest.raises(PalpateError):
        p.jobs.submit("guess", {})


def test_live_frames_come_and_the_document_says_the_same(p: Palpate) -> None:
    frames = list(itertools.islice(p.stream(), 10))
    times = [frame.time_s for frame in frames]
    assert times == sorted(times)
    assert len(set(times)) == len(times)
    live = p.live()
    assert list(frames[-1].joints) == list(p.station().joints)
    for joint, position in live.joints.items():
        assert abs(frames[-1].position(joint) - position) < 0.1


def test_an_operator_arms_moves_stops_and_leaves(p: Palpate, studio: Studio) -> None:
    with pytest.raises(PalpateError, match="only the operator") as caught:
        p.start_recording(p.recording().plans[0].id, "by-nobody")
    assert caught.value.status == 403
    until("ready", lambda: all(device.link == "ready" for device in p.live().devices))
    with p.control("test script") as hand:
        hand.arm()
        assert p.live().holder == "test script"
        before = p.live().joints[JOINT]
        after = arm_and_move(hand, {JOINT: before + 0.3})
        assert abs(after.joints[JOINT] - before - 0.3) <= 0.05
        with pytest.raises(PalpateError, match="above its limit"):
            hand.targets({JOINT: 99.0})
        with pytest.raises(PalpateError, match="No such joint"):
            hand.targets({"elbow": 0.0})
        with pytest.raises(PalpateError, match="finite"):
            hand.targets({JOINT: float("nan")})
        with Palpate(studio.url) as second:
            with pytest.raises(PalpateError, match='"test script" has control'), second.control("second"):
                pytest.fail("two have control")
            # A second client may look, and stop.
            assert next(second.stream()).holder == "test script"
            second.stop()
        until("stopped", lambda: p.live().phase == "stopped")
        with pytest.raises(PalpateError):
            hand.move({JOINT: before})
        hand.reset_stop()
        arm_and_move(hand, {JOINT: before})
        hand.disarm()
    until("given back", lambda: p.live().holder == "")
    assert p.connection.lease == 0
    with pytest.raises(PalpateError, match="ends with that block"):
        hand.targets({JOINT: 0.0})


def test_leaving_the_block_disarms(p: Palpate) -> None:
    with pytest.raises(ZeroDivisionError), p.control("failing script") as hand:
        hand.arm()
        assert 1 // int(hand.live().time_s < 0)
    until("limp", lambda: p.live().phase == "disarmed" and p.live().holder == "")


def test_a_recording_needs_the_lease_and_has_it(p: Palpate) -> None:
    plan = p.recording().plans[0]
    with p.control("recorder"):
        document = p.start_recording(plan.id, "by-script", operator="a test")
        assert document.session is not None
        assert len(document.session.steps) == plan.takes
        document = p.act("confirm_object", fixture_trusted=True)
        assert document.session is not None
        assert document.session.phase != "place_object"
        p.want("sphere_50mm", "tap", "a test wants it")
        p.unwant("sphere_50mm", "tap")
        p.place_object("sphere_50mm")
        p.place_object(None)
        p.set_faults("")
        p.act("leave")
        until("left", lambda: p.recording().session is None)
    assert any("recorder" in str(entry) for entry in p.audit())


def test_control_that_is_taken_over_is_lost(p: Palpate, studio: Studio) -> None:
    with p.control("first") as first, Palpate(studio.url) as other, other.control("second", take_over=True):
        until("noticed", lambda: p.connection.lease == 0)
        with pytest.raises(PalpateError, match="Control lost"):
            first.arm()
        assert p.live().holder == "second"


def test_a_script_that_is_killed_leaves_a_hand_that_is_limp(p: Palpate, studio: Studio) -> None:
    script = (
        "import sys, time; from palpate import Palpate\n"
        "with Palpate(sys.argv[1]) as p, p.control('doomed') as hand:\n"
        "    hand.arm(); print('armed', flush=True); time.sleep(600)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script, studio.url], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "armed\n"
    assert p.live().phase == "armed"
    process.send_signal(signal.SIGKILL)
    process.wait()
    until("limp", lambda: p.live().phase == "disarmed")
    # Its lease goes a little later, and then anybody may take control.
    until("free", lambda: p.live().holder == "")


def test_a_slow_reader_gets_new_frames(p: Palpate) -> None:
    frames = p.stream()
    next(frames)
    # Threads of the stream go on while nobody reads.
    threading.Event().wait(3.0)
    before, first, second = p.live().time_s, next(frames), next(frames)
    # One frame may have waited; the next is of now.
    assert first.time_s > before - 1.0
    assert second.time_s > before - 0.5
    assert second.dropped > 20


def test_trainings_are_asked_for_by_name(p: Palpate) -> None:
    kinds = {kind.kind: kind for kind in p.jobs.kinds()}
    trainings = [
        "tune",
        "expert",
        "evaluation",
        "demonstrations",
        "pretraining",
        "gathering",
        "imitation",
        "pipeline",
        "comparison",
    ]
    assert set(kinds) >= {"calibrate", "diagnose", *trainings}
    # Where palpate-train is missing, that is said of all of them.
    assert len({kinds[kind].problem for kind in trainings}) == 1
    asks: list[Callable[[], object]] = [
        lambda: p.jobs.tune("no such object"),
        lambda: p.jobs.expert("no such object"),
        lambda: p.jobs.evaluation("no such policy"),
        lambda: p.jobs.demonstrations("no such policy", 4),
        lambda: p.jobs.pretraining(["no such job"]),
        lambda: p.jobs.gathering(["no such object"]),
        lambda: p.jobs.gathering(expert="no such expert"),
        lambda: p.jobs.imitation(["no such job"], head="act", memory="recurrent"),
        lambda: p.jobs.imitation(["gathering-1"], policy="no such policy"),
        lambda: p.jobs.imitation(["no such job", "gathering-2"], features=True, encoder="pretraining-1", region=True),
        lambda: p.jobs.pipeline(preset="no such preset"),
        lambda: p.jobs.rollouts("no such campaign"),
        lambda: p.jobs.comparison("no such campaign"),
    ]
    for ask in asks:
        with pytest.raises(PalpateError) as caught:
            ask()
        assert caught.value.status in (400, 404, 409), caught.value
        assert "no such" in str(caught.value) or "palpate-train" in str(caught.value)
