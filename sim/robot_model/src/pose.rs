//! Poses as people write them in TOML.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// A rigid pose in a file: `{ position_m = [x, y, z], quaternion_wxyz = [w, x, y, z] }`.
///
/// The quaternion is normalised on use; a zero or non-finite one is refused by [`PoseConfig::to_isometry`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// Origin of the child frame in the parent frame, m.
    pub position_m: [f64; 3],
    /// Rotation of the child frame in the parent frame, scalar first.
    #[serde(default = "identity_wxyz")]
    pub quaternion_wxyz: [f64; 4],
}

fn identity_wxyz() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self { position_m: [0.0; 3], quaternion_wxyz: identity_wxyz() }
    }
}

impl PoseConfig {
    /// `parent_from_child`, or what is wrong with the numbers.
    pub fn to_isometry(&self) -> Result<Isometry3<f64>, String> {
        let [x, y, z] = self.position_m;
        let [qw, qx, qy, qz] = self.quaternion_wxyz;
        if ![x, y, z].iter().all(|v| v.is_finite()) {
            return Err(format!("position_m {:?} must be finite", self.position_m));
        }
        let quaternion = Quaternion::new(qw, qx, qy, qz);
        let norm = quaternion.norm();
        if !(norm.is_finite() && norm > 1e-6) {
            return Err(format!("quaternion_wxyz {:?} must not be zero", self.quaternion_wxyz));
        }
        Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
    }

    /// The same pose as a file would hold it.
    pub fn from_isometry(parent_from_child: &Isometry3<f64>) -> Self {
        let t = parent_from_child.translation.vector;
        let q = parent_from_child.rotation.quaternion();
        Self { position_m: [t.x, t.y, t.z], quaternion_wxyz: [q.w, q.i, q.j, q.k] }
    }
}
