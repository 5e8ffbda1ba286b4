//! From a sensor model to policies that are scored, by one command: closings, trials of the searching expert, trainings,
//! evaluations, a report.
//!
//! Every stage is a command of this program, which anybody can give by hand. A stage whose command, files and version of
//! the program have not changed since it was done is left as it is; one that was cut off goes on where it was.

mod config;
mod manifest;
mod report;
mod stages;
mod tables;
mod work;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_terminal::{cancel_on_ctrl_c, events};

use self::config::PipelineConfig;
use self::manifest::Manifest;
use self::stages::Stage;
use self::work::Work;
use crate::files;

const REPORT_FILE: &str = "report.html";

#[derive(clap::Args)]
pub(crate) struct PipelineArgs {
    /// What to do: "small" (two cores, an evening), "tables" (the paper's comparisons of policies, two cores, some
    /// hours) or "paper" (the method's sizes; see --device)
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
        print!("{}", plan(&stages, &manifest, &assets, args)?);
        return Ok(());
    }
    std::fs::create_dir_all(out).with_context(|| format!("failed to create {out:?}"))?;
    let _lock = lock(out)?;
    env!("CARGO_PKG_VERSION").clone_into(&mut manifest.software);
    manifest.config = text;
    let cancel = cancel_on_ctrl_c();
    let work = Work::new(&stages, manifest, &assets, args, out, &cancel);
    let (manifest, is_done) = work.run()?;
    if !is_done {
        eprintln!("stopped; the same command goes on from where it was");
        return Ok(());
    }
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

/// Cores that there are for everything.
fn cores(threads: Option<usize>) -> usize {
    threads.or_else(|| std::thread::available_parallelism().ok().map(usize::from)).unwrap_or(1)
}

/// How many stages at the beginning of `stages` are done side by side, at least 1: those that use one core each, and
/// need nothing of each other. On a graphics card one training is done after the other: side by side none of them would
/// be faster.
fn side_by_side(stages: &[Stage], args: &PipelineArgs) -> usize {
    let is_alone = |stage: &Stage| stage.is_parallel || args.device == "gpu";
    let goes_with = |(idx, stage): &(usize, &Stage)| {
        !is_alone(stage) && !stages[..*idx].iter().any(|before| stage.needs.contains(&before.name))
    };
    stages.iter().enumerate().take_while(goes_with).count().max(1)
}

/// What is left to do, for people.
fn plan(stages: &[Stage], manifest: &Manifest, assets: &str, args: &PipelineArgs) -> anyhow::Result<String> {
    let cores = cores(args.threads);
    let (mut text, mut left_min) = (String::new(), 0.0);
    let mut made_anew: BTreeSet<&str> = BTreeSet::new();
    let mut rest = stages;
    while let Some((batch, after)) = rest.split_at_checked(side_by_side(rest, args)) {
        let (mut sum_min, mut longest_min) = (0.0, 0.0_f64);
        for stage in batch {
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
                (sum_min, longest_min) = (sum_min + minutes, longest_min.max(minutes));
                made_anew.insert(&stage.name);
            }
            text.push_str(&format!("{:<28} {words:<28} {}\n", stage.name, shown(&stage.command)));
        }
        left_min += longest_min.max(sum_min / cores.min(batch.len()) as f64);
        rest = after;
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
    fn trainings_that_need_nothing_of_each_other_are_done_side_by_side() {
        let stage = |name: &str, needs: &[&str], is_parallel: bool| Stage {
            name: name.to_owned(),
            command: Vec::new(),
            needs: needs.iter().map(|need| (*need).to_owned()).collect(),
            files: Vec::new(),
            results: Vec::new(),
            writes: Vec::new(),
            core_s: 1.0,
            is_parallel,
        };
        let stages = [
            stage("trials", &[], true),
            stage("one", &["trials"], false),
            stage("two", &["trials"], false),
            stage("again", &["trials", "two"], false),
            stage("scores", &["one", "two", "again"], true),
        ];
        let args = |device: &str| PipelineArgs {
            preset: "small".to_owned(),
            config: None,
            model: None,
            out: None,
            device: device.to_owned(),
            threads: None,
            plan: false,
            print_config: false,
        };
        let batches = |device: &str| {
            (0..stages.len()).map(|first| side_by_side(&stages[first..], &args(device))).collect::<Vec<_>>()
        };
        assert_eq!(batches("cpu"), [1, 2, 1, 1, 1]);
        assert_eq!(batches("gpu"), [1; 5]);
    }
}
