//! Touch frame by frame is what a replay gives.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, Vector3};
use palpate_robot_model::{ObjectShape, Place, SensorKind, Station};
use palpate_sim::effects::{self, Effect, TACTILE};
use palpate_sim::geometry::SignedDistance;
use palpate_sim::live::{LiveScene, LiveTouch};
use palpate_sim::replay::{ReplayError, contact_trace};
use palpate_sim::tactile::{self, Readings};
use palpate_sim::{Response, SensorModel, StreamTheta, Theta};
use proptest::prelude::*;

use crate::effects::scene::{INDEX, PALM, THETA, Take, station, take};

fn live_readings(station: &Station, take: &Take, model: &SensorModel) -> Vec<Readings> {
    let scene = LiveScene::new(Arc::new(station.clone()), &take.object, model, &[]).expect("a scene");
    let mut touch = LiveTouch::new(Arc::new(scene));
    let frames = take.times_s.iter().zip(take.clean.chunks_exact(station.robot.num_dofs()));
    frames
        .map(|(&time_s, positions)| {
            touch.feel(time_s, positions, &take.base_from_object.at(0)).expect("a frame")
        })
        .collect()
}

fn replayed(station: &Station, take: &Take, model: &SensorModel, num_frames: usize) -> Readings {
    let positions = &take.clean[..num_frames * station.robot.num_dofs()];
    let mut scene = take.scene(station, positions);
    scene.frame_times_s = &take.times_s[..num_frames];
    let distance = SignedDistance::new(&take.object.shape).expect("a shape");
    let trace = contact_trace(&station.robot, &station.layout, &distance, &take.base_from_object, positions)
        .expect("a path");
    model.readings(&scene, &trace).expect("readings")
}

fn assert_same(live: &Readings, replayed: &Readings, frame: usize, what: &str) {
    assert_eq!(live.active, replayed.active_frame(frame), "{what}, frame {frame}");
    let bits = |raw: &[f64]| raw.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&live.raw), bits(replayed.raw_frame(frame)), "{what}, frame {frame}");
}

#[test]
fn a_plain_model_reads_what_it_reads_in_a_replay_to_the_bit() {
    let station = station("xarm6_leap.toml");
    let model = SensorModel::plain("plain", THETA);
    for plan in [&INDEX, &PALM] {
        let take = take(&station, plan, 2, 7);
        let all = replayed(&station, &take, &model, take.times_s.len());
        assert!(all.active.iter().any(|on| *on), "the take touches");
        for (frame, live) in live_readings(&station, &take, &model).iter().enumerate() {
            assert_same(live, &all, frame, plan.patch);
        }
    }
}

#[test]
fn every_effect_acts_as_in_a_replay_to_the_bit() {
    let station = station("xarm6_leap.toml");
    let take = take(&station, &INDEX, 1, 7);
    let last = take.times_s.len();
    for kind in TACTILE {
        let place = kind.places(&station).into_iter().next().expect("a place");
        let parameters = kind.parameters(&place, &station);
        let dosed = |p: &palpate_sim::effects::Parameter| (p.name.clone(), p.neutral + p.dose);
        let effect = Effect {
            id: kind.id().to_owned(),
            place,
            parameters: parameters.iter().map(dosed).collect(),
            interval: BTreeMap::new(),
            takes: Vec::new(),
        };
        let model = SensorModel { effects: vec![effect], ..SensorModel::plain("dosed", THETA) };
        let live = live_readings(&station, &take, &model);
        for num_frames in [1, last / 3, last / 2, last] {
            let so_far = replayed(&station, &take, &model, num_frames);
            assert_same(&live[num_frames - 1], &so_far, num_frames - 1, kind.id());
        }
        if !kind.looks_ahead() {
            let all = replayed(&station, &take, &model, last);
            for (frame, live) in live.iter().enumerate() {
                assert_same(live, &all, frame, kind.id());
            }
        }
    }
}

