//! Replays a recorded joint path past an object and keeps what every sensor model needs.

use std::ops::Range;

use nalgebra::Isometry3;
use palpate_robot_model::{Robot, TactileLayout};

use crate::geometry::SignedDistance;

/// The part of a replay that does not depend on theta, for one take.
///
/// Proximity patches reduce to the smallest signed distance of their nodes; pressure patches keep each node's penalty
/// pressure where it is not zero.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactTrace {
    /// Number of frames.
    pub num_frames: usize,
    /// Per patch of the layout, in order.
    pub patches: Vec<PatchTrace>,
}

/// What one patch felt, frame by frame.
#[derive(Clone, Debug, PartialEq)]
pub enum PatchTrace {
    /// Smallest signed distance over the patch's nodes, m, one per frame. Far frames hold a lower bound on it instead
    /// (never below [`NEAR_M`]), because no threshold reaches that far.
    Proximity {
        /// One value per frame, m.
        min_distance_m: Vec<f64>,
    },
    /// Penalty pressures, sparse: frame `t` owns `entries[offsets[t]..offsets[t + 1]]`.
    Pressure {
        /// `num_frames + 1` offsets into `entries`.
        offsets: Vec<u32>,
        /// `(node index in the patch, pressure in Pa > 0)`, by frame, nodes ascending.
        entries: Vec<(u32, f64)>,
    },
}

/// Distances up to this are exact; a `lambda_con` beyond it is refused.
pub const NEAR_M: f64 = 0.05;

impl PatchTrace {
    /// The range of `entries` of `frame` of a pressure patch.
    pub fn entry_range(offsets: &[u32], frame: usize) -> Range<usize> {
        offsets[frame] as usize..offsets[frame + 1] as usize
    }
}

/// Replays `positions` (`num_frames x num_dofs`, row-major, rad or m) with the object fixed at `base_from_object`.
///
/// Penalty pressure of node j: `f_j = stiffness * max(0, -signed_distance_j)` (paper, "Contact Modeling").
/// Refuses a path of the wrong length and NaN or infinite positions, naming frame and joint.
/// Uses every core with the `batch` feature; the result has the same bits for any number of threads.
pub fn contact_trace(
    robot: &Robot,
    layout: &TactileLayout,
    object: &SignedDistance,
    base_from_object: &Isometry3<f64>,
    positions: &[f64],
) -> Result<ContactTrace, ReplayError> {
    let _ = (robot, layout, object, base_from_object, positions);
    todo!()
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
    #[error("failed to replay frame {frame}: position of joint {joint:?} is {value}, expected a finite number")]
    NonFinitePosition {
        /// Frame, from 0.
        frame: usize,
        /// Name of the joint.
        joint: String,
        /// What was there.
        value: f64,
    },
    /// The object's pose is NaN or infinite.
    #[error("failed to replay: the object's pose must be finite, found position {position_m:?} m")]
    NonFiniteObjectPose {
        /// Position of the object in the base frame, m.
        position_m: [f64; 3],
    },
}
