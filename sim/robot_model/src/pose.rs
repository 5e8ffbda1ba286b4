//! Poses as people write them in TOML.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// A rigid pose in a file: `{ position_m = [x, y, z], quaternion_wxyz = [w, x, y, z] }`.
///
/// Instead of the quaternion, a file may give `rpy_rad = [roll, pitch, yaw]`: turns about the fixed axes x, y, z, in
/// this order, as in URDF. The quaternion is normalised on use; a zero or non-finite one is refused by
/// [`PoseConfig::to_isometry`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PoseText")]
pub struct PoseConfig {
    /// Origin of the child frame in the parent frame, m.
    pub position_m: [f64; 3],
    /// Rotation of the child frame in the parent frame, scalar first.
    pub quaternion_wxyz: [f64; 4],
}

/// The two spellings of a rotation that a file may use.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseText {
    position_m: [f64; 3],
    quaternion_wxyz: Option<[f64; 4]>,
    rpy_rad: Option<[f64; 3]>,
}

impl TryFrom<PoseText> for PoseConfig {
    type Error = String;

    fn try_from(text: PoseText) -> Result<Self, String> {
        let quaternion_wxyz = match (text.quaternion_wxyz, text.rpy_rad) {
            (Some(_), Some(_)) => return Err("a pose has quaternion_wxyz or rpy_rad, not both".to_owned()),
            (Some(quaternion), None) => quaternion,
            (None, Some([roll, pitch, yaw])) => {
                if ![roll, pitch, yaw].iter().all(|angle| angle.is_finite()) {
                    return Err(format!("rpy_rad {:?} must be finite", [roll, pitch, yaw]));
                }
                let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
                [rotation.w, rotation.i, rotation.j, rotation.k]
            }
            (None, None) => [1.0, 0.0, 0.0, 0.0],
        };
        Ok(Self { position_m: text.position_m, quaternion_wxyz })
    }
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self { position_m: [0.0; 3], quaternion_wxyz: [1.0, 0.0, 0.0, 0.0] }
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
            return Err(format!("quaternion_wxyz {:?} must be finite and not zero", self.quaternion_wxyz));
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn rpy_is_urdf_roll_then_pitch_then_yaw() {
        let pose: PoseConfig = toml::from_str(
            "position_m = [1.0, 2.0, 3.0]\nrpy_rad = [1.5707963267948966, 0.0, 1.5707963267948966]",
        )
        .unwrap();
        // Roll takes y to z, which yaw leaves; roll leaves x, which yaw takes to y.
        let parent_from_child = pose.to_isometry().unwrap();
        let y = parent_from_child * nalgebra::Vector3::y();
        assert!((y - nalgebra::Vector3::z()).norm() < 1e-12, "{y}");
        let x = parent_from_child * nalgebra::Vector3::x();
        assert!((x - nalgebra::Vector3::y()).norm() < 1e-12, "{x}");
    }

    #[test]
    fn two_rotations_nan_and_zero_quaternion_are_refused() {
        let both = "position_m = [0, 0, 0]\nrpy_rad = [0, 0, 0]\nquaternion_wxyz = [1, 0, 0, 0]";
        assert!(toml::from_str::<PoseConfig>(both).unwrap_err().message().contains("not both"));
        assert!(toml::from_str::<PoseConfig>("position_m = [0, 0, 0]\nrpy_rad = [nan, 0, 0]").is_err());
        for text in [
            "position_m = [nan, 0, 0]",
            "position_m = [0, 0, 0]\nquaternion_wxyz = [0, 0, 0, 0]",
            "position_m = [0, 0, 0]\nquaternion_wxyz = [inf, 0, 0, 0]",
        ] {
            assert!(toml::from_str::<PoseConfig>(text).unwrap().to_isometry().is_err(), "{text}");
        }
        assert!(toml::from_str::<PoseConfig>("position_m = [0, 0, 0]\nyaw = 1.0").is_err());
    }

    proptest! {
        #[test]
        fn an_isometry_survives_the_file(
            t in prop::array::uniform3(-2.0..2.0_f64),
            rpy in prop::array::uniform3(-3.0..3.0_f64),
        ) {
            let pose = Isometry3::from_parts(
                Translation3::from(t),
                UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
            );
            let text = toml::to_string(&PoseConfig::from_isometry(&pose)).unwrap();
            let back = toml::from_str::<PoseConfig>(&text).unwrap().to_isometry().unwrap();
            prop_assert!((back.translation.vector - pose.translation.vector).norm() < 1e-12);
            prop_assert!(back.rotation.angle_to(&pose.rotation) < 1e-7);
        }
    }
}
