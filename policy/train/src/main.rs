//! The `palpate-train` command: grasping in simulation. It scores scripts, tunes them, learns to do better than they,
//! searches by touch, keeps what experts do and imitates it, scores what was learned, does all of that as one pipeline,
//! pretrains the tactile encoder, and measures how fast all of it is.

mod against_hand;
mod bench;
mod bench_policy;
mod clone;
mod compare;
mod curves;
mod demos;
mod encode;
mod evaluate;
mod export;
mod export_mujoco;
mod files;
mod gather;
mod imitator;
mod learning;
mod origin;
mod pipeline;
mod policy;
mod ppo;
mod script;
mod search;
mod station;
mod task;
mod truth;
mod tune;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "palpate-train", about = "Grasping in simulation", version)]
struct Args {
    /// For programs: print progress, metrics and the report as JSON lines on standard output, and end when standard input ends
    #[arg(long, global = true)]
    events: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run trials of a script, and score them
    Script(script::ScriptArgs),
    /// Tune a script on one object by the cross-entropy method
    Tune(tune::TuneArgs),
    /// Learn to grasp one object by touch: what a policy adds to a script, or all of it
    Ppo(ppo::PpoArgs),
    /// Run trials of a policy, and score them; under a protocol beside others on the same starts
    Evaluate(evaluate::EvaluateArgs),
    /// Simulate closings of the hand, which the searching expert learns from
    Closings(search::ClosingsArgs),
    /// Roll out a policy, and keep the trials that succeed as files to learn from
    Demos(demos::DemosArgs),
    /// Let the searching expert grasp, and keep every trial as files to learn from
    Gather(gather::GatherArgs),
    /// Learn to do what an expert did: by regression, by diffusion or by action chunking with Transformers
    Clone(clone::CloneArgs),
    /// From a sensor model to policies that are scored: closings, gathered trials, trainings, evaluations, a report
    Pipeline(pipeline::PipelineArgs),
    /// Pretrain the tactile encoder with what demonstrations know beyond touch
    Encode(encode::EncodeArgs),
    /// Make a small file of a policy, for `evaluate` and `demos`, or of an encoder
    Export(export::ExportArgs),
    /// Write the grasp world's scene for other programs that run MuJoCo, with what `palpate.touch` needs beside it
    ExportMujoco(export_mujoco::ExportMujocoArgs),
    /// Draw how policies learned
    Curves(curves::CurvesArgs),
    /// Measure the grasp world beside MuJoCo's own `rollout`
    Bench(bench::BenchArgs),
    /// Measure a policy's networks beside PyTorch: from an observation to an action, and steps of learning
    BenchPolicy(bench_policy::BenchPolicyArgs),
    /// Run trials of a policy on the hand that a studio drives
    Rollout(palpate_rollout::RolloutArgs),
    /// Compare a rollout with the same policy and the same commands in the grasp world, by sensor model
    CompareRollout(against_hand::CompareRolloutArgs),
    /// Run an emulated station whose hand can grasp and lift, for any client of the real devices
    Station(station::StationArgs),
}

/// What grasps, and what simulates its touch.
#[derive(Clone, clap::Args)]
pub(crate) struct RobotArgs {
    /// Station file
    #[arg(long, default_value = "assets/stations/xarm6_leap.toml")]
    station: PathBuf,
    /// Grasp world of its robot
    #[arg(long, default_value = "assets/grasp/xarm6_leap.toml")]
    world: PathBuf,
    /// Sensor model [default: the station's nominal model]
    #[arg(long)]
    model: Option<PathBuf>,
}

/// What is grasped with what, and felt how.
#[derive(Clone, clap::Args)]
pub(crate) struct SceneArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Feel what the emulated station feels, as this truth file says, instead of what a sensor model says
    #[arg(long, conflicts_with = "model")]
    truth: Option<PathBuf>,
    /// With --truth: what this contact map makes of the readings, instead of what the station's thresholds do
    #[arg(long, value_name = "MAP.toml", requires = "truth")]
    contact_map: Option<PathBuf>,
    /// Feel nothing at all
    #[arg(long)]
    silence_touch: bool,
    /// Script: key positions over time
    #[arg(long, default_value = "assets/grasp/scripts/xarm6_leap_cube.toml")]
    script: PathBuf,
    /// Object: a file, or a name in `assets/objects`
    #[arg(long, default_value = "cube")]
    object: String,
    /// Half the edge length of the square that objects start in, cm [default: as the world's file says]
    #[arg(long, allow_negative_numbers = true)]
    start_cm: Option<f64>,
    /// Threads [default: all cores]
    #[arg(long)]
    threads: Option<usize>,
    /// One JSON document on standard output
    #[arg(long)]
    json: bool,
}

fn main() -> ExitCode {
    let args = Args::parse();
    if args.events
        && let Err(err) = palpate_terminal::events::print_events()
    {
        eprintln!("palpate-train: failed to start a thread: {err}");
        return ExitCode::FAILURE;
    }
    let done = match args.command {
        Command::Script(args) => script::run(&args),
        Command::Tune(args) => tune::run(&args),
        Command::Ppo(args) => ppo::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Closings(args) => search::run(&args),
        Command::Demos(args) => demos::run(&args),
        Command::Gather(args) => gather::run(&args),
        Command::Clone(args) => clone::run(&args),
        Command::Pipeline(args) => pipeline::run(&args),
        Command::Encode(args) => encode::run(&args),
        Command::Export(args) => export::run(&args),
        Command::ExportMujoco(args) => export_mujoco::run(&args),
        Command::Curves(args) => curves::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::BenchPolicy(args) => bench_policy::run(&args),
        Command::Rollout(args) => palpate_rollout::run(&args),
        Command::CompareRollout(args) => against_hand::run(&args),
        Command::Station(args) => station::run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(err) => {
            eprintln!("palpate-train: {err:#}");
            ExitCode::FAILURE
        }
    }
}
