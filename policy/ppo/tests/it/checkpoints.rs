//! Interrupted runs are the runs that went on; broken files are refused by name.

use std::{
    fs,
    ops::ControlFlow,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
};

use palpate_ppo::{
    Actor, CHECKPOINT_FILE, CONFIG_FILE, Finish, METRICS_FILE, PpoConfig, PpoError, Progress, Start,
    StopConfig, Trainer, TrainingError, train,
};
use proptest::prelude::*;
use safetensors::SafeTensors;
use serde_json::Value;

use crate::worlds::{Mishap, Reach, small_config};

/// Six updates of 40 steps, a checkpoint after every second.
fn short_config() -> PpoConfig {
    PpoConfig {
        total_steps: 6 * 40 * 16,
        batch_size: 4,
        checkpoint_updates: 2,
        stop: Some(StopConfig { success_rate: 1.0, episodes: 500 }),
        ..small_config()
    }
}

const HORIZON: u64 = 40;

fn go_on(_: &Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn run(folder: &Path, start: Start, env: &mut Reach) -> Result<Finish, PpoError> {
    train(folder, start, short_config(), env, &mut go_on).map(|(_, finish)| finish)
}

/// Lines of the metrics file without what depends on the clock.
fn metrics(folder: &Path) -> Vec<Value> {
    let text = fs::read_to_string(folder.join(METRICS_FILE)).expect("metrics");
    text.lines()
        .map(|line| {
            let mut line: Value = serde_json::from_str(line).expect("JSON");
            assert!(line["steps_per_s"].as_f64().is_some_and(|rate| rate > 0.0));
            line.as_object_mut().expect("an object").remove("steps_per_s");
            line
        })
        .collect()
}

fn checkpoint(folder: &Path) -> Vec<u8> {
    fs::read(folder.join(CHECKPOINT_FILE)).expect("a checkpoint")
}

fn uninterrupted(folder: &Path) -> (Vec<u8>, Vec<Value>) {
    assert_eq!(run(folder, Start::Fresh, &mut Reach::new(16)).expect("a run"), Finish::Steps);
    (checkpoint(folder), metrics(folder))
}

#[test]
fn a_run_killed_at_any_step_resumes_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let (whole, all_metrics) = uninterrupted(folder.path());
    assert_eq!(all_metrics.len(), 6);
    // In the first update, at the first step of the second, around the first checkpoint, in the last update.
    for at in [7, HORIZON, 2 * HORIZON - 1, 2 * HORIZON, 2 * HORIZON + 1, 3 * HORIZON + 9, 6 * HORIZON - 1] {
        let folder = tempfile::tempdir().expect("a folder");
        let mut env = Reach { mishap: Some((at, Mishap::Panic)), ..Reach::new(16) };
        catch_unwind(AssertUnwindSafe(|| run(folder.path(), Start::Fresh, &mut env))).expect_err("killed");
        // What a crash in the middle of writing leaves behind.
        fs::write(folder.path().join("checkpoint.partial"), &whole[..100]).expect("a partial file");
        let mut log = fs::read(folder.path().join(METRICS_FILE)).expect("metrics");
        log.extend(b"{\"update\": 1, \"st");
        fs::write(folder.path().join(METRICS_FILE), log).expect("metrics");

        let finish = run(folder.path(), Start::Resume, &mut Reach::new(16)).expect("a run");
        assert_eq!(finish, Finish::Steps);
        assert!(checkpoint(folder.path()) == whole, "killed at {at}: other bits");
        assert_eq!(metrics(folder.path()), all_metrics, "killed at {at}");
    }
}

#[test]
fn cancelling_loses_no_more_than_one_interval() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut watch = |progress: &Progress| {
        assert!(progress.eta_s > 0.0 && progress.steps_per_s > 0.0);
        assert!((progress.fraction - progress.metrics.update as f64 / 6.0).abs() < 1e-12);
        if progress.metrics.update == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let mut env = Reach::new(16);
    let result = train(folder.path(), Start::Fresh, short_config(), &mut env, &mut watch);
    let (trainer, finish) = result.expect("a run");
    assert_eq!((finish, trainer.updates()), (Finish::Cancelled, 3));
    let path = folder.path().join(CHECKPOINT_FILE);
    let kept = Trainer::from_checkpoint(short_config(), &mut env, &path, &checkpoint(folder.path()));
    assert_eq!(kept.expect("a training").updates(), 2);
}

