//! What is not quite as the files say, in every session otherwise.
//!
//! Further worlds have one part of it alone ([`Part`]), so that a report can say which part a diagnosis does not bear.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::{JointKind, Station};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{normal, within};

/// The parts of which a world has one or all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Stiffening, spread, creep and hysteresis of skin.
    Skin,
    /// Filters, wander, noise and clocks of boards, and gains of channels.
    Boards,
    /// Zeros of encoders, where patches and objects are, and how people move and mark.
    GeometryAndOperator,
}

/// What is mild and usual about a station on one day.
#[derive(Clone, Debug)]
pub(super) struct Imperfections {
    /// Measured less true position, per degree of freedom: hands are zeroed by eye against a jig, to about a
    /// milliradian.
    pub(super) encoder_zeros: Vec<f64>,
    /// Where each patch sits beside its place, m.
    pub(super) mounts: Vec<Vector3<f64>>,
    /// Where the object stands beside its recorded pose, on the left of that.
    pub(super) object_offset: Isometry3<f64>,
    pub(super) object_scale: f64,
    /// Per channel.
    pub(super) gains: Vec<f64>,
    /// Per stream.
    pub(super) skins: Vec<SkinConfig>,
    /// Per stream.
    pub(super) boards: Vec<BoardConfig>,
    pub(super) operator: OperatorConfig,
}

/// A skin of one stream.
///
/// Stiffening and hysteresis are those of filled silicone under indentation (Mullins 1969; Bergstrom and Boyce 1998),
/// creep that of soft tactile skins: some per cent over seconds (Dahiya et al. 2010).
#[derive(Clone, Copy, Debug)]
pub(super) struct SkinConfig {
    pub(super) thickness_m: f64,
    /// Pressure grows with this power of small strains: rough surfaces meet bit by bit.
    pub(super) exponent: f64,
    /// Share by which pressure grows faster at a strain of one.
    pub(super) stiffening: f64,
    /// Standard deviation of the spread from a spot of the surface to a taxel, m.
    pub(super) spread_m: f64,
    pub(super) spread: Spread,
    /// Shares of a load that come late, and their times, s.
    pub(super) creep: [(f64, f64); 2],
    /// Share of a load by which unloading lags behind loading, at any speed.
    pub(super) hysteresis: f64,
}

/// How pressure spreads with the distance from a spot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Spread {
    Gaussian,
    Exponential,
}

/// A board of one stream. Raw units are multiples of the stream's threshold.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoardConfig {
    pub(super) rc_s: f64,
    pub(super) latency_s: f64,
    /// Mean of what is random about the latency, s.
    pub(super) jitter_s: f64,
    /// Share of samples that never arrive.
    pub(super) lost: f64,
    /// Device clock against host clock, s per s.
    pub(super) skew: f64,
    pub(super) noise: f64,
    pub(super) hum: f64,
    /// Standard deviation of the slow wander of a channel, and of the board as a whole.
    pub(super) wander: [f64; 2],
}

/// Whoever moves the hand and marks what it does.
#[derive(Clone, Copy, Debug)]
pub(super) struct OperatorConfig {
    /// Standard deviation of the logarithm of the pace of a repetition.
    pub(super) pace: f64,
    /// Longest pause before one, s.
    pub(super) longest_pause_s: f64,
    /// Standard deviation of a mark, s.
    pub(super) mark_s: f64,
    pub(super) marks: Marks,
}

/// How repetitions are marked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Marks {
    /// Each with what it does.
    Labelled,
    /// By their times alone.
    Plain,
    /// Not at all.
    None,
}

