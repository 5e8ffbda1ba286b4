//! `palpate jobs`: the jobs of a data folder, with or without a studio that has it open.

use std::{path::PathBuf, process::ExitCode};

use clap::{Args, Subcommand};
use palpate_jobs::{Database, JobFolder, ListFilter};
use palpate_server::{
    Error,
    data::files,
    jobs::{JobSource, submit_job},
};
use palpate_wire::api::{Job, JobRequest, JobState, Resources};

use super::{Outcome, folder::FolderArgs, output};

/// This much of a log is printed, from its end, bytes.
const MAX_LOG_BYTES: u64 = 1 << 20;

#[derive(Subcommand)]
pub(crate) enum JobsCommand {
    /// Newest first
    List(ListArgs),
    /// Queue a job; a studio that has the folder open starts it
    Submit(SubmitArgs),
    /// One job, and where its files are
    Show(JobArgs),
    /// Ask a job to stop; a running one is asked by the studio
    Cancel(JobArgs),
    /// Queue a job that failed or was cancelled once more; it starts when a studio has the folder open
    Retry(JobArgs),
    /// What a job's process printed
    Log(JobArgs),
}

#[derive(Args)]
pub(crate) struct ListArgs {
    #[command(flatten)]
    folder: FolderArgs,
    /// Only jobs in this state: queued, running, done, failed or cancelled
    #[arg(long, value_parser = state)]
    state: Option<JobState>,
    /// Only jobs of this kind, e.g. diagnose
    #[arg(long)]
    kind: Option<String>,
    /// Most jobs
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1000))]
    limit: u32,
}

#[derive(Args)]
pub(crate) struct JobArgs {
    /// Id of the job
    id: String,
    #[command(flatten)]
    folder: FolderArgs,
}

#[derive(Args)]
pub(crate) struct SubmitArgs {
    /// Kind of job, e.g. diagnose or expert
    kind: String,
    /// The request in the form of its kind (docs/jobs.md), as JSON, e.g. '{"object": "cube"}'
    request: String,
    /// Seed of everything random
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Jobs of a higher priority start first
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    priority: i32,
    /// Cores; 0 means all of them [default: as its kind needs]
    #[arg(long)]
    cores: Option<u32>,
    /// Shards into which the work is divided, for kinds that can be (docs/jobs.md); --cores is then what each of them has
    #[arg(long, value_name = "N")]
    shards: Option<u32>,
    /// Shards that work at once at most [default: as many as there is room for]
    #[arg(long, value_name = "N", requires = "shards")]
    at_once: Option<u32>,
    /// Learn on the graphics card, for kinds that can: imitation and pipeline
    #[arg(long)]
    gpu: bool,
    /// Where it runs: process, or the name of a runner in runners.toml [default: the first that there is]
    #[arg(long)]
    runner: Option<String>,
    /// The palpate-train program [default: the one beside palpate, or on PATH]
    #[arg(long, value_name = "FILE")]
    train: Option<PathBuf>,
    #[command(flatten)]
    folder: FolderArgs,
}

fn state(name: &str) -> Result<JobState, String> {
    JobState::from_name(name)
        .ok_or_else(|| format!("{name:?} is no state; expected queued, running, done, failed or cancelled"))
}

