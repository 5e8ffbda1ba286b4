//! The tactile layout: streams, patches, taxels and the surface nodes that stand for the sensing skin.

mod config;
mod map;
mod read;
mod surface;

use nalgebra::{Isometry3, Point3, Unit, Vector3};

pub use config::AxesReading;
pub(crate) use read::taxel_axes;

use crate::{ModelError, Robot};

/// Every tactile channel of a hand (or of any other probe), in channel order.
///
/// Channels are numbered through: streams in file order, patches in file order within their stream, taxels in file
/// order within their patch.
#[derive(Clone, Debug)]
pub struct TactileLayout {
    /// Name of the layout.
    pub name: String,
    /// Streams, in channel order.
    pub streams: Vec<Stream>,
    /// Patches, in channel order.
    pub patches: Vec<Patch>,
    /// Channels, in order.
    pub channels: Vec<Channel>,
}

/// Channels that arrive together, from one kind of device.
#[derive(Clone, Debug)]
pub struct Stream {
    /// Stable id, e.g. `twintac`.
    pub id: String,
    /// Name for people, e.g. `TwinTac`.
    pub label: String,
    /// How these sensors turn contact into a reading.
    pub kind: SensorKind,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Channels of this stream: a contiguous range.
    pub channels: std::ops::Range<usize>,
    /// Unit of a raw reading as it is displayed, e.g. `counts`.
    pub raw_unit: String,
    /// The axes of its taxels, and how they become a reading.
    pub axes: TaxelAxes,
}

/// How many numbers a taxel measures, and how they become the one reading that everything works with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TaxelAxes {
    /// One, which is the reading.
    #[default]
    One,
    /// Several; the reading is the Euclidean norm of their change from where they are without touch.
    Norm {
        /// How many: 2 or 3.
        count: usize,
    },
    /// Several, one of which is along the outward normal; that one is the reading.
    Normal {
        /// How many: 2 or 3.
        count: usize,
        /// Index of the one along the normal.
        axis: usize,
        /// Whether pressing makes it fall: then the reading is its negative.
        falls: bool,
    },
}

impl TaxelAxes {
    /// What axes are called, in order.
    pub const NAMES: [&'static str; 3] = ["x", "y", "z"];

    /// How many there are.
    pub fn count(self) -> usize {
        match self {
            Self::One => 1,
            Self::Norm { count } | Self::Normal { count, .. } => count,
        }
    }

    /// The names of those that there are.
    pub fn names(self) -> &'static [&'static str] {
        &Self::NAMES[..self.count().min(Self::NAMES.len())]
    }
}

/// How a sensor turns contact into a reading (paper, section "Contact Modeling").
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorKind {
    /// Active if any surface node of the patch is nearer to the object than `lambda_con` (FSR patches).
    Proximity,
    /// Node pressures propagate to the taxels with `exp(-alpha * distance)`; active above `lambda_pre` (TwinTac).
    Pressure,
}

/// One sensing patch, fixed to a link.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Stable id, e.g. `index_tip`.
    pub id: String,
    /// Name for people, e.g. `Index tip`.
    pub label: String,
    /// Group for the flat map and for lists: `index`, `middle`, `palm`, ...
    pub group: String,
    /// Index of its stream.
    pub stream: usize,
    /// Index of its link in the robot.
    pub link: usize,
    /// Pose of the patch in its link.
    pub link_from_patch: Isometry3<f64>,
    /// Surface nodes, in the link's frame.
    pub nodes: Vec<SurfaceNode>,
    /// Taxel positions in the link's frame, one per channel of the patch.
    pub taxels_in_link: Vec<Point3<f64>>,
    /// Taxel outward normals in the link's frame.
    pub taxel_normals_in_link: Vec<Unit<Vector3<f64>>>,
    /// Channels of this patch: a contiguous range.
    pub channels: std::ops::Range<usize>,
    /// Pressure per depth of the penalty model, Pa/m; used by [`SensorKind::Pressure`] only.
    pub stiffness_pa_per_m: f64,
    /// Where each taxel is drawn on the flat map, in layout units (x right, y up), one per channel.
    pub map_positions: Vec<[f64; 2]>,
}

