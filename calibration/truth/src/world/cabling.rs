//! The lines between the sensors of a stream and its converter, and what they pick up on the way.

use std::f64::consts::TAU;

use palpate_robot_model::{Station, ik::chain_dofs};

use crate::secrets::{Secrets, Snag};

/// Frequency of the mains: the grid is never exactly at 50 Hz.
const MAINS_HZ: f64 = 49.98;
/// An amplifier is warm after some of these, s.
const WARM_UP_S: f64 = 240.0;
/// What a strained cable makes fades over this time, s.
const STRAIN_S: f64 = 0.02;

/// The lines of one stream, in the order of its channels.
#[derive(Clone, Debug)]
pub(crate) struct Cabling {
    /// Whether the lines do nothing at all to what they carry.
    plain: bool,
    lines: Vec<Line>,
    leak: f64,
    hum_raw: f64,
    hum_phase: f64,
    snags: Vec<(Snag, bool)>,
    /// Degrees of freedom that move each patch of the stream, and the voltage of its cable, as a speed.
    strains: Vec<(Vec<usize>, f64)>,
    /// Readings of the lines, before they are plugged in.
    scratch: Vec<f64>,
}

#[derive(Clone, Debug)]
struct Line {
    /// Reading of the sensor at rest, raw units.
    rest_raw: f64,
    dead: bool,
    drift_raw_per_s: f64,
    strain_raw_s: f64,
    /// Which of the strains it is on.
    strain: usize,
    /// Gain with the joints where they are; the joint's part of it.
    gain: f64,
    bend: Option<crate::secrets::Bend>,
    /// Which sensor's line is plugged in here.
    line: usize,
    /// The cable that it runs in: a patch of several taxels has one of its own, all others share one.
    cable: Option<usize>,
}

impl Cabling {
    /// The lines of stream `stream_idx`; `rest_raw` are its sensors' readings at rest. `hum_phase` is that of the mains
    /// as the take starts, in turns.
    pub(crate) fn new(
        station: &Station,
        secrets: &Secrets,
        stream_idx: usize,
        rest_raw: &[f64],
        hum_phase: f64,
    ) -> Self {
        let layout = &station.layout;
        let channels = layout.streams[stream_idx].channels.clone();
        let first_patch = layout.channels.get(channels.start).map_or(0, |channel| channel.patch);
        let lines: Vec<Line> = channels
            .clone()
            .zip(rest_raw)
            .map(|(idx, &rest_raw)| {
                let channel = &secrets.channels[idx];
                Line {
                    rest_raw,
                    dead: channel.dead,
                    drift_raw_per_s: channel.drift_raw_per_s,
                    strain_raw_s: channel.strain_raw_s,
                    strain: layout.channels[idx].patch - first_patch,
                    gain: 1.0,
                    bend: channel.bend,
                    line: channel.line - channels.start,
                    cable: Some(layout.channels[idx].patch)
                        .filter(|&patch| layout.patches[patch].channels.len() > 1),
                }
            })
            .collect();
        let stream = &secrets.streams[stream_idx];
        let idle = |(idx, line): (usize, &Line)| {
            !line.dead
                && line.drift_raw_per_s == 0.0
                && line.strain_raw_s == 0.0
                && line.bend.is_none()
                && line.line == idx
        };
        let patches = layout.patches.iter().filter(|patch| patch.stream == stream_idx);
        Self {
            plain: lines.iter().enumerate().all(idle)
                && stream.leak == 0.0
                && stream.hum_raw == 0.0
                && stream.snags.is_empty(),
            lines,
            leak: stream.leak,
            hum_raw: stream.hum_raw,
            hum_phase,
            snags: stream.snags.iter().map(|&snag| (snag, false)).collect(),
            strains: patches.map(|patch| (chain_dofs(&station.robot, patch.link), 0.0)).collect(),
            scratch: Vec::new(),
        }
    }

    /// Tells where the joints are, and how fast.
    pub(crate) fn bend(&mut self, positions: &[f64], speeds: &[f64], dt_s: f64) {
        if self.plain {
            return;
        }
        for line in &mut self.lines {
            if let Some(bend) = line.bend {
                line.gain = (1.0 + bend.per_rad * (positions[bend.dof] - bend.middle)).max(0.0);
            }
        }
        let blend = 1.0 - (-dt_s / STRAIN_S).exp();
        for (dofs, strain) in &mut self.strains {
            let speed = dofs.iter().map(|&dof| speeds[dof].powi(2)).sum::<f64>().sqrt();
            *strain += blend * (speed - *strain);
        }
        for (snag, caught) in &mut self.snags {
            let past = positions[snag.dof] - snag.beyond;
            *caught = past > if *caught { -snag.release } else { 0.0 };
        }
    }

    /// What reaches the converter at `now_s` of the take when the sensors give `readings`.
    pub(crate) fn conduct(&mut self, now_s: f64, readings: &mut [f64]) {
        if self.plain {
            return;
        }
        let warm_up_s = WARM_UP_S * (1.0 - (-now_s / WARM_UP_S).exp());
        let hum = self.hum_raw * (TAU * (MAINS_HZ * now_s + self.hum_phase)).sin();
        let snagged: f64 =
            self.snags.iter().filter(|(_, caught)| *caught).map(|(snag, _)| snag.offset_raw).sum();
        self.scratch.clear();
        self.scratch.extend(self.lines.iter().zip(&*readings).map(|(line, reading)| {
            if line.dead {
                return line.rest_raw;
            }
            let strain = line.strain_raw_s * self.strains[line.strain].1;
            line.rest_raw
                + line.gain * (reading - line.rest_raw)
                + line.drift_raw_per_s * warm_up_s
                + strain
                + snagged
                + hum
        }));
        for (idx, line) in self.lines.iter().enumerate() {
            let own = self.scratch[line.line];
            // The lines of a cable lie side by side in the order of the converter's inputs.
            let cable = self.lines[line.line].cable;
            let beside = [line.line.checked_sub(1), Some(line.line + 1)].into_iter().flatten();
            let others =
                beside.filter(|&other| self.lines.get(other).is_some_and(|line| line.cable == cable));
            let leaked: f64 = others.map(|other| self.leak * (self.scratch[other] - own)).sum();
            readings[idx] = own + leaked;
        }
    }
}
