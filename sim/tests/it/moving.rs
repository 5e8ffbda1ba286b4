//! An object that moves during a take: only how hand and object move against each other counts.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use palpate_robot_model::{FixedBox, ObjectModel, ObjectPath, ObjectShape, Place, Station};
use palpate_sim::effects::{Effect, Sensed, TACTILE, TakeScene};
use palpate_sim::geometry::SignedDistance;
use palpate_sim::live::{LiveScene, LiveTouch};
use palpate_sim::replay::{ContactTrace, PatchTrace, ReplayError, contact_trace, contact_trace_among};
use palpate_sim::{SensorModel, Theta};
use proptest::prelude::*;

use crate::effects::scene::station;

const NUM_FRAMES: usize = 40;

/// What feels little, and, further out, what does not touch.
const THETA: Theta = Theta { lambda_con_m: 0.002, alpha_per_m: 250.0, lambda_pre_pa: 4_000.0 };

/// Three stages carry the pad of the bench: the joints move all of its sensors, and turn none.
fn bench() -> Station {
    station("probe_bench.toml")
}

/// base_from_pad of every frame.
fn pad_poses(station: &Station, positions: &[f64]) -> Vec<Isometry3<f64>> {
    let mut root_from_link = Vec::new();
    positions
        .chunks_exact(station.robot.num_dofs())
        .map(|frame| {
            station.robot.forward_kinematics(frame, &mut root_from_link);
            root_from_link[station.layout.patches[0].link]
        })
        .collect()
}

/// A path that comes down onto the object, slides over it and goes up again.
fn path(side_m: [f64; 2], depth_m: f64) -> Vec<f64> {
    (0..NUM_FRAMES)
        .flat_map(|frame| {
            let t = frame as f64 / (NUM_FRAMES - 1) as f64;
            let down_m = depth_m * (std::f64::consts::PI * t).sin();
            [0.03 + side_m[0] * t, 0.02 + side_m[1] * (7.0 * t).sin(), -down_m]
        })
        .collect()
}

/// The same touch twice: of an object that stands still and that the pad meets, and of the object that moves the other way
/// round in front of a pad that stays where it was in the first frame.
struct Twice {
    station: Station,
    object: ObjectModel,
    times_s: Vec<f64>,
    by_hand: (ObjectPath, Vec<f64>),
    by_object: (ObjectPath, Vec<f64>),
}

impl Twice {
    fn new(object: &str, side_m: [f64; 2], turn: [f64; 3]) -> Self {
        let station = bench();
        let object = station.objects[object].clone();
        let num_dofs = station.robot.num_dofs();
        let positions = path(side_m, 0.02);
        let pads = pad_poses(&station, &positions);
        // Below the pad, so that its lowest place presses: the depth follows from the turned shape itself.
        let distance = SignedDistance::new(&object.shape).expect("a shape");
        let lowest = pads[NUM_FRAMES / 2];
        let patch = &station.layout.patches[0];
        let face = lowest * patch.nodes[patch.nodes.len() / 2].pos_in_link;
        let turned = Isometry3::new(Vector3::zeros(), Vector3::from(turn));
        let below = |drop_m: f64| {
            Isometry3::from_parts((face - Vector3::z() * drop_m).coords.into(), turned.rotation)
        };
        let gap_m = |drop_m: f64| distance.distance_m(&(below(drop_m).inverse() * face));
        let (mut inside_m, mut outside_m) = (0.0, 0.2);
        for _ in 0..60 {
            let middle_m = 0.5 * (inside_m + outside_m);
            if gap_m(middle_m) < -0.002 { inside_m = middle_m } else { outside_m = middle_m }
        }
        let still = below(inside_m);
        let moving = pads.iter().map(|pad| pads[0] * pad.inverse() * still).collect();
        Self {
            object,
            times_s: (0..NUM_FRAMES).map(|frame| 0.04 * frame as f64).collect(),
            by_object: (ObjectPath::Moving(moving), positions[..num_dofs].repeat(NUM_FRAMES)),
            by_hand: (ObjectPath::Still(still), positions),
            station,
        }
    }

    fn trace(&self, (path, positions): &(ObjectPath, Vec<f64>)) -> ContactTrace {
        let distance = SignedDistance::new(&self.object.shape).expect("a shape");
        contact_trace(&self.station.robot, &self.station.layout, &distance, path, positions).expect("a path")
    }

