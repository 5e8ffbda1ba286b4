use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use super::*;
use crate::episodes::tests::{encoded, encoder, features_of, reaching};
use crate::{
    ActConfig, ActLoss, Data, DiffusionConfig, Episode, Finish, Moment, ObservationConfig, Predicts,
    RecurrentConfig, Run, Shape, Start, Step, Touch, TrainingDevice, train,
};

fn robot() -> Robot {
    Robot { joints: vec!["slide".to_owned()], channels: vec!["tip".to_owned()], control_rate_hz: 20.0 }
}

fn config(head: Head) -> CloneConfig {
    CloneConfig {
        updates: 300,
        batch_size: 48,
        learning_rate: 3e-3,
        warmup_updates: 10,
        average_decay: 0.95,
        checkpoint_updates: 20,
        held_out_share: 0.2,
        predicted: 4,
        executed: 2,
        observation: ObservationConfig { frames: 3, stride: 2, ..ObservationConfig::default() },
        trunk: vec![32, 24],
        head,
        diffusion: DiffusionConfig {
            channels: [8, 12],
            kernel: 3,
            steps: 12,
            sampled_steps: 6,
            predicts: None,
        },
        act: Some(act(ActLoss::Absolute)),
        ..CloneConfig::default()
    }
}

fn act(loss: ActLoss) -> ActConfig {
    ActConfig {
        width: 12,
        heads: 2,
        feed_forward: 16,
        layers: 1,
        style_layers: 1,
        style: 3,
        divergence_weight: 0.5,
        loss,
    }
}

/// A configuration of a diffusion that predicts the noise.
fn of_noise() -> CloneConfig {
    let config = config(Head::Diffusion);
    let diffusion = DiffusionConfig { predicts: Some(Predicts::Noise), ..config.diffusion };
    CloneConfig { diffusion, ..config }
}

fn recurrent(head: Head) -> CloneConfig {
    CloneConfig { memory: Memory::Recurrent, recurrent: RecurrentConfig { width: 12 }, ..config(head) }
}

fn paces() -> Vec<f64> {
    (0..20).map(|idx| 0.05 + 0.005 * f64::from(idx)).collect()
}

fn trained(config: CloneConfig) -> Trainer {
    let [learned, _] = reaching(&paces(), 25).split(&config);
    let mut trainer = Trainer::new(config, robot(), &learned, BTreeMap::new()).expect("it fits");
    while trainer.updates() < trainer.config().updates {
        trainer.update(&learned).expect("an update");
    }
    trainer
}

/// Where the joint is after `steps` of the policy, and whether it claims to be there.
fn rolled_out(policy: Cloned, pace: f64, steps: usize) -> (f64, bool) {
    let (mut run, mut command, mut claims) =
        (Run::new(Arc::new(policy), 0, None).expect("it sees no region"), 0.0, false);
    for step in 0..steps {
        let time_s = 0.05 * step as f64;
        let (positions, active) = ([command - 0.1 * pace], [command >= 0.99]);
        let now = Moment {
            time_s,
            positions: &positions,
            commands: &[command],
            touch: Touch::Events(&active),
            features: &[],
        };
        let next = run.next(&now).expect("a step");
        (command, claims) = (next.targets[0], next.claims_held);
    }
    (command, claims)
}

#[test]
fn all_heads_learn_to_reach_and_to_say_so() {
    for config in [config(Head::Regression), config(Head::Diffusion), of_noise(), config(Head::Act)] {
        let name = format!("{:?}, {:?}", config.head, config.diffusion.predicts);
        let trainer = trained(config.clone());
        let [_, held_out] = reaching(&paces(), 25).split(&config);
        let untrained =
            Trainer::new(config, robot(), &reaching(&paces(), 25), BTreeMap::new()).expect("it fits");
        let [before, after] = [&untrained, &trainer].map(|trainer| trainer.judge(&held_out).expect("a loss"));
        assert!(after < 0.5 * before, "{name}: {before} became {after}");
        let (reached, claims) = rolled_out(trainer.cloned(), 0.1, 25);
        assert!((reached - 1.0).abs() < 0.15 && claims, "{name}: at {reached}, claims: {claims}");
    }
}

