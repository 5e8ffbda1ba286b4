//! The second world of touch, written from physics and not from the library of effects.
//!
//! It shares kinematics, geometry and the catalogue of what is hidden with the emulated station, and nothing of its
//! physics:
//!
//! | | emulated station | here |
//! |---|---|---|
//! | skin | sheet of linear solids that drag their neighbours | stiffening power law, Gaussian spread, creep with two times, rate-independent hysteresis |
//! | electronics | converter, firmware threshold | RC filter, wander of a board, mains, rounding, samples that are lost |
//! | geometry | as in the files | every encoder zero, patch and object a little off |
//! | operator | one pace, exact marks | a pace and a pause for each repetition, marks by hand |
//! | recording | takes in memory | CSV files, imported |
//!
//! What is imperfect here is mild and usual, and drawn anew for each session ([`Imperfections`]). No constant of the
//! diagnosis may be chosen by what this world shows: it is for reports.

mod electronics;
mod files;
mod imperfections;
mod operator;
mod skin;

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use palpate_recording::Take;
use palpate_robot_model::{JointKind, Place, Station};
use palpate_sim::geometry::SignedDistance;
use palpate_truth::{Case, Expected, Hidden, Stage, cases};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::BlindError;
use electronics::Board;
use files::TakeFiles;
use imperfections::Imperfections;
pub(crate) use imperfections::Part;
use operator::Pacing;
use skin::Skin;

/// Step of skin, joints and boards, s.
const STEP_S: f64 = 0.0025;
/// Steps between two looks at the geometry.
const STEPS_PER_LOOK: u64 = 2;
/// Counts of a turn of a finger's servo, and of an arm's encoder.
const COUNTS_PER_TURN: [f64; 2] = [4096.0, 65_536.0];
/// Standard deviation of a measured joint before rounding, rad or m.
const JOINT_NOISE: f64 = 2e-4;

/// What of the catalogue this world can hide. Firmware is left out: events of imported readings are the importer's.
const EFFECTS: &[&str] = &[
    "joint_offset",
    "joint_backlash",
    "object_pose_offset",
    "object_scale",
    "sensor_mount_offset",
    "sensitivity_spread",
    "elastic_crosstalk",
    "rate_dependence",
    "preload",
    "viscoelastic_release",
    "low_pass",
    "baseline_drift",
    "electrical_crosstalk",
    "latency",
    "clock_skew",
    "dead_channel",
    "stuck_channel",
    "swapped_channels",
    "mains_hum",
    "joint_dependent_gain",
];

/// The second world around the motions of a truth file, whose own physics it does not use.
pub(crate) struct Second {
    stage: Stage,
    /// What alone is imperfect; everything if `None`.
    part: Option<Part>,
}

/// What a recording keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kept {
    /// Raw readings, from which the importer makes events.
    Readings,
    /// Events alone, as the firmware has them.
    Events,
}

impl Second {
    /// Everything is a little off.
    pub(crate) fn new(stage: Stage) -> Self {
        Self { stage, part: None }
    }

    /// `part` alone is off.
    pub(crate) fn with_only(stage: Stage, part: Part) -> Self {
        Self { stage, part: Some(part) }
    }

    fn imperfections(&self, seed: u64) -> Imperfections {
        let all = Imperfections::draw(self.stage.station(), &mut ChaCha8Rng::seed_from_u64(seed));
        match self.part {
            None => all,
            Some(part) => all.only(part),
        }
    }

    /// The cases of [`cases`] whose effects this world can hide.
    pub(crate) fn cases(&self, nulls: usize, seed: u64) -> Result<Vec<Case>, BlindError> {
        let mut all = cases(&self.stage, nulls, seed)?;
        all.retain(|case| case.hidden.iter().all(|hidden| EFFECTS.contains(&hidden.id.as_str())));
        debug_assert!(all.iter().any(|case| case.expected == Expected::Nothing) || nulls == 0);
        Ok(all)
    }

    /// Records the session with `hidden` in it. Same seed, same takes, for any number of threads.
    pub(crate) fn record(&self, hidden: &[Hidden], seed: u64, kept: Kept) -> Result<Vec<Take>, BlindError> {
        let station = self.stage.station();
        let imperfections = self.imperfections(seed);
        let takes: Vec<TakeFiles> = (0..self.stage.motions().len())
            .into_par_iter()
            .map(|take| {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                rng.set_stream(1 + take as u64);
                self.take(take, hidden, &imperfections, kept, rng)
            })
            .collect::<Result<_, _>>()?;
        files::imported(station, &takes)
    }