#[test]
fn a_finished_run_has_nothing_left_to_do_and_can_be_told_to_go_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let (whole, _) = uninterrupted(folder.path());
    assert_eq!(run(folder.path(), Start::Resume, &mut Reach::new(16)).expect("a run"), Finish::Steps);
    assert!(checkpoint(folder.path()) == whole);

    let longer = PpoConfig { total_steps: 8 * HORIZON * 16, ..short_config() };
    let mut env = Reach::new(16);
    let result = train(folder.path(), Start::Resume, longer.clone(), &mut env, &mut go_on);
    assert_eq!(result.expect("a run").0.updates(), 8);
    let at_once = tempfile::tempdir().expect("a folder");
    train(at_once.path(), Start::Fresh, longer, &mut Reach::new(16), &mut go_on).expect("a run");
    assert_eq!(metrics(folder.path()), metrics(at_once.path()));
    assert!(checkpoint(folder.path()) == checkpoint(at_once.path()));
}

#[test]
fn training_stops_when_enough_episodes_succeed() {
    let folder = tempfile::tempdir().expect("a folder");
    let stop = StopConfig { success_rate: 0.8, episodes: 100 };
    let config = PpoConfig { stop: Some(stop), total_steps: 1_000_000, ..small_config() };
    let mut last = None;
    let mut watch = |progress: &Progress| {
        last = progress.metrics.recent_success_rate;
        ControlFlow::Continue(())
    };
    let mut env = Reach::new(16);
    let (trainer, finish) =
        train(folder.path(), Start::Fresh, config.clone(), &mut env, &mut watch).expect("a run");
    assert_eq!(finish, Finish::Success);
    assert!(last.is_some_and(|rate| rate >= 0.8) && trainer.steps() < 100_000, "{last:?}");
    // The verdicts are in the checkpoint, so that it knows that it is done.
    let (again, finish) =
        train(folder.path(), Start::Resume, config, &mut Reach::new(16), &mut go_on).expect("a run");
    assert_eq!((again.updates(), finish), (trainer.updates(), Finish::Success));
}

#[test]
fn a_run_neither_overwrites_another_nor_shares_its_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    uninterrupted(folder.path());
    let refusal = run(folder.path(), Start::Fresh, &mut Reach::new(16)).expect_err("a run is there");
    assert!(matches!(refusal, PpoError::Training(TrainingError::RunExists(_))), "{refusal}");
    let held = fs::File::open(folder.path().join(METRICS_FILE)).expect("metrics");
    held.lock().expect("a lock");
    let refusal = run(folder.path(), Start::Resume, &mut Reach::new(16)).expect_err("in use");
    assert!(matches!(refusal, PpoError::Training(TrainingError::RunInUse(_))), "{refusal}");
}

#[test]
fn the_file_is_safetensors_and_any_reader_gets_the_same_actions_from_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let (bytes, _) = uninterrupted(folder.path());
    let file = SafeTensors::deserialize(&bytes).expect("safetensors");
    let numbers = |name: &str| -> Vec<f64> {
        let view = file.tensor(name).expect(name);
        match view.dtype() {
            safetensors::Dtype::F32 => {
                view.data().as_chunks().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes))).collect()
            }
            _ => view.data().as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(),
        }
    };
    let observation = [0.3_f32, -0.2, 0.5, 0.1];
    let count = 6.0 * 40.0 * 16.0;
    let mut layer: Vec<f64> = observation
        .iter()
        .zip(numbers("normaliser.actor.mean"))
        .zip(numbers("normaliser.actor.squares"))
        .map(|((&value, mean), squares)| (f64::from(value) - mean) / (squares / count).sqrt())
        .collect();
    for idx in 0..3 {
        let (weights, biases) =
            (numbers(&format!("actor.{idx}.weight")), numbers(&format!("actor.{idx}.bias")));
        let sums = biases.iter().enumerate().map(|(out, bias)| {
            layer.iter().enumerate().map(|(input, x)| x * weights[input * biases.len() + out]).sum::<f64>()
                + bias
        });
        layer = sums.map(|sum| if idx < 2 && sum < 0.0 { sum.exp_m1() } else { sum }).collect();
    }
    let actor = Actor::from_bytes(Path::new("a file"), &bytes).expect("an actor");
    let actions = actor.actions(&observation).expect("actions");
    for (action, expected) in actions.iter().zip(layer) {
        assert!((f64::from(*action) - expected).abs() < 1e-5, "{action} {expected}");
    }
}

fn refusal(config: PpoConfig, env: &Reach, bytes: &[u8]) -> String {
    Trainer::from_checkpoint(config, &mut env.clone(), Path::new("c.safetensors"), bytes)
        .expect_err("refused")
        .to_string()
}

