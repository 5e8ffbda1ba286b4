//! What writer and reader agree on: topics, schema names, metadata keys, times.

use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion};
use palpate_robot_model::FixedBox;
use prost_types::Timestamp;

/// Version of the take format, as in the metadata.
pub(crate) const FORMAT: u32 = 1;

pub(crate) const PROTOBUF: &str = "protobuf";
pub(crate) const JOINT_STATES_TOPIC: &str = "/joint_states";
pub(crate) const JOINT_COMMANDS_TOPIC: &str = "/joint_commands";
pub(crate) const TACTILE_TOPIC_PREFIX: &str = "/tactile/";
pub(crate) const AXES_TOPIC_PREFIX: &str = "/tactile_axes/";
pub(crate) const OBJECT_POSE_TOPIC: &str = "/object_pose";
pub(crate) const MARKERS_TOPIC: &str = "/markers";
pub(crate) const LOG_TOPIC: &str = "/log";

pub(crate) const JOINT_STATES_SCHEMA: &str = "foxglove.JointStates";
pub(crate) const TACTILE_SCHEMA: &str = "palpate.TactileSample";
pub(crate) const AXES_SCHEMA: &str = "palpate.TactileAxes";
pub(crate) const MARKER_SCHEMA: &str = "palpate.Marker";
pub(crate) const POSE_SCHEMA: &str = "foxglove.PoseInFrame";
pub(crate) const LOG_SCHEMA: &str = "foxglove.Log";

/// How far the norm of a rotation in a message may be from 1: that of quaternions written in single precision, with room.
/// Beyond that, numbers are in another order or in another unit.
pub(crate) const UNIT_TOLERANCE: f64 = 1e-3;

/// Name of the metadata record.
pub(crate) const TAKE_METADATA: &str = "palpate.take";
/// Name of the attachment that holds the station file; the files it names are attached under the names it uses.
pub(crate) const STATION_ATTACHMENT: &str = "station.toml";

/// Topic of the stream called `stream`.
pub(crate) fn tactile_topic(stream: &str) -> String {
    format!("{TACTILE_TOPIC_PREFIX}{stream}")
}

/// Topic of what the axes of the stream called `stream` measured.
pub(crate) fn axes_topic(stream: &str) -> String {
    format!("{AXES_TOPIC_PREFIX}{stream}")
}

const NANOS_PER_SEC: u64 = 1_000_000_000;

/// Seconds as f64 of a time in ns.
pub(crate) fn secs_from_ns(time_ns: u64) -> f64 {
    // Dividing, unlike multiplying by 1e-9, gives the double next to the true value.
    time_ns as f64 / NANOS_PER_SEC as f64
}

/// ns of a time in seconds; `None` if negative, not finite, or past the range.
pub(crate) fn ns_from_secs(time_s: f64) -> Option<u64> {
    let time_ns = (time_s * NANOS_PER_SEC as f64).round();
    (time_ns >= 0.0 && time_ns < u64::MAX as f64).then_some(time_ns as u64)
}

/// A wall-clock time as protobuf has it.
pub(crate) fn timestamp_from_ns(unix_ns: u64) -> Timestamp {
    Timestamp { seconds: (unix_ns / NANOS_PER_SEC) as i64, nanos: (unix_ns % NANOS_PER_SEC) as i32 }
}

/// The inverse of [`timestamp_from_ns`]; `None` before 1970 or out of range.
pub(crate) fn ns_from_timestamp(timestamp: &Timestamp) -> Option<u64> {
    let seconds = u64::try_from(timestamp.seconds).ok()?;
    let nanos = u64::try_from(timestamp.nanos).ok().filter(|&nanos| nanos < NANOS_PER_SEC)?;
    seconds.checked_mul(NANOS_PER_SEC)?.checked_add(nanos)
}

/// Numbers as text that reads back to the same bits.
pub(crate) fn join_numbers(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

/// The inverse of [`join_numbers`].
pub(crate) fn split_numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().ok()).collect::<Option<_>>()?;
    numbers.try_into().ok().filter(|numbers: &[f64; N]| numbers.iter().all(|number| number.is_finite()))
}

/// Boxes as text: ten numbers each (position, quaternion, edges), semicolons between them.
pub(crate) fn join_boxes(boxes: &[FixedBox]) -> String {
    let numbers = boxes.iter().map(|fixed| {
        let (position_m, quaternion_wxyz) = pose_numbers(&fixed.base_from_box);
        join_numbers(&[&position_m[..], &quaternion_wxyz, &fixed.size_m].concat())
    });
    numbers.collect::<Vec<_>>().join("; ")
}

/// The inverse of [`join_boxes`].
pub(crate) fn split_boxes(text: &str) -> Option<Vec<FixedBox>> {
    let fixed = |text: &str| {
        let [x, y, z, w, i, j, k, along_x, along_y, along_z] = split_numbers::<10>(text)?;
        let size_m = [along_x, along_y, along_z];
        let base_from_box = pose_from_numbers([x, y, z], [w, i, j, k])?;
        size_m.iter().all(|&edge_m| edge_m > 0.0).then_some(FixedBox { base_from_box, size_m })
    };
    text.split(';').map(fixed).collect()
}

/// Position (x y z) and quaternion (w x y z) of a pose.
pub(crate) fn pose_numbers(pose: &Isometry3<f64>) -> ([f64; 3], [f64; 4]) {
    let t = pose.translation.vector;
    let q = pose.rotation.quaternion();
    ([t.x, t.y, t.z], [q.w, q.i, q.j, q.k])
}

/// The inverse of [`pose_numbers`]; `None` for a quaternion that is no rotation.
pub(crate) fn pose_from_numbers(position_m: [f64; 3], quaternion_wxyz: [f64; 4]) -> Option<Isometry3<f64>> {
    let [x, y, z] = position_m;
    let [w, i, j, k] = quaternion_wxyz;
    let quaternion = Quaternion::new(w, i, j, k);
    let norm = quaternion.norm();
    if !(norm.is_finite() && norm > 1e-6) {
        return None;
    }
    // A unit quaternion stays as it was written, to the bit.
    let rotation = if (norm - 1.0).abs() < 1e-12 {
        Unit::new_unchecked(quaternion)
    } else {
        UnitQuaternion::from_quaternion(quaternion)
    };
    Some(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}
