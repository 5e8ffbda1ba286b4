//! What goes from a data folder by itself: old jobs to the trash, their logs, and what has been in the trash for long.
//!
//! Nothing goes unless the configuration gives a number of days. [`plan`] says what would go and why, and touches
//! nothing; [`carry_out`] does what a plan says. Two rules stand above the numbers: an accepted take is never deleted,
//! also not out of the trash, and nothing goes that something refers to: jobs that were asked for with it, campaigns,
//! saved models.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
    thread,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use palpate_jobs::{ListFilter, Scheduler, seconds_between};
use palpate_recording::Session;
use palpate_wire::api::Job;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{AppState, Error, chain, data::files::moved_at, jobs::board};

const SECONDS_A_DAY: f64 = 86_400.0;
/// A studio that is on looks this often.
const PERIOD: Duration = Duration::from_secs(3600);
/// Largest file that is searched for references, bytes.
const MAX_SEARCHED_BYTES: u64 = 64 << 20;

/// What goes when, days; what is absent never goes. `[retention]` of the configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RetentionConfig {
    /// Jobs that ended longer ago go to the trash.
    pub jobs_days: Option<u32>,
    /// Logs of jobs that ended longer ago are deleted.
    pub log_days: Option<u32>,
    /// What has been in the trash for longer is deleted.
    pub trash_days: Option<u32>,
}

impl RetentionConfig {
    /// Whether anything goes at all.
    pub fn is_on(&self) -> bool {
        *self != Self::default()
    }
}

/// What happens to something that goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RetentionAct {
    /// The folder of a job moves to the trash.
    MoveToTrash,
    /// It is gone for good.
    Delete,
}

impl RetentionAct {
    /// In words, of something that is to come or is done.
    pub fn words(self, is_to_come: bool) -> &'static str {
        match (self, is_to_come) {
            (Self::MoveToTrash, true) => "to the trash:",
            (Self::MoveToTrash, false) => "moved to the trash:",
            (Self::Delete, true) => "to delete:",
            (Self::Delete, false) => "deleted:",
        }
    }
}

/// Something that goes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RetentionStep {
    /// How.
    pub act: RetentionAct,
    /// Where it is, relative to the data folder.
    pub path: String,
    /// Its size.
    pub bytes: u64,
    /// Why.
    pub why: String,
}

/// Something that is old enough to go, and stays.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RetentionKept {
    /// Where it is, relative to the data folder.
    pub path: String,
    /// Why.
    pub why: String,
}

/// What goes, and what stays although it is old.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RetentionPlan {
    /// What goes.
    pub goes: Vec<RetentionStep>,
    /// What stays.
    pub stays: Vec<RetentionKept>,
}

/// What would go from the data folder `data` at the time `now`.
pub fn plan(data: &Path, config: RetentionConfig, now: SystemTime) -> Result<RetentionPlan, Error> {
    let (root, scheduler) = board::beside_a_studio(data, None)?;
    plan_with(&root, &scheduler, config, now)
}

/// Does what `plan` says, whether a studio has the folder open or not. What cannot be done is logged, and the rest is
/// done.
pub fn carry_out(data: &Path, plan: &RetentionPlan) -> Result<(), Error> {
    let (root, scheduler) = board::beside_a_studio(data, None)?;
    carry_out_with(&root, &scheduler, plan)
}

