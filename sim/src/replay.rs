//! Replays a recorded joint path past an object and keeps what every sensor model needs.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use palpate_robot_model::{
    FixedBox, KnownPoses, LinkTracker, ObjectPath, ObjectShape, Patch, Robot, SensorKind, TactileLayout,
};

use crate::geometry::{self, SignedDistance};
use crate::parallel::map_chunks;
use crate::vectors::exponentials;

/// The part of a replay that does not depend on theta, for one take.
///
/// Proximity patches reduce to the smallest signed distance of their nodes; pressure patches keep each node's penalty
/// pressure where it is not zero.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactTrace {
    /// Number of frames.
    pub num_frames: usize,
    /// Per patch of the layout, in order; shared with whoever else has the patch at the same place.
    pub patches: Vec<Arc<PatchTrace>>,
}

/// What one patch felt, frame by frame.
#[derive(Clone, Debug, PartialEq)]
pub enum PatchTrace {
    /// Smallest signed distance over the patch's nodes, m, one per frame. Far frames hold a lower bound on it instead
    /// (never below [`NEAR_M`]), because no threshold reaches that far.
    Proximity {
        /// One value per frame, m.
        min_distance_m: Vec<f64>,
        /// Where the other nodes are; none of a hard pad.
        gaps: Gaps,
    },
    /// Penalty pressures, sparse: frame `t` owns `entries[offsets[t]..offsets[t + 1]]`.
    Pressure {
        /// `num_frames + 1` offsets into `entries`.
        offsets: Vec<u32>,
        /// `(node index in the patch, pressure in Pa > 0)`, by frame, nodes ascending.
        entries: Vec<(u32, f64)>,
    },
}

/// How much farther than its nearest node those of a soft pad are, for the frames in which it is near: frame `t` owns
/// `gaps_m[ends[t - 1]..ends[t]]`. Nodes behind which no softness reaches are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaps {
    ends: Vec<u32>,
    gaps_m: Vec<f64>,
}

impl Gaps {
    fn append(&mut self, other: &Self) {
        let first = self.gaps_m.len() as u32;
        self.ends.extend(other.ends.iter().map(|end| first + end));
        self.gaps_m.extend_from_slice(&other.gaps_m);
    }

    /// `-s ln sum_i exp(-d_i / s)` over the distances of all nodes, frame by frame, `s` being `softness_m`, where the
    /// nearest is at `min_distance_m`. Frames without gaps keep the distance of the nearest.
    pub(crate) fn soft_distances_m(&self, min_distance_m: &[f64], softness_m: f64) -> Vec<f64> {
        let (mut start, mut shares) = (0, Vec::new());
        let of_frame = |(frame, &smallest_m): (usize, &f64)| {
            let end = self.ends.get(frame).map_or(start, |end| *end as usize);
            let gaps_m = &self.gaps_m[std::mem::replace(&mut start, end)..end];
            if gaps_m.is_empty() {
                return smallest_m;
            }
            let near = gaps_m.iter().filter(|gap_m| **gap_m < SOFT_TAIL * softness_m);
            shares.clear();
            shares.extend(near.map(|gap_m| -gap_m / softness_m));
            exponentials(&mut shares);
            let sum: f64 = shares.iter().sum();
            smallest_m - softness_m * sum.max(1.0).ln()
        };
        min_distance_m.iter().enumerate().map(of_frame).collect()
    }
}

/// Distances up to this are exact; a `lambda_con` beyond it is refused.
pub const NEAR_M: f64 = 0.05;

/// [`crate::Response::pad_softness_m`] of the softest pad that a model may have, m.
pub const MOST_SOFTNESS_M: f64 = 3e-3;

impl PatchTrace {
    /// What its frames take in memory, bytes.
    pub(crate) fn num_bytes(&self) -> usize {
        match self {
            Self::Proximity { min_distance_m, gaps } => {
                size_of_val(&min_distance_m[..]) + size_of_val(&gaps.ends[..]) + size_of_val(&gaps.gaps_m[..])
            }
            Self::Pressure { offsets, entries } => size_of_val(&offsets[..]) + size_of_val(&entries[..]),
        }
    }

