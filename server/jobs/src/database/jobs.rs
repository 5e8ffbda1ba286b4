//! The tables of jobs. Every change of state is one statement that says from which state: two that compete cannot both
//! win.

use std::{fs::Metadata, time::UNIX_EPOCH};

use palpate_wire::api::{Job, JobPage, JobSpec, JobState, Resources};
use rusqlite::{OptionalExtension as _, Params, Row as SqlRow, TransactionBehavior, named_params, params};

use super::Database;
use crate::{JobsError, clock::rfc3339_now};

/// Highest number in an id: nobody starts so many jobs.
pub(crate) const MAX_NUMBER: u64 = 1_000_000_000_000;

/// Most jobs on a page.
const MAX_PAGE: u32 = 1000;

const COLUMNS: &str = "serial, id, kind, state, spec, owner, runner, handle, created, started, ended, attempts, cut_off, \
    cancel_requested, fraction, stage, problem, saved_as";

/// A job and what only the scheduler needs to know of it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// Order of submission.
    pub(crate) serial: i64,
    /// What everybody may know.
    pub(crate) job: Job,
    /// What the runner knows the attempt by.
    pub(crate) handle: Option<String>,
    /// Attempts that were cut off without anybody's doing since the job was last asked for.
    pub(crate) cut_off: u32,
}

/// Cores of all shards that work at once; 0: all that there are.
pub(crate) fn held_cores(resources: &Resources) -> u32 {
    resources.cores.saturating_mul(resources.max_at_once())
}

/// A job that is to be queued.
#[derive(Clone, Debug)]
pub(crate) struct NewJob<'a> {
    /// Before the number in its id.
    pub(crate) prefix: &'a str,
    pub(crate) spec: &'a JobSpec,
    pub(crate) owner: &'a str,
    pub(crate) runner: &'a str,
    /// The client's key, and the request that came with it.
    pub(crate) key: Option<(&'a str, &'a str)>,
}

/// What became of a submission.
#[derive(Clone, Debug, PartialEq)]
pub struct Submitted {
    /// The job.
    pub job: Job,
    /// False where the same request with the same key came before.
    pub is_new: bool,
}

/// A job that waits, as far as its place in the queue depends on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct QueuedJob {
    pub(crate) id: String,
    pub(crate) runner: String,
    pub(crate) cores: u32,
    pub(crate) gpu: bool,
    pub(crate) station: bool,
    pub(crate) short: bool,
}

impl From<&Row> for QueuedJob {
    fn from(row: &Row) -> Self {
        let resources = &row.job.spec.resources;
        Self {
            id: row.job.id.clone(),
            runner: row.job.runner.clone(),
            cores: held_cores(resources),
            gpu: resources.gpu,
            station: resources.station,
            short: resources.short,
        }
    }
}

/// How a job ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ending<'a> {
    pub(crate) state: JobState,
    pub(crate) problem: Option<&'a str>,
    pub(crate) ended: &'a str,
    pub(crate) fraction: f64,
}

/// All jobs of a kind in a state.
#[derive(Clone, Debug, PartialEq)]
pub struct JobTotals {
    /// The kind.
    pub kind: String,
    /// The state.
    pub state: JobState,
    /// How many there are.
    pub jobs: u64,
    /// Time for which they have run, all together, s; of those that run, until now.
    pub seconds: f64,
}

/// Which jobs to list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ListFilter {
    /// Only in this state.
    pub state: Option<JobState>,
    /// Only of this kind.
    pub kind: Option<String>,
    /// Most jobs; 100 without.
    pub limit: Option<u32>,
    /// Where the page before ended.
    pub cursor: Option<String>,
}