#[test]
fn gradients_are_those_of_finite_differences() {
    let squared = CloneConfig { act: Some(act(ActLoss::Squared)), ..config(Head::Act) };
    let configs = [
        config(Head::Regression),
        config(Head::Diffusion),
        of_noise(),
        recurrent(Head::Regression),
        config(Head::Act),
        squared,
    ];
    for config in configs {
        let (head, memory) = (config.head, config.memory);
        let episodes = reaching(&paces(), 25);
        let mut trainer = Trainer::new(config, robot(), &episodes, BTreeMap::new()).expect("it fits");
        // First predictions are small on purpose; slopes of early layers would be too.
        let is_output = |name: &str| {
            ["head.weight", "decoder.action.weight", "style.mean.weight", "style.log_variance.weight"]
                .contains(&name)
        };
        let of_head = trainer.network.arrays.iter_mut().filter(|array| is_output(&array.name));
        of_head.flat_map(|array| &mut array.values).for_each(|value| *value *= 10.0);
        let samples: Vec<Sample> =
            [(0, 3), (4, 9), (7, 20)].map(|at| episodes.sample(trainer.config(), at)).into();
        let loss = |trainer: &Trainer| trainer.gradients(&samples, NOISE, [0, 0], 3).expect("a loss").1;
        let (gradients, _) = trainer.gradients(&samples, NOISE, [0, 0], 3).expect("gradients");
        let mut checked = Vec::new();
        for (idx, array) in trainer.network.arrays.iter().enumerate() {
            // The steepest of each array: rounding is small beside it.
            let of_array = gradients[idx].iter().enumerate();
            let (at, &slope) = of_array.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).expect("numbers");
            if slope.abs() < 1e-3 {
                continue;
            }
            let moved = |by: f32| {
                let mut trainer = trainer.clone();
                trainer.network.arrays[idx].values[at] += by;
                loss(&trainer)
            };
            // Absolute errors have kinks, and a longer step would cross some.
            let step = if head == Head::Act { 1e-3 } else { 1e-2 };
            let found = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
            let expected = f64::from(slope);
            assert!(
                (found - expected).abs() < 0.05 * expected.abs() + 1e-4,
                "{}: {found}, {expected}",
                array.name
            );
            checked.push(array.name.as_str());
        }
        assert!(checked.len() >= 6, "{head:?}, {memory:?}: {checked:?}");
        let num_of_gru = checked.iter().filter(|name| name.starts_with("gru.")).count();
        let num_of_act =
            checked.iter().filter(|name| name.starts_with("decoder.") || name.starts_with("style."));
        assert_eq!(num_of_act.count() > 20, head == Head::Act, "{checked:?}");
        assert_eq!(num_of_gru, if memory == Memory::Recurrent { 4 } else { 0 }, "{checked:?}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let run = |config: &CloneConfig, threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let episodes = reaching(&paces(), 25);
            let config = CloneConfig { batch_size: 80, ..config.clone() };
            let mut trainer = Trainer::new(config, robot(), &episodes, BTreeMap::new()).expect("it fits");
            for _ in 0..5 {
                trainer.update(&episodes).expect("an update");
            }
            trainer.to_checkpoint()
        })
    };
    for config in [config(Head::Diffusion), recurrent(Head::Diffusion), config(Head::Act)] {
        assert!(run(&config, 1) == run(&config, 3), "{:?}", config.memory);
    }
}

#[test]
fn a_training_that_was_stopped_goes_on_to_the_same_bits() {
    let configs = [
        config(Head::Diffusion),
        recurrent(Head::Diffusion),
        featured(recurrent(Head::Diffusion)),
        config(Head::Act),
    ];
    for config in configs {
        goes_on_to_the_same_bits(&CloneConfig { updates: 60, ..config });
    }
}

