//! Guided recording: the checklist of a calibration session and what can be done with its steps.

use palpate_reports::TakeVerdict;
use serde::{Deserialize, Serialize};

/// Body of `POST /api/v1/recording`: begins a session, or goes on with one that was begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct StartRecording {
    /// Plan: the id of one that the station has.
    pub plan: String,
    /// Id of the session; one that is there is resumed if it has the same plan, and refused otherwise.
    pub session: String,
    /// Who records.
    #[serde(default)]
    pub operator: String,
    /// Leaves the plan's own takes out: only what is [wanted](RecordingDocument::wanted) is recorded.
    #[serde(default)]
    pub only_wanted: bool,
}

/// `GET /api/v1/recording`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RecordingDocument {
    /// Changes whenever anything below does.
    pub revision: u64,
    /// Plans that the live station has.
    pub plans: Vec<PlanSummary>,
    /// What waits for the next session: its checklist ends with it.
    #[serde(default)]
    pub wanted: Vec<WantedTake>,
    /// The session under way, if there is one.
    pub session: Option<RecordingSession>,
    /// The take that is recorded outside guided sessions, or the newest that was.
    #[serde(default)]
    pub free: Option<FreeTake>,
}

/// Body of `POST /api/v1/recording/take`: begins a take outside guided sessions; answered by [`RecordingDocument`].
///
/// Samples of all devices are recorded at their own rates, as in a guided session, whatever moves the robot. Only the operator
/// may begin one. It ends by [`TakeAction::End`], when control is lost, when the armed station stops or holds for
/// longer than a second, and when a device is lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct StartTake {
    /// Id of the session, which is made if there is none. One that follows a plan is refused.
    pub session: String,
    /// Id of the object: one of the station's, or one that `GET /api/v1/objects` lists.
    pub object: String,
    /// Where the object is, from the robot's base: x, y, z, m, then the quaternion, w first.
    pub object_pose: Vec<f64>,
    /// What is done, as a primitive's id.
    #[serde(default = "free_primitive")]
    pub primitive: String,
    /// Whether the object is known to be where it is said to be: a fixture holds it, or poses are sent while it moves.
    #[serde(default)]
    pub fixture_trusted: bool,
    /// Who records; whoever has control, where it is left out.
    #[serde(default)]
    pub operator: String,
    /// What else stands there and can be touched, e.g. the table. It does not move.
    #[serde(default)]
    pub surroundings: Vec<SurroundingBox>,
    /// The client marks the span without touch itself, by [`TakeAction::BeginMark`]. Else it is marked from the begin of the take
    /// to the first target that moves a joint of the hand.
    #[serde(default)]
    pub marks_baseline: bool,
}

/// A box that stands beside the object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SurroundingBox {
    /// Where its middle is, from the robot's base: x, y, z, m, then the quaternion, w first.
    pub pose: Vec<f64>,
    /// Its edges along its own axes, m.
    pub size_m: [f64; 3],
}

fn free_primitive() -> String {
    "free".to_owned()
}

/// Body of `POST /api/v1/recording/take/act`: what the operator does with the take that is recorded outside guided sessions;
/// answered by [`RecordingDocument`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case", tag = "action", deny_unknown_fields)]
pub enum TakeAction {
    /// A span begins now.
    BeginMark {
        /// What it marks.
        kind: MarkKind,
        /// For repetitions: which motion; equal for motions that repeat each other. At most 200 characters.
        #[serde(default)]
        label: String,
    },
    /// The span that began with the same kind and label ends now. What has not ended with the take ends there.
    EndMark {
        /// What it marks.
        kind: MarkKind,
        /// As it began.
        #[serde(default)]
        label: String,
    },
    /// The take is over, and becomes part of the session if it can be read.
    End {
        /// It is set aside instead.
        #[serde(default)]
        set_aside: bool,
    },
}

/// What a span of a take marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum MarkKind {
    /// Nothing touches: what channels read meanwhile is their zero.
    Baseline,
    /// One of several repetitions of the same motion.
    Repetition,
    /// A remark.
    Note,
}

/// A take that is recorded outside guided sessions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FreeTake {
    /// Session that it belongs to.
    pub session: String,
    /// Take id, once it is being written.
    pub take: Option<String>,
    /// Object id.
    pub object: String,
    /// What is done.
    pub primitive: String,
    /// Where it stands.
    pub state: FreeTakeState,
    /// Why it ended early or is not part of the session; empty when all is well.
    pub problem: String,
    /// Its quality check, once it was made.
    pub verdict: Option<TakeVerdict>,
}

/// Where a take stands that is recorded outside guided sessions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FreeTakeState {
    /// Samples are being written.
    Recording,
    /// It is over, and is being checked.
    Checking,
    /// Part of the session.
    Accepted,
    /// In the session's folder of takes that were set aside.
    SetAside,
    /// There is no take that could be read.
    Lost,
}

/// Body of `POST /api/v1/recording/wanted`: a take to record besides those of a plan, e.g. what a diagnosis asks for. It
/// comes last in the checklist of the session under way, or of the next one; `DELETE
/// /api/v1/recording/wanted/{object}/{primitive}` takes it off again as long as it has no take. Both are answered by
/// [`RecordingDocument`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct WantedTake {
    /// Object id.
    pub object: String,
    /// Primitive id. The motion is that of the first take of the station's plans that has both.
    pub primitive: String,
    /// Why it is wanted, as a sentence for the operator.
    #[serde(default)]
    pub because: String,
}