impl Database {
    /// Queues a job under the next number of its prefix. It is on disk when this returns.
    ///
    /// `make_folder` is called with its id before anybody can know of the job.
    pub(crate) fn insert(
        &self,
        new: &NewJob<'_>,
        make_folder: impl FnOnce(&str) -> Result<(), JobsError>,
    ) -> Result<Submitted, JobsError> {
        let sql = || JobsError::sql("queue a job");
        let spec = serde_json::to_string(new.spec).map_err(|err| JobsError::Argument(err.to_string()))?;
        let mut writer = self.writer();
        let transaction = writer.transaction_with_behavior(TransactionBehavior::Immediate).map_err(sql())?;
        if let Some((key, request)) = new.key
            && let Some(job) = job_of_key(&transaction, key, request)?
        {
            return Ok(Submitted { job, is_new: false });
        }
        let number: i64 = transaction
            .query_row(
                "INSERT INTO numbers (prefix, next) VALUES (?1, 2)
                 ON CONFLICT (prefix) DO UPDATE SET next = next + 1 RETURNING next - 1",
                [new.prefix],
                |row| row.get(0),
            )
            .map_err(sql())?;
        let id = format!("{}{number}", new.prefix);
        let created = rfc3339_now();
        let resources = new.spec.resources;
        transaction
            .execute(
                "INSERT INTO jobs (id, kind, state, spec, owner, runner, priority, cores, gpu, station, short, created, stage)
                 VALUES (?1, ?2, 'queued', ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, 'waiting for other jobs')",
                params![
                    id, new.spec.kind, spec, new.owner, new.runner, new.spec.priority, held_cores(&resources), resources.gpu,
                    resources.station, resources.short, created
                ],
            )
            .map_err(sql())?;
        if let Some((key, request)) = new.key {
            transaction
                .execute(
                    "INSERT INTO idempotency_keys (key, request, job, created) VALUES (?1, ?2, ?3, ?4)",
                    params![key, request, id, created],
                )
                .map_err(sql())?;
        }
        let row = row_by_id(&transaction, &id).map_err(sql())?;
        let row = row.ok_or_else(|| JobsError::NotFound(id.clone()))?;
        make_folder(&id)?;
        transaction.commit().map_err(sql())?;
        Ok(Submitted { job: row.job, is_new: true })
    }

    /// The job that `request` made when it came with `key` before; refused if another request came with it.
    pub(crate) fn job_of_key(&self, key: &str, request: &str) -> Result<Option<Job>, JobsError> {
        job_of_key(&self.reader(), key, request)
    }

