//! A training in a folder: configuration, checkpoint and metrics as files.

use std::{
    fs::{File, OpenOptions, TryLockError},
    io::Write,
    ops::ControlFlow,
    path::Path,
    time::Instant,
};

use serde::{Deserialize, Serialize};

use crate::{Metrics, PpoConfig, PpoError, Trainer, VectorEnv};

/// The newest checkpoint.
pub const CHECKPOINT_FILE: &str = "checkpoint.safetensors";
/// The configuration with every field, as it was when the run began or resumed.
pub const CONFIG_FILE: &str = "ppo.toml";
/// One line of JSON for each update: [`Metrics`] and `steps_per_s`.
pub const METRICS_FILE: &str = "metrics.jsonl";

/// Whether to begin or to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Begin; a folder that holds a checkpoint is refused.
    Fresh,
    /// Go on from the folder's checkpoint, or begin if the run was ended before the first one.
    Resume,
}

/// Why a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// It made the configuration's steps.
    Steps,
    /// The configuration's `stop` was reached.
    Success,
    /// Whoever watched wanted no more. The checkpoint is the last one before.
    Cancelled,
}

/// How far a training is.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// What the update told.
    pub metrics: Metrics,
    /// Share of the configuration's steps that are done, in 0..=1.
    pub fraction: f64,
    /// Steps of all environments a second, in this update.
    pub steps_per_s: f64,
    /// Time until the configuration's steps are done, as fast as since this run began or resumed.
    pub eta_s: f64,
}

#[derive(Serialize)]
struct MetricsLine<'a> {
    #[serde(flatten)]
    metrics: &'a Metrics,
    steps_per_s: f64,
}

/// Trains in `folder` until the configuration's steps are made, its `stop` is reached or `watch`, which sees every update,
/// wants no more.
///
/// Checkpoints replace one another in one move, so that a run that is killed at any moment goes on from the last one.
///
/// # Errors
/// Whatever [`Trainer`] refuses, folders that cannot be written, that another run uses, or that hold another run.
pub fn train<E: VectorEnv + ?Sized>(
    folder: &Path,
    start: Start,
    config: PpoConfig,
    env: &mut E,
    watch: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<(Trainer, Finish), PpoError> {
    config.validate()?;
    std::fs::create_dir_all(folder).map_err(file_error("create", folder))?;
    let mut log = MetricsLog::open(folder)?;
    let checkpoint = folder.join(CHECKPOINT_FILE);
    let mut trainer = match (start, checkpoint.exists()) {
        (Start::Fresh, true) => return Err(PpoError::RunExists(folder.to_owned())),
        (Start::Resume, true) => {
            let bytes = std::fs::read(&checkpoint).map_err(file_error("read", &checkpoint))?;
            Trainer::from_checkpoint(config, env, &checkpoint, &bytes)?
        }
        (_, false) => Trainer::new(config, env)?,
    };
    write_in_one_move(&folder.join(CONFIG_FILE), trainer.config().to_toml().as_bytes())?;
    log.keep_up_to(trainer.updates())?;

    let began = Instant::now();
    let first_update = trainer.updates();
    loop {
        if let Some(finish) = finish(&trainer) {
            return Ok((trainer, finish));
        }
        let update_began = Instant::now();
        let steps_before = trainer.steps();
        let metrics = trainer.update(env)?;
        let steps_per_s = (trainer.steps() - steps_before) as f64 / update_began.elapsed().as_secs_f64();
        log.append(&MetricsLine { metrics: &metrics, steps_per_s })?;
        if finish(&trainer).is_some() {
            trainer.begin_new_episodes();
        }
        if trainer.is_between_episodes() {
            log.sync()?;
            write_in_one_move(&checkpoint, &trainer.to_checkpoint())?;
        }
        let (done, all) = (trainer.updates(), trainer.config().num_updates());
        let secs_per_update = began.elapsed().as_secs_f64() / (done - first_update) as f64;
        let progress = Progress {
            metrics,
            fraction: done as f64 / all as f64,
            steps_per_s,
            eta_s: secs_per_update * (all - done) as f64,
        };
        if watch(&progress).is_break() && finish(&trainer).is_none() {
            return Ok((trainer, Finish::Cancelled));
        }
    }
}

fn finish(trainer: &Trainer) -> Option<Finish> {
    let config = trainer.config();
    let reached = |rate: f64| config.stop.as_ref().is_some_and(|stop| rate >= stop.success_rate);
    if trainer.recent_success_rate().is_some_and(reached) {
        return Some(Finish::Success);
    }
    (trainer.updates() >= config.num_updates()).then_some(Finish::Steps)
}

/// Replaces `path` by a file with `bytes`: whoever looks, also after a crash, sees the old file or the new one.
fn write_in_one_move(path: &Path, bytes: &[u8]) -> Result<(), PpoError> {
    let partial = path.with_extension("partial");
    let write = || {
        let mut file = File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&partial, path)
    };
    write().map_err(file_error("write", path))
}

fn file_error(doing: &'static str, path: &Path) -> impl Fn(std::io::Error) -> PpoError {
    let path = path.to_owned();
    move |source| PpoError::File { doing, path: path.clone(), source }
}

/// The metrics file, which this process alone writes while it is open.
struct MetricsLog {
    path: std::path::PathBuf,
    file: File,
}

/// What a line of metrics must have to be kept.
#[derive(Deserialize)]
struct LineNumber {
    update: u64,
}

impl MetricsLog {
    fn open(folder: &Path) -> Result<Self, PpoError> {
        let path = folder.join(METRICS_FILE);
        let open = OpenOptions::new().read(true).append(true).create(true).open(&path);
        let file = open.map_err(file_error("open", &path))?;
        file.try_lock().map_err(|err| match err {
            TryLockError::WouldBlock => PpoError::RunInUse(folder.to_owned()),
            TryLockError::Error(source) => file_error("lock", &path)(source),
        })?;
        Ok(Self { path, file })
    }

    /// Drops what was written after the update numbered `last`, also a line that a crash cut off.
    fn keep_up_to(&self, last: u64) -> Result<(), PpoError> {
        let bytes = std::fs::read(&self.path).map_err(file_error("read", &self.path))?;
        let is_kept = |line: &&[u8]| {
            let number: Option<LineNumber> = serde_json::from_slice(line).ok();
            line.ends_with(b"\n") && number.is_some_and(|line| line.update <= last)
        };
        let kept: usize =
            bytes.split_inclusive(|&byte| byte == b'\n').take_while(is_kept).map(<[u8]>::len).sum();
        self.file.set_len(kept as u64).map_err(file_error("write", &self.path))
    }

    fn append(&mut self, line: &MetricsLine) -> Result<(), PpoError> {
        let mut text = serde_json::to_string(line).expect("numbers and names are JSON");
        text.push('\n');
        self.file.write_all(text.as_bytes()).map_err(file_error("write", &self.path))
    }

    fn sync(&self) -> Result<(), PpoError> {
        self.file.sync_data().map_err(file_error("write", &self.path))
    }
}