fn goes_on_to_the_same_bits(config: &CloneConfig) {
    let episodes = match config.observation.features {
        true => encoded(&paces(), 25, "a"),
        false => reaching(&paces(), 25),
    };
    let [learned, held_out] = episodes.split(config);
    let folder = tempfile::tempdir().expect("a folder");
    let cpu = TrainingDevice::cpu();
    let run = |name: &str, start, stop_at: u64| {
        let data = Data { robot: robot(), train: &learned, held_out: &held_out, sources: BTreeMap::new() };
        let mut watch = |progress: &crate::Progress| match progress.update == stop_at {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        };
        train(&folder.path().join(name), start, config.clone(), data, &cpu, &mut watch).expect("a run")
    };
    let (whole, finish) = run("whole", Start::Fresh, u64::MAX);
    assert_eq!(finish, Finish::Complete);
    assert_eq!(run("parts", Start::Fresh, 33).1, Finish::Cancelled);
    let (parts, _) = run("parts", Start::Resume, u64::MAX);
    assert!(whole.to_checkpoint() == parts.to_checkpoint());
    let lines = |name: &str| {
        std::fs::read_to_string(folder.path().join(name).join("metrics.jsonl")).expect("metrics")
    };
    assert_eq!(lines("whole").lines().count(), 3);
    assert_eq!(lines("parts").lines().count(), 3);
}

/// The loss of action chunking with Transformers from what the network predicts, number by number: the mean absolute error,
/// and the weighted divergence of the normal distributions of styles from the standard one.
#[test]
fn the_loss_of_act_is_error_and_divergence_by_hand() {
    let episodes = reaching(&paces(), 25);
    let trainer = Trainer::new(config(Head::Act), robot(), &episodes, BTreeMap::new()).expect("it fits");
    let samples: Vec<Sample> =
        [(0, 3), (4, 9), (7, 20)].map(|at| episodes.sample(trainer.config(), at)).into();
    let device = Device::flex();
    let tensors = trainer.network.tensors(&device);
    let rows = |values: Vec<f32>| {
        let len = values.len() / samples.len();
        Tensor::<2>::from_data(TensorData::new(values, [samples.len(), len]), &device)
    };
    let inputs = samples.iter().flat_map(|sample| trainer.inputs.apply(&sample.input)).collect();
    let chunks: Vec<f32> = samples.iter().flat_map(|sample| trainer.chunks.apply(&sample.chunk)).collect();
    let features = trainer.network.trunk(&tensors, rows(inputs));
    let styles = trainer.network.styles(&tensors, features, rows(chunks.clone()));
    let [means, log_variances] = styles.map(values);
    let divergence: f64 = means
        .iter()
        .zip(&log_variances)
        .map(|(&mean, &log_variance)| {
            let (mean, variance) = (f64::from(mean), f64::from(log_variance).exp());
            0.5 * (mean * mean + variance - 1.0 - variance.ln())
        })
        .sum();
    let predicted = trainer.predictions(&trainer.network, &tensors, &samples, NOISE, [0, 0], &device);
    let off = values(predicted.rows)
        .into_iter()
        .zip(&chunks)
        .map(|(found, wanted)| f64::from((found - wanted).abs()));
    let error = off.sum::<f64>() / chunks.len() as f64;
    let (_, loss) = trainer.gradients(&samples, NOISE, [0, 0], 3).expect("a loss");
    let expected = error + 0.5 * divergence / 3.0;
    assert!(divergence > 1e-3 && (loss - expected).abs() < 1e-5 * expected, "{loss}, by hand {expected}");
    // Another draw of the style is another chunk; at work nothing is drawn.
    let again = trainer.predictions(&trainer.network, &tensors, &samples, NOISE, [1, 0], &device);
    let [usual, as_usual] = [[0, 0], [1, 0]].map(|numbers| {
        let held_out =
            trainer.predictions(&trainer.network, &tensors, &samples, HELD_OUT_NOISE, numbers, &device);
        assert!(held_out.divergence.is_none());
        values(held_out.rows)
    });
    assert_eq!(usual, as_usual);
    assert_ne!(values(again.rows), usual);
}