    /// Adds a job that ended in an earlier life of the data folder; one that is there already stays as it is.
    pub fn adopt(&self, prefix: &str, number: u64, job: &Job) -> Result<bool, JobsError> {
        let sql = || JobsError::sql("take over a job");
        let number = i64::try_from(number.min(MAX_NUMBER)).unwrap_or(i64::MAX - 1);
        let spec = serde_json::to_string(&job.spec).map_err(|err| JobsError::Argument(err.to_string()))?;
        let mut writer = self.writer();
        let transaction = writer.transaction_with_behavior(TransactionBehavior::Immediate).map_err(sql())?;
        transaction
            .execute(
                "INSERT INTO numbers (prefix, next) VALUES (?1, ?2 + 1)
                 ON CONFLICT (prefix) DO UPDATE SET next = max(next, ?2 + 1)",
                params![prefix, number],
            )
            .map_err(sql())?;
        let added = transaction
            .execute(
                "INSERT OR IGNORE INTO jobs (id, kind, state, spec, owner, runner, priority, cores, gpu, station, short, created,
                     started, ended, attempts, fraction, stage, problem, saved_as)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, 0, 0, 0, 0, 0, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14)",
                params![
                    job.id, job.kind, job.state.name(), spec, job.owner, job.runner, job.created, job.started, job.ended,
                    job.attempts, job.fraction, job.stage, job.problem, job.saved_as
                ],
            )
            .map_err(sql())?;
        transaction.commit().map_err(sql())?;
        Ok(added > 0)
    }

    /// The job called `id`.
    pub(crate) fn row(&self, id: &str) -> Result<Option<Row>, JobsError> {
        row_by_id(&self.reader(), id).map_err(JobsError::sql("look up a job"))
    }

    /// The job called `id`, as far as the database knows.
    pub fn job(&self, id: &str) -> Result<Option<Job>, JobsError> {
        Ok(self.row(id)?.map(|row| row.job))
    }

    /// How many jobs there are of each kind in each state, and how long they have run.
    pub fn totals(&self) -> Result<Vec<JobTotals>, JobsError> {
        let sql = || JobsError::sql("count jobs");
        let reader = self.reader();
        let mut statement = reader
            .prepare_cached(
                "SELECT kind, state, count(*),
                    total(max(0.0, (julianday(coalesce(ended, ?1)) - julianday(coalesce(started, ended, ?1))) * 86400.0))
                 FROM jobs GROUP BY kind, state ORDER BY kind, state",
            )
            .map_err(sql())?;
        let rows = statement
            .query_map([rfc3339_now()], |row| {
                let state: String = row.get(1)?;
                let state = JobState::from_name(&state).ok_or(rusqlite::Error::InvalidQuery)?;
                let jobs: i64 = row.get(2)?;
                Ok(JobTotals { kind: row.get(0)?, state, jobs: jobs.unsigned_abs(), seconds: row.get(3)? })
            })
            .map_err(sql())?;
        rows.collect::<Result<_, _>>().map_err(sql())
    }

    /// Jobs, newest first.
    pub fn list(&self, filter: &ListFilter) -> Result<JobPage, JobsError> {
        let limit = filter.limit.unwrap_or(100).clamp(1, MAX_PAGE);
        let before = match filter.cursor.as_deref() {
            None => i64::MAX,
            Some(cursor) => cursor.parse().map_err(|_| {
                JobsError::Argument(format!(
                    "no page begins at cursor {cursor:?}; give `next_cursor` of the page before, or none"
                ))
            })?,
        };
        let mut rows = self.rows(
            &format!(
                "SELECT {COLUMNS} FROM jobs WHERE serial < :before AND (:state IS NULL OR state = :state)
                 AND (:kind IS NULL OR kind = :kind) ORDER BY serial DESC LIMIT :limit"
            ),
            named_params! {
                ":before": before,
                ":state": filter.state.map(JobState::name),
                ":kind": filter.kind,
                ":limit": limit + 1,
            },
        )?;
        let more = rows.len() > limit as usize;
        rows.truncate(limit as usize);
        let next_cursor = rows.last().filter(|_| more).map(|row| row.serial.to_string());
        Ok(JobPage { jobs: rows.into_iter().map(|row| row.job).collect(), next_cursor })
    }

    /// Every job in `state`, oldest first.
    pub(crate) fn in_state(&self, state: JobState) -> Result<Vec<Row>, JobsError> {
        let sql = format!("SELECT {COLUMNS} FROM jobs WHERE state = ?1 ORDER BY serial");
        self.rows(&sql, [state.name()])
    }

    /// The first jobs that wait in a lane (short or not), in the order in which they should start.
    pub(crate) fn queue(&self, short: bool, limit: u32) -> Result<Vec<QueuedJob>, JobsError> {
        let reader = self.reader();
        let read = || -> Result<Vec<QueuedJob>, rusqlite::Error> {
            let mut statement = reader.prepare_cached(
                "SELECT id, runner, cores, gpu, station, short FROM jobs WHERE state = 'queued' AND short = ?1
                 ORDER BY priority DESC, serial LIMIT ?2",
            )?;
            let rows = statement.query_map(params![short, limit], |row| {
                Ok(QueuedJob {
                    id: row.get(0)?,
                    runner: row.get(1)?,
                    cores: row.get(2)?,
                    gpu: row.get(3)?,
                    station: row.get(4)?,
                    short: row.get(5)?,
                })
            })?;
            rows.collect()
        };
        read().map_err(JobsError::sql("read the queue"))
    }

    /// A queued job begins its next attempt. False if it waits no more.
    pub(crate) fn begin(&self, id: &str) -> Result<bool, JobsError> {
        self.change(
            "begin a job",
            "UPDATE jobs SET state = 'running', attempts = attempts + 1, started = ?2, ended = NULL, handle = NULL,
                 fraction = 0, stage = 'starting', problem = NULL WHERE id = ?1 AND state = 'queued'",
            params![id, rfc3339_now()],
        )
    }

    /// Notes what the runner knows an attempt by.
    pub(crate) fn set_handle(&self, id: &str, attempt: u32, handle: &str) -> Result<bool, JobsError> {
        self.change(
            "note the process of a job",
            "UPDATE jobs SET handle = ?3 WHERE id = ?1 AND attempts = ?2 AND state = 'running'",
            params![id, attempt, handle],
        )
    }

    /// An attempt ends. False if it ended before.
    pub(crate) fn end(&self, id: &str, attempt: u32, ending: Ending<'_>) -> Result<bool, JobsError> {
        self.change(
            "note the end of a job",
            "UPDATE jobs SET state = ?3, stage = ?3, problem = ?4, ended = ?5, fraction = ?6, handle = NULL
             WHERE id = ?1 AND attempts = ?2 AND state = 'running'",
            params![id, attempt, ending.state.name(), ending.problem, ending.ended, ending.fraction],
        )
    }

    /// An attempt that was cut off waits for the next one.
    pub(crate) fn requeue(&self, id: &str, attempt: u32) -> Result<bool, JobsError> {
        self.change(
            "queue a job again",
            "UPDATE jobs SET state = 'queued', stage = 'waiting to begin again: it was cut off', cut_off = cut_off + 1,
                 handle = NULL, fraction = 0 WHERE id = ?1 AND attempts = ?2 AND state = 'running'",
            params![id, attempt],
        )
    }

    /// Asks a job to stop: one that waits has ended, one that works is asked. False for one that had ended.
    pub fn request_cancel(&self, id: &str) -> Result<bool, JobsError> {
        self.change(
            "cancel a job",
            "UPDATE jobs SET cancel_requested = 1,
                 ended = CASE state WHEN 'queued' THEN ?2 ELSE ended END,
                 stage = CASE state WHEN 'queued' THEN 'cancelled' ELSE stage END,
                 state = CASE state WHEN 'queued' THEN 'cancelled' ELSE state END
             WHERE id = ?1 AND state IN ('queued', 'running')",
            params![id, rfc3339_now()],
        )
    }

    /// Queues a job that has ended once more. False for one that has not, or that is done.
    pub fn retry(&self, id: &str) -> Result<bool, JobsError> {
        self.change(
            "queue a job again",
            "UPDATE jobs SET state = 'queued', stage = 'waiting for other jobs', cut_off = 0, cancel_requested = 0,
                 problem = NULL, ended = NULL, fraction = 0 WHERE id = ?1 AND state IN ('failed', 'cancelled')",
            params![id],
        )
    }

    /// Notes under which id the outcome of a job was saved.
    pub(crate) fn set_saved_as(&self, id: &str, saved_as: Option<&str>) -> Result<bool, JobsError> {
        self.change(
            "note what became of a job",
            "UPDATE jobs SET saved_as = ?2 WHERE id = ?1",
            params![id, saved_as],
        )
    }

    /// Forgets that jobs (`by` names one of them, `None` all) were saved as `saved_as`.
    pub(crate) fn forget_saved(&self, saved_as: &str, by: Option<&str>) -> Result<(), JobsError> {
        self.change(
            "note what became of a job",
            "UPDATE jobs SET saved_as = NULL WHERE saved_as = ?1 AND (?2 IS NULL OR id = ?2)",
            params![saved_as, by],
        )
        .map(|_| ())
    }

    /// Removes a job that has ended. False for one that has not.
    pub(crate) fn delete(&self, id: &str) -> Result<bool, JobsError> {
        self.change(
            "delete a job",
            "DELETE FROM jobs WHERE id = ?1 AND state NOT IN ('queued', 'running')",
            params![id],
        )
    }

    /// The SHA-256 of the file `path` with that size and time, if it was computed before.
    pub(crate) fn known_hash(&self, path: &str, meta: &Metadata) -> Result<Option<String>, JobsError> {
        let (size, modified_ns) = stamp(meta);
        self.reader()
            .query_row(
                "SELECT sha256 FROM file_hashes WHERE path = ?1 AND size = ?2 AND modified_ns = ?3",
                params![path, size, modified_ns],
                |row| row.get(0),
            )
            .optional()
            .map_err(JobsError::sql("look up the hash of a file"))
    }

    /// Keeps the SHA-256 of the file `path` with that size and time.
    pub(crate) fn keep_hash(&self, path: &str, meta: &Metadata, sha256: &str) -> Result<(), JobsError> {
        let (size, modified_ns) = stamp(meta);
        self.change(
            "keep the hash of a file",
            "INSERT INTO file_hashes (path, size, modified_ns, sha256) VALUES (?1, ?2, ?3, ?4) ON CONFLICT (path) DO UPDATE
             SET size = excluded.size, modified_ns = excluded.modified_ns, sha256 = excluded.sha256",
            params![path, size, modified_ns, sha256],
        )
        .map(|_| ())
    }

    fn rows(&self, sql: &str, params: impl Params) -> Result<Vec<Row>, JobsError> {
        let reader = self.reader();
        let read = || -> Result<Vec<Row>, rusqlite::Error> {
            let mut statement = reader.prepare_cached(sql)?;
            let rows = statement.query_map(params, row_of)?;
            rows.collect()
        };
        read().map_err(JobsError::sql("list jobs"))
    }

    /// Whether `sql` changed anything.
    fn change(&self, action: &'static str, sql: &str, params: impl Params) -> Result<bool, JobsError> {
        let writer = self.writer();
        let changed = writer.prepare_cached(sql).and_then(|mut statement| statement.execute(params));
        changed.map(|changed| changed > 0).map_err(JobsError::sql(action))
    }
}

