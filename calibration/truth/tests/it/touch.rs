//! The truth world's touch where somebody else moves robot and object.

use nalgebra::{Isometry3, Translation3};
use palpate_recording::Take;
use palpate_robot_model::{ObjectShape, Station};
use palpate_truth::{Stage, TruthSense, TruthTouch};

use super::shipped;

const CONTROL_RATE_HZ: f64 = 20.0;

/// Measured positions at `time_s`.
fn positions(take: &Take, num_dofs: usize, time_s: f64) -> &[f64] {
    let idx = take.joints.times_s.partition_point(|&at| at <= time_s).max(1) - 1;
    &take.joints.positions[idx * num_dofs..(idx + 1) * num_dofs]
}

/// What the take has of every channel at `time_s`.
fn recorded(take: &Take, station: &Station, time_s: f64) -> Vec<bool> {
    let newest = |(stream, log): (&palpate_robot_model::Stream, &palpate_recording::StreamLog)| {
        let width = stream.channels.len();
        match log.times_s.partition_point(|&at| at <= time_s) {
            0 => vec![false; width],
            count => log.active[(count - 1) * width..count * width].to_vec(),
        }
    };
    station.layout.streams.iter().zip(&take.streams).flat_map(newest).collect()
}

#[test]
fn driven_along_a_recorded_take_it_feels_what_was_recorded() {
    let stage = Stage::read(&shipped("small.toml")).unwrap();
    let sense = TruthSense::read(&shipped("small.toml")).unwrap();
    let station = sense.station();
    let take = &stage.record(&[], 3).unwrap()[0];
    let mut touch = sense.touch(&station.objects[&take.meta.object], &[]).unwrap();
    touch.restart(9).unwrap();
    let num_dofs = station.robot.num_dofs();
    let (mut agreed, mut either, mut at_all) = (0, 0, 0);
    let last_s = take.joints.times_s.last().unwrap();
    for frame in 0..(last_s * CONTROL_RATE_HZ) as usize {
        let time_s = frame as f64 / CONTROL_RATE_HZ;
        touch.feel(time_s, positions(take, num_dofs, time_s), &take.meta.base_from_object);
        for (&felt, real) in touch.active().iter().zip(recorded(take, station, time_s)) {
            agreed += usize::from(felt && real);
            either += usize::from(felt || real);
            at_all += usize::from(real);
        }
    }
    // Joints are measured with an error that moves a fingertip by a tenth of a millimetre or so.
    assert!(at_all > 200 && agreed as f64 > 0.85 * either as f64, "{agreed} of {either}, {at_all} recorded");
}

/// Channels that are on in each of twenty frames. The hand turns to where all joints are at zero before frame `comes_at`,
/// and the object is at `base_from_object` all the time.
fn counts(
    touch: &mut TruthTouch,
    num_dofs: usize,
    comes_at: i32,
    base_from_object: &Isometry3<f64>,
) -> Vec<usize> {
    touch.restart(1).unwrap();
    let mut positions = vec![0.0; num_dofs];
    (0..20)
        .map(|frame| {
            positions[0] = if frame < comes_at { 0.5 } else { 0.0 };
            touch.feel(f64::from(frame) / CONTROL_RATE_HZ, &positions, base_from_object);
            touch.active().iter().filter(|&&on| on).count()
        })
        .collect()
}

#[test]
fn what_the_hand_meets_is_felt_after_the_delays_whether_it_may_move_or_stands_still() {
    let sense = TruthSense::read(&shipped("demo.toml")).unwrap();
    let station = sense.station();
    let (num_dofs, mut frames) = (station.robot.num_dofs(), Vec::new());
    station.robot.forward_kinematics(&vec![0.0; num_dofs], &mut frames);
    let patch = &station.layout.patches[0];
    let at_tip = Isometry3::from(Translation3::from(frames[patch.link] * patch.nodes[0].pos_in_link));
    let far = Isometry3::translation(5.0, 5.0, 5.0);

    let object = station.objects["sphere_50mm"].clone();
    let mut touch = sense.touch(&object, &[]).unwrap();
    let felt = counts(&mut touch, num_dofs, 8, &at_tip);
    // Seven frames apart, one on the way, then 0.14 s until the first sample is there.
    assert!(felt[..10].iter().all(|&on| on == 0) && felt[19] > 0, "{felt:?}");
    assert_eq!(counts(&mut touch, num_dofs, 8, &at_tip), felt, "the same seed");
    assert!(counts(&mut touch, num_dofs, 8, &far).iter().all(|&on| on == 0), "out of reach");

    let stands = [(at_tip, ObjectShape::Sphere { radius_m: 0.025 })];
    let mut touch = sense.touch(&object, &stands).unwrap();
    let felt = counts(&mut touch, num_dofs, 8, &far);
    assert!(felt[..10].iter().all(|&on| on == 0) && felt[19] > 0, "{felt:?}");
}
