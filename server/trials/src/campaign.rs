//! Where a campaign stands: its plan, and everything that its log says applied in order.

use palpate_wire::api::{
    Attempt, Campaign, CampaignPlan, CampaignPolicy, CampaignSummary, RolloutOutcome, ScoreRequest, Trial,
    TrialScore, TrialState, TrialVerdict,
};

use crate::{
    TrialsError,
    log::{Change, Entry},
    plan::{PlannedTrial, start_of, trials_of},
};

/// Longest name of a scorer and longest note, bytes.
const MAX_NAME_BYTES: usize = 120;
const MAX_NOTE_BYTES: usize = 2000;
/// Most reasons of a rollout, and the length of each, bytes.
const MAX_REASONS: usize = 50;
const MAX_REASON_BYTES: usize = 500;

/// Who looks at a campaign.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Viewer {
    /// Their name.
    pub name: String,
    /// They score and are not to know more than a campaign tells scorers.
    pub is_scorer: bool,
}

/// A campaign in memory.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) id: String,
    pub(crate) created: String,
    pub(crate) plan: CampaignPlan,
    pub(crate) planned: Vec<PlannedTrial>,
    /// By number, from 1: the attempts of each trial.
    pub(crate) attempts: Vec<Vec<Attempt>>,
    pub(crate) paused: Option<String>,
    pub(crate) closed: Option<String>,
}

impl State {
    pub(crate) fn new(id: String, created: String, plan: CampaignPlan) -> Self {
        let planned = trials_of(&plan);
        let attempts = vec![Vec::new(); planned.len()];
        Self { id, created, plan, planned, attempts, paused: None, closed: None }
    }

    fn unknown(&self, trial: u32) -> TrialsError {
        TrialsError::UnknownTrial { campaign: self.id.clone(), trial, planned: self.planned.len() as u32 }
    }

    fn attempts(&self, trial: u32) -> Result<&[Attempt], TrialsError> {
        let idx = (trial as usize).checked_sub(1);
        idx.and_then(|idx| self.attempts.get(idx)).map(Vec::as_slice).ok_or_else(|| self.unknown(trial))
    }

    fn state_of(attempts: &[Attempt], scorers: u32) -> TrialState {
        match attempts.last() {
            None => TrialState::Waiting,
            Some(last) if !last.has_ended => TrialState::Running,
            Some(last) if last.verdict.is_some() => TrialState::Scored,
            Some(last) if last.scores.len() < scorers as usize => TrialState::Unscored,
            Some(_) => TrialState::Unsettled,
        }
    }

    fn is_open(&self) -> Result<(), TrialsError> {
        match &self.closed {
            None => Ok(()),
            Some(time) => {
                let text = format!("campaign {:?} was closed at {time}; reopen it to go on", self.id);
                Err(TrialsError::Conflict(text))
            }
        }
    }

    /// The last attempt of `trial`, which must be number `attempt`.
    fn last(&self, trial: u32, attempt: u32) -> Result<&Attempt, TrialsError> {
        let attempts = self.attempts(trial)?;
        match attempts.last() {
            Some(last) if attempts.len() as u32 == attempt + 1 => Ok(last),
            Some(_) => Err(TrialsError::Conflict(format!(
                "trial {trial} is at attempt {}, not {attempt}; look at it again",
                attempts.len() - 1
            ))),
            None => Err(TrialsError::Conflict(format!("trial {trial} has not begun"))),
        }
    }

    /// The change that begins `trial`: its first attempt, or one more after a void one.
    pub(crate) fn begin(&self, trial: u32) -> Result<Change, TrialsError> {
        self.is_open()?;
        if let Some(time) = &self.paused {
            return Err(TrialsError::Conflict(format!(
                "campaign {:?} is paused since {time}; resume it to go on",
                self.id
            )));
        }
        let attempts = self.attempts(trial)?;
        let running =
            self.attempts.iter().position(|attempts| attempts.last().is_some_and(|last| !last.has_ended));
        if let Some(running) = running {
            return Err(TrialsError::Conflict(format!("trial {} is running; end it first", running + 1)));
        }
        match attempts.last() {
            None | Some(Attempt { verdict: Some(TrialVerdict::Void), .. }) => {
                Ok(Change::Begun { trial, attempt: attempts.len() as u32 })
            }
            Some(_) => Err(TrialsError::Conflict(format!(
                "trial {trial} has been made; only one that was scored void is repeated"
            ))),
        }
    }

