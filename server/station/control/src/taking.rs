//! Takes outside guided sessions in the control loop: who may begin one, what is prepared for it, what ends it.

use std::{collections::BTreeMap, fs, path::Path, sync::Arc};

use nalgebra::Isometry3;
use palpate_recording::{
    GrowingSession, PlannedStep, SessionPlan, Take, TakeMeta, TakeState, files::check_name,
};
use palpate_robot_model::{FixedBox, Station};
use palpate_wire::{
    api::{RecordingDocument, StartTake, TakeAction},
    proto::{ObjectPose, Targets},
};

use crate::{
    audit::{Who, rfc3339_now},
    control_loop::ControlLoop,
    error::ControlError,
    free::{Free, FreePlan, Standing, pose_of},
    guide::Effect,
    prepare::with_causes,
    requests::Claim,
};

/// What such sessions follow instead of a plan. A space keeps plans from being called the same.
const PLAN: &str = "free takes";
/// Why its steps are not those of a plan.
const BECAUSE: &str = "recorded outside guided sessions";
/// Who ends takes by itself, in the audit log.
const RECORDER: &str = "recording";
/// Characters of a primitive's id and of an operator's name.
const MAX_NAME_CHARS: usize = 200;
/// Boxes that may stand around an object.
const MAX_BOXES: usize = 64;
/// A joint of the hand that is told to be farther than this from where it is told to be now moves, rad or m.
const MOVES: f64 = 1e-3;

/// An object that a station does not have: the text of its file and the meshes that this names.
#[derive(Clone, Debug, Default)]
pub struct ObjectFiles {
    /// The file.
    pub text: String,
    /// By the name that the file has for each.
    pub meshes: BTreeMap<String, Vec<u8>>,
}

/// Finds the files of an object that the station does not have.
pub type FindObject<'a> = &'a dyn Fn(&str) -> Result<ObjectFiles, ControlError>;

/// A take that can begin.
pub(crate) struct PreparedTake {
    plan: FreePlan,
    session: GrowingSession,
    /// The station with the take's object.
    station: Arc<Station>,
    /// What was found and mended in the session.
    mended: Vec<String>,
}

/// Opens the session for a take. Reads and writes files: not for the control loop's thread.
pub(crate) fn prepare(
    station: &Arc<Station>,
    sessions_dir: &Path,
    start: StartTake,
    find_object: FindObject<'_>,
) -> Result<PreparedTake, ControlError> {
    let refused = ControlError::Refused;
    let StartTake {
        session: id,
        object,
        object_pose,
        primitive,
        fixture_trusted,
        operator,
        surroundings,
        marks_baseline,
    } = start;
    check_name(&id).map_err(|problem| refused(format!("session {id:?} {problem}")))?;
    if primitive.is_empty()
        || [&primitive, &operator].iter().any(|name| name.chars().count() > MAX_NAME_CHARS)
    {
        return Err(refused(format!(
            "a primitive and an operator have names of 1 to {MAX_NAME_CHARS} characters"
        )));
    }
    let base_from_object =
        pose_of_seven(&object_pose).map_err(|problem| refused(format!("object_pose: {problem}")))?;
    if surroundings.len() > MAX_BOXES {
        return Err(refused(format!("surroundings are {} boxes, at most {MAX_BOXES}", surroundings.len())));
    }
    let fixed_box = |(number, fixed): (usize, &palpate_wire::api::SurroundingBox)| {
        let place = |problem: String| refused(format!("surroundings, box {}: {problem}", number + 1));
        let base_from_box = pose_of_seven(&fixed.pose).map_err(place)?;
        let size_m = fixed.size_m;
        if !size_m.iter().all(|edge_m| edge_m.is_finite() && *edge_m > 0.0) {
            return Err(place(format!("size_m is {size_m:?}, expected three edges above 0")));
        }
        Ok(FixedBox { base_from_box, size_m })
    };
    let surroundings = surroundings.iter().enumerate().map(fixed_box).collect::<Result<Vec<_>, _>>()?;
    let station = with_object(station, &object, find_object)?;

    let dir = sessions_dir.join(&id);
    let in_words = |error: palpate_recording::RecordingError| refused(with_causes(&error));
    let mut steps = GrowingSession::steps_of(&dir).map_err(in_words)?.unwrap_or_default();
    steps.push(PlannedStep {
        object: object.clone(),
        primitive: primitive.clone(),
        added_because: Some(BECAUSE.to_owned()),
    });
    let step = steps.len() - 1;
    fs::create_dir_all(sessions_dir).map_err(|source| ControlError::Io {
        action: "make the folder",
        path: sessions_dir.to_owned(),
        source,
    })?;
    let follows = SessionPlan { plan: PLAN.to_owned(), steps };
    let (mut session, mut mended) =
        GrowingSession::open(&dir, &station.id, &follows, &operator, &rfc3339_now()).map_err(in_words)?;
    accept_left(&mut session, &mut mended);
    let meta = TakeMeta {
        object,
        base_from_object,
        primitive,
        fixture_trusted,
        operator,
        software: concat!("palpate ", env!("CARGO_PKG_VERSION")).to_owned(),
        surroundings,
    };
    Ok(PreparedTake { plan: FreePlan { session: id, step, meta, marks_baseline }, session, station, mended })
}

