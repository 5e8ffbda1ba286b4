//! A pipeline at work: one stage after the other, and side by side what uses one core each.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use anyhow::{Context as _, bail};
use palpate_sim::job::{Cancel, Progress};
use palpate_terminal::child::{self, Listener};
use palpate_terminal::{Bar, events};
use serde_json::{Map, Value};

use super::manifest::{self, Manifest, StageRecord};
use super::stages::Stage;
use super::{PipelineArgs, Standing, cores, shown, side_by_side, standing};

/// What all stages share.
pub(super) struct Work<'a> {
    stages: &'a [Stage],
    assets: &'a str,
    args: &'a PipelineArgs,
    /// The folder of everything.
    out: &'a Path,
    cancel: &'a Cancel,
    bar: Bar,
    manifest: Mutex<Manifest>,
    /// How much of each stage is done, 0 to 1.
    done: Mutex<Vec<f64>>,
}

impl<'a> Work<'a> {
    /// Nothing of `stages` has been looked at yet.
    pub(super) fn new(
        stages: &'a [Stage],
        manifest: Manifest,
        assets: &'a str,
        args: &'a PipelineArgs,
        out: &'a Path,
        cancel: &'a Cancel,
    ) -> Self {
        let (manifest, done) = (Mutex::new(manifest), Mutex::new(vec![0.0; stages.len()]));
        Self { stages, assets, args, out, cancel, bar: Bar::new(), manifest, done }
    }

    /// Makes what every stage leaves; gives what has been done, and whether that is all and it was not stopped before.
    ///
    /// # Errors
    /// A stage that fails, by its name; others that were under way are finished.
    pub(super) fn run(self) -> anyhow::Result<(Manifest, bool)> {
        let (mut first, mut is_done) = (0, true);
        while is_done && first < self.stages.len() {
            let end = first + side_by_side(&self.stages[first..], self.args);
            is_done = self.run_side_by_side(first, end)?;
            first = end;
        }
        Ok((self.manifest.into_inner().unwrap_or_else(PoisonError::into_inner), is_done))
    }

