//! Jobs on a Slurm cluster, by the commands that every cluster has: `sbatch`, `squeue`, `scontrol`, `scancel`.
//!
//! A job is known by a name of our own, not by Slurm's number: a controller that is restarted may forget its newest
//! jobs and give their numbers again. How a job ended is what its own process wrote (`exit.json`); Slurm is asked about
//! those that died without a word, and forgets them soon (`MinJobAge`). A job that Slurm does not know is lost only
//! once its folder shows no sign of life either.

mod answers;

use std::{
    collections::{BTreeMap, HashMap},
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use serde::Deserialize;
use sha2::{Digest as _, Sha256};

use self::answers::{Known, parse_queue, parse_show_job};
use super::{Capacity, Launch, RunState, Runner};
use crate::{JobFolder, JobsError, folder::SHARDS_DIR};

/// What Slurm says of its queue is asked for this often at most.
const QUEUE_PERIOD: Duration = Duration::from_secs(2);
/// A command that has not answered by now is given up, s.
const COMMAND_TIMEOUT_S: &str = "20";
/// After Slurm has ended a job, its last files may take this long to appear through a shared file system.
const FILES_DELAY: Duration = Duration::from_secs(15);
/// A process that works shows a sign of life more often than this.
const HEARTBEAT_PATIENCE: Duration = Duration::from_secs(60);

/// `[[slurm]]` of `runners.toml`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlurmConfig {
    /// Name of the runner, as jobs give it.
    pub name: String,
    /// The `palpate` program, as the nodes see it.
    pub program: PathBuf,
    /// The data folder, as the nodes see it; without, they see it where this computer does.
    #[serde(default)]
    pub data: Option<PathBuf>,
    /// Partition to submit to; the cluster's default without.
    #[serde(default)]
    pub partition: Option<String>,
    /// Further lines of the batch script, e.g. `#SBATCH --time=02:00:00` or `module load gcc`.
    #[serde(default)]
    pub lines: Vec<String>,
    /// Variables for Slurm's commands, e.g. `SLURM_CONF`.
    #[serde(default)]
    pub environment: BTreeMap<String, String>,
}

/// Runs jobs on a Slurm cluster.
#[derive(Debug)]
pub struct SlurmRunner {
    config: SlurmConfig,
    /// The data folder, as this computer sees it.
    root: PathBuf,
    /// In names of jobs: two studios on one cluster do not take each other's jobs for theirs.
    studio: String,
    queue: Mutex<Queue>,
}

/// What Slurm last said of its queue.
#[derive(Debug, Default)]
struct Queue {
    asked: Option<Instant>,
    /// By our name.
    jobs: HashMap<String, Known>,
    problem: Option<String>,
    /// When jobs were first seen to have ended without a word.
    silent_since: HashMap<String, Instant>,
}