    /// The range of `entries` of `frame` of a pressure patch.
    pub fn entry_range(offsets: &[u32], frame: usize) -> Range<usize> {
        offsets[frame] as usize..offsets[frame + 1] as usize
    }
}

/// Replays `positions` (`num_frames x num_dofs`, row-major, rad or m) with the object at `base_from_object`: at one pose, or at
/// one a frame.
///
/// Penalty pressure of node j: `f_j = stiffness * max(0, -signed_distance_j)` (paper, "Contact Modeling").
/// Refuses paths of the wrong length and NaN or infinite positions and poses, naming frame and joint.
/// Uses every core with the `batch` feature; the result has the same bits for any number of threads.
///
/// # Example
/// A pad 5 mm below the carriage of a lift comes down on a ball and reads the pressure in its middle:
/// ```
/// use nalgebra::Isometry3;
/// use palpate_robot_model::{
///     Channel, ObjectPath, ObjectShape, Patch, Robot, SensorKind, Stream, SurfaceNode, TactileLayout, TaxelAxes,
/// };
/// use palpate_sim::{SensorModel, geometry::SignedDistance, replay::contact_trace, tactile::readings};
///
/// let urdf = r#"<robot name="lift">
///   <link name="base"/> <link name="carriage"/>
///   <joint name="lift" type="prismatic">
///     <parent link="base"/> <child link="carriage"/> <axis xyz="0 0 1"/>
///   </joint>
/// </robot>"#;
/// let robot = Robot::from_urdf("lift.urdf", urdf, &[])?;
/// let (tip, down) = (nalgebra::point![0.0, 0.0, -0.005], -nalgebra::Vector3::z_axis());
/// let layout = TactileLayout {
///     name: "pad".into(),
///     streams: vec![Stream {
///         id: "pad".into(), label: "Pad".into(), kind: SensorKind::Pressure, rate_hz: 10.0,
///         channels: 0..1, raw_unit: "counts".into(), axes: TaxelAxes::One,
///     }],
///     patches: vec![Patch {
///         id: "pad".into(), label: "Pad".into(), group: "pad".into(), stream: 0,
///         link: robot.link_index("carriage").expect("it is in the URDF"),
///         link_from_patch: Isometry3::identity(),
///         nodes: vec![SurfaceNode { pos_in_link: tip, normal_in_link: down }],
///         taxels_in_link: vec![tip], taxel_normals_in_link: vec![down], channels: 0..1,
///         stiffness_pa_per_m: 1e6, map_positions: vec![[0.0, 0.0]],
///     }],
///     channels: vec![Channel { id: "pad".into(), stream: 0, patch: 0, taxel: 0 }],
/// };
/// let ball = SignedDistance::new(&ObjectShape::Sphere { radius_m: 0.05 })?;
///
/// let heights_m = [0.060, 0.054, 0.053];
/// let still = ObjectPath::Still(Isometry3::identity());
/// let trace = contact_trace(&robot, &layout, &ball, &still, &heights_m)?;
///
/// let model = SensorModel::from_toml("pad.toml", r#"
///     format = 1
///     name = "pad"
///     theta = { lambda_con_m = 0.001, alpha_per_m = 300.0, lambda_pre_pa = 1500.0 }
/// "#)?;
/// let readings = readings(&layout, &trace, &model.thetas());
/// assert!((readings.raw[2] - 2000.0).abs() < 1e-6); // 2 mm deep at 1 MPa/m
/// assert_eq!(readings.active, [false, false, true]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn contact_trace(
    robot: &Robot,
    layout: &TactileLayout,
    object: &SignedDistance,
    base_from_object: &ObjectPath,
    positions: &[f64],
) -> Result<ContactTrace, ReplayError> {
    contact_trace_among(robot, layout, object, &[], base_from_object, positions)
}

/// The same with `surroundings`, such as a table, beside the object: the nearest body counts. Without any, the bits are those
/// of [`contact_trace`].
pub fn contact_trace_among(
    robot: &Robot,
    layout: &TactileLayout,
    object: &SignedDistance,
    surroundings: &[FixedBox],
    base_from_object: &ObjectPath,
    positions: &[f64],
) -> Result<ContactTrace, ReplayError> {
    let everywhere = vec![true; layout.patches.len()];
    let bodies = Bodies { object, base_from_object, surroundings };
    trace_of(robot, layout, f64::NEG_INFINITY, &bodies, positions, None, &everywhere)
}