#[test]
fn a_checkpoint_of_another_training_is_refused_by_field() {
    let env = Reach::new(16);
    let trainer = Trainer::new(short_config(), &env).expect("a trainer");
    let bytes = trainer.to_checkpoint();
    let faster = PpoConfig { learning_rate: 3e-3, ..short_config() };
    assert_eq!(
        refusal(faster, &env, &bytes),
        "checkpoint c.safetensors: learning_rate is 0.002, that of the configuration is 0.003"
    );
    let renamed = Reach { second_term: "arrived", ..Reach::new(16) };
    let message = refusal(short_config(), &renamed, &bytes);
    assert!(message.starts_with("checkpoint c.safetensors: reward_terms is "), "{message}");
    let mut wider = short_config();
    wider.networks.critic = vec![64];
    assert!(refusal(wider, &env, &bytes).contains("networks.critic is "), "networks");
    assert_eq!(
        refusal(short_config(), &Reach { padding: 1, ..Reach::new(16) }, &bytes),
        "checkpoint c.safetensors: actor_dim is 4, that of the environments is 5"
    );
}

#[test]
fn a_policys_file_does_what_the_training_does_and_is_refused_where_a_training_is_wanted() {
    let folder = tempfile::tempdir().expect("a folder");
    let (whole, _) = uninterrupted(folder.path());
    let trained = Actor::from_bytes(Path::new("a checkpoint"), &whole).expect("an actor");
    let small = trained.to_bytes().expect("a file");
    assert!(3 * small.len() < whole.len(), "{} of {} bytes", small.len(), whole.len());
    let kept = Actor::from_bytes(Path::new("a policy"), &small).expect("an actor");
    assert_eq!((kept.steps(), kept.memory()), (6 * HORIZON * 16, trained.memory()));
    assert!(kept.to_bytes().expect("a file") == small, "nothing is rounded twice");
    let observations: Vec<f32> = (0..400).map(|i| (i % 23) as f32 / 10.0 - 1.1).collect();
    let [exact, rounded] = [&trained, &kept].map(|actor| actor.actions(&observations).expect("actions"));
    // Sixteen bits keep three digits of each weight.
    let largest = exact.iter().fold(0.0_f32, |most, action| most.max(action.abs()));
    let off = exact.iter().zip(&rounded).fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
    assert!(largest > 0.1 && off > 0.0 && off < 0.005 * largest, "{off} of {largest}");

    let env = Reach::new(16);
    assert_eq!(
        refusal(short_config(), &env, &small),
        "checkpoint c.safetensors: it holds a policy alone, without the training to go on with"
    );
    for (at, expected) in [(small.len() - 5, "tensor"), (100, "")] {
        let mut altered = small.clone();
        altered[at] ^= 1;
        let message =
            Actor::from_bytes(Path::new("p.safetensors"), &altered).expect_err("refused").to_string();
        assert!(message.starts_with("checkpoint p.safetensors: ") && message.contains(expected), "{message}");
    }
    assert!(Actor::from_bytes(Path::new("p.safetensors"), &small[..small.len() / 2]).is_err());
}

#[test]
fn the_folder_holds_a_configuration_that_can_be_run_again() {
    let folder = tempfile::tempdir().expect("a folder");
    uninterrupted(folder.path());
    let text = fs::read_to_string(folder.path().join(CONFIG_FILE)).expect("a configuration");
    assert_eq!(PpoConfig::from_toml(CONFIG_FILE, &text).expect("a configuration"), short_config());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn a_file_that_was_cut_or_altered_anywhere_is_refused(at in 0.0..1.0_f64, bit in 0..8_u32, cut in proptest::bool::ANY) {
        let env = Reach::new(16);
        let whole = Trainer::new(short_config(), &env).expect("a trainer").to_checkpoint();
        // Half of the positions in the header, which is a small part of the file.
        let header = 8 + u64::from_le_bytes(whole[..8].try_into().expect("eight bytes")) as usize;
        let range = if bit % 2 == 0 { whole.len() } else { header };
        let at = (at * range as f64) as usize;
        let mut bytes = whole.clone();
        if cut {
            bytes.truncate(at);
        } else {
            bytes[at] ^= 1 << bit;
        }
        let message = refusal(short_config(), &env, &bytes);
        prop_assert!(message.starts_with("checkpoint c.safetensors: "), "{}", message);
        prop_assert!(
            ["tensor", "state", "format"].iter().any(|field| message.contains(field)),
            "{} names no field", message
        );
    }
}