impl SlurmRunner {
    /// A runner for the data folder `root`.
    pub fn new(config: SlurmConfig, root: &Path) -> Result<Self, JobsError> {
        let problem = |what: &str| Err(JobsError::Argument(format!("runner {:?}: {what}", config.name)));
        if config.name.is_empty() || config.name == "process" {
            return problem("give it a name of its own, other than \"process\"");
        }
        if config.lines.iter().any(|line| line.contains('\n')) {
            return problem("a line of `lines` holds a line break; give it as two");
        }
        let root = root.canonicalize().map_err(JobsError::io("open", root))?;
        let digest = Sha256::digest(root.as_os_str().as_encoded_bytes());
        let studio = digest.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { config, root, studio, queue: Mutex::default() })
    }

    /// What Slurm calls `launch`: an array has one name for all of its tasks.
    fn job_name(&self, launch: &Launch) -> String {
        let shards = if launch.shard.is_some() { "-shards" } else { "" };
        format!("palpate-{}-{}{shards}-{}", self.studio, launch.id, launch.attempt)
    }

    /// What tells `launch` from all else in Slurm's queue.
    fn queue_name(&self, launch: &Launch) -> String {
        match launch.shard {
            None => self.job_name(launch),
            Some(shard) => format!("{}_{shard}", self.job_name(launch)),
        }
    }

    /// `path` as the nodes see it.
    fn on_nodes(&self, path: &Path) -> Result<PathBuf, JobsError> {
        let Some(data) = &self.config.data else { return Ok(path.to_owned()) };
        let path = path.canonicalize().map_err(JobsError::io("open", path))?;
        let inside = path.strip_prefix(&self.root).map_err(|_| {
            JobsError::Runner(format!("{path:?} does not lie in the data folder {:?}", self.root))
        })?;
        Ok(data.join(inside))
    }

    /// A script that works on attempt `attempt` of the job whose folder the word `folder` names in a shell.
    fn script(&self, folder: &str, attempt: u32) -> Result<String, JobsError> {
        let mut script = "#!/bin/sh\n".to_owned();
        for line in &self.config.lines {
            script.push_str(line);
            script.push('\n');
        }
        // The process itself must get Slurm's request to stop, hence exec.
        script.push_str(&format!(
            "exec {} job run --dir {folder} --attempt {attempt}\n",
            quoted(&self.config.program)?,
        ));
        Ok(script)
    }

    /// Hands Slurm the file `script` of the folder `job`; gives its number. `launch` is the job, or one of the shards of the
    /// array that `options` ask for.
    fn sbatch(
        &self,
        launch: &Launch,
        job: &JobFolder,
        script: &str,
        options: &[String],
    ) -> Result<String, JobsError> {
        let resources = launch.resources;
        let mut arguments = vec![
            "--parsable".to_owned(),
            format!("--job-name={}", self.job_name(launch)),
            format!("--comment=palpate:run:{}", launch.id),
            "--open-mode=append".to_owned(),
            format!("--chdir={}", self.on_nodes(job.path())?.display()),
            // A new attempt is the studio's to begin.
            "--no-requeue".to_owned(),
        ];
        arguments.extend_from_slice(options);
        arguments.extend(self.config.partition.iter().map(|partition| format!("--partition={partition}")));
        if resources.cores > 0 {
            arguments.push(format!("--cpus-per-task={}", resources.cores));
        }
        if resources.gpu {
            arguments.push("--gres=gpu:1".to_owned());
        }
        arguments.extend(resources.memory_mib.map(|mib| format!("--mem={mib}M")));
        arguments.push(job.file(script).display().to_string());
        let answer = self.run("sbatch", &arguments.iter().map(String::as_str).collect::<Vec<_>>())?;
        // With several clusters the answer is NUMBER;CLUSTER.
        let number = answer.trim().split(';').next().unwrap_or_default().to_owned();
        if number.is_empty() || !number.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(JobsError::Runner(format!("sbatch gave no number of a job but {answer:?}")));
        }
        // The next look must not rest on an answer from before.
        self.queue().asked = None;
        Ok(number)
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What Slurm says of `launch`; `None` if it does not know it.
    fn ask(&self, launch: &Launch, handle: Option<&str>) -> Result<Option<Known>, JobsError> {
        let name = self.queue_name(launch);
        let name = name.as_str();
        let mut queue = self.queue();
        if queue.asked.is_none_or(|asked| asked.elapsed() >= QUEUE_PERIOD) {
            queue.asked = Some(Instant::now());
            // `%j` comes last, for it is the only one that may hold anything.
            let answer =
                self.run("squeue", &["--noheader", "--array", "--states=all", "--format=%i|%T|%r|%j"]);
            match answer {
                Ok(text) => {
                    queue.jobs = parse_queue(&text);
                    queue.problem = None;
                }
                Err(err) => queue.problem = Some(err.to_string()),
            }
        }
        if let Some(problem) = &queue.problem {
            // Who does not answer says nothing of a job.
            return Err(JobsError::Runner(problem.clone()));
        }
        if let Some(known) = queue.jobs.get(name) {
            return Ok(Some(known.clone()));
        }
        drop(queue);
        if launch.shard.is_some() {
            // The answer is from after the last submission, so the array has ended long ago, or was never there.
            return Ok(None);
        }
        // It is newer than the last answer, or ended: squeue leaves out what ended before MinJobAge.
        let Some(number) = handle else { return self.ask_by_name(name) };
        let shown = self.run("scontrol", &["--oneliner", "show", "job", number]);
        match shown {
            Ok(text) => Ok(parse_show_job(&text).filter(|(shown, _)| shown == name).map(|(_, known)| known)),
            Err(err) if err.to_string().contains("Invalid job id") => Ok(None),
            Err(err) => Err(err),
        }
    }

    fn ask_by_name(&self, name: &str) -> Result<Option<Known>, JobsError> {
        let text = self.run(
            "squeue",
            &["--noheader", "--states=all", &format!("--name={name}"), "--format=%i|%T|%r|%j"],
        )?;
        Ok(parse_queue(&text).remove(name))
    }

    fn run(&self, program: &str, arguments: &[&str]) -> Result<String, JobsError> {
        let output = Command::new("timeout")
            .args([COMMAND_TIMEOUT_S, program])
            .args(arguments)
            .envs(&self.config.environment)
            .stdin(Stdio::null())
            .output()
            .map_err(|err| JobsError::Runner(format!("failed to start {program}: {err}")))?;
        if output.status.success() {
            return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
        }
        let said = String::from_utf8_lossy(&output.stderr).trim().replace('\n', "; ");
        Err(JobsError::Runner(match output.status.code() {
            Some(124) => {
                format!("{program} did not answer for {COMMAND_TIMEOUT_S} s; see whether Slurm runs")
            }
            Some(127) => format!("there is no program {program}; install Slurm's client"),
            _ => format!("{program}: {said}"),
        }))
    }

    /// Asks those of `jobs` that have not ended to stop, or, with `insists`, ends them.
    fn scancel(&self, jobs: &[Known], insists: bool) -> Result<(), JobsError> {
        let (waiting, running): (Vec<&Known>, Vec<&Known>) =
            jobs.iter().filter(|known| !known.has_ended()).partition(|known| known.is_waiting());
        let kill: &[&str] = if insists { &["--signal=KILL", "--full"] } else { &[] };
        for (options, jobs) in [(&[][..], waiting), (kill, running)] {
            if !jobs.is_empty() {
                let numbers: Vec<&str> = jobs.iter().map(|known| known.number.as_str()).collect();
                self.run("scancel", &[options, &numbers[..]].concat())?;
                self.queue().asked = None;
            }
        }
        Ok(())
    }

    /// The attempt is lost, once nothing can begin it any more.
    fn lost(launch: &Launch) -> Result<RunState, JobsError> {
        let Some(lock) = launch.folder.try_lock()? else { return Ok(RunState::Running) };
        launch.folder.give_up_attempt(launch.attempt, &lock)?;
        Ok(RunState::Lost)
    }

    /// Whether the job's process has shown a sign of life lately.
    fn is_alive(launch: &Launch) -> bool {
        let modified = fs::metadata(launch.folder.file("heartbeat")).and_then(|meta| meta.modified());
        let age = modified.ok().and_then(|modified| modified.elapsed().ok());
        let is_its = launch.folder.process().is_some_and(|process| process.attempt == launch.attempt);
        is_its && age.is_some_and(|age| age < HEARTBEAT_PATIENCE)
    }
}

