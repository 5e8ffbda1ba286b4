//! Learns to do what an expert did.

mod encoding;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_cloning::{
    CHECKPOINT_FILE, CloneConfig, Data, Episode, Episodes, Finish, Head, Memory, POLICY_FILE, PaperPolicy,
    Progress, Robot, Start, TrainingDevice,
};
use palpate_grasp::trial::Outcome;
use palpate_terminal::{Bar, cancel_on_ctrl_c, events};
use palpate_training::TrainingError;
use serde::Serialize;

use self::encoding::Encoding;
use crate::files;
use crate::gather::{self, Gathered, Trial};
use crate::learning;

/// The source that an encoder is.
const ENCODER: &str = "encoder";

#[derive(clap::Args)]
pub(crate) struct CloneArgs {
    /// Folders of `palpate-train gather`
    #[arg(long, required = true, num_args = 1..)]
    data: Vec<PathBuf>,
    /// How to learn: "small" (two cores, a quarter of an hour) or "paper" (the method's numbers)
    #[arg(long, default_value = "small")]
    preset: String,
    /// The same from a file
    #[arg(long, conflicts_with = "preset")]
    config: Option<PathBuf>,
    /// A policy of the paper, as `docs/learning.md` lists them: how it sees touch, and what predicts
    #[arg(long, conflicts_with_all = ["head", "features"])]
    policy: Option<PaperPolicy>,
    /// What predicts: "regression", "diffusion" or "act", action chunking with Transformers [default: the configuration's]
    #[arg(long, value_parser = head)]
    head: Option<Head>,
    /// How the frames of a window are joined: "window", side by side, or "recurrent", by a GRU [default: the
    /// configuration's]
    #[arg(long, value_parser = memory)]
    memory: Option<Memory>,
    /// Seed of weights, order and noise [default: the configuration's]
    #[arg(long)]
    seed: Option<u64>,
    /// Updates [default: the configuration's]
    #[arg(long, allow_negative_numbers = true)]
    updates: Option<u64>,
    /// The policy does not feel touch
    #[arg(long)]
    silence_touch: bool,
    /// The policy does not see how far joints are from where they were sent
    #[arg(long)]
    hide_tracking: bool,
    /// The policy sees how strongly each channel is touched, and not only whether it is; no station tells that
    #[arg(long)]
    strengths: bool,
    /// The policy sees the features that --encoder makes; those of the paper that do so by themselves need no such flag
    #[arg(long)]
    features: bool,
    /// What makes features: a file of `export --encoder`, or a pretraining's folder or checkpoint. It becomes part of the
    /// policy's file
    #[arg(long, value_name = "FILE")]
    encoder: Option<PathBuf>,
    /// The policy sees how wide the region is that objects begin in; the trials have to be of several regions
    #[arg(long)]
    region: bool,
    /// Learn from the trials that were won, and not from the others
    #[arg(long)]
    only_won: bool,
    /// Folder of the training
    #[arg(long)]
    out: PathBuf,
    /// Go on from the folder's checkpoint
    #[arg(long)]
    resume: bool,
    /// What computes: "cpu", or "gpu", a graphics card (another card gets other bits)
    #[arg(long, default_value = "cpu", value_parser = ["cpu", "gpu"])]
    device: String,
    /// Threads [default: all cores]
    #[arg(long)]
    threads: Option<usize>,
    /// One JSON document on standard output
    #[arg(long)]
    json: bool,
}

fn head(text: &str) -> Result<Head, String> {
    match text {
        "regression" => Ok(Head::Regression),
        "diffusion" => Ok(Head::Diffusion),
        "act" => Ok(Head::Act),
        other => Err(format!("{other:?} is none of regression, diffusion and act")),
    }
}

pub(crate) fn memory(text: &str) -> Result<Memory, String> {
    match text {
        "window" => Ok(Memory::Window),
        "recurrent" => Ok(Memory::Recurrent),
        other => Err(format!("{other:?} is neither window nor recurrent")),
    }
}

#[derive(Serialize)]
struct Report {
    updates: u64,
    episodes: usize,
    steps: usize,
    held_out_episodes: usize,
    /// Mean error of the averaged policy on held-out episodes, normalised: squared, or absolute where it learned that.
    held_out_loss: f64,
}

