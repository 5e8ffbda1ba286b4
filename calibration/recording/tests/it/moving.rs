//! Takes of objects that move.

use std::{fs, io::Cursor, path::Path};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use palpate_messages::foxglove::PoseInFrame;
use palpate_recording::{
    LiveTake, TactileSampleRef, Take, TakeMeta, TakeWriter, check_session, close_partial,
};
use palpate_reports::CheckReport;
use palpate_robot_model::{FixedBox, ObjectPath};
use proptest::prelude::*;
use prost::Message as _;

use crate::session::session;
use crate::support::{START_UNIX_NS, meta, rewrite, station, take_bytes};

const MS: u64 = 1_000_000;

/// A take of two seconds whose object is at `poses`, (ms, base_from_object).
fn moving_take(poses: &[(u64, Isometry3<f64>)]) -> Vec<u8> {
    let station = station();
    let mut meta = meta();
    if let Some((_, first)) = poses.first() {
        meta.base_from_object = *first;
    }
    let still = take_bytes(2000, &meta);
    // Everything else as in a take of an object that stands still.
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station, &meta, START_UNIX_NS).unwrap();
    for span in Take::from_bytes(Path::new("take-01.mcap"), &still).unwrap().spans {
        writer.span(&span).unwrap();
    }
    for tick_ms in (0..2000).step_by(5) {
        let time_ns = tick_ms * MS;
        if tick_ms % 100 == 0 {
            writer.joints(time_ns, &[tick_ms as f64 * 5e-5, -0.5]).unwrap();
        }
        for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
            if tick_ms % (1e3 / stream.rate_hz) as u64 == 0 {
                let width = stream.channels.len();
                let raw = vec![300.0; width];
                let active = vec![false; width];
                let sample = TactileSampleRef { raw: &raw, active: &active, device_time_ns: 0 };
                writer.tactile(stream_idx, time_ns, sample).unwrap();
            }
        }
        for (_, pose) in poses.iter().filter(|(pose_ms, _)| (tick_ms..tick_ms + 5).contains(pose_ms)) {
            writer.object_pose(time_ns, pose).unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

/// 20 mm/s along x, from (0.1, 0, 0.05), every `step_ms`.
fn pushed(step_ms: usize) -> Vec<(u64, Isometry3<f64>)> {
    (0..2000)
        .step_by(step_ms)
        .map(|ms| (ms as u64, Isometry3::translation(0.1 + 2e-5 * ms as f64, 0.0, 0.05)))
        .collect()
}

fn read(bytes: &[u8]) -> Take {
    Take::from_bytes(Path::new("take-01.mcap"), bytes).unwrap()
}

fn check(bytes: &[u8]) -> CheckReport {
    let dir = tempfile::tempdir().unwrap();
    check_session(&session(dir.path(), &[("take-01.mcap", bytes.to_vec())])).unwrap()
}

fn poses() -> impl Strategy<Value = Vec<(u64, Isometry3<f64>)>> {
    let pose = (prop::array::uniform3(-2.0..2.0_f64), prop::array::uniform3(-3.0..3.0_f64))
        .prop_map(|(at, turn)| Isometry3::new(Vector3::from(at), Vector3::from(turn)));
    prop::collection::vec((1..300_000_000_u64, pose), 1..20).prop_map(|steps| {
        let mut time_ns = 0;
        steps
            .into_iter()
            .map(|(step_ns, pose)| {
                time_ns += step_ns;
                (time_ns, pose)
            })
            .collect()
    })
}

/// The shortest take that can be read, with `poses` at times in ns.
fn short_take(poses: &[(u64, Isometry3<f64>)]) -> Vec<u8> {
    short_take_of(&meta(), poses)
}

fn short_take_of(meta: &TakeMeta, poses: &[(u64, Isometry3<f64>)]) -> Vec<u8> {
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station(), meta, START_UNIX_NS).unwrap();
    writer.joints(0, &[0.0, 0.0]).unwrap();
    for (stream_idx, active) in [&[false; 3][..], &[false; 2]].into_iter().enumerate() {
        let sample = TactileSampleRef { raw: &[], active, device_time_ns: 0 };
        writer.tactile(stream_idx, 0, sample).unwrap();
    }
    for (time_ns, pose) in poses {
        writer.object_pose(*time_ns, pose).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn poses_are_read_back_as_they_were_written(poses in poses()) {
        let bytes = short_take(&poses);
        for bytes in [rewrite(&bytes, |_| {}), bytes] {
            let take = read(&bytes);
            let times_s: Vec<f64> = poses.iter().map(|(time_ns, _)| *time_ns as f64 / 1e9).collect();
            prop_assert_eq!(&take.object_poses.times_s, &times_s);
            let written: Vec<Isometry3<f64>> = poses.iter().map(|(_, pose)| *pose).collect();
            prop_assert_eq!(&take.object_poses.poses, &written, "to the bit");
        }
    }

    #[test]
    fn between_two_poses_it_moves_and_turns_evenly_and_outside_it_stands(
        poses in poses(), share in 0.0..1.0_f64, before_s in 0.0..1.0_f64,
    ) {
        let log = read(&short_take(&poses)).object_poses;
        for (pair_s, pair) in log.times_s.windows(2).zip(log.poses.windows(2)) {
            let between = log.at(pair_s[0] + share * (pair_s[1] - pair_s[0])).unwrap();
            let way = pair[1].translation.vector - pair[0].translation.vector;
            let expected = pair[0].translation.vector + share * way;
            prop_assert!((between.translation.vector - expected).norm() < 1e-6);
            let turn_rad = pair[0].rotation.angle_to(&pair[1].rotation);
            let (back_rad, on_rad) =
                (between.rotation.angle_to(&pair[0].rotation), between.rotation.angle_to(&pair[1].rotation));
            prop_assert!((back_rad - share * turn_rad).abs() < 1e-6, "{back_rad} of {turn_rad}");
            prop_assert!((back_rad + on_rad - turn_rad).abs() < 1e-6);
        }
        for (time_s, pose) in log.times_s.iter().zip(&log.poses) {
            prop_assert_eq!(log.at(*time_s), Some(*pose), "at a pose, that one");
        }
        prop_assert_eq!(log.at(log.times_s[0] - before_s), log.poses.first().copied());
        prop_assert_eq!(log.at(log.times_s[log.times_s.len() - 1] + before_s), log.poses.last().copied());
    }
}

#[test]
fn boxes_beside_the_object_are_read_back_and_a_take_without_any_does_not_speak_of_them() {
    let pose = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.3, 0.2, -1.0));
    let table = FixedBox { base_from_box: Isometry3::translation(0.0, 0.0, -0.1), size_m: [1.0, 0.8, 0.2] };
    let wall = FixedBox { base_from_box: pose, size_m: [0.01, 0.7, 0.1 + 0.2] };
    let meta = TakeMeta { surroundings: vec![table, wall], ..meta() };
    let bytes = short_take_of(&meta, &[]);
    assert_eq!(read(&bytes).meta, meta, "to the bit");
    let speaks = |bytes: &[u8]| bytes.windows(12).any(|part| part == b"surroundings");
    assert!(speaks(&bytes) && !speaks(&short_take(&[])));
    // What could not be read is not written.
    let flat = FixedBox { size_m: [1.0, 0.0, 1.0], ..table };
    let meta = TakeMeta { surroundings: vec![table, flat], ..meta };
    let refused = TakeWriter::new(Cursor::new(Vec::new()), &station(), &meta, START_UNIX_NS).err().unwrap();
    assert!(refused.to_string().contains("edges above 0"), "{refused}");
}

