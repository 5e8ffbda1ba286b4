//! Servo logs as measurements for the engine.
//!
//! A log is cut into short windows; the model is driven through each from the state that the measurements show at its
//! beginning (multiple shooting), so that what it misses shows where it acts and does not pile up.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use palpate_recording::{RegisterUnits, ServoLog};
use palpate_robot_model::Place;
use palpate_sim::actuator::{self, Drive, Plant, Sensed, Start, rollout};
use palpate_sim::effects::{Effect, Parameter};
use rayon::prelude::*;

use crate::DiagnosisError;
use crate::engine::{BaseParameter, Domain, Model, Series};

/// Length of a window, s: long enough for a friction of 5 mN m to move the joint by several encoder counts, short
/// enough that windows of one second of motion differ.
const WINDOW_S: f64 = 0.16;
/// Rows of about this long a time depend on each other, s.
const BLOCK_S: f64 = 0.9;
/// Samples on each side that the state at a window's beginning is smoothed over.
const SMOOTHING: usize = 5;
/// Standard deviation of a measured position, rad, of an encoder of 4,096 counts a turn: a count is 1.5 mrad, and a
/// window's model is no better.
pub(super) const POSITION_RAD: f64 = 1.0e-3;
/// Standard deviation of the position at a window's beginning, rad.
const START_RAD: f64 = 0.7e-3;
/// Standard deviation of the speed at a window's beginning, rad/s.
const START_RAD_PER_S: f64 = 0.03;
/// Standard deviation of a duty: it is read some milliseconds beside the position.
const DUTY: f64 = 0.02;
/// Standard deviation of a supply voltage, V: single readings between the pulses of the driver.
const SUPPLY_V: f64 = 0.5;
/// Standard deviation of whether a reading exceeds the signed range.
const CARRY: f64 = 0.3;
/// Where the supply factor is in a model's base.
pub(super) const SUPPLY: usize = 2;
/// Number of signals.
pub(super) const SIGNALS: usize = SIGNAL_NAMES.len();
/// The signals.
pub(super) const SIGNAL_NAMES: [&str; 4] = ["position", "PWM", "supply voltage", "sign of the PWM"];
/// Weight of each signal.
const WEIGHTS: [f64; SIGNALS] = [1.0, 1.0 / DUTY, 1.0 / SUPPLY_V, 1.0 / CARRY];
/// What motors of one make differ by from their datasheet, as a share: the tolerance of magnets and windings.
const MOTOR_SPREAD: f64 = 0.1;
/// What a supply differs by from the voltage that the log states, as a share.
const SUPPLY_SPREAD: f64 = 0.03;
/// What the torque of a load differs by from that of the mass and length that the log states, as a share: these are weighed
/// and measured. What no datasheet states, such as the inertia of a rotor, may be anything.
const LOAD_SPREAD: f64 = 0.05;
/// Highest PWM reading that a signed register can hold.
const SIGNED_MAX: f64 = 32_767.0;
/// What a sixteen-bit reading wraps at.
const WRAP: f64 = 65_536.0;
/// Position gain of a servo as it is delivered, for logs that do not say.
pub(super) const DEFAULT_GAIN: f64 = 400.0;
/// Supply that the torque constants assume, V, for logs that do not say.
pub(super) const DEFAULT_SUPPLY_V: f64 = 5.0;

/// Servo logs, and the actuator models that predict them.
///
/// Each sample has four signals. Position: whitened within its window, for errors of the start grow along it. PWM: as a
/// duty, from the sixteen bits that the register has. Supply voltage. And whether the PWM reading exceeds the signed
/// range, which no plant explains but `integer_wrap`: reading that signal and the PWM apart keeps the readings' defect from
/// drowning the rest without repairing it.
pub struct ActuatorDomain<'a> {
    logs: Vec<Prepared<'a>>,
    base: Vec<BaseParameter>,
    /// What is stated of the motor.
    stated: Plant,
    load_is_stated: bool,
}

struct Prepared<'a> {
    log: &'a ServoLog,
    gain_per_rad: f64,
    windows: Vec<Window>,
    blocks: Vec<Range<usize>>,
    observed: Vec<Series>,
}

struct Window {
    samples: Range<usize>,
    start: Start,
    /// Lower Cholesky factor of the covariance of its positions.
    factor: DMatrix<f64>,
}

