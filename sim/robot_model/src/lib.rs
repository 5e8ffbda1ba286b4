//! The robot and its sense of touch as data: URDF kinematics, tactile layouts, objects and stations.
//!
//! The main types are [`Robot`] (forward kinematics; [`ik`] goes back), [`TactileLayout`] (which channels exist and where their
//! surface nodes and taxels sit), [`ObjectModel`] (what is touched) and [`Station`] (which of these belong
//! together, with limits and rates). Everything is parsed from text that the caller read: this crate opens no
//! file and knows no particular robot, so it runs in the browser too.

mod config;
mod error;
pub mod hardware;
pub mod ik;
mod layout;
pub mod new_station;
mod object;
mod object_path;
mod place;
mod pose;
mod robot;
mod station;
mod tare;

pub use error::ModelError;
pub use hardware::{
    ArmConfig, BoardConfig, DeviceConfig, DeviceKind, JointSafety, MAX_CURRENT_LIMIT_A, SafetyConfig,
    ServoBusConfig, ServoConfig, WorkspaceBox,
};
pub use layout::{AxesReading, Channel, Patch, SensorKind, Stream, SurfaceNode, TactileLayout, TaxelAxes};
pub use object::{ConvexPart, ConvexShape, ObjectGroup, ObjectModel, ObjectShape};
pub use object_path::{FixedBox, ObjectPath};
pub use place::Place;
pub use pose::PoseConfig;
pub use robot::{
    Inertial, Joint, JointKind, JointLimits, KnownPoses, Led, Link, LinkGeometry, LinkPoses, LinkShape,
    LinkTracker, Mimic, Robot, SimplifiedUrdf, simplify_urdf,
};
pub use station::{Station, StationFiles, StreamConfig};
pub use tare::Tare;