/// What can be touched in a take.
pub(crate) struct Bodies<'a> {
    pub(crate) object: &'a SignedDistance,
    pub(crate) base_from_object: &'a ObjectPath,
    pub(crate) surroundings: &'a [FixedBox],
}

/// [`contact_trace`] of the patches in `wanted`, with the gaps of proximity patches whose nearest node is nearer than
/// `gaps_below_m` ([`crate::Response::pad_softness_m`] asks for them); those of all others hold no frame. Poses of links that
/// are `known` are not computed.
pub(crate) fn trace_of(
    robot: &Robot,
    layout: &TactileLayout,
    gaps_below_m: f64,
    bodies: &Bodies<'_>,
    positions: &[f64],
    known: Option<&KnownPoses<'_>>,
    wanted: &[bool],
) -> Result<ContactTrace, ReplayError> {
    let Bodies { object, base_from_object, surroundings } = *bodies;
    let num_frames = check(robot, base_from_object.poses(), positions)?;
    let fixed = |fixed: &FixedBox| {
        if !geometry::is_finite(&fixed.base_from_box) {
            return Err(ReplayError::Object("the pose of a box beside it is not finite".to_owned()));
        }
        let distance = SignedDistance::new(&ObjectShape::Box { size_m: fixed.size_m });
        Ok((distance.map_err(ReplayError::Object)?, fixed.base_from_box.inverse()))
    };
    let surroundings = surroundings.iter().map(fixed).collect::<Result<Vec<_>, _>>()?;
    if let ObjectPath::Moving(poses) = base_from_object
        && poses.len() != num_frames
    {
        return Err(ReplayError::ObjectPath { num_poses: poses.len(), num_frames });
    }
    let num_dofs = robot.num_dofs();
    let probes: Vec<(usize, Probe)> = (0..layout.patches.len())
        .filter(|&idx| wanted[idx])
        .map(|idx| (idx, Probe::new(layout, &layout.patches[idx], gaps_below_m)))
        .collect();
    let object_from_base: Vec<Isometry3<f64>> =
        base_from_object.poses().iter().map(Isometry3::inverse).collect();
    // An object that stands still has one pose for all frames.
    let stride = usize::from(matches!(base_from_object, ObjectPath::Moving(_)));
    let tracker = LinkTracker::new(robot, probes.iter().map(|(_, probe)| probe.link), known);
    let chunks = map_chunks(num_frames.div_ceil(CHUNK_FRAMES), |chunk| {
        let frames = chunk * CHUNK_FRAMES..num_frames.min((chunk + 1) * CHUNK_FRAMES);
        let mut felt: Vec<ChunkTrace> =
            probes.iter().map(|(_, probe)| probe.empty_chunk(frames.len())).collect();
        let mut tracker = tracker.clone();
        // Where nobody wants to know, nothing need be anywhere.
        for frame in frames.filter(|_| !probes.is_empty()) {
            let of_frame = &positions[frame * num_dofs..(frame + 1) * num_dofs];
            let root_from_link = tracker.at(frame, of_frame);
            let object_from_base = object_from_base[frame * stride];
            for ((_, probe), felt) in probes.iter().zip(&mut felt) {
                let root_from_link = &root_from_link[probe.link];
                let object_from_link = object_from_base * root_from_link;
                if surroundings.is_empty() {
                    probe.feel(object, &object_from_link, felt);
                    continue;
                }
                let feel = |body: &SignedDistance, body_from_link: &Isometry3<f64>| {
                    let mut of_frame = probe.empty_chunk(1);
                    probe.feel(body, body_from_link, &mut of_frame);
                    of_frame
                };
                let mut nearest = feel(object, &object_from_link);
                for (body, body_from_base) in &surroundings {
                    nearest.keep_nearer(feel(body, &(body_from_base * root_from_link)));
                }
                felt.push(nearest);
            }
        }
        felt
    });
    let mut trace = ContactTrace::empty(layout, num_frames);
    for chunk in chunks {
        trace.append(probes.iter().map(|(idx, _)| *idx).zip(chunk));
    }
    Ok(trace)
}