impl<'a> ActuatorDomain<'a> {
    /// Prepares `logs`, which share one actuator.
    ///
    /// # Errors
    /// If there are none, a log is too short for a window, or logs state different things of the actuator.
    pub fn new(logs: &'a [ServoLog]) -> Result<Self, DiagnosisError> {
        if logs.is_empty() {
            return Err(DiagnosisError::Input("nothing to diagnose: there is no servo log".to_owned()));
        }
        let stated = stated(logs)?;
        let prepared = logs.par_iter().map(Prepared::new).collect::<Result<Vec<_>, _>>()?;
        let base =
            |name: &str, lower, upper, dose| BaseParameter { name: name.to_owned(), lower, upper, dose };
        let load_is_stated = logs[0].states_load();
        let resistance = if load_is_stated {
            base("resistance_ohm", 0.5, 40.0, 0.1)
        } else {
            // Twice the load on twice the motor moves alike: somebody must say what one of them is.
            base("resistance_ohm", stated.resistance_ohm, stated.resistance_ohm, 0.1)
        };
        Ok(Self {
            logs: prepared,
            base: vec![
                base("torque_constant_nm_per_a", 0.05, 2.0, 0.01),
                resistance,
                base("supply_factor", 0.5, 1.5, 0.01),
            ],
            stated,
            load_is_stated,
        })
    }

    /// The model that the datasheet describes.
    pub fn nominal(&self) -> Model {
        let Plant { torque_constant_nm_per_a, resistance_ohm, supply_factor, .. } = self.stated;
        Model { base: vec![torque_constant_nm_per_a, resistance_ohm, supply_factor], effects: Vec::new() }
    }

    /// The log `take`.
    pub fn log(&self, take: usize) -> &ServoLog {
        self.logs[take].log
    }

    /// What drives the joint in `take`.
    pub fn drive(&self, take: usize) -> Drive<'_> {
        self.logs[take].drive()
    }

    /// Where the joint is at the beginning of `take`.
    pub fn start(&self, take: usize) -> Start {
        smoothed(self.logs[take].log, 0)
    }

    /// The plant that `model` describes; of one that is deployed, with what was fitted along.
    ///
    /// # Errors
    /// If an effect is none of the actuator's.
    pub fn plant(&self, model: &Model) -> Result<Plant, DiagnosisError> {
        let of_base = |idx: usize| model.base.get(idx).copied().unwrap_or(0.0);
        let mut plant = Plant {
            torque_constant_nm_per_a: of_base(0),
            resistance_ohm: of_base(1),
            supply_factor: of_base(SUPPLY),
            coulomb_nm: of_base(3),
            viscous_nm_s_per_rad: of_base(4),
            encoder_offset_rad: of_base(5),
            ..Plant::default()
        };
        plant.add(&model.effects).map_err(|id| {
            DiagnosisError::Input(format!(
                "the library of actuator effects has no {id:?}; remove it from the model"
            ))
        })?;
        Ok(plant)
    }

    /// Positions by driving `model` through the whole of `take` from its first measured position, rad.
    ///
    /// # Errors
    /// If an effect is none of the actuator's.
    pub fn open_loop(&self, take: usize, model: &Model) -> Result<Vec<f64>, DiagnosisError> {
        let drive = self.drive(take);
        let sensed = rollout(&self.plant(model)?, &drive, self.start(take), drive.times_s.len());
        Ok(sensed.iter().map(|sensed| sensed.position_rad).collect())
    }

    /// Samples of each window of `take`, with the state at its beginning.
    pub(super) fn windows(&self, take: usize) -> impl Iterator<Item = (Range<usize>, Start)> + '_ {
        self.logs[take].windows.iter().map(|window| (window.samples.clone(), window.start))
    }

    /// Positions by shooting through each window of `take`, rad.
    pub(super) fn shot(&self, take: usize, model: &Model) -> Result<Vec<f64>, DiagnosisError> {
        let prepared = &self.logs[take];
        let plant = self.plant(model)?;
        Ok(prepared.shoot(&plant).iter().map(|sensed| sensed.position_rad).collect())
    }
}