#[test]
fn forces_that_creep_by_turns_do_so_as_in_a_replay_to_the_bit() {
    let station = station("xarm6_leap.toml");
    let of = |id: &str, stream: &str, parameters: &[(&str, f64)]| Effect {
        id: id.to_owned(),
        place: Place::Stream(stream.to_owned()),
        parameters: parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
        interval: BTreeMap::new(),
        takes: Vec::new(),
    };
    let creep = |stream: &str, time_constant_s: f64, exponent: f64| {
        let late = [("fraction", 0.08), ("time_constant_s", time_constant_s), ("exponent", exponent)];
        of("creep", stream, &late)
    };
    let mut effects = Vec::new();
    for stream in ["twintac", "fsr"] {
        // The first three act on the same force, one after the other; the others each on its own.
        effects.extend([0.3, 3.0, 30.0].map(|time_constant_s| creep(stream, time_constant_s, 1.7)));
        effects.push(creep(stream, 1.0, 0.6));
        effects.push(of("viscoelastic_release", stream, &[("fraction", 0.4), ("time_constant_s", 0.3)]));
        effects.push(of("low_pass", stream, &[("time_constant_s", 0.05)]));
    }
    let model = SensorModel { effects, ..SensorModel::plain("creeps", THETA) };
    for plan in [&INDEX, &PALM] {
        let take = take(&station, plan, 1, 7);
        let all = replayed(&station, &take, &model, take.times_s.len());
        assert!(all.raw.iter().any(|raw| *raw > 0.0), "the take touches");
        for (frame, live) in live_readings(&station, &take, &model).iter().enumerate() {
            assert_same(live, &all, frame, plan.patch);
        }
    }
}

/// An effect of the kind `kind`, somewhere, with its parameters `sizes` doses from neutral, within their bounds.
fn some_effect(station: &Station, kind: usize, place: usize, sizes: [f64; 3]) -> Effect {
    let kind = TACTILE[kind];
    let places = kind.places(station);
    let place = places[place % places.len()].clone();
    let parameters = kind.parameters(&place, station).into_iter().zip(sizes.into_iter().cycle());
    let sized = parameters.map(|(parameter, size)| {
        let value = parameter.neutral + size * parameter.dose;
        (parameter.name, value.clamp(parameter.lower, parameter.upper))
    });
    let (id, parameters) = (kind.id().to_owned(), sized.collect());
    Effect { id, place, parameters, interval: BTreeMap::new(), takes: Vec::new() }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn effects_together_act_as_in_a_replay_to_the_bit(
        chosen in prop::collection::vec((0..TACTILE.len(), 0_usize..1000, prop::array::uniform3(0.0..3.0_f64)), 0..7),
        off_fraction in 0.3..=1.0_f64,
        pad_softness_m in prop_oneof![Just(0.0), 1e-4..1e-3_f64],
        on_palm in any::<bool>(),
    ) {
        let station = station("xarm6_leap.toml");
        let take = take(&station, if on_palm { &PALM } else { &INDEX }, 1, 7);
        let looks_ahead = |effect: &Effect| effects::tactile(&effect.id).is_some_and(|kind| kind.looks_ahead());
        let mut chosen: Vec<Effect> = chosen
            .into_iter()
            .map(|(kind, place, sizes)| some_effect(&station, kind, place, sizes))
            .filter(|effect| !looks_ahead(effect))
            .collect();
        // What every replay has, so that what is remembered is felt.
        chosen.push(some_effect(&station, 0, 9, [1.0; 3]));
        let off_fractions = station.layout.streams.iter().map(|stream| (stream.id.clone(), off_fraction));
        let response = Response { off_fractions: off_fractions.collect(), pad_softness_m, ..Response::default() };
        let model = SensorModel { effects: chosen, response, ..SensorModel::plain("several", THETA) };
        let all = replayed(&station, &take, &model, take.times_s.len());
        for (frame, live) in live_readings(&station, &take, &model).iter().enumerate() {
            assert_same(live, &all, frame, &model.to_toml());
        }
    }
}

/// The hand with two skins of each kind: the fingertips and the patches are two streams each, parted at channels 8 and 33.
fn with_two_skins_of_each_kind() -> Station {
    let mut station = station("xarm6_leap.toml");
    let layout = &mut station.layout;
    let parts = [(0, 0..8), (0, 8..32), (1, 32..33), (1, 33..44)];
    let old = layout.streams.clone();
    layout.streams = parts
        .iter()
        .enumerate()
        .map(|(idx, (of, channels))| palpate_robot_model::Stream {
            id: format!("s{idx}"),
            channels: channels.clone(),
            ..old[*of].clone()
        })
        .collect();
    let stream_of =
        |channel: usize| parts.iter().position(|(_, channels)| channels.contains(&channel)).expect("one");
    for (idx, channel) in layout.channels.iter_mut().enumerate() {
        channel.stream = stream_of(idx);
    }
    for patch in &mut layout.patches {
        patch.stream = stream_of(patch.channels.start);
    }
    station
}