#[test]
fn frames_know_where_the_object_is() {
    let take = read(&moving_take(&pushed(250)));
    let ObjectPath::Moving(path) = take.object_path() else { panic!("it moves") };
    assert_eq!(path.len(), take.num_frames());
    for (time_s, pose) in take.joints.times_s.iter().zip(&path) {
        let expected_m = 0.1 + 0.02 * time_s.min(1.75);
        assert!((pose.translation.x - expected_m).abs() < 1e-9, "{} m at {time_s} s", pose.translation.x);
    }
    // The take's own pose is that of the start, which is all that older programs see.
    assert_eq!(take.meta.base_from_object, path[0]);
    // One pose says where it stands, none that it stands where the take says.
    let once = read(&short_take(&[(500, Isometry3::translation(0.2, 0.0, 0.0))]));
    assert_eq!(once.object_path(), ObjectPath::Still(Isometry3::translation(0.2, 0.0, 0.0)));
    let still = read(&take_bytes(2000, &meta()));
    assert!(still.object_poses.poses.is_empty());
    assert_eq!(still.object_path(), ObjectPath::Still(meta().base_from_object));
}

fn with_pose(number: usize, change: impl Fn(&mut PoseInFrame)) -> String {
    let bytes = rewrite(&moving_take(&pushed(100)), |edit| {
        if edit.topic == "/object_pose" && edit.number == number {
            let mut message = PoseInFrame::decode(edit.data.as_slice()).unwrap();
            change(&mut message);
            *edit.data = message.encode_to_vec();
        }
    });
    Take::from_bytes(Path::new("take-01.mcap"), &bytes).unwrap_err().to_string()
}

