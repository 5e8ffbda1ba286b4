//! The guided session in the control loop: its checklist, its recorder, its motions.

use std::{
    io,
    sync::{
        Arc,
        mpsc::{Receiver, SyncSender, TryRecvError, sync_channel},
    },
    thread::{self, JoinHandle},
};

use nalgebra::Isometry3;
use palpate_drivers::priority;
use palpate_motion::{MotionLimits, Plan, Primitives, TakeMotion, plan_approach};
use palpate_recording::PlannedStep;
use palpate_robot_model::{JointKind, Station};
use palpate_safety::Lease;
use palpate_wire::{
    api::{PlanSummary, RecordingDocument, WantedTake},
    proto::RecordingStatus,
};

use crate::{
    error::ControlError,
    follow::Follow,
    free::Free,
    guide::{Effect, Guide, GuideJoint, GuidePlan, GuideStep},
    prepare::{AddedStep, Prepared},
    recorder::{Recorder, RecorderConfig},
};

/// From the baseline to the motion, s.
const COUNTDOWN_S: f64 = 3.0;
/// Share of the speed limits that the way to a start pose uses: calm enough to watch and to stop.
const CALM_SHARE: f64 = 0.5;
/// How near to the start pose a joint has to be, rad or m: servos of a hand give way to gravity, arms do not.
const NEAR_HAND: f64 = 0.12;
const NEAR_CARRIER: f64 = 0.02;
const NEAR_CARRIER_M: f64 = 0.002;

/// Objects that may wait to be put in place.
const MAX_PLACED: usize = 16;

/// Puts an object of the station in place where that can be done without a person: on an emulated station.
pub type PlaceObject = Box<dyn Fn(&str) -> Result<(), String> + Send>;

/// The session that is under way, if one is.
pub(crate) struct Guided {
    pub(crate) guide: Option<Guide>,
    /// The take outside guided sessions that is being recorded, or the newest that was.
    pub(crate) free: Option<Free>,
    pub(crate) recorder: Recorder,
    /// The motion that is under way, if one is.
    pub(crate) motion: Option<Follow>,
    station: Arc<Station>,
    plans: Vec<PlanSummary>,
    /// What the next session records besides its plan.
    wanted: Vec<WantedTake>,
    plan: Option<Arc<Plan>>,
    /// The way to a start pose that is being planned, if one is.
    approach: Option<Approach>,
    motions: Vec<Arc<TakeMotion>>,
    /// Added to the guide's revision, so that revisions of sessions that follow one another count up.
    revisions_before: u64,
    placer: Option<Placer>,
    /// The object that was put in place last, and where it stands.
    object: Option<(String, Isometry3<f64>)>,
}

impl Guided {
    /// No session is under way; `plans` are those that there are.
    pub(crate) fn new(
        station: Arc<Station>,
        plans: Vec<PlanSummary>,
        place_object: Option<PlaceObject>,
    ) -> io::Result<Self> {
        let recorder = Recorder::start(Arc::clone(&station), RecorderConfig::default())?;
        let placer = place_object.map(Placer::start).transpose()?;
        Ok(Self {
            guide: None,
            free: None,
            recorder,
            motion: None,
            station,
            plans,
            wanted: Vec::new(),
            plan: None,
            approach: None,
            motions: Vec::new(),
            revisions_before: 1,
            placer,
            object: None,
        })
    }

    /// Begins or resumes a session; what has to be done first comes with it.
    pub(crate) fn begin(&mut self, prepared: Prepared) -> Result<Vec<Effect>, ControlError> {
        self.refuse_second_session()?;
        let guide_plan = guide_plan(&self.station, &prepared)?;
        let recording = prepared.session.recording();
        let steps = recording.steps.clone();
        let (guide, effects) = Guide::new(guide_plan, &prepared.id, recording, &prepared.mended);
        self.recorder.begin(prepared.session);
        self.motions = prepared.motions;
        self.plan = Some(Arc::new(prepared.plan));
        self.guide = Some(guide);
        // They are steps of the session now.
        self.wanted.retain(|wanted| {
            let is_step = |step: &PlannedStep| {
                step.added_because.is_some()
                    && step.object == wanted.object
                    && step.primitive == wanted.primitive
            };
            !steps.iter().any(is_step)
        });
        Ok(effects)
    }