/// Adds one frame to `trace`, in which the robot stands at `positions` beside several `bodies`, each with its pose in the
/// base. The nearest body counts: what a node presses into is the one that it is deepest in.
///
/// `positions` and poses must be finite; with one body the bits are those of [`contact_trace`].
pub(crate) fn feel_frame<'a>(
    robot: &Robot,
    probes: &[Probe],
    bodies: impl Iterator<Item = (&'a SignedDistance, Isometry3<f64>)>,
    positions: &[f64],
    trace: &mut ContactTrace,
) {
    let mut root_from_link = Vec::new();
    robot.forward_kinematics(positions, &mut root_from_link);
    let mut nearest: Option<Vec<ChunkTrace>> = None;
    for (body, base_from_body) in bodies {
        let body_from_base = base_from_body.inverse();
        let feel = |probe: &Probe| {
            let mut felt = probe.empty_chunk(1);
            probe.feel(body, &(body_from_base * root_from_link[probe.link]), &mut felt);
            felt
        };
        let felt: Vec<ChunkTrace> = probes.iter().map(feel).collect();
        match &mut nearest {
            Some(nearest) => nearest.iter_mut().zip(felt).for_each(|(one, other)| one.keep_nearer(other)),
            None => nearest = Some(felt),
        }
    }
    trace.num_frames += 1;
    let nearest = nearest.unwrap_or_else(|| probes.iter().map(Probe::untouched).collect());
    trace.append(nearest.into_iter().enumerate());
}

/// The patches of `layout`, prepared; `gaps_below_m` as for [`trace_of`].
pub(crate) fn probes(layout: &TactileLayout, gaps_below_m: f64) -> Vec<Probe> {
    layout.patches.iter().map(|patch| Probe::new(layout, patch, gaps_below_m)).collect()
}

/// Frames per unit of parallel work: some hundred microseconds, and many more units than cores.
const CHUNK_FRAMES: usize = 32;

/// Nodes farther than the nearest by this many softnesses count for nothing: less than one part in three thousand.
const SOFT_TAIL: f64 = 8.0;

/// Gaps that matter to the softest pad, m.
const LONGEST_GAP_M: f64 = SOFT_TAIL * MOST_SOFTNESS_M;

/// Room for rounding in a bound from the bounding sphere, m.
pub(crate) const ROUNDING_M: f64 = 1e-9;

/// The number of frames, or what is wrong with the joint path or with one of the object's `poses`.
pub(crate) fn check(
    robot: &Robot,
    poses: &[Isometry3<f64>],
    positions: &[f64],
) -> Result<usize, ReplayError> {
    let num_dofs = robot.num_dofs();
    if let Some(frame) = poses.iter().position(|pose| !geometry::is_finite(pose)) {
        let t = poses[frame].translation.vector;
        return Err(ReplayError::NonFiniteObjectPose { frame, position_m: [t.x, t.y, t.z] });
    }
    if positions.is_empty() {
        return Ok(0);
    }
    if num_dofs == 0 || !positions.len().is_multiple_of(num_dofs) {
        return Err(ReplayError::RaggedPath { num_values: positions.len(), num_dofs });
    }
    if let Some(i) = positions.iter().position(|position| !position.is_finite()) {
        let joint = robot.dofs().nth(i % num_dofs).map_or_else(String::new, |joint| joint.name.clone());
        return Err(ReplayError::NonFinitePosition { frame: i / num_dofs, joint, value: positions[i] });
    }
    Ok(positions.len() / num_dofs)
}

/// A patch prepared for many frames.
#[derive(Clone, Debug)]
pub(crate) struct Probe {
    pub(crate) link: usize,
    pub(crate) kind: SensorKind,
    stiffness_pa_per_m: f64,
    gaps_below_m: f64,
    pub(crate) nodes_in_link: Vec<Point3<f64>>,
    /// A ball that holds every node.
    pub(crate) center_in_link: Point3<f64>,
    pub(crate) radius_m: f64,
}

/// What one patch felt over the frames of a chunk.
enum ChunkTrace {
    Proximity { min_distance_m: Vec<f64>, gaps: Gaps },
    Pressure { counts: Vec<u32>, entries: Vec<(u32, f64)> },
}

