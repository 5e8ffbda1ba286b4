//! The command line: arguments in, one line of error or one JSON document out.

mod actuator;
mod backup;
mod bench;
mod blind;
mod calibrate;
mod campaign;
mod completions;
mod contact_map;
mod devices;
mod diagnose;
mod effects;
mod emulate;
mod export;
mod folder;
mod import;
mod index;
mod job;
mod jobs;
mod new_station;
mod openapi;
mod output;
mod people;
mod replay;
mod report;
mod retention;
mod retention_days;
mod serve;
mod session;
mod station;
mod tokens;

use std::{io::IsTerminal as _, process::ExitCode};

use clap::{CommandFactory as _, Parser, Subcommand};
use palpate_server::{Error, chain};
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};

/// Calibration and teleoperation studio for tactile dexterous hands
#[derive(Parser)]
#[command(name = "palpate", version, about, max_term_width = 100)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Record a calibration session from an emulated station
    Emulate(emulate::EmulateArgs),
    /// Bring recordings made elsewhere into a session
    Import(import::ImportArgs),
    /// Make a station for a hand of your own
    #[command(subcommand)]
    Station(new_station::StationCommand),
    /// Look at a recorded session
    #[command(subcommand)]
    Session(session::SessionCommand),
    /// Replay a take's joint path through a sensor model
    Replay(replay::ReplayArgs),
    /// Write recordings for other programs
    #[command(subcommand)]
    Export(export::ExportCommand),
    /// Fit the sensor model to a session
    Calibrate(calibrate::CalibrateArgs),
    /// Name what the calibrated model lacks, and add it
    Diagnose(diagnose::DiagnoseArgs),
    /// List the effects that a diagnosis chooses from
    Effects(effects::EffectsArgs),
    /// A learned map from raw readings to contact, in place of the station's thresholds
    #[command(subcommand)]
    ContactMap(contact_map::ContactMapCommand),
    /// The servo of a joint
    #[command(subcommand)]
    Actuator(actuator::ActuatorCommand),
    /// The hand, the arm and the tactile boards
    #[command(subcommand)]
    Devices(devices::DevicesCommand),
    /// Start the studio
    Serve(serve::ServeArgs),
    /// Hide effects in emulated sessions, diagnose them blind, and score the names
    Blind(blind::BlindArgs),
    /// The jobs of a studio
    #[command(subcommand)]
    Jobs(jobs::JobsCommand),
    /// Trials of policies on the hand, and what they say
    #[command(subcommand)]
    Campaign(campaign::CampaignCommand),
    /// Who may log in to a studio
    #[command(subcommand)]
    People(people::PeopleCommand),
    /// API tokens for programs
    #[command(subcommand)]
    Tokens(tokens::TokensCommand),
    /// Copy a data folder into one file, while a studio has it open or not
    Backup(backup::BackupArgs),
    /// What is known of sessions and takes without decoding them
    #[command(subcommand)]
    Index(index::IndexCommand),
    /// Delete old jobs and what has been in the trash for long
    Retention(retention::RetentionCommand),
    /// Print completions for a shell
    Completions(completions::CompletionsArgs),
    /// Write man pages
    Man(completions::ManArgs),
    /// Print the OpenAPI document of the studio's HTTP API, as it serves it at /api/v1/openapi.json
    Openapi,
    /// What runners of jobs call (docs/jobs.md)
    #[command(subcommand, hide = true)]
    Job(job::JobCommand),
    /// Measure a path that has to be fast
    #[command(subcommand)]
    Bench(bench::BenchCommand),
}

/// Runs the command; exit code 0 done, 1 failed, 2 bad arguments or bad input.
pub(crate) fn main() -> ExitCode {
    let mut args = Args::parse();
    let format = match &mut args.command {
        Command::Serve(args) => match args.read_config() {
            Ok(()) => Some(args.log_format()),
            Err(err) => return failed(&err),
        },
        _ => None,
    };
    let _log = init_log(format);
    let result = match args.command {
        Command::Emulate(args) => emulate::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Station(command) => new_station::run(&command),
        Command::Session(command) => session::run(&command),
        Command::Replay(args) => replay::run(&args),
        Command::Export(command) => export::run(&command),
        Command::Calibrate(args) => calibrate::run(&args),
        Command::Diagnose(args) => diagnose::run(&args),
        Command::Effects(args) => effects::run(&args),
        Command::ContactMap(command) => contact_map::run(&command),
        Command::Devices(command) => devices::run(&command),
        Command::Actuator(command) => actuator::run(&command),
        Command::Serve(args) => serve::run(args),
        Command::Blind(args) => blind::run(&args),
        Command::Jobs(command) => jobs::run(&command),
        Command::Campaign(command) => campaign::run(&command),
        Command::People(command) => people::run(&command),
        Command::Tokens(command) => tokens::run(&command),
        Command::Backup(args) => backup::run(&args),
        Command::Index(command) => index::run(&command),
        Command::Retention(args) => retention::run(&args),
        Command::Completions(args) => completions::completions(&args, Args::command()),
        Command::Man(args) => completions::man(&args, Args::command()),
        Command::Openapi => openapi::run(),
        Command::Job(command) => job::run(&command),
        Command::Bench(command) => bench::run(&command),
    };
    match result {
        Ok(code) => code,
        Err(err) => failed(&err),
    }
}

fn failed(err: &Error) -> ExitCode {
    eprintln!("error: {}", chain(err));
    ExitCode::from(err.exit_code())
}

/// What a command gives: its exit code, or why it could not be done.
type Outcome = Result<ExitCode, Error>;

/// Logs go to standard error; `RUST_LOG` chooses what. A thread of its own writes them: nothing else stands still because a
/// terminal or a pipe does, and lines that find it too far behind are dropped. What waits is written when the guard is
/// dropped.
fn init_log(server: Option<serve::LogFormat>) -> WorkerGuard {
    let default_level = if server.is_some() { "info" } else { "warn" };
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(default_level));
    let (writer, guard) = NonBlockingBuilder::default().lossy(true).finish(std::io::stderr());
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer);
    match server {
        Some(serve::LogFormat::Json) => log.json().flatten_event(true).init(),
        _ => log.with_ansi(std::io::stderr().is_terminal()).init(),
    }
    guard
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_consistent() {
        Args::command().debug_assert();
    }
}