impl<'a> Prepared<'a> {
    fn new(log: &'a ServoLog) -> Result<Self, DiagnosisError> {
        let num_samples = log.times_s.len();
        let too_short = || {
            DiagnosisError::Input(format!(
                "log {:?} has {num_samples} samples: too few for a window of {WINDOW_S} s; record longer or faster",
                log.id
            ))
        };
        if num_samples < 4 * SMOOTHING {
            return Err(too_short());
        }
        let duration_s = log.times_s[num_samples - 1] - log.times_s[0];
        let window = (WINDOW_S * (num_samples - 1) as f64 / duration_s).round().max(8.0) as usize;
        let num_windows = num_samples / window;
        if num_windows == 0 {
            return Err(too_short());
        }
        let windows: Vec<Window> = (0..num_windows)
            .map(|idx| {
                // The rest of the log goes to its last window.
                let end = if idx + 1 == num_windows { num_samples } else { (idx + 1) * window };
                Window::new(log, idx * window..end)
            })
            .collect::<Option<_>>()
            .ok_or_else(too_short)?;
        let per_block = (BLOCK_S / WINDOW_S).round() as usize;
        let blocks = windows
            .chunks(per_block)
            .map(|windows| {
                let (first, last) = (&windows[0], &windows[windows.len() - 1]);
                first.samples.start..last.samples.end
            })
            .collect();
        let gain = log.position_gain_register.unwrap_or(DEFAULT_GAIN);
        let mut prepared =
            Self { log, gain_per_rad: log.units.duty_per_rad(gain), windows, blocks, observed: Vec::new() };
        let measured = |idx: usize| {
            let reading = log.pwm_register.get(idx).copied().unwrap_or(f64::NAN);
            let exceeds = reading > SIGNED_MAX;
            Sensed {
                position_rad: log.positions_rad[idx],
                duty: (if exceeds { reading - WRAP } else { reading }) / log.units.full_pwm,
                supply_v: log.input_v.get(idx).copied().unwrap_or(f64::NAN),
                carry: if reading.is_nan() { f64::NAN } else { f64::from(u8::from(exceeds)) },
            }
        };
        let measured: Vec<Sensed> = (0..num_samples).map(measured).collect();
        prepared.observed = prepared.signals(&measured);
        Ok(prepared)
    }

    fn drive(&self) -> Drive<'_> {
        Drive {
            times_s: &self.log.times_s,
            goals_rad: &self.log.goals_rad,
            torque_on: &self.log.torque_on,
            gain_per_rad: self.gain_per_rad,
            supply_v: self.log.supply_v.unwrap_or(DEFAULT_SUPPLY_V),
            mass_kg: self.log.mass_kg,
            length_m: self.log.length_m,
        }
    }

    fn shoot(&self, plant: &Plant) -> Vec<Sensed> {
        let drive = self.drive();
        let shot = |window: &Window| rollout(plant, &drive, window.start, window.samples.len());
        self.windows.iter().flat_map(shot).collect()
    }

    /// Samples by signal, positions whitened.
    fn signals(&self, sensed: &[Sensed]) -> Vec<Series> {
        let mut whitened = Vec::with_capacity(sensed.len());
        for window in &self.windows {
            // Positions from the start on, so that rounding does not grow with the angle.
            let start_rad = window.start.position_rad;
            let mut positions = DVector::from_iterator(
                window.samples.len(),
                window.samples.clone().map(|idx| sensed[idx].position_rad - start_rad),
            );
            window.factor.solve_lower_triangular_mut(&mut positions);
            whitened.extend(positions.iter());
        }
        let signal = |of: fn(&Sensed) -> f64| -> Series { sensed.iter().map(of).collect() };
        vec![whitened.into(), signal(|s| s.duty), signal(|s| s.supply_v), signal(|s| s.carry)]
    }
}

impl Window {
    fn new(log: &ServoLog, samples: Range<usize>) -> Option<Self> {
        let start_s = log.times_s[samples.start];
        let since: Vec<f64> = samples.clone().map(|idx| log.times_s[idx] - start_s).collect();
        let position_rad = position_rad(&log.units);
        // The start is smoothed from positions.
        let start_rad = START_RAD * position_rad / POSITION_RAD;
        let covariance = DMatrix::from_fn(since.len(), since.len(), |row, column| {
            let own = if row == column { position_rad.powi(2) } else { 0.0 };
            own + start_rad.powi(2) + START_RAD_PER_S.powi(2) * since[row] * since[column]
        });
        let factor = covariance.cholesky()?.unpack();
        Some(Self { start: smoothed(log, samples.start), samples, factor })
    }
}

