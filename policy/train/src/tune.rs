//! Tunes a script on one object.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, bail};
use palpate_grasp::tune::{Generation, TuneParams, TuningConfig, tune};
use palpate_grasp::{GraspError, Script};
use palpate_sim::job::Cancel;

use crate::files::Sources;
use crate::{SceneArgs, files};
use palpate_terminal::{Bar, cancel_on_ctrl_c, events};

/// What changes unless another file is named.
const TUNING: &str = "assets/grasp/xarm6_leap_tuning.toml";

#[derive(clap::Args)]
pub(crate) struct TuneArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// What may change in the script, and what a trial is worth
    #[arg(long, default_value = TUNING)]
    tuning: PathBuf,
    /// Seed of candidates and trials
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rounds of candidates
    #[arg(long, allow_negative_numbers = true, default_value_t = 8)]
    generations: usize,
    /// Scripts drawn in each
    #[arg(long, allow_negative_numbers = true, default_value_t = 64)]
    candidates: usize,
    /// The best of them, which the next ones are drawn around
    #[arg(long, allow_negative_numbers = true, default_value_t = 10)]
    elite: usize,
    /// Trials of each candidate
    #[arg(long, allow_negative_numbers = true, default_value_t = 4)]
    trials: usize,
    /// Trials that choose the best generation; no candidate sees their worlds
    #[arg(long, allow_negative_numbers = true, default_value_t = 50)]
    check_trials: usize,
    /// The tuned script; it is written whenever a better one is found
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn run(args: &TuneArgs) -> anyhow::Result<()> {
    check(args)?;
    let (scene, script) = files::open(&args.scene, &Sources::default())?;
    let shown = files::shown(&args.tuning);
    let text = files::text(&args.tuning)?;
    let tuning = TuningConfig::from_toml(&shown, &text, &scene.station().robot, &script)?;
    let params = TuneParams {
        seed: args.seed,
        generations: args.generations,
        candidates: args.candidates,
        elite: args.elite,
        trials: args.trials,
        check_trials: args.check_trials,
    };
    let (bar, cancel, began) = (Bar::new(), cancel_on_ctrl_c(), Instant::now());
    let header =
        |generation| header(args, &scene.object().label, scene.config().task.half_width_m, generation);
    let mut failed = None;
    let on_generation = |generation: &Generation, best: &Script| {
        if let Err(err) = tell(args, &bar, generation, began) {
            failed.get_or_insert(err);
            cancel.cancel();
        }
        if generation.best
            && let Err(err) = write(&args.out, &header(generation.generation), best)
        {
            failed.get_or_insert(err);
            cancel.cancel();
        }
        Ok::<(), GraspError>(())
    };
    let report = tune(&scene, &script, &tuning, &params, &bar, &cancel, on_generation)?;
    drop(bar);
    if let Some(err) = failed {
        return Err(err);
    }
    let Some(report) = report else {
        bail!("stopped before the first script was scored; nothing was written")
    };
    if Cancel::is_cancelled(&cancel) {
        eprintln!("stopped early, after {} generations", report.generations.len() - 1);
    }
    events::report(&serde_json::json!({ "generations": report.generations }));
    eprintln!("wrote {}", args.out.display());
    Ok(())
}

/// What is wrong with the numbers and the place to write to, before anything starts.
fn check(args: &TuneArgs) -> anyhow::Result<()> {
    let counts = [
        ("--generations", args.generations),
        ("--candidates", args.candidates),
        ("--elite", args.elite),
        ("--trials", args.trials),
        ("--check-trials", args.check_trials),
    ];
    if let Some((name, _)) = counts.iter().find(|(_, count)| *count == 0) {
        bail!("{name} is 0, expected at least 1");
    }
    if args.elite > args.candidates {
        bail!("--elite is {}, expected at most the {} of --candidates", args.elite, args.candidates);
    }
    files::check_out(&args.out)
}

fn tell(args: &TuneArgs, bar: &Bar, generation: &Generation, began: Instant) -> anyhow::Result<()> {
    if args.scene.json {
        println!("{}", serde_json::to_string(generation)?);
    }
    events::metrics(generation.generation as u64, generation);
    let Generation { generation: number, check_score, check, spread, best, .. } = generation;
    let elapsed_s = began.elapsed().as_secs_f64();
    let left_s = elapsed_s / (number + 1) as f64 * (args.generations - number) as f64;
    bar.line(&format!(
        "generation {number} of {}: {} of {} won, score {check_score:.3}, spread {spread:.2}{}; {elapsed_s:.0} s, about \
         {left_s:.0} s left",
        args.generations,
        check.successes,
        check.trials,
        if *best { ", the best so far" } else { "" },
    ));
    Ok(())
}

/// What a tuned script says of itself, found in this generation: a search that ends there gives the same script.
fn header(args: &TuneArgs, object: &str, half_width_m: f64, generation: usize) -> String {
    format!(
        "# A closing script tuned on one object, {object}, started within {:.1} cm. Made by\n\
         #   palpate-train tune --object {} --start-cm {} --seed {} --generations {} --candidates {} --elite {} \\\n\
         #     --trials {} --check-trials {}{}\n\
         # from {}.\n\n",
        100.0 * half_width_m,
        args.scene.object,
        100.0 * half_width_m,
        args.seed,
        generation.max(1),
        args.candidates,
        args.elite,
        args.trials,
        args.check_trials,
        other_files(args),
        files::shown(&args.scene.script)
    )
}

/// The flags that name other files than those that a search takes by itself.
fn other_files(args: &TuneArgs) -> String {
    let tuning = (args.tuning != Path::new(TUNING)).then_some(&args.tuning);
    [
        ("--tuning", tuning),
        ("--model", args.scene.robot.model.as_ref()),
        ("--truth", args.scene.truth.as_ref()),
    ]
    .into_iter()
    .filter_map(|(flag, path)| Some(format!(" \\\n#     {flag} {}", files::shown(path?))))
    .collect()
}

/// Writes beside the file first, so that there is never half a script.
fn write(out: &Path, header: &str, script: &Script) -> anyhow::Result<()> {
    let text = format!("{header}{}", script.to_toml()?);
    let mut beside = out.as_os_str().to_owned();
    beside.push(".part");
    let beside = PathBuf::from(beside);
    std::fs::write(&beside, text).with_context(|| format!("failed to write {beside:?}"))?;
    std::fs::rename(&beside, out).with_context(|| format!("failed to rename {beside:?} to {out:?}"))
}