    /// The change that ends attempt `attempt` of `trial`; `None` if it has ended so already.
    pub(crate) fn end(
        &self,
        trial: u32,
        attempt: u32,
        outcome: RolloutOutcome,
    ) -> Result<Option<Change>, TrialsError> {
        check_outcome(&outcome)?;
        let last = self.last(trial, attempt)?;
        if !last.has_ended {
            return Ok(Some(Change::Ended { trial, attempt, outcome }));
        }
        match last.outcome.as_ref() == Some(&outcome) {
            true => Ok(None),
            false => Err(TrialsError::Conflict(format!(
                "trial {trial} has ended already, and its rollout said otherwise"
            ))),
        }
    }

    /// The change by which `scorer` gives a verdict; `None` if they have given just this one.
    pub(crate) fn score(
        &self,
        trial: u32,
        request: &ScoreRequest,
        scorer: &str,
    ) -> Result<Option<Change>, TrialsError> {
        self.is_open()?;
        let note = checked_texts(scorer, request)?;
        let last = self.last(trial, request.attempt)?;
        if !last.has_ended {
            return Err(TrialsError::Conflict(format!(
                "trial {trial} is running; score it when it has ended"
            )));
        }
        match last.scores.iter().find(|score| score.scorer == scorer) {
            Some(own) if own.verdict == request.verdict && own.note == note => return Ok(None),
            Some(own) => {
                return Err(TrialsError::Conflict(format!(
                    "{scorer} scored trial {trial} as {}; take that back first",
                    own.verdict.label()
                )));
            }
            None => {}
        }
        if last.scores.len() >= self.plan.scorers as usize {
            let by: Vec<&str> = last.scores.iter().map(|score| score.scorer.as_str()).collect();
            let text = format!("trial {trial} has its scores, by {}", by.join(" and "));
            return Err(TrialsError::Conflict(text));
        }
        let attempt = request.attempt;
        Ok(Some(Change::Scored { trial, attempt, verdict: request.verdict, note }))
    }

    /// The change by which `scorer` takes their verdict back.
    pub(crate) fn unscore(&self, trial: u32, attempt: u32, scorer: &str) -> Result<Change, TrialsError> {
        self.is_open()?;
        let last = self.last(trial, attempt)?;
        if last.settled.is_some() {
            return Err(TrialsError::Conflict(format!("trial {trial} is settled")));
        }
        match last.scores.iter().any(|score| score.scorer == scorer) {
            true => Ok(Change::Unscored { trial, attempt }),
            false => Err(TrialsError::Conflict(format!("{scorer} has given no score for trial {trial}"))),
        }
    }

    /// The change that settles a trial on which scorers differ.
    pub(crate) fn settle(&self, trial: u32, request: &ScoreRequest, by: &str) -> Result<Change, TrialsError> {
        self.is_open()?;
        let note = checked_texts(by, request)?;
        self.last(trial, request.attempt)?;
        match Self::state_of(self.attempts(trial)?, self.plan.scorers) {
            TrialState::Unsettled => {
                Ok(Change::Settled { trial, attempt: request.attempt, verdict: request.verdict, note })
            }
            _ => Err(TrialsError::Conflict(format!(
                "scorers do not differ on trial {trial}; nothing to settle"
            ))),
        }
    }

    /// The change that pauses the campaign; `None` if it is paused.
    pub(crate) fn pause(&self) -> Result<Option<Change>, TrialsError> {
        self.is_open().map(|()| self.paused.is_none().then_some(Change::Paused))
    }

    /// The change that goes on with it; `None` if it is not paused.
    pub(crate) fn resume(&self) -> Result<Option<Change>, TrialsError> {
        self.is_open().map(|()| self.paused.is_some().then_some(Change::Resumed))
    }

    /// The change that closes the campaign.
    pub(crate) fn close(&self) -> Result<Change, TrialsError> {
        self.is_open().map(|()| Change::Closed)
    }

