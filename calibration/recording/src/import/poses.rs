//! Where the object is over time, from columns of numbers.

use nalgebra::Isometry3;
use palpate_robot_model::{PoseConfig, Station};

use super::{assemble::Assembled, report::TakeReport, targets::POSE_NAMES};
use crate::{PoseLog, RecordingError, format::UNIT_TOLERANCE, plausible};

/// What the columns of poses are, in reports.
pub(super) const POSE_WHAT: &str = "object coordinate";

/// base_from_object of every row of `assembled`. Without a quaternion in it the object is turned as `told`. `report`
/// learns what the poses do.
pub(super) fn read(
    station: &Station,
    assembled: &Assembled,
    told: Option<&Isometry3<f64>>,
    report: &mut TakeReport,
) -> Result<Vec<Isometry3<f64>>, RecordingError> {
    let Assembled { path, table, .. } = assembled;
    let width = table.values.len() / table.times_s.len().max(1);
    let mut poses = Vec::with_capacity(table.times_s.len());
    for (row, &line) in table.lines.iter().enumerate() {
        let error = |problem: String| RecordingError::content(path, format!("line {line}"), problem);
        let values = table.row(row, width);
        let [x, y, z, turn @ ..] = values else {
            return Err(error(format!("{width} numbers, expected {} or 3 of them", POSE_NAMES.len())));
        };
        let quaternion_wxyz = match *turn {
            [w, i, j, k] => [w, i, j, k],
            _ => told.map_or([1.0, 0.0, 0.0, 0.0], |pose| PoseConfig::from_isometry(pose).quaternion_wxyz),
        };
        let norm = quaternion_wxyz.iter().map(|number| number * number).sum::<f64>().sqrt();
        if (norm - 1.0).abs() > UNIT_TOLERANCE || norm.is_nan() {
            return Err(error(format!(
                "the quaternion {quaternion_wxyz:?} (qw, qx, qy, qz) has the norm {norm}, expected a unit quaternion; mind \
                 the order of its numbers"
            )));
        }
        let pose = PoseConfig { position_m: [*x, *y, *z], quaternion_wxyz };
        let pose = pose.to_isometry().map_err(error)?;
        if let Some(problem) = plausible::out_of_reach(&station.robot, &pose) {
            return Err(error(problem));
        }
        poses.push(pose);
    }
    note(assembled, &poses, told, report);
    Ok(poses)
}

/// Says what the poses of a moving object do.
fn note(
    assembled: &Assembled,
    poses: &[Isometry3<f64>],
    told: Option<&Isometry3<f64>>,
    report: &mut TakeReport,
) {
    let Some(first) = poses.first() else { return };
    let file = assembled.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let log = PoseLog { times_s: assembled.table.times_s.clone(), poses: poses.to_vec() };
    let (far_m, turned_rad) = log.farthest();
    report.notes.push(format!(
        "the object is where {file} says: {} poses, up to {:.1} mm and {turned_rad:.2} rad from the first",
        poses.len(),
        1e3 * far_m
    ));
    report.notes.extend(assembled.note.clone());
    let apart_m = told.map_or(0.0, |told| (told.translation.vector - first.translation.vector).norm());
    if apart_m > 1e-3 {
        report.warnings.push(format!(
            "object_pose is {:.1} mm from the first pose in {file}, which counts",
            1e3 * apart_m
        ));
    }
}