    /// Keeps what is wanted for the next session.
    pub(crate) fn want(&mut self, wanted: WantedTake) -> Result<(), ControlError> {
        if self.guide.is_some() {
            return Err(ControlError::Refused("a session was begun meanwhile; try again".to_owned()));
        }
        self.wanted.push(wanted);
        self.revisions_before += 1;
        Ok(())
    }

    /// Puts a step at the end of the session under way.
    pub(crate) fn add_step(&mut self, added: AddedStep) -> Result<Vec<Effect>, ControlError> {
        let AddedStep { session, plan, motion, because } = added;
        let changed = || ControlError::Refused("the checklist changed meanwhile; try again".to_owned());
        let guide = self.guide.as_mut().ok_or_else(changed)?;
        if guide.session().session != session || plan.takes.len() != self.motions.len() + 1 {
            return Err(changed());
        }
        let take_idx = plan.takes.len() - 1;
        let step = guide_step(&self.station, &plan, take_idx, &motion, Some(because))?;
        let effects = guide.add_step(step).map_err(ControlError::Refused)?;
        self.motions.push(motion);
        self.plan = Some(Arc::new(plan));
        Ok(effects)
    }

    /// What was wanted is not any more: it is taken off the list where it waits, or off the checklist.
    pub(crate) fn unwant(&mut self, object: &str, primitive: &str) -> Result<Vec<Effect>, ControlError> {
        let waiting = self.wanted.len();
        self.wanted.retain(|wanted| wanted.object != object || wanted.primitive != primitive);
        if self.wanted.len() < waiting {
            self.revisions_before += 1;
            let what = format!("{primitive} on {object} is not wanted any more");
            return Ok(vec![Effect::Audit(what)]);
        }
        let Some(guide) = &mut self.guide else {
            return Err(ControlError::Unknown(format!("{primitive} on {object} is not wanted")));
        };
        let (removed, effects) = guide.remove_step(object, primitive).map_err(ControlError::Refused)?;
        self.motions.remove(removed);
        if let Some(plan) = &mut self.plan {
            Arc::make_mut(plan).takes.remove(removed);
        }
        Ok(effects)
    }

    /// Refuses to record anything else while a guided session is under way, or a take outside one is being recorded.
    pub(crate) fn refuse_second_session(&self) -> Result<(), ControlError> {
        if let Some(free) = self.free.as_ref().filter(|free| !free.is_over()) {
            let free = free.view();
            return Err(ControlError::Refused(format!(
                "a take of session {:?} is being recorded outside guided sessions; end it before anything else is begun",
                free.session
            )));
        }
        match &self.guide {
            None => Ok(()),
            Some(guide) => Err(ControlError::Refused(format!(
                "session {:?} is being recorded; leave it before another is begun",
                guide.session().session
            ))),
        }
    }

    /// Lets go of a session that was left.
    pub(crate) fn forget_finished(&mut self) {
        if self.guide.as_ref().is_some_and(Guide::finished)
            && let Some(guide) = self.guide.take()
        {
            self.revisions_before += guide.revision() + 1;
            self.stand_still();
            self.motions.clear();
            self.plan = None;
        }
    }

    /// What pages are told of the checklist.
    pub(crate) fn document(&self) -> RecordingDocument {
        RecordingDocument {
            revision: self.revision(),
            plans: self.plans.clone(),
            wanted: self.wanted.clone(),
            session: self.guide.as_ref().map(Guide::session),
            free: self.free.as_ref().map(Free::view),
        }
    }

    /// What pages are told with every frame.
    pub(crate) fn status(&self, now_ns: u64) -> Option<RecordingStatus> {
        let free = || self.free.as_ref().and_then(|free| free.status(now_ns));
        let mut status = self.guide.as_ref().map(|guide| guide.status(now_ns)).or_else(free)?;
        status.revision = self.revision();
        status.lost_samples = self.recorder.lost_samples();
        status.free_bytes = self.recorder.free_bytes();
        if self.approach.is_some() {
            "looking for a way to the start pose".clone_into(&mut status.activity);
        } else if status.activity.is_empty() && self.motion.is_some() {
            "to the start pose".clone_into(&mut status.activity);
        }
        Some(status)
    }

