use std::collections::BTreeMap;

use palpate_cloning::{CloneConfig, Episode, Episodes, Step, Touch, Trainer};
use palpate_encoder::{Dataset, EncoderConfig, NetworkConfig, Sample, history_steps};

use super::*;
use crate::policy::{ClonedPolicy, Policy as _, Seen};
use crate::task;

const STEPS: usize = 9;
const HISTORY: usize = 4;

fn asset(path: &str) -> Vec<u8> {
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
    std::fs::read(assets.join(path)).expect("a shipped file")
}

fn world() -> (Arc<Station>, GraspConfig) {
    let read = |name: &str| Ok(asset(&format!("stations/{name}")));
    let station = Station::read("xarm6_leap.toml", read).expect("the shipped station");
    let text = String::from_utf8(asset("grasp/xarm6_leap.toml")).expect("text");
    let world = GraspConfig::from_toml("world", &text, &station.robot).expect("the shipped world");
    (Arc::new(station), world)
}

/// Samples of a hand with these channels and joints that mean nothing.
struct Waves {
    channels: usize,
    joints: usize,
}

impl Dataset for Waves {
    fn len(&self) -> usize {
        8
    }

    fn num_channels(&self) -> usize {
        self.channels
    }

    fn num_joints(&self) -> usize {
        self.joints
    }

    fn sample(&self, idx: usize) -> Sample {
        let wave = |len: usize, size: f32| -> Vec<f32> {
            (0..len).map(|i| size * (idx as f32 + i as f32 * 0.7).sin()).collect()
        };
        Sample {
            input: wave(HISTORY * self.channels * 4, 0.1),
            hand_points: wave(2 * 3, 0.1),
            object_points: wave(2 * 3, 0.1),
            pose: [0.1, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0],
            joints: wave(self.joints, 0.5),
            contacts: vec![1.0; self.channels],
        }
    }
}

/// An encoder that has learned nothing, for a hand with these channels and joints.
fn encoder_of(channels: usize, joints: usize) -> EncoderFile {
    let network = NetworkConfig {
        width: 6,
        layers: 1,
        decoder_layers: 1,
        heads: 2,
        feed_forward: 8,
        points_per_query: 2,
    };
    let config = EncoderConfig {
        history: HISTORY,
        batch_size: 4,
        hand_points: 2,
        object_points: 2,
        network,
        ..EncoderConfig::default()
    };
    let trainer = palpate_encoder::Trainer::new(config, &Waves { channels, joints }, BTreeMap::new());
    let bytes = trainer.expect("it fits").encoder().to_bytes().expect("a file");
    let sha256 = sha256(&bytes);
    EncoderFile { bytes, sha256, num_features: 6 }
}

fn encoder(station: &Station) -> EncoderFile {
    encoder_of(station.layout.num_channels(), station.robot.num_dofs())
}

fn observation() -> ObservationConfig {
    ObservationConfig { frames: 2, stride: 2, features: true, ..ObservationConfig::default() }
}

/// What was read, commanded and felt in the step numbered `step` of a trial in which everything moves.
fn moment(station: &Station, world: &GraspConfig, step: usize) -> (Vec<f64>, Vec<f64>, Vec<bool>) {
    let commands: Vec<f64> = world
        .start_positions(&station.robot)
        .iter()
        .enumerate()
        .map(|(dof, at)| at + 0.01 * (step as f64 + dof as f64).sin())
        .collect();
    let read = commands.iter().enumerate().map(|(dof, at)| at - 0.003 * (dof as f64).cos()).collect();
    let active =
        (0..station.layout.num_channels()).map(|channel| (channel + step).is_multiple_of(3)).collect();
    (read, commands, active)
}

/// What `features` makes of each step of that trial, as at work; `spoil` may change what is seen.
fn at_work(features: &Arc<Features>, spoil: impl Fn(&mut (Vec<f64>, Vec<f64>, Vec<bool>))) -> Vec<Vec<f32>> {
    let (station, world) = world();
    let mut run = FeatureRun::new(Arc::clone(features));
    let mut see = |step: usize| {
        let mut seen = moment(&station, &world, step);
        spoil(&mut seen);
        let (positions, commands, active) = &seen;
        let time_s = 0.05 * step as f64;
        run.see(&Moment { time_s, positions, commands, touch: Touch::Events(active), features: &[] })
            .expect("features")
    };
    (0..STEPS).map(&mut see).collect()
}

fn bits(features: &[Vec<f32>]) -> Vec<Vec<u32>> {
    features.iter().map(|numbers| numbers.iter().map(|number| number.to_bits()).collect()).collect()
}

