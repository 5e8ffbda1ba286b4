//! Scores a script; prints scores.

use std::collections::BTreeMap;

use anyhow::bail;
use palpate_grasp::GraspScene;
use palpate_grasp::trial::{self, Score};
use palpate_terminal::events;
use serde::Serialize;

use crate::files::Sources;
use crate::{SceneArgs, files};

#[derive(clap::Args)]
pub(crate) struct ScriptArgs {
    #[command(flatten)]
    scene: SceneArgs,
    /// Number of trials
    #[arg(long, allow_negative_numbers = true, default_value_t = 50)]
    trials: u64,
    /// Seed of starts and randomised physics
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

#[derive(Serialize)]
struct ScriptReport {
    objects: BTreeMap<String, Score>,
}

pub(crate) fn run(args: &ScriptArgs) -> anyhow::Result<()> {
    if args.trials == 0 {
        bail!("--trials is 0, expected at least 1");
    }
    let (scene, script) = files::open(&args.scene, &Sources::default())?;
    let score = Score::of(&trial::run_all(&scene, &script, args.seed, args.trials)?);
    print(&scene, score, args.scene.json)
}

/// Prints what was scored in `scene`.
pub(crate) fn print(scene: &GraspScene, score: Score, json: bool) -> anyhow::Result<()> {
    let object = scene.object();
    let report = ScriptReport { objects: [(object.id.clone(), score.clone())].into() };
    events::report(&report);
    if json {
        println!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    if events::are_printed() {
        return Ok(());
    }
    let [low, high] = score.interval_95;
    println!(
        "{}: {} of {} lifted and held (95 % interval {low:.2} to {high:.2}); {} empty, {} slipped, {} stopped",
        object.label, score.successes, score.trials, score.empty_grasp, score.slip, score.emergency_stop
    );
    Ok(())
}