    fn revision(&self) -> u64 {
        let free = self.free.as_ref().map_or(0, Free::revision);
        self.revisions_before + self.guide.as_ref().map_or(0, Guide::revision) + free
    }

    /// Revisions of a take that is forgotten.
    pub(crate) fn count_revisions(&mut self, revisions: u64) {
        self.revisions_before += revisions;
    }

    /// Shows pages where an object is, if the station knows what it looks like.
    pub(crate) fn show_object(&mut self, (object, base_from_object): (String, Isometry3<f64>)) {
        if self.station.objects.contains_key(&object) {
            self.object = Some((object, base_from_object));
        }
    }

    /// Whether the station moves by itself, or is about to.
    pub(crate) fn moves(&self) -> bool {
        self.guide.as_ref().is_some_and(Guide::moves)
    }

    /// The motion of the step at `step`.
    pub(crate) fn take_motion(&self, step: usize) -> Option<Arc<TakeMotion>> {
        self.motions.get(step).cloned()
    }

    /// Has the way from `from` to the start of the step under way planned, on a thread of its own, or says why not.
    pub(crate) fn plan_approach(&mut self, lease: Lease, from: Vec<f64>) -> Result<(), String> {
        let step = self.guide.as_ref().and_then(|guide| guide.session().current);
        let (Some(step), Some(plan)) = (step, self.plan.clone()) else {
            return Err("no step is under way; select one".to_owned());
        };
        let station = Arc::clone(&self.station);
        let (say, planned) = sync_channel(1);
        let plan_it = move || {
            priority::ordinary();
            let mut limits = MotionLimits::of(&station);
            limits.velocity.iter_mut().for_each(|velocity| *velocity *= CALM_SHARE);
            let way = plan_approach(&station, &plan, &Primitives::new(), step, &from, Some(&limits));
            // Nobody listens if it was cancelled meanwhile.
            let _ = say.send(way.map(Arc::new).map_err(|error| error.problem));
        };
        thread::Builder::new()
            .name("plan-approach".to_owned())
            .spawn(plan_it)
            .map_err(|error| format!("the way to the start pose cannot be planned: {error}"))?;
        self.approach = Some(Approach { lease, planned });
        Ok(())
    }

    /// The way to the start pose that has been planned, or why there is none, once.
    pub(crate) fn approach(&mut self) -> Option<(Lease, Result<Arc<TakeMotion>, String>)> {
        let Approach { lease, planned } = self.approach.as_ref()?;
        let way = match planned.try_recv() {
            Ok(way) => way,
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => {
                Err("the way to the start pose could not be planned; jog there instead".to_owned())
            }
        };
        let lease = *lease;
        self.approach = None;
        Some((lease, way))
    }

    /// No motion goes on, and none begins by itself.
    pub(crate) fn stand_still(&mut self) {
        (self.motion, self.approach) = (None, None);
    }

    /// Has `object` put in place where that needs no person.
    pub(crate) fn place(&mut self, object: &str) {
        let pose = self.plan.as_ref().and_then(|plan| plan.objects.get(object));
        self.object = pose.and_then(|pose| Some((object.to_owned(), pose.to_isometry().ok()?)));
        if let Some(placer) = &self.placer {
            placer.place(object);
        }
    }

    /// Why the last object could not be put in place, once.
    pub(crate) fn misplaced(&self) -> Option<String> {
        self.placer.as_ref().and_then(|placer| placer.problems.try_recv().ok())
    }

    /// The object that was put in place last, and where it stands.
    pub(crate) fn object(&self) -> Option<(&str, Isometry3<f64>)> {
        self.object.as_ref().map(|(object, pose)| (object.as_str(), *pose))
    }
}

/// A way that is being planned.
struct Approach {
    lease: Lease,
    planned: Receiver<Result<Arc<TakeMotion>, String>>,
}

