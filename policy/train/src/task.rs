//! The learning task that a command names.

use std::path::PathBuf;
use std::sync::Arc;

use palpate_grasp::learn::{LearnConfig, LearnTask};
use palpate_grasp::{GraspScene, Script};
pub(crate) use palpate_rollout::task::{Memory, TaskRecord};

use crate::files::{Source, Sources};
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
    of_script(args, scene, (!args.without_script).then_some(script), sources)
}

/// The same on top of this script, or of none.
pub(crate) fn of_script(
    args: &TaskArgs,
    scene: Arc<GraspScene>,
    script: Option<Script>,
    sources: Sources,
) -> anyhow::Result<OpenTask> {
    let text = sources.text("learning", &args.learning)?;
    let learning = LearnConfig::from_toml(&files::shown(&args.learning), &text, &scene.station().robot)?;
    let mut sources = sources.into_list();
    sources.retain(|source| script.is_some() || source.role != "script");
    let task = Arc::new(LearnTask::new(scene, script, learning)?);
    Ok(OpenTask {
        record: TaskRecord::of(&task.scene().object().id, task.layout(), &sources)?,
        task,
        sources,
    })
}