impl Runner for SlurmRunner {
    fn name(&self) -> &str {
        &self.config.name
    }

    fn capacity(&self) -> Option<Capacity> {
        None
    }

    fn submit(&self, launch: &Launch) -> Result<String, JobsError> {
        begin(launch)?;
        let folder = &launch.folder;
        let on_nodes = self.on_nodes(folder.path())?;
        let script = self.script(&quoted(&on_nodes)?, launch.attempt)?;
        fs::write(folder.file("job.sh"), script).map_err(JobsError::io("write", folder.file("job.sh")))?;
        let log = format!("--output={}", on_nodes.join("log.txt").display());
        self.sbatch(launch, folder, "job.sh", &[log])
    }

    fn submit_shards(&self, shards: &[Launch], max_at_once: u32) -> Result<(), JobsError> {
        let Some(first) = shards.first() else { return Ok(()) };
        let Some(job) = first.folder.job_of_shard() else {
            return Err(JobsError::Runner(format!("{:?} is no folder of a shard", first.folder.path())));
        };
        shards.iter().try_for_each(begin)?;
        let on_nodes = self.on_nodes(&job.file(SHARDS_DIR))?;
        let script = self.script(&format!("{}/$SLURM_ARRAY_TASK_ID", quoted(&on_nodes)?), first.attempt)?;
        fs::write(job.file("shards.sh"), script).map_err(JobsError::io("write", job.file("shards.sh")))?;
        let indices: Vec<u32> = shards.iter().filter_map(|launch| launch.shard).collect();
        let log = format!("--output={}", on_nodes.join("%a/log.txt").display());
        let number = self.sbatch(first, &job, "shards.sh", &[array(&indices, max_at_once), log])?;
        tracing::info!(
            job = first.id,
            number,
            shards = indices.len(),
            "an array of shards is in Slurm's queue"
        );
        Ok(())
    }