#[test]
fn a_stream_with_its_own_theta_reads_what_it_reads_where_all_share_it() {
    let station = with_two_skins_of_each_kind();
    let thetas = [
        Theta { lambda_con_m: 0.0, alpha_per_m: 80.0, lambda_pre_pa: 9_000.0 },
        Theta { lambda_con_m: 0.0, alpha_per_m: 600.0, lambda_pre_pa: 40_000.0 },
        Theta { lambda_con_m: 0.006, ..THETA },
        Theta { lambda_con_m: 0.001, ..THETA },
    ];
    let streams = station.layout.streams.iter().zip(&thetas);
    let own: BTreeMap<String, StreamTheta> = streams
        .map(|(stream, theta)| (stream.id.clone(), StreamTheta::of_kind(stream.kind, theta)))
        .collect();
    let off_fractions = own.keys().map(|id| (id.clone(), 0.7)).collect();
    let soft = Response { off_fractions, pad_softness_m: 3e-4, ..Response::default() };
    for (response, plan) in
        [Response::default(), soft].into_iter().flat_map(|of| [(of.clone(), &INDEX), (of, &PALM)])
    {
        let take = take(&station, plan, 1, 7);
        let shared =
            |theta| SensorModel { response: response.clone(), ..SensorModel::plain("shared", theta) };
        let mixed = SensorModel { streams: own.clone(), ..shared(THETA) };
        let all = replayed(&station, &take, &mixed, take.times_s.len());
        for (frame, live) in live_readings(&station, &take, &mixed).iter().enumerate() {
            assert_same(live, &all, frame, plan.patch);
        }
        let mut differs = 0;
        for (stream, theta) in station.layout.streams.iter().zip(&thetas) {
            let alone = replayed(&station, &take, &shared(*theta), take.times_s.len());
            let nominal = replayed(&station, &take, &shared(THETA), take.times_s.len());
            for frame in 0..take.times_s.len() {
                let of = |readings: &Readings| {
                    let raw: Vec<u64> =
                        readings.raw_frame(frame).iter().map(|value| value.to_bits()).collect();
                    (
                        raw[stream.channels.clone()].to_vec(),
                        readings.active_frame(frame)[stream.channels.clone()].to_vec(),
                    )
                };
                assert_eq!(of(&all), of(&alone), "{} at frame {frame} of {}", stream.id, plan.patch);
                differs += usize::from(of(&all).1 != of(&nominal).1);
            }
        }
        assert!(differs > 0, "own parameters change what {} reads", plan.patch);
    }
}

#[test]
fn strengths_rise_with_touch_and_every_event_has_one() {
    let station = station("xarm6_leap.toml");
    let model = SensorModel::plain("plain", THETA);
    for plan in [&INDEX, &PALM] {
        let take = take(&station, plan, 1, 7);
        let scene = LiveScene::new(Arc::new(station.clone()), &take.object, &model, &[]).expect("a scene");
        let mut strongest = vec![0.0_f32; station.layout.num_channels()];
        let mut pairs: Vec<(f64, f32)> = Vec::new();
        for readings in live_readings(&station, &take, &model) {
            let strengths = scene.strengths(&readings.raw);
            for (channel, (&strength, &on)) in strengths.iter().zip(&readings.active).enumerate() {
                assert!(
                    (0.0..=1.0).contains(&strength) && (!on || strength > 0.0),
                    "{strength} of {channel}"
                );
                strongest[channel] = strongest[channel].max(strength);
                let is_pressure = station.layout.streams[station.layout.channels[channel].stream].kind
                    == SensorKind::Pressure;
                // More pressure, or less distance.
                let touch = if is_pressure { readings.raw[channel] } else { -readings.raw[channel] };
                if channel == station.layout.patches[0].channels.start {
                    pairs.push((touch, strength));
                }
            }
        }
        pairs.sort_by(|one, other| one.0.total_cmp(&other.0));
        assert!(pairs.windows(2).all(|pair| pair[0].1 <= pair[1].1), "{pairs:?}");
        assert!(strongest.iter().any(|&strength| strength > 0.1), "{} is touched", plan.patch);
    }
}

#[test]
fn a_moving_object_is_felt_where_it_is() {
    let station = station("xarm6_leap.toml");
    let model = SensorModel::plain("plain", THETA);
    let take = take(&station, &INDEX, 1, 7);
    let scene = LiveScene::new(Arc::new(station.clone()), &take.object, &model, &[]).expect("a scene");
    let mut touch = LiveTouch::new(Arc::new(scene));
    let distance = SignedDistance::new(&take.object.shape).expect("a shape");
    let mut any_active = false;
    for (frame, positions) in take.clean.chunks_exact(station.robot.num_dofs()).enumerate() {
        let slide = Translation3::from(Vector3::x() * 0.002 * (frame as f64 * 0.3).sin());
        let pose = slide * take.base_from_object.at(0);
        let live = touch.feel(take.times_s[frame], positions, &pose).expect("a frame");
        let trace = contact_trace(&station.robot, &station.layout, &distance, &pose.into(), positions)
            .expect("a frame");
        assert_same(&live, &tactile::readings(&station.layout, &trace, &model.thetas()), 0, "moving");
        any_active |= live.active.iter().any(|on| *on);
    }
    assert!(any_active);
}

