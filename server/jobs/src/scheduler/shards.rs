//! Divided jobs: their shards, and the last step that makes one outcome of what the shards have left.
//!
//! A shard has a folder with the files of a job and is to a runner what a job is, so all that is known of it stands
//! there and a studio that was killed finds it again. Its attempts have numbers of their own: each attempt of the job has
//! a block of them, so a shard that failed in an earlier one is told from one that failed just now. The last step is the
//! job's own process, and begins when all shards are done.

use palpate_wire::api::{JobExit, JobProgress, JobState, Resources};

use super::{LAST_STEP, MAX_CUT_OFF, SEARCHED_LOG_BYTES, Shared, telling_line};
use crate::{
    JobsError,
    clock::rfc3339_now,
    database::Row,
    plan::shards_at_once,
    process_id,
    runner::{Launch, RunState, Runner},
    working::{SHARE_OF_SHARDS, chain},
};

/// Numbers of attempts at a shard that belong to one attempt at its job.
const BLOCK: u32 = 16;
/// Of these, the ones that are used: an attempt that is lost takes a second number with it, which nothing can begin.
const MAX_NUMBERS: u32 = 2 * MAX_CUT_OFF;
const _: () = assert!(MAX_NUMBERS < BLOCK);

/// What of a shard's log the job's repeats when the shard fails, bytes.
const QUOTED_LOG_BYTES: u64 = 8 << 10;

/// Where a shard stands.
#[derive(Clone, Debug, PartialEq)]
enum Standing {
    Done,
    /// It has to be begun, as this attempt.
    Due(u32),
    /// It waits in the runner's own queue.
    Waits(Launch),
    Works(Launch, f64),
    Failed(String),
    /// It was asked to stop, and did.
    Stopped,
}

/// Number of a shard's first attempt in attempt `attempt` of its job.
fn first_attempt(attempt: u32) -> u32 {
    attempt.saturating_sub(1).saturating_mul(BLOCK) + 1
}

impl Shared {
    /// Looks after the shards of `launch`, and begins what is due: shards, the last step, or the end.
    pub(super) fn look_after_shards(
        &self,
        runner: &dyn Runner,
        row: &Row,
        launch: &Launch,
    ) -> Result<(), JobsError> {
        let asked = row.job.cancel_requested;
        if !launch.folder.path().is_dir() {
            let problem = "its folder is gone, and what its shards have done with it";
            return self.end(row, JobState::Failed, Some(problem), &rfc3339_now());
        }
        let mut standings = Vec::new();
        for shard in 0..launch.resources.shards {
            standings.push(self.standing(runner, launch, shard, asked)?);
        }
        let failed = standings.iter().zip(0..).find_map(|(standing, shard)| match standing {
            Standing::Failed(problem) => Some((shard, problem.clone())),
            _ => None,
        });
        let at_work: Vec<Launch> = standings
            .iter()
            .filter_map(|standing| match standing {
                Standing::Waits(launch) | Standing::Works(launch, _) => Some(launch.clone()),
                _ => None,
            })
            .collect();
        if asked || failed.is_some() {
            if !at_work.is_empty() {
                self.note_shards(launch, &standings, failed.as_ref().map(|(shard, _)| *shard))?;
                if let Some(insists) = self.insists(&launch.id)
                    && let Err(err) = runner.cancel_shards(&at_work, insists)
                {
                    self.complain(&launch.id, &chain(&err));
                }
                return Ok(());
            }
            return match failed {
                Some((shard, problem)) if !asked => self.end_by_shard(row, launch, shard, &problem),
                _ => self.end(row, JobState::Cancelled, None, &rfc3339_now()),
            };
        }
        if standings.iter().all(|standing| *standing == Standing::Done) {
            return self.begin_last_step(runner, row, launch);
        }
        let room = shards_at_once(&launch.resources, runner.capacity()) as usize;
        // A runner with a queue of its own minds the limit itself.
        let room = if runner.capacity().is_some() { room } else { standings.len() };
        let due = standings.iter().zip(0..).filter_map(|(standing, shard)| match standing {
            Standing::Due(attempt) => Some(shard_of(launch, shard, *attempt)),
            _ => None,
        });
        let due: Vec<Launch> = due.take(room.saturating_sub(at_work.len())).collect();
        self.begin_shards(runner, launch, due)?;
        self.note_shards(launch, &standings, None)
    }