/// A point of the sensing surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceNode {
    /// Position in the link's frame, m.
    pub pos_in_link: Point3<f64>,
    /// Outward normal in the link's frame.
    pub normal_in_link: Unit<Vector3<f64>>,
}

/// One tactile channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Stable id, e.g. `index_tip.3`, or the patch's id where it has one channel.
    pub id: String,
    /// Index of its stream.
    pub stream: usize,
    /// Index of its patch.
    pub patch: usize,
    /// Index of its taxel in the patch.
    pub taxel: usize,
}

impl TactileLayout {
    /// What people call a channel: the name of its patch, with the number of the taxel where the patch has several, the
    /// same as in its id: `Index tip · 4` is `index_tip.4`.
    pub fn channel_label(&self, channel_idx: usize) -> String {
        let channel = &self.channels[channel_idx];
        let patch = &self.patches[channel.patch];
        if patch.channels.len() == 1 {
            patch.label.clone()
        } else {
            format!("{} \u{b7} {}", patch.label, channel.taxel)
        }
    }

    /// Reads a layout file against the robot it belongs to. `file` names it in errors.
    ///
    /// Refused, naming line and patch: an unknown link or stream, no taxels, a taxel beside the surface, sizes or
    /// spacing that are not positive, a duplicate id, unknown keys.
    ///
    /// ```
    /// use palpate_robot_model::{Robot, SensorKind, TactileLayout};
    ///
    /// let robot = Robot::from_urdf("finger.urdf", r#"<robot name="finger"><link name="tip"/></robot>"#, &[])?;
    /// let layout = TactileLayout::from_toml("finger.toml", r#"
    ///     name = "One finger"
    ///
    ///     [[stream]]
    ///     id = "gel"
    ///     label = "Gel"
    ///     kind = "pressure"
    ///     rate_hz = 100.0
    ///     raw_unit = "counts"
    ///
    ///     ## A finger pad: half a cylinder along x, closed by a dome at the tip. The outward normal at the origin is +z.
    ///     [[patch]]
    ///     id = "pad"
    ///     label = "Finger pad"
    ///     group = "finger"
    ///     stream = "gel"
    ///     link = "tip"
    ///     pose = { position_m = [0.0, 0.0, 0.01] }
    ///     shape = { kind = "arc", radius_m = 0.01, arc_rad = 2.4, length_m = 0.02, dome_rad = 1.4 }
    ///     node_spacing_m = 0.002
    ///     stiffness_pa_per_m = 2.0e7
    ///     taxels_m = [[-0.005, 0.0], [0.005, 0.0], [0.015, 0.0]]
    /// "#, &robot)?;
    ///
    /// assert_eq!(layout.streams[0].kind, SensorKind::Pressure);
    /// assert_eq!(layout.channels[2].id, "pad.2");
    /// // Taxels are named by where they appear from above, and lie on the skin.
    /// let top = layout.patches[0].taxels_in_link[0];
    /// assert!((top.z - 0.01).abs() < 1e-12);
    /// # Ok::<(), palpate_robot_model::ModelError>(())
    /// ```
    pub fn from_toml(file: &str, text: &str, robot: &Robot) -> Result<Self, ModelError> {
        read::layout(file, text, robot)
    }

    /// Number of channels.
    pub fn num_channels(&self) -> usize {
        self.channels.len()
    }

    /// What axis `axis_idx` of a channel is called, for a stream of several: `index_tip.3.z`.
    pub fn axis_id(&self, channel_idx: usize, axis_idx: usize) -> String {
        let name = TaxelAxes::NAMES.get(axis_idx).copied().unwrap_or_default();
        format!("{}.{name}", self.channels[channel_idx].id)
    }

    /// The stream called `id`.
    pub fn stream_index(&self, id: &str) -> Option<usize> {
        self.streams.iter().position(|stream| stream.id == id)
    }
}