pub(super) fn run(command: &JobsCommand) -> Outcome {
    match command {
        JobsCommand::List(args) => list(args)?,
        JobsCommand::Submit(args) => submit(args)?,
        JobsCommand::Show(args) => show(args, &job(args)?)?,
        JobsCommand::Cancel(args) => {
            let before = job(args)?;
            args.folder.database()?.request_cancel(&before.id)?;
            show(args, &job(args)?)?;
        }
        JobsCommand::Retry(args) => {
            let before = job(args)?;
            if !args.folder.database()?.retry(&before.id)? {
                let state = before.state.name();
                return Err(Error::Conflict(format!(
                    "job {:?} is {state}; only one that failed or was cancelled can be tried again",
                    before.id
                )));
            }
            show(args, &job(args)?)?;
        }
        JobsCommand::Log(args) => {
            let log = args.job_folder(&job(args)?).log_tail(MAX_LOG_BYTES)?;
            match args.folder.json {
                true => output::json(&log)?,
                false => output::line(log.trim_end())?,
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

impl FolderArgs {
    fn database(&self) -> Result<Database, Error> {
        let path = self.data.join("palpate.sqlite");
        if !path.is_file() {
            return Err(Error::Argument(format!(
                "{:?} holds no table of jobs; give the data folder of a studio (--data)",
                self.data
            )));
        }
        Ok(Database::open(&path)?)
    }

    fn job_folder(&self, job: &Job) -> JobFolder {
        JobFolder::at(self.data.join("runs").join(&job.id))
    }

    /// Adds what a running job says itself, which the database learns at its end.
    fn add_progress(&self, job: &mut Job) {
        let progress = self.job_folder(job).progress().filter(|progress| progress.attempt == job.attempts);
        if let Some(progress) = progress.filter(|_| job.state == JobState::Running) {
            job.fraction = progress.fraction;
            job.stage = progress.stage;
            job.seconds_left = progress.seconds_left;
        }
    }
}

impl JobArgs {
    fn job_folder(&self, job: &Job) -> JobFolder {
        self.folder.job_folder(job)
    }
}

fn list(args: &ListArgs) -> Result<(), Error> {
    let filter =
        ListFilter { state: args.state, kind: args.kind.clone(), limit: Some(args.limit), cursor: None };
    let mut page = args.folder.database()?.list(&filter)?;
    page.jobs.iter_mut().for_each(|job| args.folder.add_progress(job));
    if args.folder.json {
        return output::json(&page);
    }
    output::line(&format!("{:<20} {:<10} {:<10} {:<24}  stage", "job", "kind", "state", "created"))?;
    page.jobs.iter().try_for_each(|job| {
        let last = job.problem.as_deref().unwrap_or(&job.stage);
        let state = job.state.name();
        output::line(&format!("{:<20} {:<10} {state:<10} {:<24}  {last}", job.id, job.kind, job.created))
    })
}

fn submit(args: &SubmitArgs) -> Result<(), Error> {
    let request = serde_json::from_str(&args.request)
        .map_err(|err| Error::Argument(format!("the request {:?} is no JSON: {err}", args.request)))?;
    let request = JobRequest {
        kind: args.kind.clone(),
        request,
        seed: args.seed,
        priority: args.priority,
        resources: (args.cores.is_some() || args.shards.is_some() || args.gpu).then(|| Resources {
            cores: args.cores.unwrap_or(0),
            shards: args.shards.unwrap_or(0),
            at_once: args.at_once.unwrap_or(0),
            gpu: args.gpu,
            ..Resources::default()
        }),
        runner: args.runner.clone(),
    };
    let source = JobSource { data: &args.folder.data, train: args.train.as_deref() };
    let owner = std::env::var("USER").unwrap_or_else(|_| "command line".to_owned());
    let job = submit_job(&source, &request, &owner)?;
    match args.folder.json {
        true => output::json(&job),
        false => output::line(&format!("{}: {}", job.id, job.stage)),
    }
}

fn job(args: &JobArgs) -> Result<Job, Error> {
    files::check_id("job", &args.id)?;
    let job = args.folder.database()?.job(&args.id)?;
    let mut job = job.ok_or_else(|| Error::NotFound {
        what: "job",
        id: args.id.clone(),
        hint: "`palpate jobs list` lists them",
    })?;
    args.folder.add_progress(&mut job);
    Ok(job)
}

fn show(args: &JobArgs, job: &Job) -> Result<(), Error> {
    if args.folder.json {
        return output::json(job);
    }
    let folder = args.job_folder(job);
    let mut lines = vec![format!(
        "{} ({}): {}, {:.0} %, {}",
        job.id,
        job.kind,
        job.state.name(),
        100.0 * job.fraction,
        job.stage
    )];
    lines.extend(job.problem.iter().map(|problem| format!("problem: {problem}")));
    lines.push(format!("created {}, attempts {}, runner {}", job.created, job.attempts, job.runner));
    lines.extend(job.started.iter().map(|time| format!("started {time}")));
    lines.extend(job.ended.iter().map(|time| format!("ended {time}")));
    lines.push(format!("request {}", job.spec.request));
    lines.push(format!("files {}", folder.path().display()));
    output::line(&lines.join("\n"))
}
