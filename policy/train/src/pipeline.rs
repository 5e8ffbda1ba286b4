//! From a sensor model to policies that are scored, by one command: closings, trials of the searching expert, trainings,
//! evaluations, a report.
//!
//! Every stage is a command of this program, which anybody can give by hand. A stage whose command, files and version of
//! the program have not changed since it was done is left as it is; one that was cut off goes on where it was.

mod config;
mod manifest;
mod report;
mod stages;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, bail};
use palpate_sim::job::{Cancel, Progress};
use palpate_terminal::child::{self, Listener};
use palpate_terminal::{Bar, cancel_on_ctrl_c, events};
use serde_json::{Map, Value};

use self::config::PipelineConfig;
use self::manifest::{Manifest, StageRecord};
use self::stages::Stage;
use crate::files;

const REPORT_FILE: &str = "report.html";

#[derive(clap::Args)]
pub(crate) struct PipelineArgs {
    /// What to do: "small" (two cores, an evening) or "paper" (the method's sizes; see --device)
    #[arg(long, default_value = "small")]
    preset: String,
    /// The same from a file; --print-config shows what one looks like
    #[arg(long, conflicts_with = "preset")]
    config: Option<PathBuf>,
    /// Sensor model that makes touch [default: the station's nominal model]
    #[arg(long)]
    model: Option<PathBuf>,
    /// Folder for everything
    #[arg(long, required_unless_present = "print_config")]
    out: Option<PathBuf>,
    /// What policies learn on: "cpu", or "gpu", a graphics card
    #[arg(long, default_value = "cpu", value_parser = ["cpu", "gpu"])]
    device: String,
    /// Threads [default: all cores]
    #[arg(long)]
    threads: Option<usize>,
    /// Say what would be done and about how long it takes, and do nothing
    #[arg(long)]
    plan: bool,
    /// Print the preset as a file for --config, and do nothing
    #[arg(long)]
    print_config: bool,
}

pub(crate) fn run(args: &PipelineArgs) -> anyhow::Result<()> {
    if args.print_config {
        print!("{}", PipelineConfig::preset(&args.preset)?);
        return Ok(());
    }
    let out = args.out.as_deref().context("--out is missing")?;
    if args.threads == Some(0) {
        bail!("--threads is 0, expected at least 1");
    }
    if let Some(model) = args.model.as_ref().filter(|model| !model.is_file()) {
        bail!("--model is {model:?}, and there is no such file");
    }
    let (file, text) = match &args.config {
        Some(path) => (files::shown(path), files::text(path)?),
        None => (format!("preset {}", args.preset), PipelineConfig::preset(&args.preset)?.to_owned()),
    };
    let config = PipelineConfig::read(&file, &text)?;
    let stages = stages::stages(&config, args, out)?;
    let assets = manifest::of_assets()?;
    let mut manifest = Manifest::read(out)?;
    if args.plan {
        print!("{}", plan(&stages, &manifest, &assets, args.threads)?);
        return Ok(());
    }
    std::fs::create_dir_all(out).with_context(|| format!("failed to create {out:?}"))?;
    let _lock = lock(out)?;
    env!("CARGO_PKG_VERSION").clone_into(&mut manifest.software);
    manifest.config = text;
    let (bar, cancel) = (Bar::new(), cancel_on_ctrl_c());
    let all_s: f64 = stages.iter().map(|stage| stage.core_s).sum();
    let mut done_s = 0.0;
    for (idx, stage) in stages.iter().enumerate() {
        let whole = Whole {
            bar: &bar,
            stage: format!("{} ({} of {})", stage.name, idx + 1, stages.len()),
            out,
            begin: done_s / all_s,
            share: stage.core_s / all_s,
        };
        let is_done = make(stage, &mut manifest, &assets, args, &whole, &cancel)
            .with_context(|| format!("stage {:?}", stage.name))?;
        if !is_done {
            drop(bar);
            eprintln!("stopped; the same command goes on from where it was");
            return Ok(());
        }
        done_s += stage.core_s;
    }
    drop(bar);
    let report = report::Report::read(&config, &manifest, out)?;
    let path = out.join(REPORT_FILE);
    files::write_in_one_move(&path, report.html().as_bytes())?;
    events::report(&report.document());
    eprintln!("{}\n{} tells everything", report.summary(), path.display());
    Ok(())
}

/// Keeps others from the folder `out` while this process lives.
fn lock(out: &Path) -> anyhow::Result<File> {
    let path = out.join("lock");
    let file = File::create(&path).with_context(|| format!("failed to create {path:?}"))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(std::fs::TryLockError::WouldBlock) => {
            bail!("another pipeline is at work in {out:?}; wait for it, or take another --out")
        }
        Err(std::fs::TryLockError::Error(err)) => {
            Err(err).with_context(|| format!("failed to lock {path:?}"))
        }
    }
}

/// Where a stage stands.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Standing {
    Done,
    /// It was begun with the same command and files.
    Begun,
    /// It has to be done from the start.
    Due,
}

fn standing(stage: &Stage, manifest: &Manifest, key: &str) -> anyhow::Result<Standing> {
    Ok(match manifest.stages.get(&stage.name) {
        Some(record) if record.key == key && record.is_intact()? => Standing::Done,
        Some(record) if record.key == key => Standing::Begun,
        _ => Standing::Due,
    })
}

