use std::collections::BTreeMap;
use std::path::Path;

use palpate_robot_model::{ObjectModel, Station};
use palpate_sim::geometry::SignedDistance;

use super::*;

const STEPS: usize = 7;

fn assets() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets")
}

fn station() -> Station {
    let read =
        |name: &str| std::fs::read(assets().join("stations").join(name)).map_err(|err| err.to_string());
    Station::read("xarm6_leap.toml", read).expect("a station")
}

fn object(name: &str) -> ObjectModel {
    let text = std::fs::read_to_string(assets().join(format!("objects/{name}.toml"))).expect("a file");
    ObjectModel::from_toml(name, &text, |_| Err("no meshes".to_owned())).expect("an object")
}

/// A demonstration in which everything moves a bit, differently in each trial. `arm` is added to the joints of the arm.
fn demonstration(station: &Station, object: usize, trial: u64, arm: f32) -> Demonstration {
    let wave = |i: usize, size: f32| size * ((1 + i) as f32 * 0.7 + trial as f32).sin();
    let (joints, channels) = (station.robot.num_dofs(), station.layout.num_channels());
    let joint = |i: usize| {
        let of_arm = station.carrier_dofs.contains(&(i % joints));
        wave(i, 0.1) + if of_arm { arm } else { 0.3 }
    };
    Demonstration {
        object,
        seed: 1,
        trial,
        read_joints: (0..STEPS * joints).map(joint).collect(),
        exact_joints: (0..STEPS * joints).map(|i| joint(i) + 0.001).collect(),
        touch: (0..STEPS * channels).map(|i| wave(i, 1.0) > 0.7).collect(),
        object_poses: (0..STEPS).flat_map(|i| [0.4, wave(i, 0.1), 0.05, 0.5, 0.5, 0.5, 0.5]).collect(),
    }
}

fn world(order: &[(usize, u64)], arm: f32) -> World {
    let station = station();
    let data = Demonstrations {
        hand_root: station.robot.link_index("palm").expect("a palm"),
        objects: vec![object("cube"), object("hourglass")],
        demonstrations: order
            .iter()
            .map(|&(object, trial)| demonstration(&station, object, trial, arm))
            .collect(),
        station,
        sources: BTreeMap::new(),
    };
    World::new(data, &config()).expect("a world")
}

fn config() -> EncoderConfig {
    EncoderConfig {
        history: 4,
        frame_stride: 3,
        hand_points: 32,
        object_points: 32,
        held_out_share: 0.4,
        ..EncoderConfig::default()
    }
}

/// Object, trial and step of every sample, with the sample.
fn named(samples: &Samples) -> Vec<((usize, u64, usize), Sample)> {
    let name = |idx: usize| {
        let (demonstration, step) = samples.moments[idx];
        let one = &samples.world.data.demonstrations[demonstration];
        (one.object, one.trial, step)
    };
    let mut named: Vec<_> = (0..samples.len()).map(|idx| (name(idx), samples.sample(idx))).collect();
    named.sort_by_key(|(name, _)| *name);
    named
}

#[test]
fn the_order_of_demonstrations_and_what_else_there_is_change_no_sample() {
    let all: Vec<(usize, u64)> = (0..12).map(|idx| (idx % 2, idx as u64)).collect();
    let reversed: Vec<(usize, u64)> = all.iter().rev().copied().collect();
    let (whole, turned, part) = (world(&all, 0.2), world(&reversed, 0.2), world(&all[..6], 0.2));
    let [whole, turned, part] = [&whole, &turned, &part].map(|world| world.split(&config()));
    for ((whole, turned), part) in whole.iter().zip(&turned).zip(&part) {
        let expected = named(whole);
        assert!(!expected.is_empty());
        assert_eq!(expected, named(turned));
        let of_part: Vec<_> = expected.into_iter().filter(|((_, trial, _), _)| *trial < 6).collect();
        assert_eq!(of_part, named(part));
    }
    let of =
        |samples: &Samples| named(samples).into_iter().map(|((_, trial, _), _)| trial).collect::<Vec<_>>();
    let [train, held_out] = whole.each_ref().map(of);
    assert!(train.iter().all(|trial| !held_out.contains(trial)), "{train:?} {held_out:?}");
}

#[test]
fn the_hands_frame_does_not_know_where_the_arm_is() {
    let [here, there] = [0.1, -0.4].map(|arm| world(&[(0, 3)], arm));
    let [here_sample, there_sample] =
        [&here, &there].map(|world| world.sample(&world.data.demonstrations[0], 5));
    let near =
        |left: &[f32], right: &[f32]| left.iter().zip(right).all(|(left, right)| (left - right).abs() < 1e-5);
    assert!(near(&here_sample.input, &there_sample.input));
    assert!(near(&here_sample.hand_points, &there_sample.hand_points));
    assert!(!near(&here_sample.pose, &there_sample.pose), "the object stayed, so to the hand it moved");
}

#[test]
fn samples_are_what_the_models_say() {
    let world = world(&[(1, 3)], 0.2);
    let (one, step) = (&world.data.demonstrations[0], 2);
    let sample = world.sample(one, step);
    let station = &world.data.station;
    let channels = station.layout.num_channels();
    // Frames 0, 0, 1, 2.
    let frames: Vec<&[f32]> = sample.input.chunks(4 * channels).collect();
    assert_eq!(frames.len(), 4);
    assert!(frames[0] == frames[1] && frames[1] != frames[2] && frames[2] != frames[3]);
    let activations: Vec<f32> = frames[3].chunks(4).map(|numbers| numbers[3]).collect();
    assert_eq!(activations, sample.contacts);
    assert!(sample.in_contact());
    // A taxel of a fingertip, by hand.
    let mut links = Vec::new();
    let joints = station.robot.num_dofs();
    kinematics(&station.robot, &one.read_joints[step * joints..][..joints], &mut links);
    let (idx, channel) = (5, &station.layout.channels[5]);
    let patch = &station.layout.patches[channel.patch];
    let taxel =
        links[world.data.hand_root].inverse() * links[patch.link] * patch.taxels_in_link[channel.taxel];
    for axis in 0..3 {
        assert!((frames[3][4 * idx + axis] - taxel[axis] as f32).abs() < 1e-6);
    }
    // The object's points lie on the object where the pose has it.
    let hand_from_object = pose(&sample.pose);
    let shape = SignedDistance::new(&world.data.objects[1].shape).expect("a solid");
    for point in sample.object_points.chunks(3) {
        let point = Point3::new(f64::from(point[0]), f64::from(point[1]), f64::from(point[2]));
        let distance_m = shape.distance_m(&(hand_from_object.inverse() * point));
        assert!(distance_m.abs() < 1e-5, "{distance_m}");
    }
}