    fn take(
        &self,
        take: usize,
        hidden: &[Hidden],
        imperfections: &Imperfections,
        kept: Kept,
        mut rng: ChaCha8Rng,
    ) -> Result<TakeFiles, BlindError> {
        let station = self.stage.station();
        let (motion, planned) = (&self.stage.motions()[take], &self.stage.plan().takes[take]);
        let pacing = Pacing::new(&motion.spans, motion.duration_s(), &imperfections.operator, &mut rng);
        let (object_id, base_from_object) = (&planned.object, &self.stage.poses()[take]);
        let true_pose = imperfections.object_offset * shifted(base_from_object, hidden, object_id);
        let factor =
            imperfections.object_scale * value(hidden, "object_scale", "factor", object_id).unwrap_or(1.0);
        let shape = station.objects[object_id].shape.scaled(factor);
        let surface = Arc::new(SignedDistance::new(&shape).map_err(BlindError::Shape)?);
        let mut skin = Skin::new(station, imperfections, hidden);
        let mut boards: Vec<Board> = (0..station.layout.streams.len())
            .map(|stream| Board::new(station, stream, imperfections, hidden, &mut rng))
            .collect();
        let mut files = TakeFiles::new(station, planned, base_from_object, kept);
        files.mark(&motion.spans, &pacing, &imperfections.operator, &mut rng);

        let object_from_base = true_pose.inverse();
        let num_dofs = station.robot.num_dofs();
        let (mut motors, mut links) = (vec![0.0; num_dofs], Vec::new());
        let mut frames = Vec::new();
        let mut next_joints_s = 0.0;
        let num_steps = (pacing.duration_s() / STEP_S) as u64;
        for step in 0..num_steps {
            let now_s = step as f64 * STEP_S;
            if step % STEPS_PER_LOOK == 0 {
                motion.at(pacing.motion_s(now_s), &mut motors);
                turn(station, hidden, &motors, &mut links);
                station.robot.forward_kinematics(&links, &mut frames);
                skin.look(station, &surface, &object_from_base, &frames, STEPS_PER_LOOK as f64 * STEP_S);
            }
            skin.step(STEP_S);
            for board in &mut boards {
                board.step(now_s, STEP_S, &skin.felt, station, &links, &mut rng);
            }
            if now_s >= next_joints_s {
                next_joints_s += 1.0 / station.joint_rate_hz;
                files.joints(now_s, measured(station, hidden, imperfections, &motors, &mut rng));
            }
        }
        for (stream, board) in boards.into_iter().enumerate() {
            files.samples(stream, board.finish(&station.streams[stream], kept));
        }
        Ok(files)
    }
}

/// A size of what is hidden in the place that `of` names; `None` where nothing of that kind is.
fn value(hidden: &[Hidden], id: &str, size: &str, of: &str) -> Option<f64> {
    let is_there = |hidden: &&Hidden| {
        let place = match &hidden.place {
            Place::Object(place)
            | Place::Joint(place)
            | Place::Stream(place)
            | Place::Patch(place)
            | Place::Group(place)
            | Place::Channel(place) => place == of,
            Place::Channels(places) | Place::Groups(places) => places.iter().any(|place| place == of),
        };
        hidden.id == id && place
    };
    hidden.iter().find(is_there).map(|hidden| hidden.parameters.get(size).copied().unwrap_or(0.0))
}

/// The shift of what is hidden, in the frame of what it moves or of its parent.
fn motion_of(hidden: &[Hidden], id: &str, of: &str) -> Option<(Vector3<f64>, UnitQuaternion<f64>)> {
    let [x, y, z, rx, ry, rz] =
        ["x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"].map(|size| value(hidden, id, size, of));
    let turn = UnitQuaternion::new(Vector3::new(rx.unwrap_or(0.0), ry.unwrap_or(0.0), rz.unwrap_or(0.0)));
    Some((Vector3::new(x?, y.unwrap_or(0.0), z.unwrap_or(0.0)), turn))
}

/// Where an object really stands that is recorded to stand at `base_from_object`.
fn shifted(base_from_object: &Isometry3<f64>, hidden: &[Hidden], object: &str) -> Isometry3<f64> {
    let Some((shift, turn)) = motion_of(hidden, "object_pose_offset", object) else {
        return *base_from_object;
    };
    let translation = Translation3::from(base_from_object.translation.vector + shift);
    Isometry3::from_parts(translation, turn * base_from_object.rotation)
}

/// Turns the `links` with the `motors`: with play, a link stays where it is until its motor has come through it.
fn turn(station: &Station, hidden: &[Hidden], motors: &[f64], links: &mut Vec<f64>) {
    if links.is_empty() {
        links.extend_from_slice(motors);
    }
    for ((joint, motor), link) in station.robot.dofs().zip(motors).zip(links) {
        let width = value(hidden, "joint_backlash", "width", &joint.name).unwrap_or(0.0);
        *link = link.clamp(motor - 0.5 * width, motor + 0.5 * width);
    }
}

/// What the encoders say.
fn measured(
    station: &Station,
    hidden: &[Hidden],
    imperfections: &Imperfections,
    motors: &[f64],
    rng: &mut ChaCha8Rng,
) -> Vec<f64> {
    let joints = station.robot.dofs().zip(motors).zip(&imperfections.encoder_zeros);
    joints
        .enumerate()
        .map(|(dof, ((joint, motor), zero))| {
            let offset = value(hidden, "joint_offset", "offset", &joint.name).unwrap_or(0.0);
            let reading = motor + zero + offset + JOINT_NOISE * normal(rng);
            let counts = COUNTS_PER_TURN[usize::from(station.carrier_dofs.contains(&dof))];
            let quantum =
                if joint.kind == JointKind::Revolute { std::f64::consts::TAU / counts } else { 1e-6 };
            (reading / quantum).round() * quantum
        })
        .collect()
}

/// A standard normal deviate (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

/// A deviate that is anywhere within `[lower, upper]` alike.
fn within(rng: &mut ChaCha8Rng, [lower, upper]: [f64; 2]) -> f64 {
    lower + (upper - lower) * rng.random::<f64>()
}

#[cfg(test)]
mod tests;
