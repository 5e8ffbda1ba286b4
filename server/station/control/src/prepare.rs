//! What a guided session needs before it can begin: its plan, its motions, its folder.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use palpate_motion::{MotionLimits, Plan, PlanError, Primitives, TakeMotion, channel_named, plan_take};
use palpate_recording::{GrowingSession, PlannedStep, SessionPlan, files::check_name};
use palpate_robot_model::Station;
use palpate_wire::api::{PlanDocument, PlanSummary, PlanTake, RecordingSession, StartRecording, WantedTake};

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
    /// The plan, and behind its own takes those that were added.
    pub(crate) plan: Plan,
    /// Why each take was added; `None` for the plan's own.
    pub(crate) added_because: Vec<Option<String>>,
    /// One a take of the plan.
    pub(crate) motions: Vec<Arc<TakeMotion>>,
    /// Id of the session.
    pub(crate) id: String,
    pub(crate) operator: String,
    pub(crate) session: GrowingSession,
    /// What was found and mended in a session that is gone on with.
    pub(crate) mended: Vec<String>,
}

/// A step for the session that is under way.
#[derive(Debug)]
pub(crate) struct AddedStep {
    /// Id of the session that it was prepared for.
    pub(crate) session: String,
    /// The plan of the session, whose last take it is.
    pub(crate) plan: Plan,
    pub(crate) motion: Arc<TakeMotion>,
    pub(crate) because: String,
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