impl Probe {
    /// `gaps_below_m` as for [`trace_of`].
    pub(crate) fn new(layout: &TactileLayout, patch: &Patch, gaps_below_m: f64) -> Self {
        let nodes_in_link: Vec<Point3<f64>> = patch.nodes.iter().map(|node| node.pos_in_link).collect();
        let first = nodes_in_link.first().copied().unwrap_or_else(Point3::origin);
        let (mut low, mut high) = (first, first);
        for node in &nodes_in_link {
            low = low.inf(node);
            high = high.sup(node);
        }
        let center_in_link = nalgebra::center(&low, &high);
        let radius_m = nodes_in_link.iter().map(|node| (node - center_in_link).norm()).fold(0.0, f64::max);
        Self {
            link: patch.link,
            kind: layout.streams[patch.stream].kind,
            stiffness_pa_per_m: patch.stiffness_pa_per_m,
            gaps_below_m,
            nodes_in_link,
            center_in_link,
            radius_m,
        }
    }

    fn empty_chunk(&self, num_frames: usize) -> ChunkTrace {
        match self.kind {
            SensorKind::Proximity => ChunkTrace::Proximity {
                min_distance_m: Vec::with_capacity(num_frames),
                gaps: Gaps::default(),
            },
            SensorKind::Pressure => {
                ChunkTrace::Pressure { counts: Vec::with_capacity(num_frames), entries: Vec::new() }
            }
        }
    }

    /// Closes a frame of `gaps`, of which a hard pad has none.
    fn end_frame(&self, gaps: &mut Gaps) {
        if self.gaps_below_m > f64::NEG_INFINITY {
            gaps.ends.push(gaps.gaps_m.len() as u32);
        }
    }

    /// One frame with nothing near.
    fn untouched(&self) -> ChunkTrace {
        match self.kind {
            SensorKind::Proximity => {
                let mut gaps = Gaps::default();
                self.end_frame(&mut gaps);
                ChunkTrace::Proximity { min_distance_m: vec![f64::INFINITY], gaps }
            }
            SensorKind::Pressure => ChunkTrace::Pressure { counts: vec![0], entries: Vec::new() },
        }
    }

    /// Adds one frame to `felt`.
    ///
    /// Signed distance changes no faster than the point moves, so the distance of the bounding ball's centre less its
    /// radius bounds those of all nodes from below.
    fn feel(&self, object: &SignedDistance, object_from_link: &Isometry3<f64>, felt: &mut ChunkTrace) {
        let reach_m = self.radius_m + ROUNDING_M;
        let bound_below_m = |limit_m: f64| {
            object.distance_below_m(&(object_from_link * self.center_in_link), limit_m + reach_m) - reach_m
        };
        match felt {
            ChunkTrace::Proximity { min_distance_m, gaps } => {
                let mut smallest = bound_below_m(NEAR_M).max(NEAR_M);
                if self.nodes_in_link.is_empty() {
                    smallest = f64::INFINITY;
                } else if smallest <= NEAR_M {
                    smallest = object.min_distance_below_m(object_from_link, &self.nodes_in_link, NEAR_M);
                    if smallest < self.gaps_below_m {
                        let limit_m = smallest + LONGEST_GAP_M;
                        object.for_each_distance_below(
                            object_from_link,
                            &self.nodes_in_link,
                            limit_m,
                            |_, distance_m| {
                                if distance_m < limit_m {
                                    gaps.gaps_m.push(distance_m - smallest);
                                }
                            },
                        );
                    }
                }
                min_distance_m.push(smallest);
                self.end_frame(gaps);
            }
            ChunkTrace::Pressure { counts, entries } => {
                let before = entries.len();
                if bound_below_m(0.0) < 0.0 {
                    object.for_each_distance_below(
                        object_from_link,
                        &self.nodes_in_link,
                        0.0,
                        |node, distance| {
                            if distance < 0.0 {
                                entries.push((node as u32, -distance * self.stiffness_pa_per_m));
                            }
                        },
                    );
                }
                counts.push((entries.len() - before) as u32);
            }
        }
    }
}

