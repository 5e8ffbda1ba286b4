//! The campaigns of a data folder.

use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use jiff::Timestamp;
use palpate_recording::files::{check_name, read_text, replace_file};
use palpate_wire::api::{
    Campaign, CampaignPlan, CampaignResults, CampaignSummary, PublishedResult, RolloutOutcome, ScoreRequest,
};
use serde::{Deserialize, Serialize};

use crate::{
    TrialsError, Viewer,
    campaign::State,
    log::{Change, Entry, Log},
    plan::check_plan,
    results,
    tables::trials_csv,
};

/// Largest plan that is read, bytes.
const MAX_PLAN_BYTES: u64 = 4 << 20;
/// The plan's file and the log's, in the campaign's folder.
const PLAN_FILE: &str = "campaign.json";
const LOG_FILE: &str = "log.jsonl";

/// File `campaign.json`.
#[derive(Serialize, Deserialize)]
struct PlanFile {
    created: String,
    plan: CampaignPlan,
}

/// A campaign that has been read.
#[derive(Debug)]
struct Opened {
    state: State,
    log: Log,
}

/// The folder `campaigns` of a data folder. Whoever has one open for changes is the only one.
#[derive(Debug)]
pub struct Campaigns {
    root: PathBuf,
    published: Vec<PublishedResult>,
    opened: Mutex<HashMap<String, Arc<Mutex<Opened>>>>,
}

impl Campaigns {
    /// The campaigns below `root`, which need not exist, beside `published` results.
    pub fn new(root: impl Into<PathBuf>, published: Vec<PublishedResult>) -> Self {
        Self { root: root.into(), published, opened: Mutex::default() }
    }

