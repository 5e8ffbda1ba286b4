//! Pretrains the tactile encoder on demonstrations and trials of an expert, and scores what its decoder then knows of what
//! nothing was felt of.

mod reader;
mod samples;
mod surface;

use std::path::PathBuf;

use anyhow::bail;
use palpate_encoder::{Data, Dataset, EncoderConfig, Finish, MeanPrediction, Progress, Score, Start};
use palpate_terminal::{Bar, cancel_on_ctrl_c, events};
use serde::Serialize;

use self::samples::World;
use crate::files;
use crate::learning::{self, ConfigArgs};

#[derive(clap::Args)]
pub(crate) struct EncodeArgs {
    /// Folders of demonstrations, or of trials of the searching expert (`gather`)
    #[arg(long, required = true, num_args = 1.., value_name = "FOLDER")]
    demos: Vec<PathBuf>,
    #[command(flatten)]
    config: ConfigArgs,
    /// Seed of weights, order, points and of what is held out [default: the configuration's]
    #[arg(long)]
    seed: Option<u64>,
    /// How often to go through the samples [default: the configuration's]
    #[arg(long)]
    epochs: Option<u64>,
    /// Tell the encoder of activations only, not where taxels are
    #[arg(long)]
    without_positions: bool,
    /// Tell the encoder where taxels are only, not what they feel
    #[arg(long)]
    silence_touch: bool,
    /// Folder for checkpoint and metrics
    #[arg(long)]
    out: PathBuf,
    /// Go on from the folder's checkpoint; a run that has ended is scored again
    #[arg(long)]
    resume: bool,
    /// Threads [default: all cores]
    #[arg(long)]
    threads: Option<usize>,
    /// One JSON document on standard output
    #[arg(long)]
    json: bool,
}

/// How good held-out predictions are.
#[derive(Serialize)]
struct Report {
    updates: u64,
    train_samples: usize,
    held_out: Score,
    /// Of one that feels nothing and says the means of what was learned from.
    mean_baseline: Score,
}

pub(crate) fn run(args: &EncodeArgs) -> anyhow::Result<()> {
    let config = config(args)?;
    files::start_threads(args.threads)?;
    let world = World::new(reader::read(&args.demos)?, &config)?;
    let [train, held_out] = world.split(&config);
    eprintln!(
        "{} demonstrations: {} samples to learn from, {} held out",
        world.data().demonstrations.len(),
        train.len(),
        held_out.len()
    );
    let (bar, cancel) = (Bar::new(), cancel_on_ctrl_c());
    let mut watch = |progress: &Progress| learning::tell(progress, &bar, &cancel);
    let start = if args.resume { Start::Resume } else { Start::Fresh };
    let data = Data { train: &train, held_out: &held_out, sources: world.data().sources.clone() };
    let result = palpate_encoder::train(&args.out, start, config.clone(), data, &mut watch);
    drop(bar);
    let (trainer, finish) = result?;
    if finish == Finish::Cancelled {
        eprintln!("stopped; `--resume` goes on from the last checkpoint in {}", args.out.display());
        return Ok(());
    }
    let mean = MeanPrediction::of(&train, &config)?;
    let report = Report {
        updates: trainer.updates(),
        train_samples: train.len(),
        held_out: Score::of(|add| trainer.predict(&held_out, add).map(|_| ()))?,
        mean_baseline: Score::of(|add| {
            (0..held_out.len()).for_each(|idx| add(mean.prediction(), &held_out.sample(idx)));
            anyhow::Ok(())
        })?,
    };
    events::report(&report);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else if !events::are_printed() {
        print(&report);
    }
    eprintln!("{} updates; {} holds the run", report.updates, args.out.display());
    Ok(())
}

fn config(args: &EncodeArgs) -> anyhow::Result<EncoderConfig> {
    let mut config = args.config.read(EncoderConfig::from_toml, EncoderConfig::preset)?;
    config.seed = args.seed.unwrap_or(config.seed);
    config.epochs = args.epochs.unwrap_or(config.epochs);
    config.inputs.positions &= !args.without_positions;
    config.inputs.touch &= !args.silence_touch;
    if !(config.inputs.positions || config.inputs.touch) {
        bail!(
            "an encoder that is told neither where taxels are nor what they feel has nothing to learn from"
        );
    }
    config.validate()?;
    Ok(config)
}

fn print(report: &Report) {
    let (found, mean) = (&report.held_out, &report.mean_baseline);
    println!("held out: {} samples, {} of them in contact", found.samples, found.in_contact);
    println!("{:34} {:>9} {:>14}", "", "encoder", "training means");
    let row = |what: &str, digits: usize, values: [Option<f64>; 2]| {
        let [found, mean] =
            values.map(|value| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}")));
        println!("{what:34} {found:>9} {mean:>14}");
    };
    row("object's place, cm off", 2, [found.position_cm, mean.position_cm]);
    row("object's rotation, degrees off", 1, [found.rotation_deg, mean.rotation_deg]);
    row("object's points, mm off", 2, [found.object_chamfer_mm, mean.object_chamfer_mm]);
    row("hand's points, mm off", 2, [found.hand_chamfer_mm, mean.hand_chamfer_mm].map(Some));
    row("joints, rad off (rms)", 3, [found.joint_rms, mean.joint_rms].map(Some));
    row("contacts, AUC", 3, [found.contact_auc, mean.contact_auc]);
    row("contacts, F1", 3, [found.contact_f1, mean.contact_f1]);
}
