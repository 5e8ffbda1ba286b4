//! The learning task that a command names, and what a checkpoint remembers of it.

use std::path::PathBuf;
use std::sync::Arc;

use palpate_grasp::learn::{Curriculum, LearnConfig, LearnTask};
use palpate_grasp::{GraspScene, Script};
use serde::{Deserialize, Serialize};

use crate::files::{Source, Sources, sha256};
use crate::{SceneArgs, files};

/// A scene and what is learned in it.
#[derive(Clone, clap::Args)]
pub(crate) struct TaskArgs {
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    /// Actions, observations, rewards and starts
    #[arg(long, default_value = "assets/grasp/xarm6_leap_learning.toml")]
    pub(crate) learning: PathBuf,
    /// Learn the whole motion instead of what is added to the script
    #[arg(long)]
    pub(crate) without_script: bool,
}

/// A task, what ties a policy to it, and the files that it was made from.
pub(crate) struct OpenTask {
    pub(crate) task: Arc<LearnTask>,
    pub(crate) record: TaskRecord,
    pub(crate) sources: Vec<Source>,
}

/// Reads everything that `args` names, and starts its threads.
pub(crate) fn open(args: &TaskArgs) -> anyhow::Result<OpenTask> {
    let sources = Sources::default();
    let (scene, script) = files::open(&args.scene, &sources)?;
    of(args, scene, script, sources)
}

/// The task of `args` in a scene that is open already, made from `sources`.
pub(crate) fn of(
    args: &TaskArgs,
    scene: Arc<GraspScene>,
    script: Script,
    sources: Sources,
) -> anyhow::Result<OpenTask> {
    let text = sources.text("learning", &args.learning)?;
    let learning = LearnConfig::from_toml(&files::shown(&args.learning), &text, &scene.station().robot)?;
    let script = (!args.without_script).then_some(script);
    let task = Arc::new(LearnTask::new(scene, script, learning)?);
    let mut sources = sources.into_list();
    sources.retain(|source| !(args.without_script && source.role == "script"));
    Ok(OpenTask { record: TaskRecord::of(&task, &sources)?, task, sources })
}

/// What a policy is tied to: it fits no other object, script, learning file or layout than it was trained with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct TaskRecord {
    /// Name of the object.
    object: String,
    /// SHA-256 of its files.
    object_sha256: String,
    /// Of the script; nothing without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    script_sha256: Option<String>,
    /// Of the learning file.
    learning_sha256: String,
    /// Of the names and units of every number of observations and actions.
    layout_sha256: String,
}

impl TaskRecord {
    fn of(task: &LearnTask, sources: &[Source]) -> anyhow::Result<Self> {
        let digest = |role: &str| {
            let of_role: Vec<&str> = sources
                .iter()
                .filter(|source| source.role == role)
                .map(|source| source.sha256.as_str())
                .collect();
            match of_role[..] {
                [] => None,
                [one] => Some(one.to_owned()),
                _ => Some(sha256(of_role.concat().as_bytes())),
            }
        };
        Ok(Self {
            object: task.scene().object().id.clone(),
            object_sha256: digest("object").unwrap_or_default(),
            script_sha256: digest("script"),
            learning_sha256: digest("learning").unwrap_or_default(),
            layout_sha256: sha256(serde_json::to_string(task.layout())?.as_bytes()),
        })
    }

    /// Says what differs between `self`, which a policy was trained with, and `given`.
    pub(crate) fn check(&self, given: &Self) -> Result<(), String> {
        if self.object != given.object {
            return Err(format!("it was trained with the object {:?}, not {:?}", self.object, given.object));
        }
        match (&self.script_sha256, &given.script_sha256) {
            (None, Some(_)) => return Err("it was trained without a script; add --without-script".to_owned()),
            (Some(_), None) => {
                return Err("it was trained on top of a script; leave --without-script out".to_owned());
            }
            _ => (),
        }
        let none = String::new();
        let compared = [
            ("object's file", "--object", &self.object_sha256, &given.object_sha256),
            (
                "script",
                "--script",
                self.script_sha256.as_ref().unwrap_or(&none),
                given.script_sha256.as_ref().unwrap_or(&none),
            ),
            ("learning file", "--learning", &self.learning_sha256, &given.learning_sha256),
            (
                "layout of observations and actions (joints and channels of the station)",
                "--station",
                &self.layout_sha256,
                &given.layout_sha256,
            ),
        ];
        match compared.iter().find(|(_, _, trained, given)| trained != given) {
            None => Ok(()),
            Some((what, flag, trained, given)) => {
                Err(format!("it was trained with another {what} ({flag}): SHA-256 {trained}, not {given}"))
            }
        }
    }
}

/// What outlives the episodes of a training, as TOML, whose numbers come back with the same bits.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Memory {
    /// How wide the region of starts is.
    pub(crate) curriculum: Curriculum,
    pub(crate) task: TaskRecord,
}

impl Memory {
    pub(crate) fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    pub(crate) fn from_toml(text: &str) -> Result<Self, String> {
        toml::from_str(text)
            .map_err(|err| format!("it does not say what it was trained with: {}", err.message()))
    }
}