#[test]
fn files_are_read_back_and_what_does_not_belong_together_is_named() {
    let path = Path::new("policy.safetensors");
    let remembering =
        Trainer::new(recurrent(Head::Regression), robot(), &reaching(&paces(), 25), BTreeMap::new());
    let bytes = remembering.expect("it fits").cloned().to_bytes().expect("a file");
    let read = Cloned::from_bytes(path, &bytes).expect("the policy");
    assert_eq!(read.config().memory, Memory::Recurrent);
    assert!(read.to_bytes().expect("a file") == bytes, "the same file again");
    let chunking = Trainer::new(config(Head::Act), robot(), &reaching(&paces(), 25), BTreeMap::new());
    let bytes = chunking.expect("it fits").cloned().to_bytes().expect("a file");
    let read = Cloned::from_bytes(path, &bytes).expect("the policy");
    assert_eq!(read.config().act, Some(act(ActLoss::Absolute)));
    assert!(read.to_bytes().expect("a file") == bytes, "the same file again");
    let trainer = trained(config(Head::Diffusion));
    let bytes = trainer.cloned().to_bytes().expect("a file");
    let read = Cloned::from_bytes(path, &bytes).expect("the policy");
    assert!(read.to_bytes().expect("a file") == bytes, "the same file again");
    assert_eq!(read.updates(), 300);
    assert_eq!(read.config().diffusion.predicts, Some(Predicts::Chunk));
    let mut altered = bytes.clone();
    *altered.last_mut().expect("bytes") ^= 1;
    let problem = Cloned::from_bytes(path, &altered).expect_err("it was altered").to_string();
    assert!(problem.contains("policy.safetensors") && problem.contains("checksum"), "{problem}");
    let other = Robot { channels: vec!["palm".to_owned()], ..robot() };
    assert_eq!(
        read.robot().check(&other).expect_err("another robot").to_string(),
        "the policy was made for the channel \"tip\" where the robot has \"palm\""
    );
    assert_eq!(
        read.robot()
            .check(&Robot { control_rate_hz: 30.0, ..robot() })
            .expect_err("another rate")
            .to_string(),
        "the policy was made for 20 control steps a second, the robot has 30"
    );
    let [learned, _] = reaching(&paces(), 25).split(trainer.config());
    let going_on = |config, robot, bytes: &[u8]| {
        Trainer::from_checkpoint(config, robot, &learned, BTreeMap::new(), path, bytes)
            .map(|_| ())
            .map_err(|err| err.to_string())
    };
    let checkpoint = trainer.to_checkpoint();
    let config = trainer.config().clone();
    assert_eq!(going_on(config.clone(), robot(), &checkpoint), Ok(()));
    let problem =
        going_on(CloneConfig { predicted: 6, ..config.clone() }, robot(), &checkpoint).expect_err("differs");
    assert!(problem.contains("predicted is 4, that of the configuration is 6"), "{problem}");
    let problem = going_on(config.clone(), other, &checkpoint).expect_err("differs");
    assert!(problem.contains("\"palm\""), "{problem}");
    let problem = going_on(config, robot(), &bytes).expect_err("no training");
    assert!(problem.contains("a policy alone"), "{problem}");
}

/// A configuration of a policy that sees features.
fn featured(config: CloneConfig) -> CloneConfig {
    let observation = ObservationConfig { features: true, ..config.observation };
    CloneConfig { observation, ..config }
}