fn job_of_key(connection: &rusqlite::Connection, key: &str, request: &str) -> Result<Option<Job>, JobsError> {
    let sql = || JobsError::sql("look up an idempotency key");
    let known: Option<(String, String)> = connection
        .query_row("SELECT request, job FROM idempotency_keys WHERE key = ?1", [key], |row| {
            Ok((row.get(0)?, row.get(1)?))
        })
        .optional()
        .map_err(sql())?;
    let Some((before, id)) = known else { return Ok(None) };
    if before != request {
        return Err(JobsError::KeyReused(format!(
            "the idempotency key {key:?} came before with another request, which made job {id:?}; use a new key for a \
             new request"
        )));
    }
    let row = row_by_id(connection, &id).map_err(sql())?;
    let row = row.ok_or_else(|| {
        JobsError::Conflict(format!(
            "the job {id:?} of idempotency key {key:?} has been deleted; use a new key"
        ))
    })?;
    Ok(Some(row.job))
}

fn stamp(meta: &Metadata) -> (i64, i64) {
    let modified = meta.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    let modified_ns = modified.map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(0));
    (i64::try_from(meta.len()).unwrap_or(i64::MAX), modified_ns)
}

fn row_by_id(connection: &rusqlite::Connection, id: &str) -> Result<Option<Row>, rusqlite::Error> {
    let mut statement = connection.prepare_cached(&format!("SELECT {COLUMNS} FROM jobs WHERE id = ?1"))?;
    statement.query_row([id], row_of).optional()
}

fn row_of(row: &SqlRow<'_>) -> Result<Row, rusqlite::Error> {
    let text_error = |column, err: Box<dyn std::error::Error + Send + Sync>| {
        rusqlite::Error::FromSqlConversionFailure(column, rusqlite::types::Type::Text, err)
    };
    let state: String = row.get(3)?;
    let state =
        JobState::from_name(&state).ok_or_else(|| text_error(3, format!("state {state:?}").into()))?;
    let spec: String = row.get(4)?;
    let spec: JobSpec = serde_json::from_str(&spec).map_err(|err| text_error(4, err.into()))?;
    let job = Job {
        id: row.get(1)?,
        kind: row.get(2)?,
        state,
        created: row.get(8)?,
        started: row.get(9)?,
        ended: row.get(10)?,
        attempts: row.get(11)?,
        owner: row.get(5)?,
        runner: row.get(6)?,
        fraction: row.get(14)?,
        stage: row.get(15)?,
        seconds_left: None,
        problem: row.get(16)?,
        cancel_requested: row.get(13)?,
        saved_as: row.get(17)?,
        spec,
    };
    Ok(Row { serial: row.get(0)?, job, handle: row.get(7)?, cut_off: row.get(12)? })
}
