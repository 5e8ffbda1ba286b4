//! Takes outside guided sessions: begun, marked and ended by whoever has control.

use std::{
    thread,
    time::{Duration, Instant},
};

use palpate_control::{ControlError, ObjectFiles};
use palpate_recording::{Session, SpanKind, check_session};
use palpate_wire::{
    api::{FreeTake, FreeTakeState, MarkKind, StartRecording, StartTake, SurroundingBox, TakeAction},
    proto::{ObjectPose, control_request::Request},
};

use crate::bench::{Bench, Operator, assets, targets};

const PATIENCE: Duration = Duration::from_secs(120);

fn start(object: &str) -> StartTake {
    StartTake {
        session: "grasps".to_owned(),
        object: object.to_owned(),
        object_pose: vec![0.4, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0],
        primitive: "rollout".to_owned(),
        fixture_trusted: true,
        operator: "Ada".to_owned(),
        surroundings: vec![SurroundingBox {
            pose: vec![0.0, 0.0, -0.1, 1.0, 0.0, 0.0, 0.0],
            size_m: [2.0, 2.0, 0.2],
        }],
        marks_baseline: false,
    }
}

/// Finds shipped objects.
fn find(object: &str) -> Result<ObjectFiles, ControlError> {
    let path = assets().join("objects").join(format!("{object}.toml"));
    let text = std::fs::read_to_string(path);
    let text = text.map_err(|_| ControlError::Refused(format!("there is no object {object:?}")))?;
    Ok(ObjectFiles { text, meshes: [].into() })
}

fn begin(bench: &Bench, operator: &Operator, start: StartTake) -> Result<FreeTake, ControlError> {
    bench.handle.begin_take(&operator.claim(), start, &find).map(|document| document.free.expect("a take"))
}

/// Waits until the newest take is as wanted.
fn wait(bench: &Bench, what: &str, wanted: impl Fn(&FreeTake) -> bool) -> FreeTake {
    let begun = Instant::now();
    loop {
        let free = bench.handle.recording().expect("the loop answers").free.expect("a take");
        if wanted(&free) {
            return free;
        }
        assert!(begun.elapsed() < PATIENCE, "never {what}: {free:?}");
        thread::sleep(Duration::from_millis(5));
    }
}

fn pose(x_m: f64) -> Request {
    Request::ObjectPose(ObjectPose {
        position_m: vec![x_m, 0.0, 0.1],
        quaternion_wxyz: vec![1.0, 0.0, 0.0, 0.0],
        time_s: 0.0,
    })
}

#[test]
fn takes_are_recorded_outside_guided_sessions_and_can_be_read() {
    let bench = Bench::patient();
    let operator = Operator::armed(&bench, 1);
    assert!(operator.refused(pose(0.4)).contains("begin one first"));
    let refused = |start: StartTake, expected: &str| {
        let error = begin(&bench, &operator, start).expect_err(expected);
        assert!(error.to_string().contains(expected), "{error}");
    };
    refused(start("no such thing"), "there is no object");
    refused(StartTake { session: "../out".to_owned(), ..start("cube") }, "session");
    refused(StartTake { object_pose: vec![0.0; 7], ..start("cube") }, "quaternion");
    refused(StartTake { primitive: String::new(), ..start("cube") }, "names of 1 to");
    let flat = SurroundingBox { pose: start("cube").object_pose, size_m: [1.0, 1.0, 0.0] };
    refused(StartTake { surroundings: vec![flat], ..start("cube") }, "edges above 0");

    // The station does not have the cube; the take has it.
    begin(&bench, &operator, start("cube")).expect("a take");
    refused(start("cube"), "is being recorded");
    let plan = StartRecording {
        plan: "quick_check".to_owned(),
        session: "monday".to_owned(),
        operator: String::new(),
        only_wanted: false,
    };
    let guided = bench.handle.start_recording(&operator.claim(), plan.clone()).expect_err("it is busy");
    assert!(guided.to_string().contains("outside guided sessions"), "{guided}");
    bench.wait_for("told to pages", |state| {
        state.recording.as_ref().is_some_and(|status| status.phase == "running" && status.elapsed_s > 0.6)
    });
    for step in 0..10 {
        operator.accepted(pose(0.4 + 0.001 * f64::from(step)));
        thread::sleep(Duration::from_millis(20));
    }
    let dof = bench.dof("index_pip");
    let lift = || (MarkKind::Repetition, "lift".to_owned());
    let (kind, label) = lift();
    let act = |action: TakeAction| bench.handle.act_on_take(&operator.claim(), action).expect("its time");
    act(TakeAction::BeginMark { kind, label });
    operator.accepted(targets(&[dof], &[0.5]));
    bench.wait_until("there", |now| (now.positions[dof] - 0.5).abs() < 0.05);
    let (kind, label) = lift();
    act(TakeAction::EndMark { kind, label });
    act(TakeAction::End { set_aside: false });
    let first = wait(&bench, "accepted", |free| free.state == FreeTakeState::Accepted);
    assert_eq!((first.take.as_deref(), first.problem.as_str()), (Some("take-01"), ""));
    assert!(first.verdict.is_some());

    // Another one, in the middle of which the operator's page is gone: it is kept, and says so.
    begin(&bench, &operator, start("sphere_50mm")).expect("a second take");
    thread::sleep(Duration::from_millis(300));
    let mut operator = operator;
    operator.vanish(&bench);
    let second = wait(&bench, "over", |free| free.state == FreeTakeState::Accepted);
    // It holds first, then lets go.
    assert!(second.problem.starts_with("the station"), "{second:?}");
    // One that is under way when the studio ends is kept too.
    let mut third = Operator::watcher(&bench, 2);
    third.take_control(true);
    begin(&bench, &third, start("cube")).expect("a third take");
    thread::sleep(Duration::from_millis(300));
    let dir = bench.dir.path().join("sessions/grasps");
    let mut bench = bench;
    bench.end_control();

    let session = Session::open(&dir).expect("a session");
    let takes = session.accepted_takes().expect("its takes");
    assert_eq!(takes.len(), 3, "{:?}", session.file);
    let take = &takes[0];
    assert_eq!((take.meta.primitive.as_str(), take.meta.operator.as_str()), ("rollout", "Ada"));
    assert!(take.meta.fixture_trusted && take.meta.surroundings.len() == 1);
    assert_eq!(take.object_poses.poses.len(), 10);
    let last = take.object_poses.poses[9].translation;
    assert!((last.x - 0.409).abs() < 1e-12, "{last}");
    let baseline =
        take.spans.iter().find(|span| span.kind == SpanKind::Baseline).expect("a span without touch");
    assert!(baseline.start_s == 0.0 && baseline.end_s > 0.6, "{baseline:?}");
    let lift = take.spans.iter().find(|span| span.label == "lift").expect("a mark");
    assert!(lift.kind == SpanKind::Repetition && (lift.start_s - baseline.end_s).abs() < 0.5, "{lift:?}");
    assert!(
        take.station.objects.contains_key("cube") && !bench.handle.station().objects.contains_key("cube")
    );
    // At the devices' own rates.
    let joint_rate_hz = take.num_frames() as f64 / take.duration_s();
    assert!(joint_rate_hz > 2.0 * take.station.joint_rate_hz, "{joint_rate_hz} Hz");
    let report = check_session(&session).expect("a report");
    assert!(report.ok, "{report:?}");
}
