use super::*;
use crate::sample::Dims;

const DIMS: Dims = Dims { history: 3, channels: 5, joints: 7, hand_points: 11, object_points: 13 };

fn wave(len: usize, pace: f32, size: f32) -> Vec<f32> {
    (0..len).map(|i| size * (1.0 + i as f32 * pace).sin()).collect()
}

fn sample(in_contact: bool) -> Sample {
    let contact = |i: usize| f32::from(u8::from(in_contact && i.is_multiple_of(2)));
    Sample {
        input: wave(DIMS.input_len(), 0.7, 0.1),
        hand_points: wave(3 * DIMS.hand_points, 0.9, 0.1),
        object_points: wave(3 * DIMS.object_points, 1.7, 0.1),
        pose: [0.05, -0.02, 0.1, 0.5, -0.5, 0.5, 0.5],
        joints: wave(DIMS.joints, 0.3, 1.0),
        contacts: (0..DIMS.channels).map(contact).collect(),
    }
}

fn row() -> Vec<f32> {
    let outputs = DIMS.outputs();
    let mut row = wave(outputs.len(), 2.3, 0.12);
    row[outputs.contacts.clone()].copy_from_slice(&[2.0, -1.0, 0.3, -4.0, 0.0]);
    // Near each other, and near the hand, so that both regularisers have something to push.
    for axis in 0..3 {
        row[outputs.object.start + 3 + axis] = row[outputs.object.start + axis] + 0.002;
        row[outputs.object.start + 6 + axis] = row[outputs.hand.start + axis] + 0.001;
    }
    row
}

#[test]
fn every_term_has_the_gradient_that_differences_find() {
    let config = LossConfig::default();
    let outputs = DIMS.outputs();
    for (idx, name) in TERMS.iter().enumerate() {
        let sample = sample(WHEN[idx] != When::Empty);
        let row = row();
        let mut gradient = vec![0.0; row.len()];
        let value = |row: &[f32]| term(idx, &sample, row, &outputs, &config, 0.0, &mut vec![0.0; row.len()]);
        assert!(value(&row) > 0.0, "{name} has something to measure");
        term(idx, &sample, &row, &outputs, &config, 1.0, &mut gradient);
        let mut moved = 0;
        for at in 0..row.len() {
            if *name == "penetration" && outputs.hand.contains(&at) {
                assert_eq!(gradient[at], 0.0, "the hand does not give way");
                continue;
            }
            let step = 1e-4;
            let [there, back] = [step, -step].map(|step| {
                let mut row = row.clone();
                row[at] += step;
                (value(&row), f64::from(row[at]))
            });
            let slope = (there.0 - back.0) / (there.1 - back.1);
            assert!((f64::from(gradient[at]) - slope).abs() < 2e-3, "{name}[{at}]: {} {slope}", gradient[at]);
            moved += usize::from(slope.abs() > 1e-4);
        }
        assert!(moved >= 3, "{name} depends on {moved} numbers");
    }
}

#[test]
fn the_objective_is_the_weighted_sum_and_so_is_its_gradient() {
    let config = LossConfig::default();
    let outputs = DIMS.outputs();
    for in_contact in [true, false] {
        let (sample, row) = (sample(in_contact), row());
        let mut gradient = vec![0.0; row.len()];
        let terms = sample_loss(&sample, &row, &outputs, &config, 0.5, &mut gradient);
        let mut expected = vec![0.0; row.len()];
        let mut total = 0.0;
        for (idx, mean) in terms.means().iter().enumerate() {
            let absent = if in_contact { When::Empty } else { When::InContact };
            assert_eq!(mean.is_none(), WHEN[idx] == absent, "{}", TERMS[idx]);
            let Some(mean) = mean else { continue };
            let weight = weights(&config)[idx];
            total += weight * mean;
            term(idx, &sample, &row, &outputs, &config, 0.5 * weight, &mut expected);
        }
        assert!((terms.total() - total).abs() < 1e-12);
        assert_eq!(gradient, expected);
    }
}

#[test]
fn a_chamfer_distance_is_zero_between_equals_and_the_same_both_ways() {
    let (left, right) = (wave(33, 0.9, 1.0), wave(48, 1.7, 1.0));
    let distance = |left: &[f32], right: &[f32]| chamfer(left, right, 0.0, &mut vec![0.0; left.len()]);
    let mut shuffled: Vec<f32> = left.chunks(3).rev().flatten().copied().collect();
    assert_eq!(distance(&left, &shuffled), 0.0);
    assert!((distance(&left, &right) - distance(&right, &left)).abs() < 1e-12);
    assert!((distance(&left, &right) - 2.0 * mean_distance_m(&left, &right)).abs() < 1e-12);
    // A cloud that is moved by a hair is a hair away, and pulled straight back.
    shuffled.iter_mut().step_by(3).for_each(|x| *x += 1e-3);
    let mut gradient = vec![0.0; left.len()];
    let moved = chamfer(&shuffled, &left, 1.0, &mut gradient);
    assert!((moved - 2e-3).abs() < 1e-6, "{moved}");
    for slope in gradient.chunks(3) {
        assert!((slope[0] - 2.0 / 11.0).abs() < 1e-3 && slope[1].abs() < 1e-3, "{slope:?}");
    }
}

#[test]
fn a_rotation_has_two_quaternions_and_any_length() {
    let target = [0.5, -0.5, 0.5, 0.5];
    let loss = |quaternion: [f32; 4]| rotation(&quaternion, &target, 0.0, &mut [0.0; 4]);
    for same in [[0.5, -0.5, 0.5, 0.5], [-0.5, 0.5, -0.5, -0.5], [2.0, -2.0, 2.0, 2.0]] {
        assert!(loss(same).abs() < 1e-6, "{same:?}");
    }
    assert!((loss([0.5, 0.5, -0.5, 0.5]) - 1.0).abs() < 1e-6);
    let (there, back) = ([0.1, 0.9, -0.2, 0.3], [-0.1, -0.9, 0.2, -0.3]);
    assert_eq!(loss(there), loss(back));
    let mut gradient = [0.0; 4];
    assert_eq!(rotation(&[0.0; 4], &target, 1.0, &mut gradient), 1.0);
    assert!(gradient.iter().all(|slope| slope.is_finite()));
}

#[test]
fn far_from_a_contact_a_focal_loss_is_finite() {
    let config = LossConfig::default();
    let mut gradient = [0.0; 2];
    let loss = focal(&[-200.0, 200.0], &[1.0, 0.0], &config, 1.0, &mut gradient);
    assert!((loss - 0.5 * (0.25 * 200.0 + 0.75 * 200.0)).abs() < 1e-9, "{loss}");
    assert_eq!(gradient, [-0.125, 0.375]);
    let loss = focal(&[200.0, -200.0], &[1.0, 0.0], &config, 1.0, &mut gradient);
    assert!(loss.abs() < 1e-12);
}