/// The trial as it is kept, without features.
fn kept(station: &Station, world: &GraspConfig) -> Episode {
    let shape = task::robot(station, world).shape();
    let mut episode = Episode::default();
    for step in 0..STEPS {
        let (positions, commands, active) = moment(station, world, step);
        let moment = Moment {
            time_s: 0.05 * step as f64,
            positions: &positions,
            commands: &commands,
            touch: Touch::Events(&active),
            features: &[],
        };
        episode.push(shape, &Step { moment, targets: &commands, claims_held: false });
    }
    episode
}

#[test]
fn training_sees_the_bits_that_a_policy_sees() {
    let (station, world) = world();
    let file = encoder(&station);
    let shape = task::robot(&station, &world).shape();
    for observation in [observation(), ObservationConfig { tracking: false, ..observation() }] {
        let features = Features::new(&file, &observation, Arc::clone(&station), &world).expect("it fits");
        let features = Arc::new(features);
        let seen = at_work(&features, |_| ());
        let mut run = FeatureRun::new(features);
        let episode = kept(&station, &world);
        let frames = episode.frames.chunks(shape.frame_len());
        let learned: Vec<Vec<f32>> = frames.map(|frame| run.see_frame(frame).expect("features")).collect();
        assert_eq!(bits(&seen), bits(&learned));
        assert!(seen.windows(2).all(|pair| pair[0] != pair[1]), "everything moves");
    }
}

#[test]
fn the_encoder_is_told_what_its_pretraining_was_told() {
    let (station, world) = world();
    let features = Features::new(&encoder(&station), &observation(), Arc::clone(&station), &world);
    let features = Arc::new(features.expect("it fits"));
    let frame_len = 4 * station.layout.num_channels();
    let mut frames = Vec::new();
    for step in 0..STEPS {
        let (positions, _, active) = moment(&station, &world, step);
        let positions: Vec<f32> = positions.iter().map(|&position| position as f32).collect();
        let mut frame = Vec::new();
        let touch = active.into_iter().map(|on| f32::from(u8::from(on)));
        features.taxels.push_frame(&station.robot, &positions, touch, &mut frame);
        frames.push(frame);
    }
    let mut run = FeatureRun::new(Arc::clone(&features));
    let shape = task::robot(&station, &world).shape();
    for (step, frame) in kept(&station, &world).frames.chunks(shape.frame_len()).enumerate() {
        let newest = run.points(frame);
        let input = run.window(newest, HISTORY);
        let expected = history_steps(step, HISTORY).map(|step| &frames[step]);
        for (found, expected) in input.chunks(frame_len).zip(expected) {
            // What was read is the command less the error, both of them rounded.
            let near = |(found, expected): (&f32, &f32)| (found - expected).abs() < 1e-6;
            assert!(found.iter().zip(expected).all(near), "step {step}");
        }
    }
}

#[test]
fn points_are_the_newest_frame_that_an_encoder_would_be_told() {
    let (station, world) = world();
    let points = Features::points(&observation(), Arc::clone(&station), &world).expect("they fit");
    let encoding =
        Features::new(&encoder(&station), &observation(), Arc::clone(&station), &world).expect("it fits");
    assert_eq!(points.num_features(), POINT * station.layout.num_channels());
    let (mut seen, mut encoded) = (FeatureRun::new(Arc::new(points)), FeatureRun::new(Arc::new(encoding)));
    let shape = task::robot(&station, &world).shape();
    for frame in kept(&station, &world).frames.chunks(shape.frame_len()) {
        let found = seen.see_frame(frame).expect("points");
        let newest = encoded.points(frame);
        let window = encoded.window(newest, HISTORY);
        assert_eq!(found, window[window.len() - found.len()..]);
    }
}

#[test]
fn what_a_policy_may_not_see_its_encoder_may_not_see_either() {
    let (station, world) = world();
    let file = encoder(&station);
    let of = |touch: bool, tracking: bool| {
        let observation = ObservationConfig { touch, tracking, ..observation() };
        Arc::new(Features::new(&file, &observation, Arc::clone(&station), &world).expect("it fits"))
    };
    let silenced = |seen: &mut (Vec<f64>, Vec<f64>, Vec<bool>)| seen.2.fill(false);
    let exact = |seen: &mut (Vec<f64>, Vec<f64>, Vec<bool>)| seen.0.clone_from(&seen.1);
    assert_eq!(at_work(&of(false, true), |_| ()), at_work(&of(false, true), silenced));
    assert_ne!(at_work(&of(true, true), |_| ()), at_work(&of(true, true), silenced));
    assert_eq!(at_work(&of(true, false), |_| ()), at_work(&of(true, false), exact));
    assert_ne!(at_work(&of(true, true), |_| ()), at_work(&of(true, true), exact));
}