#[test]
fn what_stands_still_is_felt_beside_the_object_and_the_nearer_counts() {
    let station = Arc::new(station("xarm6_leap.toml"));
    // A proximity threshold far out, so that distances are seen, and a soft touch.
    let theta = Theta { lambda_con_m: 0.04, alpha_per_m: 250.0, lambda_pre_pa: 1.0 };
    let model = SensorModel::plain("plain", theta);
    let take = take(&station, &INDEX, 1, 7);
    let positions = &take.clean[..station.robot.num_dofs()];
    let mut link_poses = Vec::new();
    station.robot.forward_kinematics(positions, &mut link_poses);
    let tip = station.layout.patches.iter().find(|patch| patch.id == "index_tip").expect("a patch");
    let far = Isometry3::translation(0.0, 0.0, -5.0);
    // A block around the tip: every node is inside of it.
    let block = (link_poses[tip.link], ObjectShape::Box { size_m: [0.2; 3] });
    let ball = (link_poses[tip.link], ObjectShape::Sphere { radius_m: 0.15 });
    let feel = |object: &Isometry3<f64>, fixed: &[(Isometry3<f64>, ObjectShape)]| {
        let scene = LiveScene::new(Arc::clone(&station), &take.object, &model, fixed).expect("a scene");
        LiveTouch::new(Arc::new(scene)).feel(0.0, positions, object).expect("a frame")
    };
    let there = take.base_from_object.at(0);
    let alone = feel(&there, &[]);
    let nothing = feel(&far, &[]);
    assert!(nothing.active.iter().all(|on| !on));
    assert_eq!(feel(&there, &[(far, block.1.clone())]), alone, "what is far changes nothing");
    let (in_block, in_ball) =
        (feel(&far, std::slice::from_ref(&block)), feel(&far, std::slice::from_ref(&ball)));
    assert!(in_block.active[tip.channels.start]);
    let in_both = feel(&far, &[block, ball]);
    for (idx, channel) in station.layout.channels.iter().enumerate() {
        let (one, other, both) = (in_block.raw[idx], in_ball.raw[idx], in_both.raw[idx]);
        match station.layout.streams[channel.stream].kind {
            SensorKind::Proximity => assert_eq!(both, one.min(other), "{}", channel.id),
            SensorKind::Pressure => {
                assert!(both >= one.max(other), "{}: {both} of {one} and {other}", channel.id);
            }
        }
    }
}

#[test]
fn frames_that_cannot_be_felt_are_refused() {
    let station = station("xarm6_leap.toml");
    let object = station.objects["sphere_50mm"].clone();
    let num_dofs = station.robot.num_dofs();
    let model = SensorModel::plain("plain", THETA);
    let scene = LiveScene::new(Arc::new(station), &object, &model, &[]).expect("a scene");
    let mut touch = LiveTouch::new(Arc::new(scene));
    let (home, pose) = (vec![0.0; num_dofs], Isometry3::identity());
    touch.feel(1.0, &home, &pose).expect("a frame");
    assert!(matches!(touch.feel(1.0, &home, &pose), Err(ReplayError::TimeNotIncreasing { .. })));
    assert!(matches!(touch.feel(f64::NAN, &home, &pose), Err(ReplayError::TimeNotIncreasing { .. })));
    assert!(matches!(
        touch.feel(2.0, &[home.clone(), home.clone()].concat(), &pose),
        Err(ReplayError::RaggedPath { .. })
    ));
    assert!(matches!(touch.feel(2.0, &[], &pose), Err(ReplayError::RaggedPath { .. })));
    let nan = vec![f64::NAN; num_dofs];
    assert!(matches!(touch.feel(2.0, &nan, &pose), Err(ReplayError::NonFinitePosition { .. })));
    let lost = Isometry3::translation(f64::NAN, 0.0, 0.0);
    assert!(matches!(touch.feel(2.0, &home, &lost), Err(ReplayError::NonFiniteObjectPose { .. })));
    touch.restart();
    touch.feel(0.0, &home, &pose).expect("time starts again");
}
