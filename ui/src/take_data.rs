//! A recorded take as the page uses it: the trace from the server, checked, with look-ups by time.

use nalgebra::Isometry3;
use palpate_messages::bits;
use palpate_robot_model::{FixedBox, PoseConfig, Station};
use palpate_wire::proto::{ReplayTrace, StreamTrace, TakeTrace};

/// A take, ready to draw.
#[derive(Clone, Debug)]
pub struct TakeData {
    /// As received; times are seconds since the take's start.
    pub trace: TakeTrace,
    num_dofs: usize,
    duration_s: f64,
    /// base_from_object of each frame; empty of an object that stands still.
    object_poses: Vec<Isometry3<f64>>,
    surroundings: Vec<FixedBox>,
}

impl TakeData {
    /// Checks what can be checked without the station: that times increase, that joint positions come in whole frames
    /// and are finite.
    pub fn new(trace: TakeTrace) -> Result<Self, String> {
        let num_frames = trace.frame_times_s.len();
        check_times("joint frames", &trace.frame_times_s)?;
        for stream in &trace.streams {
            check_times(&format!("stream {:?}", stream.stream), &stream.times_s)?;
        }
        let num_values = trace.joint_positions.len();
        if (num_frames == 0 && num_values > 0) || (num_frames > 0 && !num_values.is_multiple_of(num_frames)) {
            return Err(format!("{num_values} joint positions do not fill {num_frames} frames evenly"));
        }
        if let Some(value_idx) = trace.joint_positions.iter().position(|value| !value.is_finite()) {
            let frame_idx = value_idx * num_frames / num_values;
            return Err(format!("joint frame {frame_idx} holds a position that is no number"));
        }
        let num_dofs = num_values.checked_div(num_frames).unwrap_or(0);
        let object_poses = object_poses(&trace.object_poses, num_frames)?;
        let surroundings = surroundings(&trace.surroundings)?;
        let duration_s = trace
            .streams
            .iter()
            .map(|stream| &stream.times_s)
            .chain([&trace.frame_times_s])
            .filter_map(|times_s| times_s.last())
            .fold(0.0, |longest: f64, &end_s| longest.max(end_s));
        Ok(Self { trace, num_dofs, duration_s, object_poses, surroundings })
    }

    /// Checks the take against the station it is said to come from: joints, channels and streams must match.
    pub fn check_against(&self, station: &Station) -> Result<(), String> {
        let num_frames = self.num_frames();
        let num_channels = station.layout.num_channels();
        if num_frames > 0 && self.num_dofs != station.robot.num_dofs() {
            return Err(format!(
                "the take holds {} joints a frame, its station {:?} has {}",
                self.num_dofs,
                station.id,
                station.robot.num_dofs()
            ));
        }
        check_bits("activations", &self.trace.real_active, num_frames, num_channels)?;
        for stream in &self.trace.streams {
            let Some(stream_idx) = station.layout.stream_index(&stream.stream) else {
                return Err(format!(
                    "the take holds a stream {:?} that its station {:?} does not know",
                    stream.stream, station.id
                ));
            };
            let width = station.layout.streams[stream_idx].channels.len();
            let what = format!("stream {:?}", stream.stream);
            check_bits(&what, &stream.active, stream.times_s.len(), width)?;
            if !stream.raw.is_empty() && stream.raw.len() != stream.times_s.len() * width {
                return Err(format!(
                    "{what}: {} raw readings for {} samples of {width} channels",
                    stream.raw.len(),
                    stream.times_s.len()
                ));
            }
        }
        Ok(())
    }

    /// Number of joint frames.
    pub fn num_frames(&self) -> usize {
        self.trace.frame_times_s.len()
    }

    /// Degrees of freedom in each joint frame.
    pub fn num_dofs(&self) -> usize {
        self.num_dofs
    }

    /// From the take's start to its last sample, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The joint frame in effect at `time_s`: the last one not after it, else the first; `None` if there are none.
    pub fn frame_at(&self, time_s: f64) -> Option<usize> {
        index_at(&self.trace.frame_times_s, time_s)
    }

    /// Joint positions at `time_s`, rad or m, linear between frames and held at the ends; empty without frames.
    pub fn joint_positions_at(&self, time_s: f64) -> Vec<f64> {
        let Some((frame_idx, share)) = self.between_frames(time_s) else { return Vec::new() };
        let row = |idx: usize| &self.trace.joint_positions[idx * self.num_dofs..(idx + 1) * self.num_dofs];
        let from = row(frame_idx);
        if frame_idx + 1 == self.num_frames() {
            return from.iter().map(|&position| f64::from(position)).collect();
        }
        from.iter()
            .zip(row(frame_idx + 1))
            .map(|(&a, &b)| f64::from(a) + share * (f64::from(b) - f64::from(a)))
            .collect()
    }