#[test]
fn a_policy_learns_from_features_with_either_memory_and_head() {
    let configs =
        [config(Head::Regression), config(Head::Diffusion), recurrent(Head::Regression), config(Head::Act)];
    for config in configs.map(featured) {
        let (head, memory) = (config.head, config.memory);
        // Nothing but features says where the joint is and what it feels.
        let observation = ObservationConfig { touch: false, tracking: false, ..config.observation.clone() };
        let config = CloneConfig { observation, ..config };
        let episodes = encoded(&paces(), 25, "a");
        let mut trainer = Trainer::new(config, robot(), &episodes, BTreeMap::new()).expect("it fits");
        let before = trainer.judge(&episodes).expect("a loss");
        while trainer.updates() < trainer.config().updates {
            trainer.update(&episodes).expect("an update");
        }
        let after = trainer.judge(&episodes).expect("a loss");
        assert!(after < 0.5 * before, "{head:?}, {memory:?}: {before} became {after}");
        let policy = trainer.cloned();
        assert_eq!(policy.shape().features, 3);
        let planned = |active: bool| {
            let mut seen = policy.history(None).expect("it sees no region");
            let features = features_of(1.0, active);
            seen.see(&Moment {
                time_s: 1.0,
                positions: &[1.0],
                commands: &[1.0],
                touch: Touch::Events(&[active]),
                features: &features,
            });
            policy.plan(&seen, &[1.0], [0, 0]).expect("a plan")
        };
        assert_ne!(planned(true), planned(false), "{head:?}, {memory:?}: features are seen");
    }
}

#[test]
fn a_policy_brings_its_encoder_along_and_goes_on_with_no_other() {
    let path = Path::new("policy.safetensors");
    let config = featured(CloneConfig { updates: 60, ..config(Head::Regression) });
    let [learned, _] = encoded(&paces(), 25, "a").split(&config);
    let mut trainer = Trainer::new(config.clone(), robot(), &learned, BTreeMap::new()).expect("it fits");
    trainer.update(&learned).expect("an update");
    let (bytes, checkpoint) = (trainer.cloned().to_bytes().expect("a file"), trainer.to_checkpoint());
    for bytes in [&bytes, &checkpoint] {
        let read = Cloned::from_bytes(path, bytes).expect("the policy");
        assert_eq!(read.encoder(), Some(&encoder("a")));
    }
    let read = Cloned::from_bytes(path, &bytes).expect("the policy");
    assert!(read.to_bytes().expect("a file") == bytes, "the same file again");
    let at = bytes.windows(9).position(|window| window == b"encoder a").expect("its bytes are in the file");
    let mut altered = bytes.clone();
    altered[at] ^= 1;
    let problem = Cloned::from_bytes(path, &altered).expect_err("it was altered").to_string();
    assert!(problem.contains("tensor encoder does not match its checksum"), "{problem}");

    let going_on = |config: &CloneConfig, episodes: &Episodes| {
        let [learned, _] = episodes.clone().split(config);
        let sources = BTreeMap::new();
        Trainer::from_checkpoint(config.clone(), robot(), &learned, sources, path, &checkpoint)
            .map(|trainer| trainer.to_checkpoint() == checkpoint)
            .map_err(|err| err.to_string())
    };
    assert_eq!(going_on(&config, &encoded(&paces(), 25, "a")), Ok(true));
    let problem = going_on(&config, &encoded(&paces(), 25, "b")).expect_err("another encoder");
    assert!(
        problem.contains(
            "made by the encoder with SHA-256 digest of a, those of this call by the encoder with SHA-256 \
            digest of b"
        ),
        "{problem}"
    );
    let observation = ObservationConfig { features: false, ..config.observation.clone() };
    let blind = CloneConfig { observation, ..config };
    let problem = going_on(&blind, &reaching(&paces(), 25));
    let problem = problem.expect_err("no encoder");
    assert!(
        problem.contains("observation.features is true, that of the configuration is false"),
        "{problem}"
    );
}

#[test]
fn features_and_configuration_belong_together() {
    let refused = |config: CloneConfig, episodes: &Episodes| {
        Trainer::new(config, robot(), episodes, BTreeMap::new()).expect_err("it does not fit").to_string()
    };
    assert_eq!(
        refused(featured(config(Head::Regression)), &reaching(&paces(), 25)),
        "observation.features is true, but the episodes have no features of an encoder"
    );
    assert_eq!(
        refused(config(Head::Regression), &encoded(&paces(), 25, "a")),
        "observation.features is false, but the episodes have 3 features in each step"
    );
}