    /// All campaigns, newest first. One that cannot be read says why.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn list(&self) -> Result<Vec<CampaignSummary>, TrialsError> {
        let entries = match fs::read_dir(&self.root) {
            Ok(entries) => entries,
            Err(err) if err.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(err) => return Err(TrialsError::io("read", &self.root)(err)),
        };
        let mut campaigns = Vec::new();
        for entry in entries {
            let entry = entry.map_err(TrialsError::io("read", &self.root))?;
            let id = entry.file_name().to_string_lossy().into_owned();
            if check_name(&id).is_err() || !entry.path().join(PLAN_FILE).exists() {
                continue;
            }
            campaigns.push(match self.look(&id, State::summary) {
                Ok(summary) => summary,
                Err(err) => broken(id, &err),
            });
        }
        campaigns.sort_by(|a, b| b.created.cmp(&a.created).then_with(|| a.id.cmp(&b.id)));
        Ok(campaigns)
    }

    /// Makes the campaign `id` of `plan`.
    ///
    /// # Errors
    /// A plan that nobody could carry out; a name that is taken.
    pub fn create(&self, id: &str, plan: CampaignPlan, viewer: &Viewer) -> Result<Campaign, TrialsError> {
        check_name(id).map_err(|problem| TrialsError::Argument(format!("campaign {id:?} {problem}")))?;
        check_plan(&plan)?;
        let mut opened = hold(&self.opened);
        let folder = self.root.join(id);
        fs::create_dir_all(&self.root).map_err(TrialsError::io("make", &self.root))?;
        fs::create_dir(&folder).map_err(|err| match err.kind() {
            std::io::ErrorKind::AlreadyExists => {
                TrialsError::Conflict(format!("there is a campaign {id:?} already; choose another name"))
            }
            _ => TrialsError::io("make", &folder)(err),
        })?;
        let file = PlanFile { created: now(), plan };
        let text =
            serde_json::to_string_pretty(&file).map_err(|err| TrialsError::Argument(err.to_string()))?;
        replace_file(&folder.join(PLAN_FILE), &text)?;
        let (log, _) = Log::open(&folder.join(LOG_FILE))?;
        let state = State::new(id.to_owned(), file.created, file.plan);
        let view = state.view(viewer);
        opened.insert(id.to_owned(), Arc::new(Mutex::new(Opened { state, log })));
        Ok(view)
    }

    /// The campaign `id` as `viewer` may see it.
    ///
    /// # Errors
    /// No such campaign; a file that cannot be used.
    pub fn campaign(&self, id: &str, viewer: &Viewer) -> Result<Campaign, TrialsError> {
        self.look(id, |state| state.view(viewer))
    }

    /// The results of campaign `id`. Refused to a scorer who is not to know them yet.
    ///
    /// # Errors
    /// No such campaign; a file that cannot be used; it is blind and not closed.
    pub fn results(&self, id: &str, viewer: &Viewer) -> Result<CampaignResults, TrialsError> {
        results::of(&self.unblinded(id, viewer)?, &self.published)
    }

    /// Every attempt of campaign `id` as comma-separated values. Refused as its results are.
    ///
    /// # Errors
    /// The same.
    pub fn trials_csv(&self, id: &str, viewer: &Viewer) -> Result<String, TrialsError> {
        trials_csv(&self.unblinded(id, viewer)?.view(viewer))
    }

    /// The campaign `id`, unless `viewer` is a scorer who is not to know yet which policy was which.
    fn unblinded(&self, id: &str, viewer: &Viewer) -> Result<State, TrialsError> {
        let state = self.look(id, State::clone)?;
        if state.plan.is_blind && viewer.is_scorer && state.closed.is_none() {
            return Err(TrialsError::Conflict(format!(
                "campaign {id:?} is blind; scorers see its results once it is closed"
            )));
        }
        Ok(state)
    }

    /// The object of `trial` is placed and its rollout begins.
    ///
    /// # Errors
    /// The trial has been made, another one is running, or the campaign is closed.
    pub fn begin(&self, id: &str, trial: u32, viewer: &Viewer) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, |state| state.begin(trial).map(Some))
    }

    /// The rollout of `trial` has ended. Told twice, it is kept once.
    ///
    /// # Errors
    /// Another attempt has begun; it ended otherwise already.
    pub fn end(
        &self,
        id: &str,
        (trial, attempt): (u32, u32),
        outcome: &RolloutOutcome,
        viewer: &Viewer,
    ) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, |state| state.end(trial, attempt, outcome.clone()))
    }

    /// `viewer` gives `trial` a verdict. Given twice, it is kept once.
    ///
    /// # Errors
    /// The trial has not ended, has its scores, or another verdict of theirs.
    pub fn score(
        &self,
        id: &str,
        trial: u32,
        request: &ScoreRequest,
        viewer: &Viewer,
    ) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, |state| state.score(trial, request, &viewer.name))
    }

    /// `viewer` takes their verdict of `trial` back.
    ///
    /// # Errors
    /// They have given none, or it is settled.
    pub fn unscore(
        &self,
        id: &str,
        (trial, attempt): (u32, u32),
        viewer: &Viewer,
    ) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, |state| state.unscore(trial, attempt, &viewer.name).map(Some))
    }

    /// `viewer` decides on a trial on which scorers differ.
    ///
    /// # Errors
    /// They do not differ.
    pub fn settle(
        &self,
        id: &str,
        trial: u32,
        request: &ScoreRequest,
        viewer: &Viewer,
    ) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, |state| state.settle(trial, request, &viewer.name).map(Some))
    }

    /// No trial begins until the campaign is resumed; the one that runs goes on to its end. Asked twice, it is kept once.
    ///
    /// # Errors
    /// It is closed.
    pub fn pause(&self, id: &str, viewer: &Viewer) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, State::pause)
    }

    /// Trials begin again. Asked twice, it is kept once.
    ///
    /// # Errors
    /// It is closed.
    pub fn resume(&self, id: &str, viewer: &Viewer) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, State::resume)
    }

    /// No trial is made any more; a blind campaign is open to everybody from now on.
    ///
    /// # Errors
    /// It is closed.
    pub fn close(&self, id: &str, viewer: &Viewer) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, |state| state.close().map(Some))
    }

    /// Trials go on.
    ///
    /// # Errors
    /// It is open, or was blind.
    pub fn reopen(&self, id: &str, viewer: &Viewer) -> Result<Campaign, TrialsError> {
        self.change(id, viewer, &viewer.name, |state| state.reopen().map(Some))
    }

    /// Adds the change that `decide` wants, if any, to the log, then to what is in memory.
    fn change(
        &self,
        id: &str,
        viewer: &Viewer,
        who: &str,
        decide: impl FnOnce(&State) -> Result<Option<Change>, TrialsError>,
    ) -> Result<Campaign, TrialsError> {
        let opened = self.open(id)?;
        let mut opened = hold(&opened);
        if let Some(change) = decide(&opened.state)? {
            let entry = Entry { time: now(), who: who.to_owned(), change };
            // Tried on a copy first, so that the log holds nothing that cannot be read again.
            let mut after = opened.state.clone();
            after.apply(entry.clone())?;
            opened.log.add(&entry)?;
            opened.state = after;
        }
        Ok(opened.state.view(viewer))
    }

    fn look<T>(&self, id: &str, see: impl FnOnce(&State) -> T) -> Result<T, TrialsError> {
        let opened = self.open(id)?;
        let opened = hold(&opened);
        Ok(see(&opened.state))
    }

    fn open(&self, id: &str) -> Result<Arc<Mutex<Opened>>, TrialsError> {
        check_name(id).map_err(|problem| TrialsError::Argument(format!("campaign {id:?} {problem}")))?;
        let mut opened = hold(&self.opened);
        if let Some(known) = opened.get(id) {
            return Ok(known.clone());
        }
        let folder = self.root.join(id);
        if !folder.join(PLAN_FILE).is_file() {
            return Err(TrialsError::UnknownCampaign(id.to_owned()));
        }
        let mut state = read_plan(&folder, id)?;
        let path = folder.join(LOG_FILE);
        let (log, entries) = Log::open(&path)?;
        replay(&mut state, entries, &path)?;
        let campaign = Arc::new(Mutex::new(Opened { state, log }));
        opened.insert(id.to_owned(), campaign.clone());
        Ok(campaign)
    }
}