#[test]
fn every_fault_of_a_pose_names_topic_and_message() {
    let position = |message: &mut PoseInFrame, x: f64| {
        message.pose.as_mut().unwrap().position.as_mut().unwrap().x = x;
    };
    let turn = |message: &mut PoseInFrame, w: f64| {
        message.pose.as_mut().unwrap().orientation.as_mut().unwrap().w = w;
    };
    let late = rewrite(&moving_take(&pushed(100)), |edit| {
        if edit.topic == "/object_pose" && edit.number == 5 {
            *edit.log_time -= 200 * MS;
        }
    });
    let schema = rewrite(&moving_take(&pushed(100)), |edit| {
        if edit.topic == "/object_pose" {
            *edit.schema = "foxglove.Pose".to_owned();
        }
    });
    let error_of = |bytes: &[u8]| Take::from_bytes(Path::new("take-01.mcap"), bytes).unwrap_err().to_string();
    let cases = [
        (
            with_pose(3, |message| position(message, f64::NAN)),
            "/object_pose: message 4 at 0.300 s: the object is at [NaN, 0.0, 0.05] m, expected finite numbers",
        ),
        (
            with_pose(2, |message| turn(message, 2.0)),
            "/object_pose: message 3 at 0.200 s: the object's quaternion is [2.0, 0.0, 0.0, 0.0] (w x y z), whose norm is 2; \
             expected a unit quaternion",
        ),
        (
            with_pose(0, |message| turn(message, f64::INFINITY)),
            "/object_pose: message 1 at 0.000 s: the object's quaternion",
        ),
        (
            with_pose(1, |message| message.pose = None),
            "/object_pose: message 2 at 0.100 s: there is no pose in it",
        ),
        (
            with_pose(1, |message| message.pose.as_mut().unwrap().orientation = None),
            "/object_pose: message 2 at 0.100 s: the pose has no orientation",
        ),
        (
            with_pose(1, |message| message.frame_id = "camera".to_owned()),
            "/object_pose: message 2 at 0.100 s: the pose is given in frame \"camera\", expected the base",
        ),
        (error_of(&late), "/object_pose: message 6: its time 0.3 s does not come after 0.4 s"),
        (
            error_of(&schema),
            "/object_pose: messages are foxglove.Pose in \"protobuf\", expected foxglove.PoseInFrame",
        ),
    ];
    for (error, expected) in cases {
        assert!(error.contains(expected), "{error}\nlacks\n{expected}");
    }
}

#[test]
fn the_writer_refuses_poses_that_the_reader_would() {
    let mut writer = TakeWriter::new(Cursor::new(Vec::new()), &station(), &meta(), START_UNIX_NS).unwrap();
    writer.object_pose(5, &Isometry3::identity()).unwrap();
    let error = writer.object_pose(5, &Isometry3::identity()).unwrap_err().to_string();
    assert!(error.contains("/object_pose") && error.contains("times must increase"), "{error}");
    let lost = Isometry3::translation(0.0, f64::NAN, 0.0);
    let error = writer.object_pose(6, &lost).unwrap_err().to_string();
    assert!(error.contains("position [0.0, NaN, 0.0] m"), "{error}");
    let long = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.1, 0.0, 0.0, 0.0));
    let error = writer
        .object_pose(6, &Isometry3::from_parts(Translation3::identity(), long))
        .unwrap_err()
        .to_string();
    assert!(error.contains("expected finite numbers and a unit quaternion"), "{error}");
}