/// Makes what `stage` leaves, unless it is there; says whether it is there now, and not stopped before.
fn make(
    stage: &Stage,
    manifest: &mut Manifest,
    assets: &str,
    args: &PipelineArgs,
    whole: &Whole<'_>,
    cancel: &Cancel,
) -> anyhow::Result<bool> {
    let key = manifest.key(stage, assets)?;
    let standing = standing(stage, manifest, &key)?;
    if standing == Standing::Done {
        whole.bar.line(&format!("{}: nothing has changed, it is left as it is", whole.stage));
        return Ok(true);
    }
    if standing == Standing::Due {
        clear(stage, manifest)?;
        let record = StageRecord { command: shown(&stage.command), key, ..StageRecord::default() };
        manifest.stages.insert(stage.name.clone(), record);
        manifest.write(whole.out)?;
    }
    for path in stage.writes.iter().filter_map(|path| path.parent()) {
        std::fs::create_dir_all(path).with_context(|| format!("failed to create {path:?}"))?;
    }
    whole.bar.line(&format!("{}: {}", whole.stage, shown(&stage.command)));
    let began = Instant::now();
    let ended = start(stage, args, whole, cancel)?;
    let record = manifest.stages.entry(stage.name.clone()).or_default();
    record.seconds += began.elapsed().as_secs_f64();
    let is_there = stage.results.iter().all(|path| path.exists());
    if cancel.is_cancelled() || !ended.status.success() || !is_there {
        manifest.write(whole.out)?;
        if cancel.is_cancelled() {
            return Ok(false);
        }
        match ended.complaint.as_str() {
            "" => {
                bail!("palpate-train {} ended without its results ({})", shown(&stage.command), ended.status)
            }
            complaint => bail!("{complaint}"),
        }
    }
    record.results = manifest::results(&stage.results)?;
    manifest.write(whole.out)?;
    Ok(true)
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

/// Runs the command of `stage` until it ends.
fn start(
    stage: &Stage,
    args: &PipelineArgs,
    whole: &Whole<'_>,
    cancel: &Cancel,
) -> anyhow::Result<child::Ended> {
    let program = std::env::current_exe().context("failed to find this program")?;
    let mut command = child::command(&program);
    command.args(&stage.command);
    if let Some(threads) = args.threads {
        command.args(["--threads", &threads.to_string()]);
    }
    let prefix = stage.name.replace(' ', "_");
    let listener = Listener {
        progress: whole,
        metrics: &|point| events::metrics(step(point), &Value::Object(prefixed(&prefix, point))),
        log: &|line| whole.bar.line(line),
        cancel,
    };
    child::run(&mut command, &listener).with_context(|| format!("failed to run {program:?}"))
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

/// How far the whole pipeline is, by how far a stage is.
struct Whole<'a> {
    bar: &'a Bar,
    /// The folder of everything.
    out: &'a Path,
    stage: String,
    begin: f64,
    share: f64,
}

impl Progress for Whole<'_> {
    fn report(&self, fraction: f64, stage: &str) {
        self.bar.report(
            (self.begin + self.share * fraction.clamp(0.0, 1.0)).min(1.0),
            &format!("{}: {stage}", self.stage),
        );
    }
}

/// A command as one gives it in a terminal.
fn shown(command: &[OsString]) -> String {
    let quoted = |argument: &OsString| {
        let text = argument.to_string_lossy().into_owned();
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,".contains(c);
        if text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
    };
    let arguments: Vec<String> = command.iter().map(quoted).collect();
    format!("palpate-train {}", arguments.join(" "))
}

/// What is left to do, for people.
fn plan(
    stages: &[Stage],
    manifest: &Manifest,
    assets: &str,
    threads: Option<usize>,
) -> anyhow::Result<String> {
    let cores = threads.or_else(|| std::thread::available_parallelism().ok().map(usize::from)).unwrap_or(1);
    let (mut text, mut left_min) = (String::new(), 0.0);
    let mut made_anew: BTreeSet<&str> = BTreeSet::new();
    for stage in stages {
        let standing = match manifest.key(stage, assets) {
            Ok(key) if !stage.needs.iter().any(|name| made_anew.contains(name.as_str())) => {
                standing(stage, manifest, &key)?
            }
            // What it needs will be another.
            _ => Standing::Due,
        };
        let minutes = stage.core_s / if stage.is_parallel { cores as f64 } else { 1.0 } / 60.0;
        let words = match standing {
            Standing::Done => "done".to_owned(),
            Standing::Begun => format!("begun, about {minutes:.0} min from the start"),
            Standing::Due => format!("about {minutes:.0} min"),
        };
        if standing != Standing::Done {
            left_min += minutes;
            made_anew.insert(&stage.name);
        }
        text.push_str(&format!("{:<28} {words:<28} {}\n", stage.name, shown(&stage.command)));
    }
    text.push_str(&format!(
        "about {left_min:.0} min in all on {cores} cores, where policies learn by the preset small on a CPU\n"
    ));
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_shown_as_a_terminal_takes_it() {
        let command = ["gather", "--out", "a b/it's", "--count", "3"].map(OsString::from);
        assert_eq!(shown(&command), r"palpate-train gather --out 'a b/it'\''s' --count 3");
    }

    #[test]
    fn curves_of_a_stage_have_its_name() {
        let point: Map<String, Value> =
            serde_json::from_value(serde_json::json!({"step": 4, "train": 0.5})).expect("an object");
        assert_eq!(step(&point), 4);
        let named = serde_json::json!({"policy_0": {"train": 0.5}});
        assert_eq!(Value::Object(prefixed("policy_0", &point)), named);
    }
}