#[test]
fn points_take_the_place_of_features_without_an_encoder() {
    let observation =
        ObservationConfig { points: true, touch: false, ..config(Head::Regression).observation };
    let config = CloneConfig { updates: 5, observation, ..config(Head::Regression) };
    let plain = reaching(&paces(), 25);
    let problem =
        Trainer::new(config.clone(), robot(), &plain, BTreeMap::new()).expect_err("no points").to_string();
    assert!(problem.contains("0 numbers of points in each step, expected 4"), "{problem}");
    let shape = Shape { features: 4, ..plain.shape() };
    let episodes = plain.with_numbers(4);
    assert_eq!(episodes.shape(), shape);
    let mut trainer = Trainer::new(config, robot(), &episodes, BTreeMap::new()).expect("it fits");
    trainer.update(&episodes).expect("an update");
    let bytes = trainer.cloned().to_bytes().expect("a file");
    let read = Cloned::from_bytes(Path::new("policy"), &bytes).expect("the policy");
    assert_eq!((read.shape(), read.encoder()), (shape, None));
}

/// Twenty episodes of a robot of one joint that goes up where the region is wide, and down where it is not.
fn told_the_region() -> Episodes {
    let shape = Shape { dofs: 1, channels: 1, features: 0 };
    let episode = |is_wide: bool| {
        let half_width_m = Some(if is_wide { 0.08 } else { 0.02 });
        let mut episode = Episode { half_width_m, ..Episode::default() };
        for step in 0..5 {
            let time_s = 0.05 * step as f64;
            let moment = Moment {
                time_s,
                positions: &[0.0],
                commands: &[0.0],
                touch: Touch::Events(&[false]),
                features: &[],
            };
            let target = if is_wide { 0.3 } else { -0.3 };
            episode.push(shape, &Step { moment, targets: &[target], claims_held: false });
        }
        episode
    };
    Episodes::new(shape, (0..20).map(|idx| episode(idx % 2 == 0)).collect()).expect("they fit")
}

#[test]
fn a_policy_that_is_told_its_region_does_what_is_right_there() {
    let episodes = told_the_region();
    for memory in [Memory::Window, Memory::Recurrent] {
        let told = CloneConfig { predicted: 1, executed: 1, memory, ..config(Head::Regression) };
        let observation = ObservationConfig { region: true, ..told.observation.clone() };
        let told = CloneConfig { observation, ..told };
        let mut trainer = Trainer::new(told, robot(), &episodes, BTreeMap::new()).expect("it fits");
        while trainer.updates() < trainer.config().updates {
            trainer.update(&episodes).expect("an update");
        }
        let bytes = trainer.cloned().to_bytes().expect("a file");
        let policy = Cloned::from_bytes(Path::new("policy"), &bytes).expect("the policy");
        let [wide, narrow] = [0.08, 0.02].map(|half_width_m| {
            let mut seen = policy.history(Some(half_width_m)).expect("it is told");
            let (positions, active) = ([0.0], [false]);
            seen.see(&Moment {
                time_s: 0.0,
                positions: &positions,
                commands: &positions,
                touch: Touch::Events(&active),
                features: &[],
            });
            policy.plan(&seen, &[0.0], [0, 0]).expect("a plan")[0].targets[0]
        });
        assert!((wide - 0.3).abs() < 0.05 && (narrow + 0.3).abs() < 0.05, "went to {wide} and {narrow}");
        let problem = policy.history(None).expect_err("nobody knows").to_string();
        assert!(problem.contains("observation.region") && problem.contains("nobody says"), "{problem}");
        assert!(policy.history(Some(f64::NAN)).is_err());
    }
}