#[test]
fn an_encoder_for_another_hand_is_refused_by_name() {
    let (station, mut world) = world();
    let good = encoder(&station);
    let (channels, joints) = (station.layout.num_channels(), station.robot.num_dofs());
    let refused = |file: &EncoderFile, world: &GraspConfig| {
        let features = Features::new(file, &observation(), Arc::clone(&station), world);
        format!("{:#}", features.expect_err("it does not fit"))
    };
    let problem = refused(&encoder_of(channels + 1, joints), &world);
    let expected = format!(
        "pretrained on a hand with {} channels, the station {:?} has {channels}",
        channels + 1,
        station.id
    );
    assert!(problem.contains(&expected), "{problem}");
    assert!(refused(&encoder_of(channels, joints - 1), &world).contains("joints"));
    let narrow = EncoderFile { num_features: 5, ..good.clone() };
    assert!(refused(&narrow, &world).contains("makes 6 features, the policy expects 5"));
    let mut altered = good.clone();
    altered.bytes.push(0);
    assert!(refused(&altered, &world).contains("it was altered"));
    world.hand_root = "no_such_link".to_owned();
    assert!(refused(&good, &world).contains("hand_root is \"no_such_link\""));
}

/// A policy that has learned nothing and sees features of `file`.
fn policy_with(file: EncoderFile, station: &Station, world: &GraspConfig) -> Cloned {
    let robot = task::robot(station, world);
    let config = CloneConfig {
        batch_size: 4,
        trunk: vec![16],
        observation: observation(),
        predicted: 4,
        executed: 2,
        ..CloneConfig::default()
    };
    let shape = Shape { features: file.num_features, ..robot.shape() };
    let features: Vec<f32> = (0..STEPS * file.num_features).map(|i| (i as f32).sin()).collect();
    let episode = kept(station, world).with_features(robot.shape(), file.num_features, &features);
    let episodes = Episodes::new(shape, vec![episode]).and_then(|all| all.encoded_by(Arc::new(file)));
    let trainer = Trainer::new(config, robot, &episodes.expect("they fit"), BTreeMap::new());
    trainer.expect("it fits").cloned()
}

#[test]
fn a_rollout_plans_with_the_features_of_the_policys_own_encoder() {
    let (station, world) = world();
    let policy = Arc::new(policy_with(encoder(&station), &station, &world));
    let mut rolled =
        ClonedPolicy::new(Arc::clone(&policy), Arc::clone(&station), &world, None).expect("it fits");
    let features = Features::of_policy(&policy, &station, &world).expect("it fits").expect("it has some");
    let (start, _, _) = moment(&station, &world, 0);
    // Twice, because a trial remembers nothing of the one before.
    for trial in 1..=2 {
        rolled.begin(&start);
        let (mut run, mut history) =
            (FeatureRun::new(Arc::clone(&features)), policy.history(None).expect("no region"));
        let mut commands = vec![start.clone()];
        let mut seen = VecDeque::new();
        let mut num_seen = 0;
        for step in 0..STEPS {
            let (positions, _, active) = moment(&station, &world, step);
            let command = commands[step.min(commands.len() - 1)].clone();
            let now = Moment {
                time_s: 0.05 * step as f64,
                positions: &positions,
                commands: &command,
                touch: Touch::Events(&active),
                features: &[],
            };
            let made = run.see(&now).expect("features");
            history.see(&Moment { features: &made, ..now });
            num_seen += 1;
            seen.push_back(Seen { time_s: now.time_s, positions: positions.clone(), active: active.clone() });
            if step % 2 == 1 {
                continue;
            }
            let found = rolled.plan(&seen).expect("a plan");
            let last = commands.last().expect("a command").clone();
            let expected = policy.plan(&history, &last, [trial, num_seen]).expect("a plan");
            for (found, expected) in found.iter().zip(&expected) {
                let limits = station.safety.joints.iter();
                let within = expected.targets.iter().zip(limits).map(|(at, to)| at.clamp(to.lower, to.upper));
                assert_eq!(found.targets, within.collect::<Vec<_>>());
            }
            commands.extend(found.into_iter().map(|step| step.targets));
            seen.clear();
        }
    }
    let other = Arc::new(policy_with(encoder_of(3, 2), &station, &world));
    let problem = ClonedPolicy::new(other, Arc::clone(&station), &world, None);
    let problem = format!("{:#}", problem.err().expect("another hand"));
    assert!(
        problem.contains("the policy's encoder does not fit") && problem.contains("3 channels"),
        "{problem}"
    );
}