    /// The change that reopens it.
    pub(crate) fn reopen(&self) -> Result<Change, TrialsError> {
        if self.closed.is_none() {
            return Err(TrialsError::Conflict(format!("campaign {:?} is open", self.id)));
        }
        if self.plan.is_blind {
            return Err(TrialsError::Conflict(format!(
                "campaign {:?} was blind, and since it was closed everybody may know which policy was which; make a new one",
                self.id
            )));
        }
        Ok(Change::Reopened)
    }

    /// Applies what the log says; refuses what cannot have happened.
    pub(crate) fn apply(&mut self, entry: Entry) -> Result<(), TrialsError> {
        let Entry { time, who, change } = entry;
        let score = |verdict, note| TrialScore { scorer: who.clone(), time: time.clone(), verdict, note };
        match change {
            Change::Begun { trial, attempt } => {
                if self.begin(trial)? != (Change::Begun { trial, attempt }) {
                    return Err(TrialsError::Conflict(format!(
                        "trial {trial} cannot be at attempt {attempt}"
                    )));
                }
                let idx = trial as usize - 1;
                self.attempts[idx].push(Attempt {
                    began: time,
                    by: who,
                    outcome: None,
                    take: None,
                    has_ended: false,
                    scores: Vec::new(),
                    settled: None,
                    verdict: None,
                });
            }
            Change::Ended { trial, attempt, outcome } => {
                let last = self.last_mut(trial, attempt)?;
                last.take = outcome.take.clone();
                last.outcome = Some(outcome);
                last.has_ended = true;
            }
            Change::Scored { trial, attempt, verdict, note } => {
                let score = score(verdict, note);
                self.last_mut(trial, attempt)?.scores.push(score);
                self.decide(trial);
            }
            Change::Unscored { trial, attempt } => {
                self.last_mut(trial, attempt)?.scores.retain(|score| score.scorer != who);
                self.decide(trial);
            }
            Change::Settled { trial, attempt, verdict, note } => {
                let score = score(verdict, note);
                self.last_mut(trial, attempt)?.settled = Some(score);
                self.decide(trial);
            }
            Change::Paused => self.paused = Some(time),
            Change::Resumed => self.paused = None,
            Change::Closed => self.closed = Some(time),
            Change::Reopened => self.closed = None,
        }
        Ok(())
    }

    fn last_mut(&mut self, trial: u32, attempt: u32) -> Result<&mut Attempt, TrialsError> {
        self.last(trial, attempt)?;
        let unknown = self.unknown(trial);
        self.attempts.get_mut(trial as usize - 1).and_then(|attempts| attempts.last_mut()).ok_or(unknown)
    }

    /// Finds the verdict that counts for the last attempt of `trial`.
    fn decide(&mut self, trial: u32) {
        let scorers = self.plan.scorers as usize;
        let Some(last) = self.attempts.get_mut(trial as usize - 1).and_then(|attempts| attempts.last_mut())
        else {
            return;
        };
        let first = last.scores.first().map(|score| score.verdict);
        let agree =
            last.scores.len() >= scorers && last.scores.iter().all(|score| Some(score.verdict) == first);
        last.verdict = last.settled.as_ref().map(|score| score.verdict).or(first.filter(|_| agree));
    }

    pub(crate) fn summary(&self) -> CampaignSummary {
        let count = |wanted: &[TrialState]| {
            let states = self.attempts.iter().map(|attempts| Self::state_of(attempts, self.plan.scorers));
            states.filter(|state| wanted.contains(state)).count() as u32
        };
        CampaignSummary {
            id: self.id.clone(),
            name: self.plan.name.clone(),
            created: self.created.clone(),
            planned: self.planned.len() as u32,
            scored: count(&[TrialState::Scored]),
            to_score: count(&[TrialState::Unscored, TrialState::Unsettled]),
            paused: self.paused.clone(),
            closed: self.closed.clone(),
            error: None,
        }
    }

