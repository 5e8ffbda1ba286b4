//! What a guided session needs before it can begin: its plan, its motions, its folder.

use std::{
    fs,
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use palpate_motion::{MotionLimits, Plan, PlanError, Primitives, TakeMotion, plan_take};
use palpate_recording::{GrowingSession, PlannedStep, SessionPlan};
use palpate_robot_model::Station;
use palpate_wire::api::{PlanSummary, StartRecording};

use crate::{audit::rfc3339_now, error::ControlError};

/// The plans of a station, and where sessions are kept.
#[derive(Debug)]
pub(crate) struct Plans {
    station: Arc<Station>,
    plans: Vec<Plan>,
    sessions_dir: PathBuf,
    /// Motions that were planned before, by plan: planning takes seconds, and the same plan gives the same motions.
    planned: Mutex<Vec<(usize, Motions)>>,
}

/// One a take of the plan.
type Motions = Vec<Arc<TakeMotion>>;

/// A session that is ready to be recorded.
pub(crate) struct Prepared {
    pub(crate) plan: Plan,
    /// One a take of the plan.
    pub(crate) motions: Vec<Arc<TakeMotion>>,
    /// Id of the session.
    pub(crate) id: String,
    pub(crate) operator: String,
    pub(crate) session: GrowingSession,
    /// What was found and mended in a session that is gone on with.
    pub(crate) mended: Vec<String>,
}

impl std::fmt::Debug for Prepared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Prepared").field("plan", &self.plan.id).field("id", &self.id).finish_non_exhaustive()
    }
}

impl Plans {
    /// The plans of `station`, each checked against it.
    pub(crate) fn new(station: Arc<Station>, sessions_dir: PathBuf) -> Result<Self, PlanError> {
        let mut plans = Vec::with_capacity(station.plans.len());
        for (id, text) in &station.plans {
            let plan = Plan::from_text(&format!("{id}.toml"), text)?;
            plan.check(&station)?;
            plans.push(plan);
        }
        Ok(Self { station, plans, sessions_dir, planned: Mutex::default() })
    }

    /// What pages list.
    pub(crate) fn summaries(&self) -> Vec<PlanSummary> {
        let summary = |plan: &Plan| PlanSummary {
            id: plan.id.clone(),
            label: plan.label.clone(),
            takes: plan.takes.len(),
            duration_s: plan.takes.iter().map(|take| take.duration_s).sum(),
        };
        self.plans.iter().map(summary).collect()
    }

    /// Plans the motions and opens the folder. Takes seconds the first time: not for the control loop's thread.
    pub(crate) fn prepare(&self, start: StartRecording) -> Result<Prepared, ControlError> {
        let StartRecording { plan: plan_id, session: id, operator } = start;
        let Some(plan_idx) = self.plans.iter().position(|plan| plan.id == plan_id) else {
            let known: Vec<&str> = self.plans.iter().map(|plan| plan.id.as_str()).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            return Err(ControlError::Unknown(format!(
                "the station has no plan {plan_id:?}; it has {known}, as its station file says"
            )));
        };
        check_session_id(&id)?;
        let plan = &self.plans[plan_idx];
        let motions = self.motions(plan_idx).map_err(|error| ControlError::Refused(error.to_string()))?;
        let steps = plan
            .takes
            .iter()
            .map(|take| PlannedStep { object: take.object.clone(), primitive: take.primitive.clone() });
        let follows = SessionPlan { plan: plan.id.clone(), steps: steps.collect() };
        fs::create_dir_all(&self.sessions_dir).map_err(|source| ControlError::Io {
            action: "make the folder",
            path: self.sessions_dir.clone(),
            source,
        })?;
        let dir = self.sessions_dir.join(&id);
        let (session, mended) =
            GrowingSession::open(&dir, &self.station.id, &follows, &operator, &rfc3339_now())
                .map_err(|error| ControlError::Refused(with_causes(&error)))?;
        Ok(Prepared { plan: plan.clone(), motions, id, operator, session, mended })
    }

    fn motions(&self, plan_idx: usize) -> Result<Motions, PlanError> {
        let lock = || self.planned.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, motions)) = lock().iter().find(|(idx, _)| *idx == plan_idx) {
            return Ok(motions.clone());
        }
        let motions = plan_all(&self.station, &self.plans[plan_idx])?;
        lock().push((plan_idx, motions.clone()));
        Ok(motions)
    }
}

/// Every take of the plan as the station may move it, on as many threads as leave the control loop a core.
fn plan_all(station: &Station, plan: &Plan) -> Result<Motions, PlanError> {
    let limits = MotionLimits::of(station);
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let planned = Mutex::new((0..plan.takes.len()).map(|_| None).collect::<Vec<_>>());
    let work = || {
        loop {
            let take_idx = next.fetch_add(1, Ordering::Relaxed);
            if take_idx >= plan.takes.len() {
                return;
            }
            let motion = plan_take(station, plan, &Primitives::new(), take_idx, Some(&limits));
            planned.lock().unwrap_or_else(PoisonError::into_inner)[take_idx] = Some(motion.map(Arc::new));
        }
    };
    thread::scope(|scope| {
        for _ in 2..cores.min(plan.takes.len()) {
            scope.spawn(work);
        }
        work();
    });
    planned.into_inner().unwrap_or_else(PoisonError::into_inner).into_iter().flatten().collect()
}

/// Ids are names of folders: nothing that leads elsewhere.
fn check_session_id(id: &str) -> Result<(), ControlError> {
    let known = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let fits = !id.is_empty() && id.len() <= 80 && !id.starts_with('.') && id.chars().all(known);
    if fits {
        return Ok(());
    }
    Err(ControlError::Refused(format!(
        "{id:?} cannot be the id of a session; use up to 80 letters, digits, '-', '_' and '.', not starting with '.'"
    )))
}

/// An error with everything that led to it.
pub(crate) fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}
