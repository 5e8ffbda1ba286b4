//! The stages of a pipeline: each is a command of this program, what it reads of earlier ones, and what it leaves.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use palpate_cloning::{CHECKPOINT_FILE, Head, Memory, POLICY_FILE, PaperPolicy};

use super::PipelineArgs;
use super::config::{EvaluationConfig, PipelineConfig, PolicyConfig};
use crate::files;

/// Seconds of one core that the parts of a stage take with the preset `small`, as measured for docs/learning.md; what
/// takes longer on another machine takes longer by about the same factor.
mod core_s {
    pub(super) const CLOSING: f64 = 0.05;
    pub(super) const TRIAL: f64 = 0.11;
    /// A trial of an evaluation, for each second of the episode.
    pub(super) const EVALUATED_S: f64 = 0.012;
    pub(super) const REGRESSION_UPDATE: f64 = 0.04;
    pub(super) const DIFFUSION_UPDATE: f64 = 0.13;
    pub(super) const ACT_UPDATE: f64 = 0.24;
    /// What an update takes longer where the policy's memory is recurrent.
    pub(super) const RECURRENT_MORE: f64 = 0.03;
    /// A sample of an encoder's update, by the preset `quick`.
    pub(super) const ENCODER_SAMPLE: f64 = 0.002;
    /// The features of one step, by the same encoder.
    pub(super) const FEATURES_STEP: f64 = 0.00015;
    /// Steps of a trial for each second of the longest one: many are won before.
    pub(super) const STEPS_PER_S: f64 = 15.0;
}

/// The stage that pretrains the encoder, and its folder.
pub(super) const ENCODER: &str = "encoder";

/// One stage.
#[derive(Debug)]
pub(super) struct Stage {
    pub(super) name: String,
    /// Arguments of `palpate-train`.
    pub(super) command: Vec<OsString>,
    /// Names of earlier stages whose results it reads.
    pub(super) needs: Vec<String>,
    /// Files that it reads besides the assets and what earlier stages made.
    pub(super) files: Vec<PathBuf>,
    /// What it leaves for later stages and for people; a folder means every file in it.
    pub(super) results: Vec<PathBuf>,
    /// Everything that it writes.
    pub(super) writes: Vec<PathBuf>,
    /// Seconds of one core that it takes, roughly.
    pub(super) core_s: f64,
    /// Whether it uses more than one core.
    pub(super) is_parallel: bool,
}

/// A command in the making.
struct Command(Vec<OsString>);

impl Command {
    fn of(name: &str) -> Self {
        Self(vec![name.into()])
    }

    fn with(mut self, flag: &str, value: impl Into<OsString>) -> Self {
        self.0.extend([format!("--{flag}").into(), value.into()]);
        self
    }

    fn maybe(self, flag: &str, value: Option<impl Into<OsString>>) -> Self {
        match value {
            Some(value) => self.with(flag, value),
            None => self,
        }
    }

    fn flag(mut self, flag: &str, is_wanted: bool) -> Self {
        if is_wanted {
            self.0.push(format!("--{flag}").into());
        }
        self
    }
}

/// A training of a pipeline.
pub(super) struct Training<'a> {
    pub(super) policy: &'a PolicyConfig,
    pub(super) seed: u64,
    /// Rounds of takeover that it learns from, beside the expert's own trials.
    pub(super) round: u64,
    pub(super) folder: PathBuf,
}

impl Training<'_> {
    pub(super) fn name(&self) -> String {
        training_name(self.policy, self.seed, self.round)
    }

    /// As `palpate-train evaluate` names it.
    pub(super) fn as_policy(&self) -> OsString {
        let mut text = OsString::from("clone:");
        text.push(&self.folder);
        text
    }
}

fn training_name(policy: &PolicyConfig, seed: u64, round: u64) -> String {
    let after = if round == 0 { String::new() } else { format!("_round{round}") };
    format!("{}_{seed}{after}", policy.name)
}

/// Every training, in the order in which they are compared; what is learned again after rounds of takeover comes last.
pub(super) fn trainings<'a>(config: &'a PipelineConfig, out: &Path) -> Vec<Training<'a>> {
    let training = |policy: &'a PolicyConfig, seed: u64, round: u64| {
        let folder = out.join("policies").join(training_name(policy, seed, round));
        Training { policy, seed, round, folder }
    };
    let of_policy =
        |policy: &'a PolicyConfig| policy.seeds.iter().map(move |&seed| training(policy, seed, 0));
    let first = config.policies.first().and_then(|policy| Some((policy, *policy.seeds.first()?)));
    let again = first
        .into_iter()
        .flat_map(|(policy, seed)| (1..=config.rounds()).map(move |round| training(policy, seed, round)));
    config.policies.iter().flat_map(of_policy).chain(again).collect()
}