/// Does it now and every hour, for as long as the studio is there.
pub(crate) fn keep_in_order(state: &Arc<AppState>, config: RetentionConfig) -> Result<(), Error> {
    let state = Arc::downgrade(state);
    let look = move || {
        while let Some(state) = state.upgrade() {
            let scheduler = state.jobs().scheduler();
            let done = plan_with(state.data(), scheduler, config, SystemTime::now()).and_then(|plan| {
                for step in &plan.goes {
                    tracing::info!(path = step.path, why = step.why, "{}", step.act.words(true));
                }
                carry_out_with(state.data(), scheduler, &plan)
            });
            if let Err(err) = done {
                tracing::error!(err = chain(&err), "the data folder is not kept in order; it is tried again");
            }
            let mut shutdown = state.shutdown();
            drop(state);
            // Wakes now and then, so that the thread ends with the studio.
            let mut waited = Duration::ZERO;
            while waited < PERIOD && !*shutdown.borrow_and_update() {
                thread::sleep(Duration::from_secs(1));
                waited += Duration::from_secs(1);
            }
            if *shutdown.borrow() {
                return;
            }
        }
    };
    thread::Builder::new()
        .name("retention".to_owned())
        .spawn(look)
        .map(drop)
        .map_err(|err| Error::Internal(format!("failed to start a thread: {err}")))
}

fn plan_with(
    root: &Path,
    scheduler: &Scheduler,
    config: RetentionConfig,
    now: SystemTime,
) -> Result<RetentionPlan, Error> {
    let mut plan = RetentionPlan::default();
    let jobs = all_jobs(scheduler)?;
    let references = References::of(root, &jobs)?;
    for job in &jobs {
        let age = job.ended.as_deref().and_then(|ended| seconds_between(ended, now));
        let (false, Some(age_days)) = (job.is_unfinished(), age.map(|age| age / SECONDS_A_DAY)) else {
            continue;
        };
        let path = format!("runs/{}", job.id);
        if is_older(age_days, config.jobs_days) {
            let saved = job.saved_as.as_ref().filter(|id| root.join(format!("models/{id}.toml")).exists());
            let why = match (saved, references.to(&job.id)) {
                (Some(model), _) => Some(format!("model {model} was saved from it")),
                (None, Some(referrer)) => Some(format!("{referrer} refers to it")),
                (None, None) => holds_takes(&root.join(&path)),
            };
            match why {
                Some(why) => plan.stays.push(RetentionKept { path: path.clone(), why }),
                None => {
                    let why = format!("{} {}", job.state.name(), days_ago(age_days));
                    plan.add(root, RetentionAct::MoveToTrash, path, why);
                    continue;
                }
            }
        }
        let log = format!("{path}/log.txt");
        if is_older(age_days, config.log_days) && root.join(&log).is_file() {
            plan.add(root, RetentionAct::Delete, log, format!("its job ended {}", days_ago(age_days)));
        }
    }
    if config.trash_days.is_some() {
        for folder in ["runs", "sessions", "models"] {
            plan_trash(root, folder, &references, config.trash_days, now, &mut plan)?;
        }
    }
    Ok(plan)
}

fn plan_trash(
    root: &Path,
    folder: &str,
    references: &References,
    days: Option<u32>,
    now: SystemTime,
    plan: &mut RetentionPlan,
) -> Result<(), Error> {
    for (name, path) in entries(&root.join("trash").join(folder))? {
        let age_days = since_moved(&path, now)? / SECONDS_A_DAY;
        if !is_older(age_days, days) {
            continue;
        }
        let shown = format!("trash/{folder}/{name}");
        let id = id_of(&name);
        let why = match (holds_takes(&path), references.to(id)) {
            (Some(why), _) => Some(why),
            // Takes say which session they were recorded in, and models which one they were fitted to.
            (None, Some(_)) if folder == "sessions" => None,
            (None, Some(referrer)) => Some(format!("{referrer} refers to it")),
            (None, None) => None,
        };
        match why {
            Some(why) => plan.stays.push(RetentionKept { path: shown, why }),
            None => {
                let why = format!("in the trash since {}", days_ago(age_days));
                plan.add(root, RetentionAct::Delete, shown, why);
            }
        }
    }
    Ok(())
}

impl RetentionPlan {
    fn add(&mut self, root: &Path, act: RetentionAct, path: String, why: String) {
        let bytes = size_of(&root.join(&path));
        self.goes.push(RetentionStep { act, path, bytes, why });
    }
}

