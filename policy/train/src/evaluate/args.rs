//! What the command line of `evaluate` says.

use std::path::PathBuf;

use crate::search;
use crate::task::TaskArgs;

#[derive(clap::Args)]
pub(crate) struct EvaluateArgs {
    #[command(flatten)]
    pub(crate) task: TaskArgs,
    /// A training's folder, a checkpoint or an exported policy; under a protocol also "search", "search:touch",
    /// "search:tracking", "search:none", "script", "repetition", "oracle", or "clone:PATH" for a policy that imitates
    /// an expert, and {object} in a path stands for the object's name
    #[arg(long)]
    pub(crate) policy: String,
    /// Number of trials [default: the protocol's, or 50]
    #[arg(long, allow_negative_numbers = true)]
    pub(crate) trials: Option<u64>,
    /// Seed of starts, randomised physics and noise of readings [default: the protocol's, or 1]
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    /// Compare under a protocol: a file, or a name in `assets/grasp/protocols`
    #[arg(long)]
    pub(crate) protocol: Option<String>,
    /// Objects of a comparison: "seen", "unseen", "all", or names or files with commas between [default: --object]
    #[arg(long, requires = "protocol")]
    pub(crate) objects: Option<String>,
    /// Compare with everything that a claim has to be compared with: script, blind repetition, an oracle, the policy
    /// silenced, with tracking errors hidden, with both
    #[arg(long, requires = "protocol")]
    pub(crate) controls: bool,
    /// Compare with this policy as well; may be given several times
    #[arg(long, requires = "protocol")]
    pub(crate) beside: Vec<String>,
    /// Every joint seems to be where it was sent
    #[arg(long, requires = "protocol")]
    pub(crate) hide_tracking: bool,
    /// How the searching expert tries to grasp
    #[arg(long, default_value = search::SEARCH)]
    pub(crate) search: PathBuf,
    /// Closings that it has learned from
    #[arg(long, default_value = search::CLOSINGS)]
    pub(crate) closings: PathBuf,
    /// The searching expert and the oracle know which of the shapes in the closings they look for
    #[arg(long, requires = "protocol")]
    pub(crate) know_shape: bool,
    /// Folder for the trials, a file an object: trials that are there already are not run again
    #[arg(long, requires = "protocol")]
    pub(crate) by_object: Option<PathBuf>,
    /// Folder for pictures (SVG): of each object the first trial that the policy won and the first that it lost, from above,
    /// with what was felt; of searching experts also what they believed
    #[arg(long, requires = "protocol")]
    pub(crate) pictures: Option<PathBuf>,
    /// Folder for films of the same trials: a session of takes, which the studio plays back and `palpate session check` opens
    #[arg(long, requires = "protocol")]
    pub(crate) films: Option<PathBuf>,
    /// Write the comparison with every trial to this file
    #[arg(long, requires = "protocol")]
    pub(crate) out: Option<PathBuf>,
}
