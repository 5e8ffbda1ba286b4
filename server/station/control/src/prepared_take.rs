//! What is prepared for a take outside guided sessions before it can begin.

use std::{collections::BTreeMap, fs, path::Path, sync::Arc};

use nalgebra::Isometry3;
use palpate_recording::{
    GrowingSession, PlannedStep, SessionPlan, Take, TakeMeta, TakeState, files::check_name,
};
use palpate_robot_model::{FixedBox, Station};
use palpate_wire::api::StartTake;

use crate::{
    audit::rfc3339_now,
    error::ControlError,
    free::{FreePlan, pose_of},
    prepare::with_causes,
};

/// What such sessions follow instead of a plan. A space keeps plans from being called the same.
const PLAN: &str = "free takes";
/// Why its steps are not those of a plan.
const BECAUSE: &str = "recorded outside guided sessions";
/// Characters of a primitive's id and of an operator's name.
const MAX_NAME_CHARS: usize = 200;
/// Boxes that may stand around an object.
const MAX_BOXES: usize = 64;

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
    pub(crate) plan: FreePlan,
    pub(crate) session: GrowingSession,
    /// The station with the take's object.
    pub(crate) station: Arc<Station>,
    /// What was found and mended in the session.
    pub(crate) mended: Vec<String>,
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