    /// Where a moving object is at `time_s`, in the base frame: on the way from one joint frame to the next, and held at the
    /// ends. `None` of one that stands still.
    pub fn object_pose_at(&self, time_s: f64) -> Option<Isometry3<f64>> {
        let (frame_idx, share) = self.between_frames(time_s)?;
        let from = self.object_poses.get(frame_idx)?;
        let to = self.object_poses.get(frame_idx + 1).unwrap_or(from);
        Some(from.try_lerp_slerp(to, share, 1e-9).unwrap_or(*from))
    }

    /// Fixed boxes beside the object, such as the table.
    pub fn surroundings(&self) -> &[FixedBox] {
        &self.surroundings
    }

    /// The joint frame in effect at `time_s`, and how much of the time to the next is over, 0 to 1; 0 at the last.
    fn between_frames(&self, time_s: f64) -> Option<(usize, f64)> {
        let frame_idx = self.frame_at(time_s)?;
        let from_s = self.trace.frame_times_s[frame_idx];
        let span_s = self.trace.frame_times_s.get(frame_idx + 1).map_or(0.0, |to_s| to_s - from_s);
        Some((frame_idx, if span_s > 0.0 { ((time_s - from_s) / span_s).clamp(0.0, 1.0) } else { 0.0 }))
    }

    /// Whether `channel` was active in joint frame `frame`.
    pub fn real_active(&self, frame: usize, channel: usize, num_channels: usize) -> bool {
        bits::get(&self.trace.real_active, frame * num_channels + channel)
    }

    /// Samples of the stream called `id`, if it was recorded.
    pub fn stream(&self, id: &str) -> Option<&StreamTrace> {
        self.trace.streams.iter().find(|stream| stream.stream == id)
    }

    /// The newest reading of `channel` at `time_s`, raw units less the reference value; `None` for binary takes, before
    /// the stream's first sample, and for channels that the station does not have.
    pub fn raw_at(&self, time_s: f64, channel: usize, station: &Station) -> Option<f32> {
        let channel_info = station.layout.channels.get(channel)?;
        let stream_info = &station.layout.streams[channel_info.stream];
        let stream = self.stream(&stream_info.id)?;
        if stream.times_s.first().is_none_or(|&first_s| time_s < first_s) {
            return None;
        }
        let sample_idx = index_at(&stream.times_s, time_s)?;
        let width = stream_info.channels.len();
        stream.raw.get(sample_idx * width + channel - stream_info.channels.start).copied()
    }
}

/// Poses from seven numbers a frame: x, y, z, then w, x, y, z.
fn object_poses(numbers: &[f32], num_frames: usize) -> Result<Vec<Isometry3<f64>>, String> {
    if !numbers.is_empty() && numbers.len() != 7 * num_frames {
        return Err(format!(
            "{} numbers of object poses for {num_frames} frames, expected 7 each",
            numbers.len()
        ));
    }
    let pose = |(frame_idx, numbers): (usize, &[f32])| {
        pose_of(numbers).map_err(|problem| format!("the object's pose in joint frame {frame_idx}: {problem}"))
    };
    numbers.chunks_exact(7).enumerate().map(pose).collect()
}

/// A pose from x, y, z, then w, x, y, z.
fn pose_of(numbers: &[f32]) -> Result<Isometry3<f64>, String> {
    let [x, y, z, qw, qx, qy, qz] =
        std::array::from_fn(|idx| numbers.get(idx).map_or(f64::NAN, |&number| f64::from(number)));
    PoseConfig { position_m: [x, y, z], quaternion_wxyz: [qw, qx, qy, qz] }.to_isometry()
}

/// Boxes from ten numbers each: a pose, then three edges.
fn surroundings(numbers: &[f32]) -> Result<Vec<FixedBox>, String> {
    if !numbers.len().is_multiple_of(10) {
        return Err(format!("{} numbers of boxes beside the object, expected 10 each", numbers.len()));
    }
    let fixed_box = |(idx, numbers): (usize, &[f32])| {
        let place = |problem: String| format!("box {idx} beside the object: {problem}");
        let base_from_box = pose_of(numbers).map_err(place)?;
        let size_m: [f64; 3] = std::array::from_fn(|edge| f64::from(numbers[7 + edge]));
        if !size_m.iter().all(|edge_m| edge_m.is_finite() && *edge_m > 0.0) {
            return Err(place(format!("its edges are {size_m:?} m")));
        }
        Ok(FixedBox { base_from_box, size_m })
    };
    numbers.chunks_exact(10).enumerate().map(fixed_box).collect()
}

/// Checks a replay against the take it belongs to.
pub fn check_replay(replay: &ReplayTrace, take: &TakeData, station: &Station) -> Result<(), String> {
    let (num_frames, num_channels) = (take.num_frames(), station.layout.num_channels());
    check_bits("the replay", &replay.active, num_frames, num_channels)?;
    if !replay.raw.is_empty() && replay.raw.len() != num_frames * num_channels {
        return Err(format!(
            "the replay holds {} signals for {num_frames} frames of {num_channels} channels",
            replay.raw.len()
        ));
    }
    Ok(())
}