    /// Makes the stages from `first` to before `end`, as many at a time as there are cores; says whether none was
    /// stopped.
    fn run_side_by_side(&self, first: usize, end: usize) -> anyhow::Result<bool> {
        let num_workers = cores(self.args.threads).min(end - first);
        // The cores are shared out where there are several at a time; one alone takes them all, as it does without
        // this.
        let threads =
            if num_workers > 1 { Some(cores(self.args.threads) / num_workers) } else { self.args.threads };
        let next = AtomicUsize::new(first);
        let worker = || -> anyhow::Result<bool> {
            loop {
                let idx = next.fetch_add(1, Ordering::Relaxed);
                if idx >= end {
                    return Ok(true);
                }
                let made = self.make(idx, threads);
                if !matches!(made, Ok(true)) {
                    // Nothing more is begun.
                    next.store(end, Ordering::Relaxed);
                    return made.with_context(|| format!("stage {:?}", self.stages[idx].name));
                }
            }
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..num_workers).map(|_| scope.spawn(worker)).collect();
            let mut is_done = true;
            for worker in workers {
                is_done &= worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
            }
            Ok(is_done)
        })
    }

    fn manifest(&self) -> MutexGuard<'_, Manifest> {
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes what a stage leaves, unless it is there; says whether it is there now, and not stopped before.
    fn make(&self, idx: usize, threads: Option<usize>) -> anyhow::Result<bool> {
        let stage = &self.stages[idx];
        let title = format!("{} ({} of {})", stage.name, idx + 1, self.stages.len());
        let key = self.manifest().key(stage, self.assets)?;
        let standing = standing(stage, &self.manifest(), &key)?;
        if standing == Standing::Done {
            self.bar.line(&format!("{title}: nothing has changed, it is left as it is"));
            self.report(idx, 1.0, &title);
            return Ok(true);
        }
        if standing == Standing::Due {
            let mut manifest = self.manifest();
            clear(stage, &manifest)?;
            let record = StageRecord { command: shown(&stage.command), key, ..StageRecord::default() };
            manifest.stages.insert(stage.name.clone(), record);
            manifest.write(self.out)?;
        }
        for path in stage.writes.iter().filter_map(|path| path.parent()) {
            std::fs::create_dir_all(path).with_context(|| format!("failed to create {path:?}"))?;
        }
        self.bar.line(&format!("{title}: {}", shown(&stage.command)));
        let began = Instant::now();
        let ended = self.start(idx, &title, threads)?;
        let seconds = began.elapsed().as_secs_f64();
        let is_there = stage.results.iter().all(|path| path.exists());
        let is_made = !self.cancel.is_cancelled() && ended.status.success() && is_there;
        let results = if is_made { Some(manifest::results(&stage.results)?) } else { None };
        let mut manifest = self.manifest();
        let record = manifest.stages.entry(stage.name.clone()).or_default();
        record.seconds += seconds;
        record.results = results.unwrap_or_default();
        manifest.write(self.out)?;
        drop(manifest);
        match ended.complaint.as_str() {
            _ if is_made => {
                self.report(idx, 1.0, &title);
                Ok(true)
            }
            _ if self.cancel.is_cancelled() => Ok(false),
            "" => {
                bail!("palpate-train {} ended without its results ({})", shown(&stage.command), ended.status)
            }
            complaint => bail!("{complaint}"),
        }
    }

    /// Runs the command of a stage until it ends.
    fn start(&self, idx: usize, title: &str, threads: Option<usize>) -> anyhow::Result<child::Ended> {
        let stage = &self.stages[idx];
        let program = std::env::current_exe().context("failed to find this program")?;
        let mut command = child::command(&program);
        command.args(&stage.command);
        if let Some(threads) = threads {
            command.args(["--threads", &threads.to_string()]);
        }
        let prefix = stage.name.replace(' ', "_");
        let listener = Listener {
            progress: &OfStage { work: self, idx, title },
            metrics: &|point| events::metrics(step(point), &Value::Object(prefixed(&prefix, point))),
            log: &|line| self.bar.line(line),
            cancel: self.cancel,
        };
        child::run(&mut command, &listener).with_context(|| format!("failed to run {program:?}"))
    }

    /// Says how far everything is when `fraction` of a stage is done.
    fn report(&self, idx: usize, fraction: f64, words: &str) {
        let all_s: f64 = self.stages.iter().map(|stage| stage.core_s).sum();
        let mut done = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        done[idx] = fraction.clamp(0.0, 1.0);
        let done_s: f64 = done.iter().zip(self.stages).map(|(done, stage)| done * stage.core_s).sum();
        drop(done);
        self.bar.report((done_s / all_s).min(1.0), words);
    }
}

/// How far a stage is.
struct OfStage<'a> {
    work: &'a Work<'a>,
    idx: usize,
    title: &'a str,
}

impl Progress for OfStage<'_> {
    fn report(&self, fraction: f64, stage: &str) {
        self.work.report(self.idx, fraction, &format!("{}: {stage}", self.title));
    }
}

/// Removes what an earlier run of `stage` left; refuses to where no pipeline made it.
fn clear(stage: &Stage, manifest: &Manifest) -> anyhow::Result<()> {
    for path in stage.writes.iter().filter(|path| path.exists()) {
        if !manifest.stages.contains_key(&stage.name) {
            bail!("{path:?} is there, and no pipeline made it; move it away, or take another --out");
        }
        let removed = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
        removed.with_context(|| format!("failed to remove {path:?}"))?;
    }
    Ok(())
}

fn step(point: &Map<String, Value>) -> u64 {
    point.get("step").and_then(Value::as_u64).unwrap_or_default()
}

/// The values of `point` in an object called `prefix`, so that stages do not share curves.
fn prefixed(prefix: &str, point: &Map<String, Value>) -> Map<String, Value> {
    let values = point.iter().filter(|(name, _)| *name != "step");
    let values: Map<String, Value> = values.map(|(name, value)| (name.clone(), value.clone())).collect();
    Map::from_iter([(prefix.to_owned(), Value::Object(values))])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_of_a_stage_have_its_name() {
        let point: Map<String, Value> =
            serde_json::from_value(serde_json::json!({"step": 4, "train": 0.5})).expect("an object");
        assert_eq!(step(&point), 4);
        let named = serde_json::json!({"policy_0": {"train": 0.5}});
        assert_eq!(Value::Object(prefixed("policy_0", &point)), named);
    }
}