/// The results of the campaign in `folder`, read without changing anything, also beside a studio that has it open.
pub fn results_of_folder(
    folder: &Path,
    published: &[PublishedResult],
) -> Result<CampaignResults, TrialsError> {
    results::of(&state_of_folder(folder)?, published)
}

/// The campaign in `folder` as `viewer` may see it, read in the same way.
pub fn campaign_of_folder(folder: &Path, viewer: &Viewer) -> Result<Campaign, TrialsError> {
    Ok(state_of_folder(folder)?.view(viewer))
}

fn state_of_folder(folder: &Path) -> Result<State, TrialsError> {
    let id = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    if !folder.join(PLAN_FILE).is_file() {
        return Err(TrialsError::UnknownCampaign(id));
    }
    let mut state = read_plan(folder, &id)?;
    let path = folder.join(LOG_FILE);
    replay(&mut state, Log::read(&path)?, &path)?;
    Ok(state)
}

fn read_plan(folder: &Path, id: &str) -> Result<State, TrialsError> {
    let path = folder.join(PLAN_FILE);
    let content = |problem: String| TrialsError::Content { path: path.clone(), problem };
    let file: PlanFile = serde_json::from_str(&read_text(&path, MAX_PLAN_BYTES)?)
        .map_err(|err| content(format!("is no plan of a campaign ({err}); restore the file")))?;
    check_plan(&file.plan).map_err(|err| content(err.to_string()))?;
    Ok(State::new(id.to_owned(), file.created, file.plan))
}

fn replay(state: &mut State, entries: Vec<Entry>, path: &Path) -> Result<(), TrialsError> {
    for (entry, line) in entries.into_iter().zip(1..) {
        state.apply(entry).map_err(|err| TrialsError::Content {
            path: path.to_owned(),
            problem: format!("line {line} does not fit what came before ({err}); restore the file"),
        })?;
    }
    Ok(())
}

fn broken(id: String, err: &TrialsError) -> CampaignSummary {
    CampaignSummary {
        name: id.clone(),
        id,
        created: String::new(),
        planned: 0,
        scored: 0,
        to_score: 0,
        paused: None,
        closed: None,
        error: Some(err.to_string()),
    }
}

fn now() -> String {
    format!("{:.3}", Timestamp::now())
}

/// What is behind a mutex whose holders change it whole or not at all, so that it is right even after one panicked.
fn hold<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
