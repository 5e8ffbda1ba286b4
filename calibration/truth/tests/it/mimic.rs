//! A station with a joint that follows another.

use std::path::{Path, PathBuf};

use palpate_recording::{SpanKind, check_session};
use palpate_robot_model::Robot;
use tempfile::TempDir;

use crate::{record, takes};

fn fixture(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/gripper-station").join(file)
}

fn dof(robot: &Robot, name: &str) -> usize {
    robot.dofs().position(|joint| joint.name == name).unwrap()
}

#[test]
fn an_emulated_session_moves_it_with_the_other_and_both_fingers_feel() {
    let dir = TempDir::new().unwrap();
    let session = record(&fixture("truth.toml"), &dir.path().join("gripper"), 1).unwrap();
    let check = check_session(&session).unwrap();
    assert!(check.ok, "{:?}", check.problems);
    assert!(check.coverage.iter().all(|channel| channel.touches >= 4), "{:?}", check.coverage);
    let (mut moved_m, mut num_by_limb) = (0.0_f64, 0);
    for take in takes(&session) {
        let robot = &take.station.robot;
        let (left, right, num_dofs) = (dof(robot, "left"), dof(robot, "right"), robot.num_dofs());
        let first = take.joints.positions[left];
        for frame in take.joints.positions.chunks_exact(num_dofs) {
            // Encoders of their own: noise of 10 um each.
            let apart_m = frame[right] - (0.8 * frame[left] + 0.004);
            assert!(apart_m.abs() < 8e-5, "{}: {apart_m} m apart", take.id);
            moved_m = moved_m.max((frame[left] - first).abs());
        }
        // A finger that is pressed by its own drive feels it, the right one by way of the left one's.
        let by_limb = take
            .spans
            .iter()
            .filter(|span| span.kind == SpanKind::Repetition && span.label.contains("by limb"));
        let gel = &take.streams[0];
        for span in by_limb {
            num_by_limb += 1;
            let channels = take.station.layout.channels.iter();
            let channel = channels
                .clone()
                .position(|channel| span.label.contains(&format!(" {} ", channel.id)))
                .unwrap();
            let felt = gel.times_s.iter().enumerate().any(|(sample, time_s)| {
                (span.start_s..span.end_s).contains(time_s) && gel.active[sample * channels.len() + channel]
            });
            assert!(felt, "{}: nothing is felt in {:?}", take.id, span.label);
        }
    }
    assert!(
        moved_m > 0.005 && num_by_limb >= 6,
        "{moved_m} m, {num_by_limb} presses of fingers by themselves"
    );
}