impl Imperfections {
    pub(super) fn draw(station: &Station, rng: &mut ChaCha8Rng) -> Self {
        let layout = &station.layout;
        let vector = |size: f64, rng: &mut ChaCha8Rng| Vector3::from_fn(|_, _| size * normal(rng));
        let encoder_zeros = station
            .robot
            .dofs()
            .map(|joint| normal(rng) * if joint.kind == JointKind::Revolute { 1e-3 } else { 1e-4 })
            .collect();
        let mounts = layout.patches.iter().map(|_| vector(1e-4, rng)).collect();
        let shift = vector(1.5e-4, rng);
        Self {
            encoder_zeros,
            mounts,
            object_offset: Isometry3::from_parts(Translation3::from(shift), UnitQuaternion::identity()),
            object_scale: 1.0 + 0.002 * normal(rng),
            gains: layout.channels.iter().map(|_| (0.03 * normal(rng)).exp()).collect(),
            skins: layout.streams.iter().map(|_| SkinConfig::draw(rng)).collect(),
            boards: layout.streams.iter().map(|_| BoardConfig::draw(rng)).collect(),
            operator: OperatorConfig::draw(rng),
        }
    }

    /// This with `part` alone, and all else as in the files, or as good as things are.
    pub(super) fn only(mut self, part: Part) -> Self {
        if part != Part::Skin {
            self.skins.iter_mut().for_each(SkinConfig::make_plain);
        }
        if part != Part::Boards {
            self.gains.fill(1.0);
            self.boards.iter_mut().for_each(BoardConfig::make_plain);
        }
        if part != Part::GeometryAndOperator {
            self.encoder_zeros.fill(0.0);
            self.mounts.fill(Vector3::zeros());
            self.object_offset = Isometry3::identity();
            self.object_scale = 1.0;
            self.operator = OperatorConfig::EXACT;
        }
        self
    }
}

impl SkinConfig {
    /// Proportional, without memory, and spread as the simulator has it.
    fn make_plain(&mut self) {
        self.exponent = 1.0;
        self.stiffening = 0.0;
        self.spread = Spread::Exponential;
        self.creep = self.creep.map(|(_, time_s)| (0.0, time_s));
        self.hysteresis = 0.0;
    }

    fn draw(rng: &mut ChaCha8Rng) -> Self {
        Self {
            thickness_m: within(rng, [0.003, 0.005]),
            exponent: within(rng, [1.1, 1.4]),
            stiffening: within(rng, [1.0, 3.0]),
            spread_m: within(rng, [0.0016, 0.0026]),
            spread: Spread::Gaussian,
            creep: [
                (within(rng, [0.02, 0.06]), within(rng, [0.2, 0.6])),
                (within(rng, [0.02, 0.06]), within(rng, [5.0, 15.0])),
            ],
            hysteresis: within(rng, [0.01, 0.04]),
        }
    }
}

impl BoardConfig {
    /// A fast filter, a little noise, and nothing else.
    fn make_plain(&mut self) {
        *self = Self {
            rc_s: 0.004,
            latency_s: 0.001,
            jitter_s: 0.0,
            lost: 0.0,
            skew: 0.0,
            noise: 0.01,
            hum: 0.0,
            wander: [0.0; 2],
        };
    }

    fn draw(rng: &mut ChaCha8Rng) -> Self {
        Self {
            rc_s: within(rng, [0.004, 0.010]),
            latency_s: within(rng, [0.001, 0.003]),
            jitter_s: within(rng, [0.0005, 0.002]),
            lost: within(rng, [0.0, 0.004]),
            skew: 2e-5 * normal(rng),
            noise: within(rng, [0.01, 0.03]),
            hum: within(rng, [0.0, 0.02]),
            wander: [within(rng, [0.005, 0.02]), within(rng, [0.0, 0.02])],
        }
    }
}

impl OperatorConfig {
    /// One pace, no pause, and marks on the spot.
    const EXACT: Self = Self { pace: 0.0, longest_pause_s: 0.0, mark_s: 0.0, marks: Marks::Labelled };

    fn draw(rng: &mut ChaCha8Rng) -> Self {
        let marks = match rng.random::<f64>() {
            0.0..0.6 => Marks::Labelled,
            0.6..0.9 => Marks::Plain,
            _ => Marks::None,
        };
        Self {
            pace: within(rng, [0.02, 0.15]),
            longest_pause_s: within(rng, [0.2, 1.0]),
            mark_s: within(rng, [0.05, 0.15]),
            marks,
        }
    }
}