    /// Folder of the sessions that are recorded.
    pub(crate) fn sessions_dir(&self) -> &Path {
        &self.sessions_dir
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

    /// The plans with their takes.
    pub(crate) fn documents(&self) -> Result<Vec<PlanDocument>, ControlError> {
        self.plans.iter().map(|plan| self.document(plan)).collect()
    }

    fn document(&self, plan: &Plan) -> Result<PlanDocument, ControlError> {
        let refused = |problem: String| ControlError::Refused(format!("{}: {problem}", plan.file));
        let channels = &self.station.layout.channels;
        let takes = plan.takes.iter().map(|take| {
            let of_plan = || refused(format!("object {:?} is not of this station", take.object));
            let object = self.station.objects.get(&take.object).ok_or_else(of_plan)?;
            let pose = plan.objects.get(&take.object).ok_or_else(of_plan)?.to_isometry().map_err(refused)?;
            let no_others = Primitives::new();
            let primitive =
                plan.primitive(&take.primitive, &no_others).map_err(|error| refused(error.to_string()))?;
            let touches = take.touch.iter().filter_map(|touch| channel_named(&self.station, touch));
            Ok(PlanTake {
                object: take.object.clone(),
                object_label: object.label.clone(),
                object_position_m: pose.translation.vector.into(),
                primitive: take.primitive.clone(),
                primitive_label: primitive.label.clone(),
                instruction: take.instruction.clone(),
                touches: touches.map(|channel| channels[channel].id.clone()).collect(),
                duration_s: take.duration_s,
            })
        });
        let takes = takes.collect::<Result<_, ControlError>>()?;
        Ok(PlanDocument { id: plan.id.clone(), label: plan.label.clone(), takes })
    }

    /// Plans the motions and opens the folder. Takes seconds the first time: not for the control loop's thread.
    /// What is `wanted` comes behind what the session has.
    pub(crate) fn prepare(
        &self,
        start: StartRecording,
        wanted: &[WantedTake],
    ) -> Result<Prepared, ControlError> {
        let StartRecording { plan: plan_id, session: id, operator, only_wanted } = start;
        let plan_idx = self.plan_idx(&plan_id)?;
        // Ids are names of folders: nothing that leads elsewhere.
        check_name(&id).map_err(|problem| ControlError::Refused(format!("session {id:?} {problem}")))?;
        let dir = self.sessions_dir.join(&id);
        let known =
            GrowingSession::steps_of(&dir).map_err(|error| ControlError::Refused(with_causes(&error)))?;
        if only_wanted && known.is_none() && wanted.is_empty() {
            return Err(ControlError::Refused(
                "nothing is wanted that could be recorded by itself; ask for a take first, or record by a plan".to_owned(),
            ));
        }
        let own = known.as_ref().map_or(!only_wanted, |steps| {
            steps.is_empty() || steps.iter().any(|step| step.added_because.is_none())
        });
        let mut added: Vec<WantedTake> = known.into_iter().flatten().filter_map(as_wanted).collect();
        added.extend_from_slice(wanted);
        let plan = self.checklist(plan_idx, own, &added)?;
        let refused = |error: PlanError| ControlError::Refused(error.to_string());
        let mut motions = if own { self.motions(plan_idx).map_err(refused)? } else { Motions::new() };
        for take_idx in motions.len()..plan.takes.len() {
            motions.push(self.motion(&plan, take_idx)?);
        }
        let own_takes = plan.takes.len() - added.len();
        let added_because: Vec<Option<String>> = std::iter::repeat_n(None, own_takes)
            .chain(added.into_iter().map(|wanted| Some(wanted.because)))
            .collect();
        let steps = plan.takes.iter().zip(&added_because).map(|(take, because)| PlannedStep {
            object: take.object.clone(),
            primitive: take.primitive.clone(),
            added_because: because.clone(),
        });
        let follows = SessionPlan { plan: plan.id.clone(), steps: steps.collect() };
        fs::create_dir_all(&self.sessions_dir).map_err(|source| ControlError::Io {
            action: "make the folder",
            path: self.sessions_dir.clone(),
            source,
        })?;
        let (session, mended) =
            GrowingSession::open(&dir, &self.station.id, &follows, &operator, &rfc3339_now())
                .map_err(|error| ControlError::Refused(with_causes(&error)))?;
        Ok(Prepared { plan, added_because, motions, id, operator, session, mended })
    }

    /// Whether some plan has the motion that is wanted; says what there is otherwise.
    pub(crate) fn check_wanted(&self, wanted: &WantedTake) -> Result<(), ControlError> {
        self.find(0, wanted).map(|_| ())
    }

    /// Plans the motion of what is wanted as the last step of the session under way. Takes a moment: not for the control
    /// loop's thread.
    pub(crate) fn add_step(
        &self,
        session: &RecordingSession,
        wanted: WantedTake,
    ) -> Result<AddedStep, ControlError> {
        let plan_idx = self.plan_idx(&session.plan)?;
        let own = session.steps.iter().any(|step| step.added_because.is_none());
        let before = session.steps.iter().filter_map(|step| {
            let because = step.added_because.clone()?;
            Some(WantedTake { object: step.object.clone(), primitive: step.primitive.clone(), because })
        });
        let because = wanted.because.clone();
        let added: Vec<WantedTake> = before.chain([wanted]).collect();
        let plan = self.checklist(plan_idx, own, &added)?;
        let motion = self.motion(&plan, plan.takes.len() - 1)?;
        Ok(AddedStep { session: session.session.clone(), plan, motion, because })
    }

    fn plan_idx(&self, plan_id: &str) -> Result<usize, ControlError> {
        self.plans.iter().position(|plan| plan.id == plan_id).ok_or_else(|| {
            let known: Vec<&str> = self.plans.iter().map(|plan| plan.id.as_str()).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            ControlError::Unknown(format!(
                "the station has no plan {plan_id:?}; it has {known}, as its station file says"
            ))
        })
    }

    /// The plan at `plan_idx`, with or without its own takes, and behind them what was `added`. Objects stand where this
    /// plan has them, and move as it says, whichever plan has the added motion.
    fn checklist(&self, plan_idx: usize, own: bool, added: &[WantedTake]) -> Result<Plan, ControlError> {
        let mut plan = self.plans[plan_idx].clone();
        if !own {
            plan.takes.clear();
        }
        for wanted in added {
            let (from, take_idx) = self.find(plan_idx, wanted)?;
            let take = &from.takes[take_idx];
            if let Some(pose) = from.objects.get(&take.object) {
                plan.objects.entry(take.object.clone()).or_insert(*pose);
            }
            if let Some(primitive) = from.primitives.get(&take.primitive) {
                plan.primitives.entry(take.primitive.clone()).or_insert_with(|| primitive.clone());
            }
            plan.takes.push(take.clone());
        }
        Ok(plan)
    }

    /// The first take with the wanted motion on the wanted object: of the plan at `first`, or else of another.
    fn find(&self, first: usize, wanted: &WantedTake) -> Result<(&Plan, usize), ControlError> {
        let fits = |take: &palpate_motion::PlannedTake| {
            take.object == wanted.object && take.primitive == wanted.primitive
        };
        let plans = self.plans.get(first).into_iter().chain(&self.plans);
        let mut found = plans.filter_map(|plan| Some((plan, plan.takes.iter().position(fits)?)));
        found.next().ok_or_else(|| {
            ControlError::Unknown(format!(
                "no plan of this station has {} on {}; add such a [[take]] to one of its plans",
                wanted.primitive, wanted.object
            ))
        })
    }

    fn motion(&self, plan: &Plan, take_idx: usize) -> Result<Arc<TakeMotion>, ControlError> {
        let limits = MotionLimits::of(&self.station);
        let motion = plan_take(&self.station, plan, &Primitives::new(), take_idx, Some(&limits));
        motion.map(Arc::new).map_err(|error| ControlError::Refused(error.to_string()))
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

/// What was wanted, of a step that was added.
fn as_wanted(step: PlannedStep) -> Option<WantedTake> {
    let PlannedStep { object, primitive, added_because } = step;
    added_because.map(|because| WantedTake { object, primitive, because })
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
