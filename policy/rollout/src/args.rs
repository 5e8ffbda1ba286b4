//! What the command line of a rollout says.

use std::path::PathBuf;

use crate::fit::FitArgs;
use crate::inject::Injected;
use crate::take::RecordArgs;

/// Trials of a policy on the hand that a studio drives.
#[derive(Clone, Debug, clap::Args)]
pub struct RolloutArgs {
    /// Address of the studio, as `palpate serve` prints it
    #[arg(long, default_value = "http://127.0.0.1:8080")]
    pub(crate) url: String,
    /// Certificates in PEM that vouch for a studio that speaks TLS, as a copy of `tls/cert.pem` in its data folder does
    #[arg(long, value_name = "FILE")]
    pub(crate) ca_file: Option<PathBuf>,
    /// A learned policy: a training's folder, a checkpoint or an exported file; without one the script alone runs. With
    /// `--campaign`, ID=PATH for a policy of the campaign whose own source is not to be used; may be repeated
    #[arg(long)]
    pub(crate) policy: Vec<String>,
    #[command(flatten)]
    pub(crate) fit: FitArgs,
    /// Make the trials of this campaign of the studio, one after the other, until none is left or somebody pauses it
    #[arg(long, value_name = "ID", conflicts_with_all = ["script", "without_script", "object", "silence_touch", "trials", "first", "seed", "start_cm", "inject"])]
    pub(crate) campaign: Option<String>,
    /// Make trials of the campaign that were scored void once more
    #[arg(long, requires = "campaign")]
    pub(crate) repeat_void: bool,
    /// Whoever places the object says so on the studio's page, where they begin each trial of the campaign
    #[arg(long, requires = "campaign", conflicts_with_all = ["operator", "placed"])]
    pub(crate) placed_at_page: bool,
    /// Tell the policy that it feels nothing, to see what touch is worth
    #[arg(long)]
    pub(crate) silence_touch: bool,
    /// Number of trials
    #[arg(long, default_value_t = 1)]
    pub(crate) trials: u64,
    /// Number of the first of them
    #[arg(long, default_value_t = 0)]
    pub(crate) first: u64,
    /// Seed of the starts that an emulated station's operator places
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
    /// Half the edge length of the square that objects start in, cm [default: as the world's file says]
    #[arg(long)]
    pub(crate) start_cm: Option<f64>,
    /// Folder for the records of the trials and `outcomes.jsonl`; it must be new or empty, or hold the same campaign
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Socket of the operator of `palpate-train station`, who places objects and sees what became of them
    #[arg(long, value_name = "SOCKET")]
    pub(crate) operator: Option<PathBuf>,
    /// The object lies there already: nobody is asked to place it
    #[arg(long, conflicts_with = "operator")]
    pub(crate) placed: bool,
    /// Who has control meanwhile, for everybody else's page
    #[arg(long, default_value = "rollout")]
    pub(crate) name: String,
    /// Take control from whoever has it
    #[arg(long)]
    pub(crate) take_over: bool,
    /// Switch the studio's reflex of the digits on for the rollout, as this file has it (`docs/reflex.md`)
    #[arg(long, value_name = "FILE")]
    pub(crate) reflex: Option<PathBuf>,
    /// A fault on purpose: nan, jumps, slow or hang, and when in each trial, s
    #[arg(long, value_name = "KIND=S")]
    pub(crate) inject: Option<Injected>,
    #[command(flatten)]
    pub(crate) record: RecordArgs,
    /// A line of JSON for each trial on standard output
    #[arg(long)]
    pub(crate) json: bool,
}