    fn sense(&self, (path, positions): &(ObjectPath, Vec<f64>), model: &SensorModel) -> Sensed {
        let scene = TakeScene {
            station: &self.station,
            object: &self.object,
            base_from_object: path,
            surroundings: &[],
            frame_times_s: &self.times_s,
            positions,
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        };
        model.sense(&scene).expect("it fits")
    }
}

/// An object that is elsewhere than it is said to be, in every coordinate that its shape shows.
fn offset(station: &Station, object: &str) -> Effect {
    let kind = TACTILE.iter().find(|kind| kind.id() == "object_pose_offset").expect("it is an effect");
    let place = Place::Object(object.to_owned());
    let names = kind.parameters(&place, station).into_iter().map(|parameter| parameter.name.to_owned());
    Effect {
        id: kind.id().to_owned(),
        parameters: names.zip([0.001, -0.0005, 0.001, 0.05, -0.04, 0.03]).collect(),
        place,
        interval: [].into(),
        takes: Vec::new(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn an_object_that_moves_past_a_still_hand_is_felt_as_by_the_hand_that_moves_past_it(
        object in prop::sample::select(vec!["sphere_50mm", "cylinder_25x100mm", "wedge_80mm"]),
        side_m in prop::array::uniform2(-0.02..0.02_f64),
        turn in prop::array::uniform3(-1.0..1.0_f64),
    ) {
        let twice = Twice::new(object, side_m, turn);
        let (hand, moved) = (twice.trace(&twice.by_hand), twice.trace(&twice.by_object));
        let mut num_pressed = 0;
        for (hand, moved) in hand.patches.iter().zip(&moved.patches) {
            match (&**hand, &**moved) {
                (
                    PatchTrace::Proximity { min_distance_m: hand_m, .. },
                    PatchTrace::Proximity { min_distance_m: moved_m, .. },
                ) => {
                    for (hand_m, moved_m) in hand_m.iter().zip(moved_m) {
                        prop_assert!((hand_m - moved_m).abs() < 1e-9, "{hand_m} against {moved_m}");
                    }
                }
                (
                    PatchTrace::Pressure { offsets, entries },
                    PatchTrace::Pressure { offsets: moved_offsets, entries: moved_entries },
                ) => {
                    for frame in 0..NUM_FRAMES {
                        let of = |offsets: &[u32], entries: &[(u32, f64)]| -> std::collections::BTreeMap<u32, f64> {
                            entries[PatchTrace::entry_range(offsets, frame)].iter().copied().collect()
                        };
                        let (hand, moved) = (of(offsets, entries), of(moved_offsets, moved_entries));
                        // A node at the very surface may press by a rounding error or not at all.
                        for node in hand.keys().chain(moved.keys()) {
                            let of = |felt: &std::collections::BTreeMap<u32, f64>| felt.get(node).copied().unwrap_or(0.0);
                            let (hand_pa, moved_pa) = (of(&hand), of(&moved));
                            prop_assert!((hand_pa - moved_pa).abs() < 0.1, "{hand_pa} Pa against {moved_pa} Pa");
                            num_pressed += usize::from(hand_pa > 100.0);
                        }
                    }
                }
                _ => prop_assert!(false, "a patch has one kind"),
            }
        }
        prop_assert!(num_pressed > 0, "the path must press");

        // An effect that moves the object does so wherever it is.
        let mut model = SensorModel::plain("offset", THETA);
        let plain = twice.sense(&twice.by_object, &model);
        model.effects.push(offset(&twice.station, object));
        let (by_hand, by_object) = (twice.sense(&twice.by_hand, &model), twice.sense(&twice.by_object, &model));
        for (by_hand, by_object) in by_hand.load.iter().zip(&by_object.load) {
            prop_assert!((by_hand - by_object).abs() < 0.1, "{by_hand} against {by_object}");
        }
        prop_assert!(plain.load != by_object.load, "the effect is felt");
    }
}

#[test]
fn one_pose_for_every_frame_has_the_bits_of_an_object_that_stands_still() {
    let twice = Twice::new("wedge_80mm", [0.01, -0.01], [0.2, 0.1, 0.4]);
    let (path, positions) = &twice.by_hand;
    let same = (ObjectPath::Moving(vec![path.at(0); NUM_FRAMES]), positions.clone());
    assert!(twice.trace(&same) == twice.trace(&twice.by_hand));
    let mut model = SensorModel::plain("offset", THETA);
    model.effects.push(offset(&twice.station, "wedge_80mm"));
    assert!(twice.sense(&same, &model) == twice.sense(&twice.by_hand, &model));
}

#[test]
fn surroundings_are_felt_as_an_object_in_their_place_and_the_nearest_body_counts() {
    let twice = Twice::new("wedge_80mm", [0.01, -0.01], [0.2, 0.1, 0.4]);
    let (path, positions) = &twice.by_hand;
    // Larger than the wedge, so that the pad presses into it where it presses into the wedge.
    let size_m = [0.1, 0.09, 0.1];
    let block = ObjectShape::Box { size_m };
    let fixed = FixedBox { base_from_box: path.at(0), size_m };
    let far = ObjectPath::Still(Isometry3::translation(0.0, 0.0, -3.0));
    let among = |shape: &ObjectShape, surroundings: &[FixedBox], path: &ObjectPath| {
        let distance = SignedDistance::new(shape).expect("a shape");
        let Station { robot, layout, .. } = &twice.station;
        contact_trace_among(robot, layout, &distance, surroundings, path, positions).expect("a path")
    };
    let alone = among(&block, &[], path);
    let pressed = |trace: &ContactTrace| match &*trace.patches[0] {
        PatchTrace::Pressure { entries, .. } => entries.iter().map(|(_, pressure_pa)| pressure_pa).sum(),
        PatchTrace::Proximity { min_distance_m, .. } => -min_distance_m.iter().sum::<f64>(),
    };
    assert!(among(&block, &[fixed], &far) == alone, "beside an object that is far away");
    assert!(among(&block, &[fixed], path) == alone, "where the object is as well");
    let wedge = &twice.object.shape;
    assert!(among(wedge, &[fixed], &far) == alone && among(wedge, &[], path) == twice.trace(&twice.by_hand));
    let both = among(wedge, &[fixed], path);
    assert!(pressed(&both) >= pressed(&alone).max(pressed(&twice.trace(&twice.by_hand))));

    // The chain feels them too, and an effect on the object leaves them where they are.
    let mut model = SensorModel::plain("plain", THETA);
    let scene = |surroundings| TakeScene {
        station: &twice.station,
        object: &twice.object,
        base_from_object: &far,
        surroundings,
        tares: &[],
        frame_times_s: &twice.times_s,
        positions,
        arrival_times_s: &[],
        frozen_for_s: &[],
    };
    let surroundings = [fixed];
    let felt = model.sense(&scene(&surroundings)).expect("it fits");
    assert!(felt != model.sense(&scene(&[])).expect("it fits"));
    model.effects.push(offset(&twice.station, "wedge_80mm"));
    assert!(felt == model.sense(&scene(&surroundings)).expect("it fits"));
}

#[test]
fn a_moving_object_is_felt_live_as_it_is_replayed() {
    let twice = Twice::new("sphere_50mm", [0.01, 0.005], [0.0; 3]);
    let (path, positions) = &twice.by_object;
    let model = SensorModel::plain("plain", THETA);
    let scene = LiveScene::new(Arc::new(twice.station.clone()), &twice.object, &model, &[]).expect("a scene");
    let mut touch = LiveTouch::new(Arc::new(scene));
    let trace = twice.trace(&twice.by_object);
    let replayed = palpate_sim::tactile::readings(&twice.station.layout, &trace, &model.thetas());
    for (frame, positions) in positions.chunks_exact(twice.station.robot.num_dofs()).enumerate() {
        let live = touch.feel(twice.times_s[frame], positions, &path.at(frame)).expect("a frame");
        assert_eq!(live.raw, replayed.raw_frame(frame), "frame {frame}");
        assert_eq!(live.active, replayed.active_frame(frame), "frame {frame}");
    }
    assert!(replayed.active.contains(&true) && replayed.active.contains(&false));
}

#[test]
fn as_many_poses_as_frames_are_wanted_and_all_of_them_finite() {
    let twice = Twice::new("sphere_50mm", [0.0; 2], [0.0; 3]);
    let distance = SignedDistance::new(&twice.object.shape).expect("a shape");
    let (path, positions) = &twice.by_object;
    let replay = |poses: Vec<Isometry3<f64>>| {
        let path = ObjectPath::Moving(poses);
        contact_trace(&twice.station.robot, &twice.station.layout, &distance, &path, positions)
            .expect_err("refused")
    };
    let error = replay(path.poses()[1..].to_vec());
    assert_eq!(
        error.to_string(),
        "failed to replay: the moving object has 39 poses, but the joint path has 40 frames; give one pose for each frame"
    );
    let mut lost = path.poses().to_vec();
    lost[6].translation.y = f64::NAN;
    let error = replay(lost);
    assert!(matches!(error, ReplayError::NonFiniteObjectPose { frame: 6, .. }), "{error}");
}
