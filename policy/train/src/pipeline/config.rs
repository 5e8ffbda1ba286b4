//! What a pipeline does, as a file.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_cloning::{CloneConfig, Head, Memory, PaperPolicy};
use palpate_encoder::EncoderConfig;
use serde::Deserialize;

use crate::files::{self, Sources};
use crate::gather;

/// Presets by name.
const PRESETS: [(&str, &str); 3] = [
    ("small", include_str!("../../presets/pipeline_small.toml")),
    ("tables", include_str!("../../presets/pipeline_tables.toml")),
    ("paper", include_str!("../../presets/pipeline_paper.toml")),
];

/// Everything that a pipeline does, in the order in which it is done.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct PipelineConfig {
    /// What the searching expert learns from.
    pub(super) closings: ClosingsConfig,
    /// What policies learn from.
    pub(super) trials: TrialsConfig,
    /// Rounds in which the expert takes over from what was learned; absent means none.
    pub(super) takeover: Option<TakeoverConfig>,
    /// The encoder whose features policies may see, pretrained on the same trials; absent means none.
    pub(super) encoder: Option<PretrainingConfig>,
    /// What is learned; the first seed of the first is what everything else is compared with.
    pub(super) policies: Vec<PolicyConfig>,
    /// How policies are scored.
    pub(super) evaluations: Vec<EvaluationConfig>,
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct ClosingsConfig {
    /// "seen", "unseen", "all", or names with commas between.
    pub(super) objects: String,
    /// On each object, at least 1.
    pub(super) count: u64,
    pub(super) seed: u64,
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct TrialsConfig {
    /// "seen", "unseen", "all", or names with commas between.
    pub(super) objects: String,
    /// On each object, at least 1.
    pub(super) count: u64,
    /// A file, or the name of a shipped protocol.
    pub(super) protocol: String,
    /// Not that of a protocol of `evaluations`.
    pub(super) seed: u64,
    /// As many trials under each of these protocols; policies that see the region need those of another.
    #[serde(default)]
    pub(super) also: Vec<MoreTrialsConfig>,
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct MoreTrialsConfig {
    /// A file, or the name of a shipped protocol.
    pub(super) protocol: String,
    /// Whose trials: "search", "search:touch", "search:tracking" or "repetition"; absent means "search".
    pub(super) expert: Option<String>,
}

/// Takeover-DAgger: in each round the first policy, with its first seed, moves the robot until the expert takes over, and is
/// learned again on all trials so far.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct TakeoverConfig {
    /// 0 for none.
    pub(super) rounds: u64,
    /// Trials of a round on each object, at least 1.
    pub(super) count: u64,
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct PretrainingConfig {
    /// A preset of `palpate-train encode`, or a file.
    pub(super) preset: Option<String>,
    pub(super) config: Option<PathBuf>,
    /// Absent means the configuration's.
    pub(super) epochs: Option<u64>,
    /// Absent means the configuration's.
    pub(super) seed: Option<u64>,
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct PolicyConfig {
    /// Letters, digits, "_" and "-".
    pub(super) name: String,
    /// A preset of `palpate-train clone`, or a file.
    pub(super) preset: Option<String>,
    pub(super) config: Option<PathBuf>,
    /// A policy of the paper: "raw-dp", "kinematic-dp", "pretrained-dp", "pretrained-act" or "pretrained-bc"; absent means what
    /// the other fields say.
    pub(super) policy: Option<PaperPolicy>,
    /// "regression", "diffusion" or "act"; absent means the configuration's.
    pub(super) head: Option<Head>,
    /// "window" or "recurrent"; absent means the configuration's.
    pub(super) memory: Option<Memory>,
    /// Absent means the configuration's.
    pub(super) updates: Option<u64>,
    #[serde(default)]
    pub(super) silence_touch: bool,
    #[serde(default)]
    pub(super) hide_tracking: bool,
    /// Whether it sees how strongly channels are touched, and not only whether they are.
    #[serde(default)]
    pub(super) strengths: bool,
    /// Whether it sees the features of `encoder`.
    #[serde(default)]
    pub(super) features: bool,
    /// Whether it sees how wide the region is that objects begin in.
    #[serde(default)]
    pub(super) region: bool,
    /// One training each.
    pub(super) seeds: Vec<u64>,
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub(super) struct EvaluationConfig {
    /// A file, or the name of a shipped protocol.
    pub(super) protocol: String,
    /// "seen", "unseen", "all", or names with commas between.
    pub(super) objects: String,
    /// Beside script, blind repetition, oracle, and the first policy without its senses.
    #[serde(default)]
    pub(super) controls: bool,
    /// Starts an object; absent means the protocol's.
    pub(super) trials: Option<u64>,
    /// Feel what this truth file says instead of what the sensor model says.
    pub(super) truth: Option<PathBuf>,
}

impl PretrainingConfig {
    /// How it is learned, in full.
    pub(super) fn encoder_config(&self) -> anyhow::Result<EncoderConfig> {
        let mut config = match (&self.preset, &self.config) {
            (Some(_), Some(_)) => bail!("encoder has a preset and a config; leave one out"),
            (_, Some(path)) => EncoderConfig::from_toml(&files::shown(path), &files::text(path)?)?,
            (preset, None) => EncoderConfig::preset(preset.as_deref().unwrap_or("quick"))?,
        };
        config.epochs = self.epochs.unwrap_or(config.epochs);
        config.seed = self.seed.unwrap_or(config.seed);
        config.validate()?;
        Ok(config)
    }
}

impl PolicyConfig {
    /// How it is learned, in full.
    pub(super) fn clone_config(&self) -> anyhow::Result<CloneConfig> {
        let mut config = match (&self.preset, &self.config) {
            (Some(_), Some(_)) => {
                bail!("policies: {:?} has a preset and a config; leave one out", self.name)
            }
            (_, Some(path)) => CloneConfig::from_toml(&files::shown(path), &files::text(path)?)?,
            (preset, None) => CloneConfig::preset(preset.as_deref().unwrap_or("small"))?,
        };
        if let Some(policy) = self.policy {
            if self.head.is_some() || self.features {
                bail!(
                    "policies: {:?} is a policy of the paper, which says itself what predicts and how it sees touch; leave head \
                     and features out",
                    self.name
                );
            }
            policy.apply(&mut config);
        }
        config.head = self.head.unwrap_or(config.head);
        config.memory = self.memory.unwrap_or(config.memory);
        config.updates = self.updates.unwrap_or(config.updates);
        config.observation.strengths |= self.strengths;
        config.observation.features |= self.features;
        config.observation.region |= self.region;
        config.validate()?;
        Ok(config)
    }
}

impl EvaluationConfig {
    /// The protocol's name, and the truth's if it is felt.
    pub(super) fn name(&self) -> String {
        let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let protocol = stem(Path::new(&self.protocol));
        self.truth.as_ref().map_or_else(|| protocol.clone(), |truth| format!("{protocol}_{}", stem(truth)))
    }
}

impl PipelineConfig {
    /// Rounds in which the expert takes over.
    pub(super) fn rounds(&self) -> u64 {
        self.takeover.as_ref().map_or(0, |takeover| takeover.rounds)
    }

    /// The text of a preset.
    pub(super) fn preset(name: &str) -> anyhow::Result<&'static str> {
        let found = PRESETS.iter().find(|(preset, _)| *preset == name);
        let names = PRESETS.map(|(preset, _)| preset).join(", ");
        Ok(found.with_context(|| format!("--preset is {name:?}, expected one of {names}"))?.1)
    }

    /// Reads `text`, which `file` names in errors, and whatever can be refused before anything starts.
    pub(super) fn read(file: &str, text: &str) -> anyhow::Result<Self> {
        let config: Self = palpate_training::parse(file, text)?;
        config.check().with_context(|| format!("{file} cannot be run"))?;
        Ok(config)
    }

    fn check(&self) -> anyhow::Result<()> {
        let (closings, trials) = (&self.closings, &self.trials);
        let takeover = self.takeover.as_ref().map(|takeover| ("takeover.count", takeover.count));
        let counts = [("closings.count", closings.count), ("trials.count", trials.count)];
        for (field, count) in counts.into_iter().chain(takeover) {
            if count == 0 {
                bail!("{field} is 0, expected at least 1");
            }
        }
        for (field, objects) in [("closings", &closings.objects), ("trials", &trials.objects)] {
            files::objects(objects).with_context(|| format!("{field}.objects is {objects:?}"))?;
        }
        let protocol = |given: &str| files::protocol(given, &Sources::default());
        let (_, first) = protocol(&trials.protocol).context("trials.protocol")?;
        let mut is_of_one_region = true;
        for also in &trials.also {
            let (_, other) = protocol(&also.protocol).context("trials.also: protocol")?;
            is_of_one_region &= other.half_width_m == first.half_width_m;
            if let Some(expert) = &also.expert {
                gather::expert_kind(expert)
                    .map_err(|problem| anyhow::anyhow!("trials.also: expert: {problem}"))?;
            }
        }
        if self.policies.is_empty() || self.evaluations.is_empty() {
            bail!("policies and evaluations need at least one entry each");
        }
        let (mut names, mut is_encoder_used) = (BTreeSet::new(), false);
        for policy in &self.policies {
            let name = &policy.name;
            let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
            if name.is_empty() || !name.chars().all(is_plain) {
                bail!("policies: the name is {name:?}, expected letters, digits, _ and -");
            }
            if !names.insert(name.clone()) {
                bail!("policies: {name:?} is there twice");
            }
            let seeds: BTreeSet<u64> = policy.seeds.iter().copied().collect();
            if seeds.is_empty() || seeds.len() != policy.seeds.len() {
                bail!("policies: seeds of {name:?} are {:?}, expected one or more, each once", policy.seeds);
            }
            let how = policy.clone_config().with_context(|| format!("policies: {name:?}"))?;
            if how.observation.features && self.encoder.is_none() {
                bail!(
                    "policies: {name:?} sees features, but there is no section [encoder] to make them; add one, or \
                     leave features out"
                );
            }
            if how.observation.region && is_of_one_region {
                bail!(
                    "policies: {name:?} sees the region, but all trials are of one region; add a protocol of another to \
                     trials.also, or leave region out"
                );
            }
            is_encoder_used |= how.observation.features;
        }
        if let Some(encoder) = &self.encoder {
            encoder.encoder_config().context("encoder")?;
            if !is_encoder_used {
                bail!(
                    "encoder: no policy sees its features; add features = true to one of policies, or leave the \
                     section out"
                );
            }
        }
        names.clear();
        for evaluation in &self.evaluations {
            let name = evaluation.name();
            if !names.insert(name.clone()) {
                bail!("evaluations: {name:?} is there twice");
            }
            if evaluation.trials == Some(0) {
                bail!("evaluations: trials of {name:?} is 0, expected at least 1");
            }
            let (_, protocol) =
                protocol(&evaluation.protocol).with_context(|| format!("evaluations: {name:?}"))?;
            for round in 0..=self.rounds() {
                let seed = trials.seed.wrapping_add(round);
                gather::check_seed(seed, &name, &protocol)
                    .with_context(|| format!("trials.seed, and {round} rounds of takeover after it"))?;
            }
            files::objects(&evaluation.objects)
                .with_context(|| format!("evaluations: objects of {name:?} is {:?}", evaluation.objects))?;
            if let Some(truth) = evaluation.truth.as_ref().filter(|truth| !truth.is_file()) {
                bail!("evaluations: truth of {name:?} is {truth:?}, and there is no such file");
            }
        }
        Ok(())
    }
}