    /// The campaign as `viewer` may see it.
    pub(crate) fn view(&self, viewer: &Viewer) -> Campaign {
        let is_blind = self.plan.is_blind && viewer.is_scorer && self.closed.is_none();
        let mut plan = self.plan.clone();
        if is_blind {
            // Order and starts follow from the seed, so it would tell which policy is tried when.
            plan.seed = 0;
            // A name may say what to expect.
            for (policy, number) in plan.policies.iter_mut().zip(1..) {
                *policy = CampaignPolicy {
                    id: format!("policy {number}"),
                    source: String::new(),
                    is_silenced: false,
                };
            }
        }
        let trials: Vec<Trial> = self
            .planned
            .iter()
            .zip(&self.attempts)
            .zip(1..)
            .map(|((planned, attempts), number)| {
                let state = Self::state_of(attempts, self.plan.scorers);
                let mut attempts = attempts.clone();
                let mut start = start_of(&self.plan, planned.object, planned.start);
                if is_blind {
                    attempts.iter_mut().for_each(|attempt| hide(attempt, &viewer.name));
                    start.seed = 0;
                }
                let policy = (!is_blind).then(|| self.plan.policies[planned.policy].id.clone());
                let object = self.plan.objects[planned.object].id.clone();
                Trial { number, policy, object, start_number: planned.start + 1, start, state, attempts }
            })
            .collect();
        let is_next = |trial: &&Trial| matches!(trial.state, TrialState::Waiting | TrialState::Running);
        let waits_for = |trial: &&Trial| {
            let last = trial.attempts.last();
            let has_own =
                last.is_some_and(|last| last.scores.iter().any(|score| score.scorer == viewer.name));
            trial.state == TrialState::Unscored && !has_own
        };
        let number = |trial: &Trial| trial.number;
        let is_closed = self.closed.is_some();
        Campaign {
            summary: self.summary(),
            plan,
            next: trials.iter().find(is_next).map(number).filter(|_| !is_closed),
            next_to_score: trials.iter().find(waits_for).map(number).filter(|_| !is_closed),
            trials,
        }
    }
}

/// Leaves of an attempt what a blind scorer may see: that it ended, its take, and what they said themselves.
fn hide(attempt: &mut Attempt, scorer: &str) {
    attempt.outcome = None;
    attempt.scores.retain(|score| score.scorer == scorer);
    attempt.settled = None;
    attempt.verdict = None;
}

/// The note of `request`, without blanks around it; refused if it or `who` cannot be kept.
fn checked_texts(who: &str, request: &ScoreRequest) -> Result<String, TrialsError> {
    if who.trim().is_empty() || who.len() > MAX_NAME_BYTES || who.chars().any(char::is_control) {
        return Err(TrialsError::Argument(format!(
            "scorer {who:?} is no name; expected a text of 1 to {MAX_NAME_BYTES} bytes"
        )));
    }
    let note = request.note.trim();
    if note.len() > MAX_NOTE_BYTES {
        return Err(TrialsError::Argument(format!(
            "note is too long; expected at most {MAX_NOTE_BYTES} bytes"
        )));
    }
    Ok(note.to_owned())
}

fn check_outcome(outcome: &RolloutOutcome) -> Result<(), TrialsError> {
    for (field, value) in [("time_to_grasp_s", outcome.time_to_grasp_s), ("held_s", outcome.held_s)] {
        if let Some(value) = value.filter(|value| !(value.is_finite() && *value >= 0.0)) {
            return Err(TrialsError::Argument(format!("{field} is {value}, expected a time of 0 s or more")));
        }
    }
    if outcome.reasons.len() > MAX_REASONS || outcome.reasons.iter().any(|text| text.len() > MAX_REASON_BYTES)
    {
        return Err(TrialsError::Argument(format!(
            "reasons are too many or too long; expected at most {MAX_REASONS} texts of {MAX_REASON_BYTES} bytes"
        )));
    }
    if outcome.take.as_ref().is_some_and(|take| take.len() > MAX_REASON_BYTES) {
        return Err(TrialsError::Argument("take is too long; expected session/take".to_owned()));
    }
    if outcome.record.as_ref().is_some_and(|record| record.len() > MAX_REASON_BYTES) {
        return Err(TrialsError::Argument(format!(
            "record is too long; expected a path of at most {MAX_REASON_BYTES} bytes"
        )));
    }
    Ok(())
}
