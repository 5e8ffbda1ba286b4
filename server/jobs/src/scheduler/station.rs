//! Jobs on the station: they move the robot, so each begins when somebody has just asked for it, or not at all.

use palpate_wire::api::{Job, JobState};

use super::{Shared, lock};
use crate::{JobsError, runner::Launch};

/// Why one that was cut off has failed.
pub(super) const CUT_OFF: &str = "it was cut off; try it again when the robot may move";
/// Why one that nobody has just asked for has failed.
pub(super) const NOT_WANTED: &str =
    "the studio was started again since somebody asked for it; try it again when the robot may move";

impl Shared {
    /// Refuses a further job: it would begin at a time that nobody chose.
    pub(super) fn refuse_second_on_station(&self) -> Result<(), JobsError> {
        for state in [JobState::Queued, JobState::Running] {
            let rows = self.config.database.in_state(state)?;
            if let Some(row) = rows.iter().find(|row| row.job.spec.resources.station) {
                return Err(JobsError::Conflict(format!(
                    "job {:?} has the station; wait until it has ended, or cancel it",
                    row.job.id
                )));
            }
        }
        Ok(())
    }

    /// Notes that somebody wants `job` now, if it is on the station.
    pub(super) fn note_wanted(&self, job: &Job) {
        if job.spec.resources.station {
            lock(&self.wanted).insert(job.id.clone());
        }
    }

    /// Whether `launch` may begin now: others than those on the station always may.
    pub(super) fn is_wanted_now(&self, launch: &Launch) -> bool {
        !launch.resources.station || lock(&self.wanted).remove(&launch.id)
    }
}