impl ChunkTrace {
    /// Adds the frames of `next`, of the same patch.
    fn push(&mut self, next: Self) {
        match (self, next) {
            (
                Self::Proximity { min_distance_m, gaps },
                Self::Proximity { min_distance_m: next_m, gaps: next_gaps },
            ) => {
                min_distance_m.extend(next_m);
                gaps.append(&next_gaps);
            }
            (
                Self::Pressure { counts, entries },
                Self::Pressure { counts: next_counts, entries: next_entries },
            ) => {
                counts.extend(next_counts);
                entries.extend(next_entries);
            }
            _ => unreachable!("a patch has one kind"),
        }
    }

    /// Of two traces of the same single frame, the nearer: what a node presses into is the body that it is deepest in.
    fn keep_nearer(&mut self, other: Self) {
        match (self, other) {
            (
                Self::Proximity { min_distance_m, gaps },
                Self::Proximity { min_distance_m: others_m, gaps: others },
            ) => {
                if others_m[0] < min_distance_m[0] {
                    (*min_distance_m, *gaps) = (others_m, others);
                }
            }
            (Self::Pressure { counts, entries }, Self::Pressure { entries: others, .. }) => {
                entries.extend(others);
                // The deeper entry of a node comes first and stays.
                entries.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
                entries.dedup_by_key(|(node, _)| *node);
                *counts = vec![entries.len() as u32];
            }
            _ => unreachable!("a patch has one kind"),
        }
    }
}

impl ContactTrace {
    /// Of no frames yet; `num_frames` is what it will hold.
    pub(crate) fn empty(layout: &TactileLayout, num_frames: usize) -> Self {
        let empty = |patch: &Patch| match layout.streams[patch.stream].kind {
            SensorKind::Proximity => {
                PatchTrace::Proximity { min_distance_m: Vec::new(), gaps: Gaps::default() }
            }
            SensorKind::Pressure => PatchTrace::Pressure { offsets: vec![0], entries: Vec::new() },
        };
        Self { num_frames, patches: layout.patches.iter().map(|patch| Arc::new(empty(patch))).collect() }
    }

    /// Its frames, and those of `next` behind them; both of the same layout.
    pub(crate) fn followed_by(mut self, next: &Self) -> Self {
        self.num_frames += next.num_frames;
        for (patch, next) in self.patches.iter_mut().zip(&next.patches) {
            match (Arc::make_mut(patch), &**next) {
                (
                    PatchTrace::Proximity { min_distance_m, gaps },
                    PatchTrace::Proximity { min_distance_m: next_m, gaps: next_gaps },
                ) => {
                    min_distance_m.extend_from_slice(next_m);
                    gaps.append(next_gaps);
                }
                (
                    PatchTrace::Pressure { offsets, entries },
                    PatchTrace::Pressure { offsets: next_offsets, entries: next_entries },
                ) => {
                    let first = entries.len() as u32;
                    offsets.extend(next_offsets.iter().skip(1).map(|offset| first + offset));
                    entries.extend_from_slice(next_entries);
                }
                _ => unreachable!("a patch has one kind"),
            }
        }
        self
    }

    /// Puts the frames of a chunk, by patch, behind those that are there.
    fn append(&mut self, chunk: impl Iterator<Item = (usize, ChunkTrace)>) {
        for (patch, felt) in chunk {
            match (Arc::make_mut(&mut self.patches[patch]), felt) {
                (
                    PatchTrace::Proximity { min_distance_m: all, gaps: all_gaps },
                    ChunkTrace::Proximity { min_distance_m, gaps },
                ) => {
                    all.extend(min_distance_m);
                    all_gaps.append(&gaps);
                }
                (
                    PatchTrace::Pressure { offsets, entries: all },
                    ChunkTrace::Pressure { counts, entries },
                ) => {
                    for count in counts {
                        offsets.push(offsets.last().copied().unwrap_or(0) + count);
                    }
                    all.extend(entries);
                }
                _ => unreachable!("a chunk has the kinds of its probes"),
            }
        }
    }
}