pub(crate) fn run(args: &CloneArgs) -> anyhow::Result<()> {
    let mut config = match &args.config {
        Some(path) => CloneConfig::from_toml(&files::shown(path), &files::text(path)?)?,
        None => CloneConfig::preset(&args.preset)?,
    };
    if let Some(policy) = args.policy {
        policy.apply(&mut config);
    }
    config.head = args.head.unwrap_or(config.head);
    config.memory = args.memory.unwrap_or(config.memory);
    config.seed = args.seed.unwrap_or(config.seed);
    config.updates = args.updates.unwrap_or(config.updates);
    config.observation.touch &= !args.silence_touch;
    config.observation.tracking &= !args.hide_tracking;
    config.observation.strengths |= args.strengths;
    config.observation.features |= args.features;
    config.observation.region |= args.region;
    config.validate()?;
    let encoder = encoder(args, &config)?;
    files::start_threads(args.threads)?;
    let device = match args.device.as_str() {
        "gpu" => TrainingDevice::gpu()?,
        _ => TrainingDevice::cpu(),
    };
    let gathered = gather::read_all(&args.data)?;
    if config.observation.region
        && let Some((path, _)) = gathered.iter().find(|(_, one)| one.record.half_width_m().is_none())
    {
        bail!(
            "{path} does not say how wide the region was that its objects began in, which earlier versions did not keep, and \
             observation.region is true; the `palpate-train gather` that made it, given once more, adds that"
        );
    }
    let encoding = match encoder {
        // Refused before minutes are spent on features, and not after.
        Some(_) if !args.resume && args.out.join(CHECKPOINT_FILE).exists() => {
            return Err(TrainingError::RunExists(args.out.clone()).into());
        }
        Some(path) => Some(Encoding::open(path, &config, &gathered)?),
        None if config.observation.points => Some(Encoding::points(&config, &gathered)?),
        None => None,
    };
    let (robot, episodes, mut sources) = learned_from(args, &config, gathered)?;
    let (bar, cancel) = (Bar::new(), cancel_on_ctrl_c());
    let episodes = match &encoding {
        None => Episodes::new(robot.shape(), episodes)?,
        Some(encoding) => {
            sources.extend(encoding.sha256().map(|sha256| (ENCODER.to_owned(), sha256.to_owned())));
            let Some(encoded) = encoding.encode(&robot, episodes, &bar, &cancel)? else {
                drop(bar);
                eprintln!("stopped before anything was learned");
                return Ok(());
            };
            encoded
        }
    };
    let [train, held_out] = episodes.split(&config);
    bar.line(&format!(
        "{} trials with {} steps to learn from, {} held out; learning on {}",
        train.len(),
        train.num_steps(),
        held_out.len(),
        device.name()
    ));
    let mut watch = |progress: &Progress| learning::tell(progress, &bar, &cancel);
    let start = if args.resume { Start::Resume } else { Start::Fresh };
    let data = Data { robot, train: &train, held_out: &held_out, sources };
    let result = palpate_cloning::train(&args.out, start, config, data, &device, &mut watch);
    drop(bar);
    let (trainer, finish) = result?;
    if finish == Finish::Cancelled {
        eprintln!("stopped; `--resume` goes on from the last checkpoint in {}", args.out.display());
        return Ok(());
    }
    let policy = args.out.join(POLICY_FILE);
    files::write_in_one_move(&policy, &trainer.cloned().to_bytes()?)?;
    let report = Report {
        updates: trainer.updates(),
        episodes: train.len(),
        steps: train.num_steps(),
        held_out_episodes: held_out.len(),
        held_out_loss: trainer.judge(&held_out)?,
    };
    events::report(&report);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    }
    eprintln!(
        "{} updates, held-out loss {:.4}; {} holds the policy",
        report.updates,
        report.held_out_loss,
        policy.display()
    );
    Ok(())
}

/// Where the encoder is, if the policy shall see its features.
fn encoder<'a>(args: &'a CloneArgs, config: &CloneConfig) -> anyhow::Result<Option<&'a Path>> {
    match (&args.encoder, config.observation.features) {
        (Some(path), true) => Ok(Some(path)),
        (None, false) => Ok(None),
        (None, true) => bail!(
            "observation.features is true, but there is no encoder to make features; give --encoder FILE \
             (`palpate-train encode` pretrains one), or set observation.features to false"
        ),
        (Some(path), false) => bail!(
            "--encoder is {path:?}, but observation.features is false, so the policy would not see its features; add \
             --features, or leave --encoder out"
        ),
    }
}

/// The robot, the trials and what they were made from.
fn learned_from(
    args: &CloneArgs,
    config: &CloneConfig,
    gathered: Vec<(String, Gathered)>,
) -> anyhow::Result<(Robot, Vec<Episode>, BTreeMap<String, String>)> {
    let mut robot: Option<Robot> = None;
    let (mut episodes, mut sources) = (Vec::new(), BTreeMap::new());
    for (path, gathered) in gathered {
        let of_file = gathered.record.robot();
        match &robot {
            None => robot = Some(of_file),
            Some(robot) if *robot == of_file => {}
            Some(_) => bail!("{path} was made with another robot than the files before it"),
        }
        if sources.insert(gathered.record.name(), gathered.sha256).is_some() {
            bail!("{path} holds {} once more; leave one of the folders out", gathered.record.name());
        }
        let is_kept = |outcome: Outcome| {
            outcome == Outcome::Success || !(args.only_won || outcome == Outcome::EmergencyStop)
        };
        let kept = gathered.trials.into_iter().filter(|trial| is_kept(trial.outcome));
        if !config.observation.strengths {
            episodes.extend(kept.map(|trial| trial.episode));
            continue;
        }
        let shape = gathered.record.robot().shape();
        for Trial { episode, strengths, .. } in kept {
            if strengths.is_empty() && !episode.is_empty() {
                bail!(
                    "{path} does not say how strongly channels were touched, which earlier versions did not keep and a truth file \
                     does not tell, and observation.strengths is true; gather the trials again with a sensor model, into another \
                     folder"
                );
            }
            episodes.push(episode.with_strengths(shape, &strengths));
        }
    }
    let robot = robot.context("--data names no folder")?;
    if episodes.len() < 2 {
        bail!("there are {} trials to learn from, expected 2 or more: one is held out", episodes.len());
    }
    Ok((robot, episodes, sources))
}
