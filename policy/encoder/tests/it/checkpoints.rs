//! Interrupted runs are the runs that went on; broken files are refused by name.

use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

use palpate_encoder::{
    CHECKPOINT_FILE, Data, Dataset as _, Encoder, EncoderConfig, EncoderError, Finish, LossConfig,
    METRICS_FILE, Start, Trainer, train,
};
use serde_json::Value;

use crate::world::{Row, config, sources};

/// Eight updates, a checkpoint after every fifth and at the end, until the update numbered `last`.
fn run(folder: &Path, start: Start, config: EncoderConfig, last: u64) -> Result<Finish, EncoderError> {
    let data = Data { train: &Row::new(0, 100), held_out: &Row::new(9000, 20), sources: sources("a") };
    let mut watch = |progress: &palpate_encoder::Progress| match progress.update == last {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    };
    train(folder, start, config, data, &mut watch).map(|(_, finish)| finish)
}

/// Lines of the metrics file without what depends on the clock.
fn metrics(folder: &Path) -> Vec<Value> {
    let text = fs::read_to_string(folder.join(METRICS_FILE)).expect("metrics");
    let line = |line: &str| {
        let mut line: Value = serde_json::from_str(line).expect("a line of JSON");
        line.as_object_mut().expect("an object").remove("samples_per_s").expect("a speed");
        line
    };
    text.lines().map(line).collect()
}

#[test]
fn a_run_that_resumes_has_the_bits_of_one_that_went_on() {
    let [whole, parts] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    assert_eq!(run(whole.path(), Start::Fresh, config(), 0).expect("a run"), Finish::Complete);
    assert_eq!(run(parts.path(), Start::Fresh, config(), 7).expect("a run"), Finish::Cancelled);
    assert_eq!(metrics(parts.path()).len(), 1);
    assert_eq!(run(parts.path(), Start::Resume, config(), 0).expect("a run"), Finish::Complete);
    let checkpoint = |folder: &Path| fs::read(folder.join(CHECKPOINT_FILE)).expect("a checkpoint");
    assert!(checkpoint(whole.path()) == checkpoint(parts.path()), "other bits");
    let lines = metrics(whole.path());
    assert_eq!(lines, metrics(parts.path()));
    assert_eq!((lines.len(), &lines[0]["update"], &lines[1]["update"]), (2, &5.into(), &8.into()));
    for of in ["train", "held_out"] {
        let mut named: Vec<&str> =
            lines[1][of].as_object().expect("losses").keys().map(String::as_str).collect();
        let mut expected = [&palpate_encoder::TERMS[..], &["total"]].concat();
        named.sort_unstable();
        expected.sort_unstable();
        assert_eq!(named, expected, "{of}");
    }
}

#[test]
fn what_does_not_fit_or_was_altered_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    run(folder.path(), Start::Fresh, config(), 0).expect("a run");
    let bytes = fs::read(folder.path().join(CHECKPOINT_FILE)).expect("a checkpoint");
    let path = Path::new("c.safetensors");
    let data = Row::new(0, 100);
    let refused = |config, data: &Row, digest: &str, bytes: &[u8]| {
        let trainer = Trainer::from_checkpoint(config, data, sources(digest), path, bytes);
        trainer.expect_err("refused").to_string()
    };
    let mut altered = bytes.clone();
    let last = altered.len() - 1;
    altered[last] ^= 1;
    let loss = LossConfig { rotation: 0.2, ..LossConfig::default() };
    let encoder = Encoder::from_bytes(path, &bytes).expect("an encoder").to_bytes().expect("16 bits");
    let refusals = [
        refused(EncoderConfig { history: 4, ..config() }, &data, "a", &bytes),
        refused(EncoderConfig { loss, ..config() }, &data, "a", &bytes),
        refused(config(), &data, "b", &bytes),
        refused(config(), &Row::new(0, 99), "a", &bytes),
        refused(config(), &data, "a", &encoder),
        refused(config(), &data, "a", &bytes[..bytes.len() - 1]),
        refused(config(), &data, "a", &altered),
        Encoder::from_bytes(path, b"no tensors at all").expect_err("refused").to_string(),
    ];
    assert_eq!(refusals.join("\n"), include_str!("../refusals/checkpoints.txt").trim_end());
    altered = bytes.clone();
    let middle = altered.len() / 2;
    altered[middle] ^= 1;
    let said = refused(config(), &data, "a", &altered);
    assert!(said.ends_with("does not match its checksum: the file was altered"), "{said}");
    assert!(matches!(
        run(folder.path(), Start::Fresh, config(), 0),
        Err(EncoderError::Training(palpate_encoder::TrainingError::RunExists(_)))
    ));
}

#[test]
fn an_exported_encoder_feels_the_same_within_16_bits() {
    let data = Row::new(0, 100);
    let mut trainer = Trainer::new(config(), &data, sources("a")).expect("a trainer");
    trainer.update(&data).expect("an update");
    let whole = trainer.encoder();
    let path = Path::new("e.safetensors");
    assert_eq!(Encoder::from_bytes(path, &trainer.to_checkpoint()).expect("an encoder"), whole);
    let bytes = whole.to_bytes().expect("16 bits");
    let exported = Encoder::from_bytes(path, &bytes).expect("an encoder");
    assert!(exported.to_bytes().expect("16 bits") == bytes, "the file of the encoder that was read");
    assert!(bytes.len() < trainer.to_checkpoint().len() / 6);
    let inputs: Vec<f32> = (0..40).flat_map(|idx| data.sample(idx).input).collect();
    let (expected, found) =
        (whole.encode(&inputs).expect("features"), exported.encode(&inputs).expect("features"));
    assert_eq!(expected.len(), 40 * whole.width());
    for (expected, found) in expected.iter().zip(&found) {
        assert!((expected - found).abs() < 0.02, "{expected} {found}");
    }
    assert!(whole.encode(&inputs[1..]).is_err() && whole.encode(&[f32::NAN; 72]).is_err());
}