/// What `logs` state of the motor, on which they must agree.
fn stated(logs: &[ServoLog]) -> Result<Plant, DiagnosisError> {
    let says =
        |log: &ServoLog| (log.torque_constant_nm_per_a, log.resistance_ohm, log.units, log.states_load());
    if let Some(other) = logs.iter().find(|log| says(log) != says(&logs[0])) {
        return Err(DiagnosisError::Input(format!(
            "logs {:?} and {:?} differ in what they state of the actuator (torque_constant, resistance, \
             counts_per_turn, full_pwm, unit_gain, or whether the mass is known); logs of one actuator must state \
             the same",
            logs[0].id, other.id
        )));
    }
    let plant = Plant::default();
    Ok(Plant {
        torque_constant_nm_per_a: logs[0].torque_constant_nm_per_a.unwrap_or(plant.torque_constant_nm_per_a),
        resistance_ohm: logs[0].resistance_ohm.unwrap_or(plant.resistance_ohm),
        ..plant
    })
}

/// Standard deviation of a measured position, rad: the coarser the encoder, the larger.
fn position_rad(units: &RegisterUnits) -> f64 {
    POSITION_RAD * (RegisterUnits::default().counts_per_turn / units.counts_per_turn).max(1.0)
}

/// The state at `sample`: a parabola through the positions around it.
fn smoothed(log: &ServoLog, sample: usize) -> Start {
    let around = sample.saturating_sub(SMOOTHING)..(sample + SMOOTHING + 1).min(log.times_s.len());
    let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros());
    for idx in around {
        let since = log.times_s[idx] - log.times_s[sample];
        let powers = nalgebra::Vector3::new(1.0, since, 0.5 * since * since);
        normal += powers * powers.transpose();
        right += powers * log.positions_rad[idx];
    }
    let state = normal.cholesky().map_or_else(
        || nalgebra::Vector3::new(log.positions_rad[sample], 0.0, 0.0),
        |factor| factor.solve(&right),
    );
    Start { sample, position_rad: state[0], speed_rad_per_s: state[1], acceleration_rad_per_s2: state[2] }
}

impl Domain for ActuatorDomain<'_> {
    fn num_takes(&self) -> usize {
        self.logs.len()
    }

    fn blocks(&self, take: usize) -> &[Range<usize>] {
        &self.logs[take].blocks
    }

    fn observed(&self, take: usize, signal: usize) -> &[f64] {
        &self.logs[take].observed[signal]
    }

    fn base(&self) -> &[BaseParameter] {
        &self.base
    }

    fn candidates(&self) -> Vec<Effect> {
        let joint = &self.logs[0].log.joint;
        actuator::ACTUATOR
            .iter()
            .filter(|kind| kind.could_be(self.load_is_stated))
            .map(|kind| Effect {
                id: kind.id().to_owned(),
                place: Place::Joint(joint.clone()),
                parameters: kind.parameters().into_iter().map(|p| (p.name, p.neutral)).collect(),
                interval: Default::default(),
                takes: Vec::new(),
            })
            .collect()
    }

    fn parameters(&self, effect: &Effect) -> Vec<Parameter> {
        actuator::actuator(&effect.id).map_or_else(Vec::new, |kind| kind.parameters())
    }

    fn num_units(&self) -> usize {
        SIGNALS
    }

    fn support(&self, _effect: &Effect, _parameter: &str) -> Vec<bool> {
        vec![true; SIGNALS]
    }

    fn predict(&self, take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
        let prepared = &self.logs[take];
        let signals = prepared.signals(&prepared.shoot(&self.plant(model)?));
        let unbounded = signals.iter().find_map(|series| series.iter().position(|value| !value.is_finite()));
        match unbounded {
            Some(sample) => Err(DiagnosisError::Input(format!(
                "the model leaves all bounds at sample {sample} of log {:?}: {:?}",
                prepared.log.id, model
            ))),
            None => Ok(signals),
        }
    }

    /// A pendulum with a heavier rotor moves as one with a lighter load and a higher resistance of the winding does: only
    /// what is stated tells them apart.
    fn strain(&self, model: &Model) -> Result<f64, DiagnosisError> {
        let (plant, stated) = (self.plant(model)?, &self.stated);
        let factors = [
            (plant.torque_constant_nm_per_a / stated.torque_constant_nm_per_a, MOTOR_SPREAD),
            (plant.resistance_ohm / stated.resistance_ohm, MOTOR_SPREAD),
            (plant.supply_factor / stated.supply_factor, SUPPLY_SPREAD),
            (plant.gravity_factor / stated.gravity_factor, LOAD_SPREAD),
        ];
        Ok(factors.iter().map(|(factor, spread)| (factor.ln() / spread).powi(2)).sum())
    }

    fn weights(&self, _take: usize, signal: usize, prediction: &[f64]) -> Vec<f64> {
        vec![WEIGHTS[signal]; prediction.len()]
    }
}