    /// Where shard `shard` of `launch` stands.
    fn standing(
        &self,
        runner: &dyn Runner,
        launch: &Launch,
        shard: u32,
        asked: bool,
    ) -> Result<Standing, JobsError> {
        let folder = launch.folder.shard(shard);
        let (current, first) = (folder.attempt()?, first_attempt(launch.attempt));
        let exit = folder.exit(current);
        let is_done = exit.as_ref().is_some_and(|exit| exit.outcome == JobState::Done);
        if current < first {
            return Ok(if is_done { Standing::Done } else { Standing::Due(first) });
        }
        if is_done && self.live().get(&launch.id).is_some_and(|live| live.shards_done.contains(&shard)) {
            return Ok(Standing::Done);
        }
        let attempt = shard_of(launch, shard, current);
        let works = |attempt| Ok(Standing::Works(attempt, fraction(&folder, current)));
        // Asked of those that have said how they ended, too: the runner lets go of their processes.
        let state = match (runner.state(&attempt, None), exit) {
            (Ok(RunState::Died(_) | RunState::Lost), Some(exit)) => RunState::Ended(exit),
            (Ok(state), _) => state,
            (Err(err), _) => {
                self.complain(&launch.id, &chain(&err));
                return works(attempt);
            }
        };
        match state {
            RunState::Waiting(_) => return Ok(Standing::Waits(attempt)),
            RunState::Running => return works(attempt),
            RunState::Ended(exit) => match exit.outcome {
                JobState::Done => {
                    self.live().entry(launch.id.clone()).or_default().shards_done.insert(shard);
                    return Ok(Standing::Done);
                }
                _ if asked => return Ok(Standing::Stopped),
                // Because another one failed, or somebody else has asked it: a computer that is shut down, for instance.
                JobState::Cancelled => {}
                _ => {
                    let problem = exit.problem;
                    let problem =
                        problem.unwrap_or_else(|| "it failed and did not say why; see its log".to_owned());
                    return Ok(Standing::Failed(problem));
                }
            },
            RunState::Died(why) if !asked => {
                let log = folder.log_tail(SEARCHED_LOG_BYTES).unwrap_or_default();
                let problem = match telling_line(&log) {
                    Some(line) => format!("{why}: {line}"),
                    None => why,
                };
                return match note_end(&attempt, JobState::Failed, Some(&problem))? {
                    true => Ok(Standing::Failed(problem)),
                    false => works(attempt),
                };
            }
            RunState::Died(_) | RunState::Lost => {
                if !note_end(&attempt, JobState::Cancelled, None)? {
                    return works(attempt);
                }
                if asked {
                    return Ok(Standing::Stopped);
                }
            }
        }
        let next = folder.attempt()? + 1;
        if next >= first + MAX_NUMBERS {
            let problem = format!(
                "it was cut off {MAX_CUT_OFF} times before it ended; find out what ends it, then try the job again"
            );
            note_end(&attempt, JobState::Failed, Some(&problem))?;
            return Ok(Standing::Failed(problem));
        }
        Ok(Standing::Due(next))
    }

    /// Starts `due`. What cannot be started has failed.
    fn begin_shards(&self, runner: &dyn Runner, job: &Launch, due: Vec<Launch>) -> Result<(), JobsError> {
        job.folder.make_shards(due.iter().filter_map(|launch| launch.shard))?;
        let mut due = due;
        due.sort_by_key(|launch| (launch.attempt, launch.shard));
        for together in due.chunk_by(|one, other| one.attempt == other.attempt) {
            for shard in together.iter().filter(|shard| shard.attempt != first_attempt(job.attempt)) {
                tracing::warn!(job = shard.id, shard = shard.shard, "a shard was cut off; it begins again");
            }
            if let Err(err) = runner.submit_shards(together, job.resources.max_at_once()) {
                let problem = format!("it could not be started: {}", chain(&err));
                for shard in together {
                    note_end(shard, JobState::Failed, Some(&problem))?;
                }
            }
        }
        Ok(())
    }