/// Folder of the trials of a round of takeover.
fn takeover_dir(out: &Path, round: u64) -> PathBuf {
    out.join(takeover_name(round))
}

fn takeover_name(round: u64) -> String {
    format!("takeover_{round}")
}

/// Folder of the pretraining of the encoder.
pub(super) fn encoder_dir(out: &Path) -> PathBuf {
    out.join(ENCODER)
}

/// The searching expert, as `palpate-train evaluate` names it.
pub(super) const EXPERT: &str = "search";

/// Where an evaluation is written.
pub(super) fn comparison(out: &Path, evaluation: &EvaluationConfig) -> PathBuf {
    out.join("evaluations").join(format!("{}.json", evaluation.name()))
}

/// Folder of the pictures of its single trials.
pub(super) fn pictures(out: &Path, evaluation: &EvaluationConfig) -> PathBuf {
    out.join("pictures").join(evaluation.name())
}

/// What `config` asks for in the folder `out`, in the order in which it is done.
pub(super) fn stages(config: &PipelineConfig, args: &PipelineArgs, out: &Path) -> anyhow::Result<Vec<Stage>> {
    let count = |objects: &str| -> anyhow::Result<f64> { Ok(files::objects(objects)?.len() as f64) };
    let model = args.model.as_ref();
    let own = |path: Option<&PathBuf>| path.cloned().into_iter().collect::<Vec<_>>();
    let closings_file = out.join("closings.safetensors");
    let closings = &config.closings;
    let mut stages = vec![Stage {
        name: "closings".to_owned(),
        command: Command::of("closings")
            .with("objects", &closings.objects)
            .with("count", closings.count.to_string())
            .with("seed", closings.seed.to_string())
            .maybe("model", model)
            .with("out", &closings_file)
            .0,
        needs: Vec::new(),
        files: own(model),
        results: vec![closings_file.clone()],
        writes: vec![closings_file.clone()],
        core_s: core_s::CLOSING * count(&closings.objects)? * closings.count as f64,
        is_parallel: true,
    }];
    let trials = &config.trials;
    let all_trials = count(&trials.objects)? * trials.count as f64;
    let mut trials_of = Vec::new();
    let kinds = trials.also.iter().map(|also| (&also.protocol, also.expert.as_ref()));
    for (idx, (protocol, expert)) in std::iter::once((&trials.protocol, None)).chain(kinds).enumerate() {
        let name = if idx == 0 { "trials".to_owned() } else { format!("trials_{}", idx + 1) };
        let folder = out.join(&name);
        stages.push(Stage {
            name: name.clone(),
            command: Command::of("gather")
                .with("objects", &trials.objects)
                .with("count", trials.count.to_string())
                .with("protocol", protocol)
                .maybe("expert", expert)
                .with("seed", trials.seed.to_string())
                .maybe("model", model)
                .with("closings", &closings_file)
                .with("out", &folder)
                .0,
            needs: vec!["closings".to_owned()],
            files: own(model),
            results: vec![folder.clone()],
            writes: vec![folder.clone()],
            core_s: core_s::TRIAL * all_trials,
            is_parallel: true,
        });
        trials_of.push((name, folder));
    }
    let trials_names = || trials_of.iter().map(|(name, _)| name.clone());
    // Names of commands' flags that take several folders stand before each.
    let reading = |command: Command, flag: &str| {
        trials_of.iter().fold(command, |command, (_, folder)| command.with(flag, folder))
    };
    let (_, protocol) = files::protocol(&trials.protocol, &files::Sources::default())?;
    let steps = core_s::STEPS_PER_S * protocol.episode_s * all_trials * trials_of.len() as f64;
    let encoder_dir = encoder_dir(out);
    if let Some(encoder) = &config.encoder {
        let how = encoder.encoder_config()?;
        stages.push(Stage {
            name: ENCODER.to_owned(),
            command: reading(Command::of("encode"), "demos")
                .maybe("preset", encoder.preset.as_ref())
                .maybe("config", encoder.config.as_ref())
                .with("epochs", how.epochs.to_string())
                .with("seed", how.seed.to_string())
                .flag("resume", true)
                .with("out", &encoder_dir)
                .0,
            needs: trials_names().collect(),
            files: own(encoder.config.as_ref()),
            results: vec![encoder_dir.join(CHECKPOINT_FILE)],
            writes: vec![encoder_dir.clone()],
            core_s: core_s::ENCODER_SAMPLE * how.epochs as f64 * steps / how.frame_stride as f64,
            is_parallel: true,
        });
    }
    let trainings = trainings(config, out);
    for training in &trainings {
        if let (1.., Some(takeover)) = (training.round, &config.takeover) {
            // By whoever learned in the round before.
            let student = |one: &&Training<'_>| {
                one.round + 1 == training.round && one.policy == training.policy && one.seed == training.seed
            };
            let student = trainings.iter().find(student).context("a round of takeover has no student")?;
            let folder = takeover_dir(out, training.round);
            stages.push(Stage {
                name: takeover_name(training.round),
                command: Command::of("gather")
                    .with("objects", &trials.objects)
                    .with("count", takeover.count.to_string())
                    .with("protocol", &trials.protocol)
                    .with("seed", trials.seed.wrapping_add(training.round).to_string())
                    .with("takeover", student.as_policy())
                    .maybe("model", model)
                    .with("closings", &closings_file)
                    .with("out", &folder)
                    .0,
                needs: vec!["closings".to_owned(), student.name()],
                files: own(model),
                results: vec![folder.clone()],
                writes: vec![folder],
                core_s: core_s::TRIAL * count(&trials.objects)? * takeover.count as f64,
                is_parallel: true,
            });
        }
        let how = training.policy.clone_config()?;
        let (head, update_core_s) = match how.head {
            Head::Regression => ("regression", core_s::REGRESSION_UPDATE),
            Head::Diffusion => ("diffusion", core_s::DIFFUSION_UPDATE),
            Head::Act => ("act", core_s::ACT_UPDATE),
        };
        let policy = training.policy.policy.and_then(|policy| {
            PaperPolicy::ALL.into_iter().find_map(|(name, one)| (one == policy).then_some(name))
        });
        let more_core_s = match how.memory {
            Memory::Window => 0.0,
            Memory::Recurrent => core_s::RECURRENT_MORE,
        };
        let features = how.observation.features;
        let features_core_s = if features { core_s::FEATURES_STEP * steps } else { 0.0 };
        let memory = training.policy.memory.map(|memory| match memory {
            Memory::Window => "window",
            Memory::Recurrent => "recurrent",
        });
        stages.push(Stage {
            name: training.name(),
            command: (1..=training.round)
                .fold(reading(Command::of("clone"), "data"), |command, round| {
                    command.with("data", takeover_dir(out, round))
                })
                .maybe("preset", training.policy.preset.as_ref())
                .maybe("config", training.policy.config.as_ref())
                .maybe("policy", policy)
                .maybe("head", policy.is_none().then_some(head))
                .maybe("memory", memory)
                .with("updates", how.updates.to_string())
                .with("seed", training.seed.to_string())
                .flag("silence-touch", training.policy.silence_touch)
                .flag("hide-tracking", training.policy.hide_tracking)
                .flag("strengths", training.policy.strengths)
                .flag("region", training.policy.region)
                .flag("features", features && policy.is_none())
                .maybe("encoder", features.then_some(&encoder_dir))
                .with("device", &args.device)
                .flag("resume", true)
                .with("out", &training.folder)
                .0,
            needs: trials_names()
                .chain((1..=training.round).map(takeover_name))
                .chain(features.then(|| ENCODER.to_owned()))
                .collect(),
            files: own(training.policy.config.as_ref()),
            results: vec![training.folder.join(POLICY_FILE)],
            writes: vec![training.folder.clone()],
            core_s: (update_core_s + more_core_s) * how.updates as f64 + features_core_s,
            is_parallel: false,
        });
    }
    for evaluation in &config.evaluations {
        let (_, protocol) = files::protocol(&evaluation.protocol, &files::Sources::default())?;
        let path = comparison(out, evaluation);
        let (by_object, pictures) = (path.with_extension(""), pictures(out, evaluation));
        let mut command = Command::of("evaluate")
            .with("protocol", &evaluation.protocol)
            .with("objects", &evaluation.objects)
            .maybe("trials", evaluation.trials.map(|trials| trials.to_string()))
            .flag("controls", evaluation.controls)
            .with("closings", &closings_file);
        command = match &evaluation.truth {
            Some(truth) => command.with("truth", truth),
            None => command.maybe("model", model),
        };
        for (idx, training) in trainings.iter().enumerate() {
            command = command.with(if idx == 0 { "policy" } else { "beside" }, training.as_policy());
        }
        if evaluation.controls {
            // Who the policies have learned from.
            command = command.with("beside", EXPERT);
        }
        let arms = trainings.len() + if evaluation.controls { 7 } else { 0 };
        let trials = evaluation.trials.unwrap_or(protocol.trials) as f64;
        stages.push(Stage {
            name: format!("evaluation {}", evaluation.name()),
            command: command.with("by-object", &by_object).with("pictures", &pictures).with("out", &path).0,
            needs: std::iter::once("closings".to_owned())
                .chain(trainings.iter().map(Training::name))
                .collect(),
            files: own(evaluation.truth.as_ref()).into_iter().chain(own(model)).collect(),
            results: vec![path.clone(), pictures.clone()],
            writes: vec![path, by_object, pictures],
            core_s: core_s::EVALUATED_S
                * protocol.episode_s
                * trials
                * count(&evaluation.objects)?
                * arms as f64,
            is_parallel: true,
        });
    }
    Ok(stages)
}