/// A plan of a calibration session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PlanSummary {
    /// Id: the stem of its file.
    pub id: String,
    /// Name for people.
    pub label: String,
    /// Number of takes.
    pub takes: usize,
    /// How long its motions take together, s; longer where limits make the robot slower.
    pub duration_s: f64,
}

/// A plan with its takes, as `GET /api/v1/recording/plans` lists those of the live station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PlanDocument {
    /// Id: the stem of its file.
    pub id: String,
    /// Name for people.
    pub label: String,
    /// Its takes, in order.
    pub takes: Vec<PlanTake>,
}

/// A take of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PlanTake {
    /// Object id.
    pub object: String,
    /// Name of the object.
    pub object_label: String,
    /// Where the object stands, from the robot's base: x, y, z, m.
    pub object_position_m: [f64; 3],
    /// Primitive id.
    pub primitive: String,
    /// Name of the primitive.
    pub primitive_label: String,
    /// What to do with the body before the motion runs; empty where that is to put the object in place.
    pub instruction: String,
    /// Channels that the motion means to touch, by id, once for each touch.
    pub touches: Vec<String>,
    /// How long the motion takes, s; longer where limits make the robot slower.
    pub duration_s: f64,
}

/// A session that is being recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RecordingSession {
    /// Id of the session.
    pub session: String,
    /// Plan it follows.
    pub plan: String,
    /// Who records.
    pub operator: String,
    /// The checklist, in order.
    pub steps: Vec<RecordingStep>,
    /// Index of the step under way; `None` once every step is done.
    pub current: Option<usize>,
    /// What the step under way waits for.
    pub phase: RecordingPhase,
    /// Why the last thing did not work, and what to do; empty when all is well.
    pub problem: String,
    /// Channels that no accepted take has touched, by id.
    pub untouched: Vec<String>,
    /// Whether the last discard can be taken back.
    pub can_undo: bool,
}

/// One take of the checklist.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RecordingStep {
    /// Object id and its name for people.
    pub object: String,
    /// Name of the object.
    pub object_label: String,
    /// Primitive id.
    pub primitive: String,
    /// Name of the primitive.
    pub primitive_label: String,
    /// What to do with the body before the motion runs.
    pub instruction: String,
    /// Where the plan has the object, from the robot's base: x, y, z, m, then the quaternion, w first.
    #[serde(default)]
    pub object_pose: Vec<f64>,
    /// Where the motion starts, a position for each degree of freedom, rad or m.
    #[serde(default)]
    pub start: Vec<f64>,
    /// Channels that the motion means to touch, by id.
    pub touches: Vec<String>,
    /// How long the motion takes, s.
    pub duration_s: f64,
    /// Why it was added to the plan's own takes; absent for those of the plan.
    #[serde(default)]
    pub added_because: Option<String>,
    /// Where it stands.
    pub state: StepState,
    /// Take id once it is recorded.
    pub take: Option<String>,
    /// The quality check of the newest recording of this step.
    pub verdict: Option<TakeVerdict>,
}

/// Where a step stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum StepState {
    /// Nothing recorded.
    Open,
    /// Recorded and checked; neither accepted nor discarded.
    Review,
    /// Accepted: part of the session.
    Accepted,
}

/// What the step under way waits for or does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum RecordingPhase {
    /// The operator confirms object and fixture.
    PlaceObject,
    /// The operator brings the robot to the start pose: [`RecordingAction::GoToStart`], jogging or lead-through.
    StartPose,
    /// The robot moves to the start pose.
    GoingToStart,
    /// Nothing touches: the baseline is captured.
    Baseline,
    /// The countdown runs.
    Countdown,
    /// The motion runs.
    Running,
    /// The take is checked.
    Checking,
    /// The operator accepts, records again or discards.
    Review,
    /// Every step is done.
    Done,
}

/// Body of `POST /api/v1/recording/act`: what the operator does; answered by [`RecordingDocument`].
///
/// Only the operator may act: the request carries the lease in the header [`LEASE_HEADER`](super::LEASE_HEADER). What moves
/// the robot also needs an armed station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case", tag = "action")]
pub enum RecordingAction {
    /// Object and fixture are as the step says.
    ConfirmObject {
        /// Whether the fixture holds the object where the plan says.
        fixture_trusted: bool,
    },
    /// Moves to the start pose of the step.
    GoToStart,
    /// Captures the baseline, counts down and runs the motion.
    Run,
    /// Stops the motion; what was recorded is kept for review.
    Cancel,
    /// The take becomes part of the session.
    Accept,
    /// The take is set aside and the step starts over.
    Again,
    /// The take is set aside and the step is open again.
    Discard,
    /// Takes the last discard back.
    Undo,
    /// Goes to another step.
    Select {
        /// Its index.
        step: usize,
    },
    /// A remark at this moment of the take.
    Note {
        /// The remark; empty for a bare mark.
        text: String,
    },
    /// Leaves the session; what was accepted stays, and it can be resumed.
    Leave,
}