/// Puts objects in place from a thread of its own: an emulated world takes a moment to be built anew.
struct Placer {
    objects: Option<SyncSender<String>>,
    problems: Receiver<String>,
    thread: Option<JoinHandle<()>>,
}

impl Placer {
    fn start(place_object: PlaceObject) -> io::Result<Self> {
        let (objects, wanted) = sync_channel::<String>(MAX_PLACED);
        let (say, problems) = sync_channel(MAX_PLACED);
        let thread = thread::Builder::new().name("place-object".to_owned()).spawn(move || {
            for object in wanted {
                if let Err(problem) = place_object(&object) {
                    // Nobody listens once the control loop has ended.
                    let _ = say.try_send(format!("{object} could not be put in place: {problem}"));
                }
            }
        })?;
        Ok(Self { objects: Some(objects), problems, thread: Some(thread) })
    }

    fn place(&self, object: &str) {
        if let Some(objects) = &self.objects {
            // A thread that is gone has panicked, which was printed. One that is so far behind has newer wishes than this
            // to come to; the operator sees that the object is not there.
            if objects.try_send(object.to_owned()).is_err() {
                tracing::warn!(
                    object,
                    "an object could not be put in place: too many wait, or the thread is gone"
                );
            }
        }
    }
}

impl Drop for Placer {
    fn drop(&mut self) {
        self.objects = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was printed when it happened.
            let _ = thread.join();
        }
    }
}

/// A take of the plan as the guide follows it.
fn guide_step(
    station: &Station,
    plan: &Plan,
    take_idx: usize,
    motion: &TakeMotion,
    added_because: Option<String>,
) -> Result<GuideStep, ControlError> {
    let refused = |problem: String| ControlError::Refused(problem);
    let take = &plan.takes[take_idx];
    let unknown = || refused(format!("{}: object {:?} is not of this station", plan.file, take.object));
    let object = station.objects.get(&take.object).ok_or_else(unknown)?;
    let pose = plan.objects.get(&take.object).ok_or_else(unknown)?;
    let no_others = Primitives::new();
    let primitive =
        plan.primitive(&take.primitive, &no_others).map_err(|error| refused(error.to_string()))?;
    Ok(GuideStep {
        object: take.object.clone(),
        object_label: object.label.clone(),
        base_from_object: pose.to_isometry().map_err(refused)?,
        primitive: take.primitive.clone(),
        primitive_label: primitive.label.clone(),
        instruction: take.instruction.clone(),
        start: motion.start().to_vec(),
        duration_s: motion.duration_s(),
        spans: motion.spans.clone(),
        activities: motion.activities.clone(),
        touches: motion.touches.clone(),
        added_because,
    })
}

/// The plan as the guide follows it.
fn guide_plan(station: &Station, prepared: &Prepared) -> Result<GuidePlan, ControlError> {
    let Prepared { plan, motions, added_because, .. } = prepared;
    let takes = motions.iter().zip(added_because).enumerate();
    let steps = takes
        .map(|(take_idx, (motion, because))| guide_step(station, plan, take_idx, motion, because.clone()));
    let steps = steps.collect::<Result<Vec<_>, _>>()?;
    let joints = station.robot.dofs().enumerate().map(|(dof, joint)| {
        let near = match (station.carrier_dofs.contains(&dof), joint.kind) {
            (true, JointKind::Prismatic) => NEAR_CARRIER_M,
            (true, _) => NEAR_CARRIER,
            (false, _) => NEAR_HAND,
        };
        let unit = if joint.kind == JointKind::Prismatic { "m" } else { "rad" };
        GuideJoint { name: joint.name.clone(), near, unit }
    });
    Ok(GuidePlan {
        id: plan.id.clone(),
        steps,
        joints: joints.collect(),
        channels: station.layout.channels.iter().map(|channel| channel.id.clone()).collect(),
        baseline_s: plan.motion.baseline_s,
        countdown_s: COUNTDOWN_S,
        software: concat!("palpate ", env!("CARGO_PKG_VERSION")).to_owned(),
    })
}
