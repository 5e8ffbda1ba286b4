//! Where an object is while a take goes on.

use nalgebra::Isometry3;

/// A box that stands still beside an object, as a table does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedBox {
    /// Where its middle is, in the base frame.
    pub base_from_box: Isometry3<f64>,
    /// Its edges along its own axes, m; each above 0.
    pub size_m: [f64; 3],
}

/// Poses of an object in the base frame, over the frames of a take.
///
/// ```
/// use nalgebra::Isometry3;
/// use palpate_robot_model::ObjectPath;
///
/// let still = ObjectPath::from(Isometry3::translation(0.4, 0.0, 0.1));
/// assert_eq!(still.at(7).translation.x, 0.4);
///
/// let pushed = ObjectPath::Moving(vec![
///     Isometry3::translation(0.4, 0.0, 0.1), Isometry3::translation(0.41, 0.0, 0.1),
/// ]);
/// assert_eq!(pushed.at(1).translation.x, 0.41);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum ObjectPath {
    /// It stands still at this base_from_object.
    Still(Isometry3<f64>),
    /// base_from_object of each frame.
    Moving(Vec<Isometry3<f64>>),
}

impl ObjectPath {
    /// base_from_object of `frame`; of the last one behind it. A path of no frames is at the origin.
    pub fn at(&self, frame: usize) -> Isometry3<f64> {
        match self {
            Self::Still(pose) => *pose,
            Self::Moving(poses) => poses.get(frame).or(poses.last()).copied().unwrap_or_default(),
        }
    }

    /// The one pose of an object that stands still, or one pose a frame.
    pub fn poses(&self) -> &[Isometry3<f64>] {
        match self {
            Self::Still(pose) => std::slice::from_ref(pose),
            Self::Moving(poses) => poses,
        }
    }

    /// As [`Self::poses`], to be changed.
    pub fn poses_mut(&mut self) -> &mut [Isometry3<f64>] {
        match self {
            Self::Still(pose) => std::slice::from_mut(pose),
            Self::Moving(poses) => poses,
        }
    }
}

impl From<Isometry3<f64>> for ObjectPath {
    fn from(pose: Isometry3<f64>) -> Self {
        Self::Still(pose)
    }
}