#[test]
fn what_was_cut_off_keeps_the_poses_before() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("take-01.mcap");
    let mut live = LiveTake::create(&path, &station(), &meta(), START_UNIX_NS).unwrap();
    for ms in (0..3000_u64).step_by(10) {
        let pose = Isometry3::translation(0.1 + 1e-5 * ms as f64, 0.0, 0.0);
        live.joints(ms * MS, &[0.0, 0.0]).unwrap();
        live.object_pose(ms * MS, &pose).unwrap();
        for (stream_idx, active) in [&[false; 3][..], &[false; 2]].into_iter().enumerate() {
            let sample = TactileSampleRef { raw: &[], active, device_time_ns: 0 };
            live.tactile(stream_idx, ms * MS, sample).unwrap();
        }
    }
    // Its writer is killed: what was not handed over is lost, and there is no end.
    let bytes = fs::read(&path).unwrap();
    drop(live);
    fs::write(&path, &bytes[..bytes.len() - 7]).unwrap();
    let recovered = Take::recover(&path).unwrap();
    assert!(recovered.damage.is_some());
    let num_poses = recovered.take.object_poses.poses.len();
    assert!(num_poses > 100, "{num_poses}");
    let closed = close_partial(&path).unwrap();
    assert!(closed.damage.is_some());
    assert_eq!(closed.take.object_poses, recovered.take.object_poses);
    assert_eq!(Take::read(&path).unwrap().object_poses, recovered.take.object_poses);
}

#[test]
fn a_check_says_what_is_wrong_with_a_path() {
    let found = |bytes: &[u8]| -> Vec<String> {
        let problems = check(bytes).problems;
        let ours = problems.iter().filter(|problem| problem.place.contains("object_pose"));
        ours.map(|problem| format!("{:?} {}: {}", problem.severity, problem.place, problem.message)).collect()
    };
    assert_eq!(found(&take_bytes(2000, &meta())), Vec::<String>::new());
    assert_eq!(found(&moving_take(&pushed(20))), Vec::<String>::new());

    let lost: Vec<_> = pushed(20).into_iter().filter(|(ms, _)| !(500..900).contains(ms)).collect();
    let gap = "Warning take-01, /object_pose: 1 gap in which the object moved, the longest 0.420 s";
    assert!(found(&moving_take(&lost))[0].starts_with(gap), "{:?}", found(&moving_take(&lost)));
    // While it stands, nothing is lost with its pose.
    let standing: Vec<_> = lost
        .iter()
        .map(|(ms, _)| (*ms, Isometry3::translation(if *ms < 1500 { 0.1 } else { 0.105 }, 0.0, 0.05)))
        .collect();
    assert_eq!(found(&moving_take(&standing)), Vec::<String>::new());

    let short: Vec<_> = pushed(20).into_iter().filter(|(ms, _)| *ms < 1000).collect();
    let ends = "Warning take-01, /object_pose: poses are there from 0.000 s to 0.980 s, joints from 0.000 s to 1.900 s";
    assert!(found(&moving_take(&short))[0].starts_with(ends), "{:?}", found(&moving_take(&short)));

    let mut jump = pushed(20);
    jump[30].1.translation.y += 0.5;
    let jumps =
        "Warning take-01, /object_pose: the object jumps: from one pose to the next it moves at 25 m/s";
    assert!(found(&moving_take(&jump))[0].starts_with(jumps), "{:?}", found(&moving_take(&jump)));

    let mut far = pushed(20);
    far[40].1.translation.x = 700.0;
    let reach = "Error take-01, /object_pose: message 41 at 0.800 s: the object is 70";
    assert!(
        found(&moving_take(&far)).iter().any(|found| found.starts_with(reach)),
        "{:?}",
        found(&moving_take(&far))
    );

    let elsewhere = short_take(&[(0, Isometry3::identity())]);
    let begins = "Warning take-01, /object_pose: the first pose is 374.2 mm and";
    assert!(found(&elsewhere)[0].starts_with(begins), "{:?}", found(&elsewhere));
}