/// Index of the last of `times_s` (increasing) that is not after `time_s`, else 0; `None` if there are none.
pub fn index_at(times_s: &[f64], time_s: f64) -> Option<usize> {
    if times_s.is_empty() {
        return None;
    }
    Some(times_s.partition_point(|&start_s| start_s <= time_s).saturating_sub(1))
}

fn check_times(what: &str, times_s: &[f64]) -> Result<(), String> {
    if let Some(idx) = times_s.iter().position(|time_s| !time_s.is_finite()) {
        return Err(format!("{what}: time {idx} is no number"));
    }
    match times_s.windows(2).position(|pair| pair[1] < pair[0]) {
        Some(idx) => Err(format!("{what}: time steps back after sample {idx}")),
        None => Ok(()),
    }
}

fn check_bits(what: &str, bytes: &[u8], rows: usize, columns: usize) -> Result<(), String> {
    let expected = (rows * columns).div_ceil(8);
    if bytes.len() == expected {
        Ok(())
    } else {
        Err(format!(
            "{what}: {} bytes of activations for {rows} samples of {columns} channels, expected {expected}",
            bytes.len()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace() -> TakeTrace {
        TakeTrace {
            frame_times_s: vec![0.0, 1.0, 3.0],
            joint_positions: vec![0.0, 10.0, 1.0, 20.0, 5.0, 40.0],
            ..Default::default()
        }
    }

    #[test]
    fn joints_are_linear_between_frames_and_held_outside() {
        let take = TakeData::new(trace()).expect("a sound trace");
        assert_eq!(take.joint_positions_at(-1.0), [0.0, 10.0]);
        assert_eq!(take.joint_positions_at(2.0), [3.0, 30.0]);
        assert_eq!(take.joint_positions_at(99.0), [5.0, 40.0]);
        assert_eq!((take.frame_at(0.99), take.frame_at(1.0)), (Some(0), Some(1)));
    }

    #[test]
    fn ragged_or_unordered_traces_are_refused_with_the_place() {
        let ragged = TakeTrace { joint_positions: vec![0.0; 5], ..trace() };
        assert!(TakeData::new(ragged).expect_err("ragged").contains("5 joint positions"));
        let back = TakeTrace { frame_times_s: vec![0.0, 2.0, 1.0], ..trace() };
        assert!(TakeData::new(back).expect_err("back").contains("steps back after sample 1"));
        let nan = TakeTrace { joint_positions: vec![0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0], ..trace() };
        assert!(TakeData::new(nan).expect_err("nan").contains("joint frame 1"));
    }

    #[test]
    fn a_moving_object_is_on_its_way_from_frame_to_frame() {
        let up = [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0_f32];
        // A quarter turn about z, and 0.2 m along x.
        let turned = [0.2, 0.0, 0.1, 0.5_f32.sqrt(), 0.0, 0.0, 0.5_f32.sqrt()];
        let moving = TakeTrace { object_poses: [up, turned, turned].concat(), ..trace() };
        let take = TakeData::new(moving.clone()).expect("a sound trace");
        let at = |time_s| take.object_pose_at(time_s).expect("it moves");
        assert!((at(0.5).translation.x - 0.1).abs() < 1e-6);
        assert!((at(0.5).rotation.angle() - std::f64::consts::FRAC_PI_4).abs() < 1e-6);
        assert_eq!((at(-1.0).translation.x, at(2.0), at(99.0)), (0.0, at(1.0), at(1.0)));
        assert_eq!(
            TakeData::new(trace()).expect("a sound trace").object_pose_at(0.5),
            None,
            "it stands still"
        );

        let short = TakeTrace { object_poses: up.to_vec(), ..moving.clone() };
        assert!(TakeData::new(short).expect_err("short").contains("7 numbers of object poses for 3 frames"));
        let mut lost = moving;
        lost.object_poses[7] = f32::NAN;
        assert!(TakeData::new(lost).expect_err("lost").contains("the object's pose in joint frame 1"));
    }

    #[test]
    fn boxes_beside_the_object_have_a_place_and_edges() {
        let table = [0.4, 0.0, -0.02, 1.0, 0.0, 0.0, 0.0, 0.8, 1.2, 0.04_f32];
        let with = |surroundings: Vec<f32>| TakeData::new(TakeTrace { surroundings, ..trace() });
        let take = with(table.to_vec()).expect("a sound trace");
        let [fixed] = take.surroundings() else { panic!("{:?}", take.surroundings()) };
        assert!(
            (fixed.base_from_box.translation.z + 0.02).abs() < 1e-6 && (fixed.size_m[1] - 1.2).abs() < 1e-6
        );
        assert!(with(table[..9].to_vec()).expect_err("short").contains("9 numbers of boxes"));
        let mut flat = table;
        flat[9] = 0.0;
        assert!(with(flat.to_vec()).expect_err("flat").contains("box 0 beside the object: its edges"));
    }

    #[test]
    fn empty_take_answers_with_nothing() {
        let take = TakeData::new(TakeTrace::default()).expect("an empty trace is sound");
        assert_eq!(take.frame_at(0.0), None);
        assert!(take.joint_positions_at(0.0).is_empty());
    }
}