/// A joint path that cannot be replayed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReplayError {
    /// The number of values is no multiple of the number of degrees of freedom.
    #[error(
        "failed to replay a joint path of {num_values} values: the robot has {num_dofs} degrees of freedom, \
         so the path must hold a multiple of that"
    )]
    RaggedPath {
        /// Values in the path.
        num_values: usize,
        /// Degrees of freedom of the robot.
        num_dofs: usize,
    },
    /// A joint position is NaN or infinite.
    #[error(
        "failed to replay frame {frame}: position of joint {joint:?} is {value}, expected a finite number"
    )]
    NonFinitePosition {
        /// Frame, from 0.
        frame: usize,
        /// Name of the joint.
        joint: String,
        /// What was there.
        value: f64,
    },
    /// A moving object has another number of poses than the path has frames.
    #[error(
        "failed to replay: the moving object has {num_poses} poses, but the joint path has {num_frames} frames; give one \
         pose for each frame"
    )]
    ObjectPath {
        /// Poses of the object.
        num_poses: usize,
        /// Frames of the joint path.
        num_frames: usize,
    },
    /// Frames must follow each other.
    #[error(
        "failed to feel the frame at {time_s} s: the frame before it was at {before_s} s, expected a later time"
    )]
    TimeNotIncreasing {
        /// Time of the frame, s.
        time_s: f64,
        /// Time of the one before, s.
        before_s: f64,
    },
    /// The object has no inside, or is degenerate.
    #[error("failed to replay: the object cannot be touched: {0}")]
    Object(String),
    /// The sensor model does not fit the station.
    #[error("failed to replay: {0}")]
    Model(String),
    /// The object's pose is NaN or infinite.
    #[error(
        "failed to replay: the object's pose must be finite, found position {position_m:?} m at frame {frame}"
    )]
    NonFiniteObjectPose {
        /// Frame, from 0; 0 for an object that stands still.
        frame: usize,
        /// Position of the object in the base frame, m.
        position_m: [f64; 3],
    },
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A pad of 5 x 5 nodes in the plane z = 0.
    fn pad() -> Probe {
        let nodes_in_link: Vec<Point3<f64>> = (0..25)
            .map(|node| Point3::new(f64::from(node % 5 - 2) * 2e-3, f64::from(node / 5 - 2) * 2e-3, 0.0))
            .collect();
        Probe {
            link: 0,
            kind: SensorKind::Proximity,
            stiffness_pa_per_m: 0.0,
            gaps_below_m: f64::INFINITY,
            nodes_in_link,
            center_in_link: Point3::origin(),
            radius_m: 6e-3,
        }
    }

    fn felt_m(softness_m: f64, object: &ObjectShape, object_from_link: Isometry3<f64>) -> f64 {
        let probe = pad();
        let object = SignedDistance::new(object).expect("valid");
        let mut felt = probe.empty_chunk(1);
        probe.feel(&object, &object_from_link, &mut felt);
        match felt {
            ChunkTrace::Proximity { min_distance_m, .. } if softness_m == 0.0 => min_distance_m[0],
            ChunkTrace::Proximity { min_distance_m, gaps } => {
                gaps.soft_distances_m(&min_distance_m, softness_m)[0]
            }
            ChunkTrace::Pressure { .. } => unreachable!("the pad senses proximity"),
        }
    }

    const BALL: ObjectShape = ObjectShape::Sphere { radius_m: 0.03 };

    proptest! {
        #[test]
        fn a_soft_pad_is_nearer_by_at_most_what_all_of_it_adds(
            height_m in 0.02..0.06, softness_m in 1e-5..3e-3, side_m in -0.01..0.01,
        ) {
            let pose = Isometry3::translation(side_m, 0.0, height_m);
            let (hard, soft) = (felt_m(0.0, &BALL, pose), felt_m(softness_m, &BALL, pose));
            prop_assert!(soft <= hard && hard - soft <= softness_m * 25.0_f64.ln() + 1e-12, "{soft} {hard}");
        }
    }

    #[test]
    fn a_flat_face_loads_a_soft_pad_more_than_a_ball_as_deep() {
        let block = ObjectShape::Box { size_m: [0.06; 3] };
        let deep = Isometry3::translation(0.0, 0.0, 0.029);
        let apart_m = |softness_m| felt_m(softness_m, &BALL, deep) - felt_m(softness_m, &block, deep);
        assert!(apart_m(0.0).abs() < 1e-12);
        assert!(apart_m(2e-4) > 2e-4, "{}", apart_m(2e-4));
    }
}