/// Takes that the end of a process left behind become part of the session as any other, if they can be read.
fn accept_left(session: &mut GrowingSession, mended: &mut Vec<String>) {
    let takes = session.recording().takes.iter();
    let left: Vec<String> =
        takes.filter(|take| take.state == TakeState::Review).map(|take| take.id().to_owned()).collect();
    for id in left {
        let read = session.take_path(&id).and_then(|path| Take::read(&path));
        let done = match read {
            Ok(_) => session.accept(&id).map(|()| format!("{id} is part of the session")),
            Err(error) => session
                .set_aside(&id)
                .map(|()| format!("{id} cannot be read, so it is set aside: {}", with_causes(&error))),
        };
        mended.push(done.unwrap_or_else(|error| with_causes(&error)));
    }
}

/// `station`, with `object` where it does not have that.
fn with_object(
    station: &Arc<Station>,
    object: &str,
    find_object: FindObject<'_>,
) -> Result<Arc<Station>, ControlError> {
    if station.objects.contains_key(object) {
        return Ok(Arc::clone(station));
    }
    let ObjectFiles { text, meshes } = find_object(object)?;
    let more = station
        .files
        .with_object(object, &text, &meshes)
        .and_then(|files| Station::from_files(files).map_err(|error| error.to_string()));
    let more = more.map_err(|problem| ControlError::Refused(format!("object {object:?}: {problem}")))?;
    if !more.objects.contains_key(object) {
        return Err(ControlError::Refused(format!(
            "the file of object {object:?} is of an object with another id"
        )));
    }
    Ok(Arc::new(more))
}

fn pose_of_seven(numbers: &[f64]) -> Result<Isometry3<f64>, String> {
    if numbers.len() != 7 {
        return Err(format!(
            "{} numbers, expected seven: x y z, m, then the quaternion, w first",
            numbers.len()
        ));
    }
    pose_of(&numbers[..3], &numbers[3..])
}

impl ControlLoop {
    /// Begins a take outside guided sessions.
    pub(crate) fn begin_take(
        &mut self,
        claim: &Claim,
        prepared: PreparedTake,
    ) -> Result<RecordingDocument, ControlError> {
        let who = self.authorise(claim, "record a take", false)?;
        if let Some((device, problem)) = self.senses.missing().next() {
            return Err(ControlError::Refused(format!(
                "{device} is missing, so that the take would be without it: {problem}"
            )));
        }
        let now_ns = self.clock.now_ns();
        let PreparedTake { mut plan, session, station, mended } = prepared;
        if plan.meta.operator.is_empty() {
            plan.meta.operator.clone_from(&who.name);
        }
        let lease = self.supervisor.status(now_ns).lease.map_or(0, |lease| lease.0);
        let object = (plan.meta.object.clone(), plan.meta.base_from_object);
        let effects = self.guided.begin_take(plan, session, station, lease, now_ns)?;
        self.guided.show_object(object);
        for line in mended {
            self.audit.note_by(now_ns, &Who::part(RECORDER), &line);
        }
        self.record(now_ns, &who, effects);
        Ok(self.guided.document())
    }