    /// Starts the process of the job itself.
    fn begin_last_step(&self, runner: &dyn Runner, row: &Row, launch: &Launch) -> Result<(), JobsError> {
        let database = &self.config.database;
        // Noted before: after a crash between here and the next note the attempt is looked for, and not begun twice.
        if !database.set_handle(&launch.id, launch.attempt, LAST_STEP)? {
            return Ok(());
        }
        match runner.submit(launch) {
            Ok(handle) => database.set_handle(&launch.id, launch.attempt, &handle).map(|_| ()),
            Err(err) => {
                let problem = format!("its last step could not be started: {}", chain(&err));
                self.end(row, JobState::Failed, Some(&problem), &rfc3339_now())
            }
        }
    }

    fn end_by_shard(&self, row: &Row, launch: &Launch, shard: u32, problem: &str) -> Result<(), JobsError> {
        let quoted = launch.folder.shard(shard).log_tail(QUOTED_LOG_BYTES).unwrap_or_default();
        let written = launch.folder.open_log().and_then(|mut log| {
            std::io::Write::write_fmt(&mut log, format_args!("--- shard {shard}:\n{quoted}"))
                .map_err(JobsError::io("write", launch.folder.file("log.txt")))
        });
        if let Err(err) = written {
            // Its own log says it, too.
            self.complain(&launch.id, &chain(&err));
        }
        self.end(row, JobState::Failed, Some(&format!("shard {shard}: {problem}")), &rfc3339_now())
    }

    /// Notes how far all shards are together.
    fn note_shards(
        &self,
        launch: &Launch,
        standings: &[Standing],
        failed: Option<u32>,
    ) -> Result<(), JobsError> {
        let (mut done, mut work, mut wait, mut sum) = (0_usize, 0_usize, 0_usize, 0.0);
        for standing in standings {
            match standing {
                Standing::Done => (done, sum) = (done + 1, sum + 1.0),
                Standing::Works(_, fraction) => (work, sum) = (work + 1, sum + fraction),
                Standing::Waits(_) | Standing::Due(_) => wait += 1,
                Standing::Failed(_) | Standing::Stopped => {}
            }
        }
        let stage = match failed {
            Some(shard) => format!("shard {shard} failed; stopping the others"),
            None => format!("{done} of {} shards done, {work} at work, {wait} waiting", standings.len()),
        };
        let progress = JobProgress {
            attempt: launch.attempt,
            fraction: SHARE_OF_SHARDS * sum / standings.len().max(1) as f64,
            stage,
            seconds_left: None,
        };
        // For whoever looks at the folder alone.
        if launch.folder.progress().as_ref() != Some(&progress) {
            launch.folder.write_progress(&progress)?;
        }
        self.note_progress(launch, progress)
    }
}

/// Attempt `attempt` at shard `shard` of `launch`.
fn shard_of(launch: &Launch, shard: u32, attempt: u32) -> Launch {
    Launch {
        id: launch.id.clone(),
        shard: Some(shard),
        attempt,
        resources: Resources { shards: 0, at_once: 0, ..launch.resources },
        folder: launch.folder.shard(shard),
    }
}

fn fraction(folder: &crate::JobFolder, attempt: u32) -> f64 {
    folder.progress().filter(|progress| progress.attempt == attempt).map_or(0.0, |progress| progress.fraction)
}

/// Writes down how `shard` ended, where its process did not, so that a studio that is started again knows it. False where a
/// process works on it after all.
fn note_end(shard: &Launch, outcome: JobState, problem: Option<&str>) -> Result<bool, JobsError> {
    let Some(_lock) = shard.folder.try_lock()? else { return Ok(false) };
    let ended = rfc3339_now();
    shard.folder.write_exit(&JobExit {
        attempt: shard.folder.attempt()?,
        outcome,
        code: 1,
        problem: problem.map(str::to_owned),
        started: ended.clone(),
        ended,
        host: process_id::host(),
    })?;
    Ok(true)
}