fn carry_out_with(root: &Path, scheduler: &Scheduler, plan: &RetentionPlan) -> Result<(), Error> {
    for step in &plan.goes {
        let path = root.join(&step.path);
        let done = match step.act {
            RetentionAct::MoveToTrash => {
                scheduler.delete(step.path.trim_start_matches("runs/")).map_err(Error::from)
            }
            RetentionAct::Delete => remove(&path),
        };
        if let Err(err) = done {
            tracing::warn!(path = step.path, err = chain(&err), "something old could not go");
        }
    }
    Ok(())
}

/// Removes what is at `path`. What a link leads to stays.
fn remove(path: &Path) -> Result<(), Error> {
    let meta = match path.symlink_metadata() {
        Err(err) if err.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        meta => meta.map_err(Error::io("look at", path))?,
    };
    if !meta.is_dir() {
        return fs::remove_file(path).map_err(Error::io("delete", path));
    }
    if let Some(why) = holds_takes(path) {
        return Err(Error::Conflict(why));
    }
    fs::remove_dir_all(path).map_err(Error::io("delete", path))
}

/// Why the folder `path` must not be deleted for the takes in it; `None` if none of them was accepted.
fn holds_takes(path: &Path) -> Option<String> {
    let meta = path.symlink_metadata().ok()?;
    if !meta.is_dir() {
        return None;
    }
    if path.join("session.toml").symlink_metadata().is_ok() {
        return match Session::open(path) {
            Ok(session) => {
                let accepted = session.file.takes.iter().filter(|take| take.accepted).count();
                (accepted > 0).then(|| format!("{accepted} of its takes are accepted"))
            }
            Err(err) => Some(format!("its session cannot be read, so nobody knows what was accepted: {err}")),
        };
    }
    match fs::read_dir(path) {
        Ok(entries) => entries.flatten().find_map(|entry| {
            let path = entry.path();
            let is_take = path.extension().is_some_and(|extension| extension == "mcap");
            if is_take {
                return Some("it holds a take that belongs to no session".to_owned());
            }
            holds_takes(&path)
        }),
        Err(err) => Some(format!("it cannot be looked into: {err}")),
    }
}

/// Everything that may refer to a job, a model or a policy.
struct References {
    /// Who refers, and the text in which the id stands.
    texts: Vec<(String, String)>,
}

impl References {
    fn of(root: &Path, jobs: &[Job]) -> Result<Self, Error> {
        let mut texts = Vec::new();
        for job in jobs {
            let mut text: Vec<&str> = job.spec.inputs.keys().map(String::as_str).collect();
            strings_in(&job.spec.request, &mut text);
            texts.push((format!("job {}", job.id), text.join("\n")));
        }
        for (name, dir) in entries(&root.join("campaigns"))? {
            for file in ["campaign.json", "log.jsonl"] {
                if let Some(text) = text_of(&dir.join(file))? {
                    texts.push((format!("campaign {name}"), text));
                }
            }
        }
        for (name, path) in entries(&root.join("models"))? {
            if let Some(text) = text_of(&path)? {
                texts.push((format!("model {}", name.trim_end_matches(".toml")), text));
            }
        }
        Ok(Self { texts })
    }

    /// Who refers to `id`, if anybody else does.
    fn to(&self, id: &str) -> Option<&str> {
        let own = [format!("job {id}"), format!("model {id}")];
        let referrer = |(referrer, text): &&(String, String)| !own.contains(referrer) && names(text, id);
        self.texts.iter().find(referrer).map(|(referrer, _)| referrer.as_str())
    }
}

/// Whether `id` stands in `text` as a word of its own.
fn names(text: &str, id: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    !id.is_empty()
        && text.match_indices(id).any(|(begin, _)| {
            let before = text[..begin].chars().next_back();
            let after = text[begin + id.len()..].chars().next();
            !before.is_some_and(is_part) && !after.is_some_and(is_part)
        })
}

fn strings_in<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
    match value {
        Value::String(text) => found.push(text),
        Value::Array(items) => items.iter().for_each(|item| strings_in(item, found)),
        Value::Object(fields) => fields.values().for_each(|value| strings_in(value, found)),
        _ => {}
    }
}