    /// What the operator does with it.
    pub(crate) fn act_on_take(
        &mut self,
        claim: &Claim,
        action: &TakeAction,
    ) -> Result<RecordingDocument, ControlError> {
        let who = self.authorise(claim, "record a take", false)?;
        let now_ns = self.clock.now_ns();
        let none = || "no take is being recorded outside guided sessions; begin one first".to_owned();
        let free = self.guided.free.as_mut().ok_or_else(none).map_err(ControlError::Refused)?;
        let effects = free.act(now_ns, action).map_err(ControlError::Refused)?;
        self.record(now_ns, &who, effects);
        Ok(self.guided.document())
    }

    /// Whoever has control says where the object is.
    pub(crate) fn object_is_at(
        &mut self,
        now_ns: u64,
        received_ns: u64,
        pose: &ObjectPose,
    ) -> Result<(), String> {
        let none = || "no take is being recorded outside guided sessions; begin one first".to_owned();
        let free = self.guided.free.as_mut().ok_or_else(none)?;
        let (at_ns, base_from_object) = free.pose(now_ns, received_ns, pose)?;
        let object = free.view().object;
        self.guided.recorder.object_pose(at_ns, base_from_object);
        self.guided.show_object((object, base_from_object));
        Ok(())
    }

    /// Targets were accepted: the first that moves a joint of the hand ends the span without touch.
    pub(crate) fn told(&mut self, now_ns: u64, targets: &Targets) {
        let is_far = |dof: usize, target: f64| {
            self.commanded.get(dof).is_none_or(|commanded| (target - commanded).abs() > MOVES)
        };
        let mut told = targets.dofs.iter().map(|&dof| dof as usize).zip(&targets.positions);
        let moves_hand = self.guided.free.is_some()
            && told.any(|(dof, &target)| !self.station.carrier_dofs.contains(&dof) && is_far(dof, target));
        if moves_hand {
            self.touch_begins(now_ns);
        }
    }

    /// From now on something may be touched.
    pub(crate) fn touch_begins(&mut self, now_ns: u64) {
        if let Some(free) = &mut self.guided.free {
            let effects = free.moved(now_ns);
            self.record(now_ns, &Who::part(RECORDER), effects);
        }
    }

    /// One turn of the take.
    pub(crate) fn tick_take(&mut self, now_ns: u64) {
        let Some(free) = self.guided.free.as_mut().filter(|free| !free.is_over()) else { return };
        let status = self.supervisor.status(now_ns);
        let missing = self.senses.missing().next();
        let effects = match missing {
            Some((device, problem)) => free.stop(now_ns, &format!("{device} is lost: {problem}")),
            None => {
                let lease = status.lease.map_or(0, |lease| lease.0);
                free.tick(now_ns, &Standing { phase: status.phase, lease, reason: &status.reason })
            }
        };
        self.record(now_ns, &Who::part(RECORDER), effects);
    }

    /// The recorder says something while a take outside guided sessions has it.
    pub(crate) fn take_recorded(&mut self, now_ns: u64, event: crate::recorder::RecorderEvent) {
        let effects = self.guided.free.as_mut().map(|free| free.recorder(event)).unwrap_or_default();
        self.record(now_ns, &Who::part(RECORDER), effects);
    }

    fn record(&mut self, now_ns: u64, who: &Who, effects: Vec<Effect>) {
        for effect in effects {
            match effect {
                Effect::Record(command) => self.guided.recorder.command(command),
                Effect::Audit(what) => self.audit.note_by(now_ns, who, &what),
                // A take outside guided sessions moves nothing.
                _ => {}
            }
        }
    }
}

impl crate::guided::Guided {
    /// Begins a take where nothing else is recorded.
    fn begin_take(
        &mut self,
        plan: FreePlan,
        session: GrowingSession,
        station: Arc<Station>,
        lease: u64,
        now_ns: u64,
    ) -> Result<Vec<Effect>, ControlError> {
        self.refuse_second_session()?;
        self.recorder.begin_with(session, station);
        let (free, effects) = Free::begin(plan, lease, now_ns);
        if let Some(before) = self.free.replace(free) {
            self.count_revisions(before.revision() + 1);
        }
        Ok(effects)
    }
}