    fn state(&self, launch: &Launch, handle: Option<&str>) -> Result<RunState, JobsError> {
        let name = self.queue_name(launch);
        if let Some(exit) = launch.folder.exit(launch.attempt) {
            self.queue().silent_since.remove(&name);
            return Ok(RunState::Ended(exit));
        }
        let Some(known) = self.ask(launch, handle)? else {
            return match Self::is_alive(launch) {
                true => Ok(RunState::Running),
                false => Self::lost(launch),
            };
        };
        if known.is_waiting() {
            return Ok(RunState::Waiting(format!("waiting in Slurm: {}", known.reason)));
        }
        if known.is_running() {
            return Ok(RunState::Running);
        }
        let since = *self.queue().silent_since.entry(name.clone()).or_insert_with(Instant::now);
        if since.elapsed() < FILES_DELAY && !known.ended_from_outside() {
            return Ok(RunState::Running);
        }
        self.queue().silent_since.remove(&name);
        if known.is_worth_another_attempt() {
            return Self::lost(launch);
        }
        Ok(RunState::Died(format!(
            "Slurm says {} ({}) of its job {}; see its log",
            known.state, known.reason, known.number
        )))
    }

    fn cancel(&self, launch: &Launch, handle: Option<&str>, insists: bool) -> Result<(), JobsError> {
        match self.ask(launch, handle)? {
            Some(known) => self.scancel(&[known], insists),
            None => Ok(()),
        }
    }

    fn cancel_shards(&self, shards: &[Launch], insists: bool) -> Result<(), JobsError> {
        let mut known = Vec::new();
        for shard in shards {
            known.extend(self.ask(shard, None)?);
        }
        self.scancel(&known, insists)
    }
}

/// Makes the attempt of `launch` the one that counts.
fn begin(launch: &Launch) -> Result<(), JobsError> {
    let lock = launch.folder.lock()?;
    launch.folder.begin_attempt(launch.attempt, &lock)
}

/// The option of sbatch for tasks `indices`, which ascend, of which `max_at_once` may run at once.
fn array(indices: &[u32], max_at_once: u32) -> String {
    let runs = indices.chunk_by(|before, after| before + 1 == *after);
    let runs = runs.filter_map(|run| match run {
        [] => None,
        [one] => Some(one.to_string()),
        [first, .., last] => Some(format!("{first}-{last}")),
    });
    let runs = runs.collect::<Vec<_>>().join(",");
    match (max_at_once as usize) < indices.len() {
        true => format!("--array={runs}%{max_at_once}"),
        false => format!("--array={runs}"),
    }
}

/// `path` as one word of a shell.
fn quoted(path: &Path) -> Result<String, JobsError> {
    let text = path.to_str().filter(|text| !text.contains('\n')).ok_or_else(|| {
        JobsError::Runner(format!("the path {path:?} cannot be written into a script; use a simpler one"))
    })?;
    Ok(format!("'{}'", text.replace('\'', r"'\''")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn array_names_what_is_begun_again_and_its_limit() {
        assert_eq!(array(&[0, 1, 2, 3], 4), "--array=0-3");
        assert_eq!(array(&[0, 1, 2, 3], 2), "--array=0-3%2");
        assert_eq!(array(&[1, 3, 4, 7, 8, 9], 4), "--array=1,3-4,7-9%4");
        assert_eq!(array(&[5], 4), "--array=5");
    }

    #[test]
    fn paths_stay_one_word_of_the_script() {
        assert_eq!(quoted(Path::new("/data/Ada's hand")).unwrap(), r"'/data/Ada'\''s hand'");
        assert!(quoted(Path::new("a\nb")).is_err());
    }
}