#[test]
fn episodes_that_say_nothing_of_their_region_are_refused_where_it_is_seen() {
    let observation = ObservationConfig { region: true, ..config(Head::Regression).observation };
    let config = CloneConfig { observation, ..config(Head::Regression) };
    let refused = |episodes: &Episodes| {
        let trainer = Trainer::new(config.clone(), robot(), episodes, BTreeMap::new());
        trainer.expect_err("it does not fit").to_string()
    };
    let problem = refused(&reaching(&paces(), 25));
    assert!(problem.contains("do not all say in which region"), "{problem}");
    let [wide, _] = told_the_region().split(&CloneConfig { held_out_share: 0.5, ..config.clone() });
    let wide = wide.in_one_region(0.08);
    let problem = refused(&wide);
    assert!(problem.contains("all episodes began within 0.08 m of the middle"), "{problem}");
}

/// Twenty episodes of a robot of one joint that waits for four steps and then goes up if it felt something in the first
/// step, down if not.
fn told_at_the_beginning() -> Episodes {
    let shape = Shape { dofs: 1, channels: 1, features: 0 };
    let episode = |is_up: bool| {
        let mut episode = Episode::default();
        for step in 0..5 {
            let moment = Moment {
                time_s: 0.05 * step as f64,
                positions: &[0.0],
                commands: &[0.0],
                touch: Touch::Events(&[is_up && step == 0]),
                features: &[],
            };
            let target = if step < 4 {
                0.0
            } else if is_up {
                0.3
            } else {
                -0.3
            };
            episode.push(shape, &Step { moment, targets: &[target], claims_held: false });
        }
        episode
    };
    Episodes::new(shape, (0..20).map(|idx| episode(idx % 2 == 0)).collect()).expect("they fit")
}

#[test]
fn a_recurrent_policy_does_what_it_was_told_some_frames_ago() {
    let episodes = told_at_the_beginning();
    let learned = |frames| {
        let observation = ObservationConfig { frames, stride: 1, ..ObservationConfig::default() };
        let config = CloneConfig { observation, predicted: 1, executed: 1, ..recurrent(Head::Regression) };
        let mut trainer = Trainer::new(config, robot(), &episodes, BTreeMap::new()).expect("it fits");
        while trainer.updates() < trainer.config().updates {
            trainer.update(&episodes).expect("an update");
        }
        let policy = trainer.cloned();
        [true, false].map(|is_up| {
            let mut seen = policy.history(None).expect("it sees no region");
            for step in 0..5 {
                let active = [is_up && step == 0];
                seen.see(&Moment {
                    time_s: 0.05 * step as f64,
                    positions: &[0.0],
                    commands: &[0.0],
                    touch: Touch::Events(&active),
                    features: &[],
                });
            }
            policy.plan(&seen, &[0.0], [0, 0]).expect("a plan")[0].targets[0]
        })
    };
    let [up, down] = learned(5);
    assert!((up - 0.3).abs() < 0.05 && (down + 0.3).abs() < 0.05, "went to {up} and {down}");
    let [up, down] = learned(4);
    assert_eq!(up, down, "a window that does not reach back to the beginning cannot tell");
}

#[test]
fn what_a_policy_may_not_feel_changes_nothing() {
    let config = CloneConfig {
        observation: ObservationConfig {
            touch: false,
            tracking: false,
            ..config(Head::Regression).observation
        },
        ..config(Head::Regression)
    };
    let policy =
        Trainer::new(config, robot(), &reaching(&paces(), 25), BTreeMap::new()).expect("it fits").cloned();
    let planned = |position: f64, active: bool| {
        let mut history = policy.history(None).expect("it sees no region");
        history.see(&Moment {
            time_s: 0.1,
            positions: &[position],
            commands: &[0.3],
            touch: Touch::Events(&[active]),
            features: &[],
        });
        policy.plan(&history, &[0.3], [0, 0]).expect("a plan")
    };
    assert_eq!(planned(0.3, false), planned(0.1, true));
}

/// The training after `updates`, in a folder of its own or going on from the checkpoint in `folder`.
fn learned_on(device: &TrainingDevice, config: &CloneConfig, folder: &Path, start: Start) -> Trainer {
    let [learned, held_out] = reaching(&paces(), 25).split(config);
    let data = Data { robot: robot(), train: &learned, held_out: &held_out, sources: BTreeMap::new() };
    let mut watch = |_: &crate::Progress| ControlFlow::Continue(());
    train(folder, start, config.clone(), data, device, &mut watch).expect("a run").0
}