/// The text of a file; `None` where there is none. One that cannot be searched is an error: nothing may go then.
fn text_of(path: &Path) -> Result<Option<String>, Error> {
    let meta = match fs::metadata(path) {
        Err(err) if err.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        meta => meta.map_err(Error::io("look at", path))?,
    };
    if !meta.is_file() {
        return Ok(None);
    }
    if meta.len() > MAX_SEARCHED_BYTES {
        return Err(Error::TooLarge(format!("{path:?} is too large to be searched for what it refers to")));
    }
    let bytes = fs::read(path).map_err(Error::io("read", path))?;
    Ok(Some(String::from_utf8_lossy(&bytes).into_owned()))
}

fn all_jobs(scheduler: &Scheduler) -> Result<Vec<Job>, Error> {
    let mut jobs = Vec::new();
    let mut filter = ListFilter { limit: Some(1000), ..ListFilter::default() };
    loop {
        let page = scheduler.list(&filter)?;
        jobs.extend(page.jobs);
        if page.next_cursor.is_none() {
            return Ok(jobs);
        }
        filter.cursor = page.next_cursor;
    }
}

/// `(name, path)` of what lies in `folder`, by name; nothing where there is no such folder.
fn entries(folder: &Path) -> Result<Vec<(String, PathBuf)>, Error> {
    let read = match fs::read_dir(folder) {
        Err(err) if err.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        read => read.map_err(Error::io("read", folder))?,
    };
    let mut entries = Vec::new();
    for entry in read {
        let entry = entry.map_err(Error::io("read", folder))?;
        entries.push((entry.file_name().to_string_lossy().into_owned(), entry.path()));
    }
    entries.sort();
    Ok(entries)
}

/// The id of something in the trash; one that stepped aside for a later one of its name is called `.2-NAME`.
fn id_of(name: &str) -> &str {
    let name = match name.strip_prefix('.').and_then(|rest| rest.split_once('-')) {
        Some((number, rest)) if number.bytes().all(|byte| byte.is_ascii_digit()) => rest,
        _ => name,
    };
    name.trim_end_matches(".toml")
}

/// How long ago what is at `path` was moved there, s. Moving something changes when its entry last changed.
fn since_moved(path: &Path, now: SystemTime) -> Result<f64, Error> {
    let seconds = |time: SystemTime| time.duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    Ok(seconds(now) - seconds(moved_at(path)?))
}

fn is_older(age_days: f64, days: Option<u32>) -> bool {
    days.is_some_and(|days| age_days > f64::from(days))
}

fn days_ago(age_days: f64) -> String {
    match age_days {
        days if days < 2.0 => format!("{:.0} hours ago", 24.0 * days.max(0.0)),
        days => format!("{days:.0} days ago"),
    }
}

/// Bytes of everything below `path`.
fn size_of(path: &Path) -> u64 {
    let Ok(meta) = path.symlink_metadata() else { return 0 };
    if !meta.is_dir() {
        return meta.len();
    }
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| size_of(&entry.path())).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn id_is_a_word_and_not_a_part_of_one() {
        for text in ["runs/expert-1/policy.safetensors", "expert-1", "from expert-1, seed 2", "\"expert-1\""]
        {
            assert!(names(text, "expert-1"), "{text}");
        }
        for text in ["expert-12", "my-expert-1", "expert-1-old", "expert_1", ""] {
            assert!(!names(text, "expert-1"), "{text}");
        }
        assert!(names("expert-12 and expert-1", "expert-1"), "the second one is it");
        assert!(!names("anything", ""));
    }

    #[test]
    fn ids_in_the_trash() {
        assert_eq!(id_of("bench.toml"), "bench");
        assert_eq!(id_of(".2-bench.toml"), "bench");
        assert_eq!(id_of(".hidden"), ".hidden");
        assert_eq!(id_of("expert-1"), "expert-1");
    }
}