/// What `device` makes of a training: without noise the parameters of the CPU but for rounding; with either head less loss
/// on what is held out, and a checkpoint that the CPU goes on from.
fn learns_as_the_cpu_does(device: &TrainingDevice) {
    let folder = tempfile::tempdir().expect("a folder");
    let config = |head, updates| CloneConfig { updates, ..config(head) };
    let short = config(Head::Regression, 20);
    let [of_cpu, of_device] = [(TrainingDevice::cpu(), "cpu"), (device.clone(), "device")]
        .map(|(device, name)| learned_on(&device, &short, &folder.path().join(name), Start::Fresh));
    let pairs = |of: fn(&Trainer) -> Vec<f32>| of(&of_cpu).into_iter().zip(of(&of_device));
    let flat = |trainer: &Trainer| -> Vec<f32> {
        trainer.network.arrays.iter().flat_map(|array| array.values.clone()).collect()
    };
    let begun = {
        let [learned, _] = reaching(&paces(), 25).split(&short);
        flat(&Trainer::new(short.clone(), robot(), &learned, BTreeMap::new()).expect("it fits"))
    };
    let moved = pairs(flat).zip(&begun).map(|((cpu, _), begun)| (cpu - begun).abs()).fold(0.0, f32::max);
    let apart = pairs(flat).map(|(cpu, card)| (cpu - card).abs()).fold(0.0, f32::max);
    assert!(apart < 0.01 * moved, "parameters moved by {moved} and are {apart} apart");
    let averages = pairs(|trainer| trainer.average.concat());
    assert!(averages.map(|(cpu, card)| (cpu - card).abs()).fold(0.0, f32::max) < 0.01 * moved);
    let [_, held_out] = reaching(&paces(), 25).split(&short);
    let [cpu, card] = [&of_cpu, &of_device].map(|trainer| trainer.judge(&held_out).expect("a loss"));
    assert!((cpu - card).abs() < 1e-3 * cpu, "{cpu} and {card}");

    for head in [Head::Regression, Head::Diffusion, Head::Act] {
        let folder = folder.path().join(format!("{head:?}"));
        let part = learned_on(device, &config(head, 300), &folder, Start::Fresh);
        let [learned, held_out] = reaching(&paces(), 25).split(part.config());
        let begun = Trainer::new(part.config().clone(), robot(), &learned, BTreeMap::new()).expect("it fits");
        let [before, after] = [&begun, &part].map(|trainer| trainer.judge(&held_out).expect("a loss"));
        assert!(after < 0.5 * before, "{head:?}: {before} became {after}");
        let bytes = std::fs::read(folder.join(crate::CHECKPOINT_FILE)).expect("a checkpoint");
        let again = Trainer::from_checkpoint(
            part.config().clone(),
            robot(),
            &learned,
            BTreeMap::new(),
            Path::new("checkpoint"),
            &bytes,
        );
        assert!(again.expect("the CPU reads it").to_checkpoint() == part.to_checkpoint());
    }
}

#[test]
fn one_device_that_keeps_everything_learns_as_the_cpu_does() {
    learns_as_the_cpu_does(&TrainingDevice::one(burn_tensor::Device::flex()));
}

/// Wherever Vulkan, Metal or DirectX is, a software driver too: `cargo test -p palpate_cloning --features gpu`.
#[cfg(feature = "gpu")]
#[test]
fn a_graphics_card_learns_as_the_cpu_does() {
    learns_as_the_cpu_does(&TrainingDevice::gpu().expect("a graphics card, or a driver that plays one"));
}

#[cfg(not(feature = "gpu"))]
#[test]
fn a_program_without_graphics_cards_says_how_to_build_one_with() {
    let problem = TrainingDevice::gpu().expect_err("it has none").to_string();
    assert!(problem.contains("--features gpu"), "{problem}");
}
