//! The emulated station in real time.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_robot_model::Station;
use rayon::prelude::*;

use crate::motion::{TakeMotion, plan_take};
use crate::session::scenes;
use crate::truth::Emulation;
use crate::world::Event;
use crate::{EmulationError, TruthWorld};

/// Longest step that [`LiveStation::advance`] catches up on, s.
const LONGEST_STEP_S: f64 = 1.0;

/// The emulated station, going through its primitives for ever.
pub struct LiveStation {
    emulation: Emulation,
    motions: Vec<TakeMotion>,
    poses: Vec<Isometry3<f64>>,
    /// Where a station would believe the objects to be.
    recorded_poses: Vec<Isometry3<f64>>,
    seed: u64,
    world: TruthWorld,
    /// Takes gone through since the start.
    round: u64,
    /// When the current take started, s since the station started.
    take_start_s: f64,
    references: Vec<f64>,
    sample: LiveSample,
}

/// The state of a live station at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveSample {
    /// Since the station started, s.
    pub time_s: f64,
    /// Measured joint positions, one per degree of freedom.
    pub positions: Vec<f64>,
    /// One per channel.
    pub active: Vec<bool>,
    /// Raw readings less their reference, one per channel.
    pub raw: Vec<f32>,
    /// What it is doing, for people.
    pub activity: String,
    /// Object in place: id, and pose in the base frame.
    pub object: Option<(String, nalgebra::Isometry3<f64>)>,
    /// Samples taken so far: joints, then each stream of the layout.
    pub samples: Vec<u64>,
}

impl LiveStation {
    /// Prepares the station of the truth file at `truth_path`: plans all its motions, which takes some seconds.
    pub fn new(truth_path: &Path, seed: u64) -> Result<Self, EmulationError> {
        let emulation = Emulation::read(truth_path)?;
        let scenes = scenes(&emulation)?;
        let takes = &emulation.plan.takes;
        let motions: Vec<TakeMotion> = (0..takes.len())
            .into_par_iter()
            .map(|take_idx| plan_take(&emulation, &scenes[&takes[take_idx].object], take_idx))
            .collect::<Result<_, _>>()?;
        let poses: Vec<_> = takes.iter().map(|take| scenes[&take.object].base_from_object()).collect();
        let recorded = takes.iter().zip(&poses);
        let recorded_poses: Vec<_> =
            recorded.map(|(take, pose)| emulation.secrets.recorded_pose(&take.object, pose)).collect();
        drop(scenes);
        let world = world(&emulation, &poses, seed, 0)?;
        let num_channels = emulation.station.layout.num_channels();
        let sample = LiveSample {
            time_s: 0.0,
            positions: emulation.rest(),
            active: vec![false; num_channels],
            raw: vec![0.0; num_channels],
            activity: String::new(),
            object: Some((emulation.plan.takes[0].object.clone(), recorded_poses[0])),
            samples: vec![0; 1 + emulation.station.layout.streams.len()],
        };
        let references = vec![0.0; num_channels];
        Ok(Self {
            emulation,
            motions,
            poses,
            recorded_poses,
            seed,
            world,
            round: 0,
            take_start_s: 0.0,
            references,
            sample,
        })
    }

    /// The station.
    pub fn station(&self) -> &Station {
        &self.emulation.station
    }

    /// Steps the world by `dt_secs` (at most a second) and gives the newest state.
    pub fn advance(&mut self, dt_secs: f64) -> LiveSample {
        let dt_secs = if dt_secs.is_finite() { dt_secs.clamp(0.0, LONGEST_STEP_S) } else { 0.0 };
        self.sample.time_s += dt_secs;
        let mut take_idx = self.take_idx();
        let duration_s = self.emulation.plan.takes[take_idx].duration_s;
        if self.sample.time_s - self.take_start_s >= duration_s {
            self.take_start_s += duration_s;
            // A world that could be made once can be made again; staying in the old one would be the lesser evil.
            if let Ok(world) = world(&self.emulation, &self.poses, self.seed, self.round + 1) {
                self.round += 1;
                self.world = world;
            }
            take_idx = self.take_idx();
            self.sample.object =
                Some((self.emulation.plan.takes[take_idx].object.clone(), self.recorded_poses[take_idx]));
        }
        let now_s = self.sample.time_s - self.take_start_s;
        let station = Arc::clone(&self.emulation.station);
        let motion = &self.motions[take_idx];
        let sample = &mut self.sample;
        if self.world.time_s() < 0.0 {
            // Nothing reaches the host before the take starts; what the devices learn until then is their reference.
            let warmed_up = self.world.advance(0.0, |time_s, at| motion.at(time_s, at), &mut |_| Ok(()));
            debug_assert!(warmed_up.is_ok(), "the sink cannot fail");
            self.references = self.world.references();
        }
        let references = &self.references;
        let advanced = self.world.advance(now_s, |time_s, at| motion.at(time_s, at), &mut |event| {
            match event {
                Event::Joints { positions, .. } => {
                    sample.positions = positions;
                    sample.samples[0] += 1;
                }
                Event::Tactile { stream, sample: arrival } => {
                    let channels = station.layout.streams[stream].channels.clone();
                    for (channel, (raw, active)) in channels.zip(arrival.raw.iter().zip(&arrival.active)) {
                        sample.raw[channel] = raw - references[channel] as f32;
                        sample.active[channel] = *active;
                    }
                    sample.samples[1 + stream] += 1;
                }
            }
            Ok(())
        });
        debug_assert!(advanced.is_ok(), "the sink cannot fail");
        motion.activity(now_s).clone_into(&mut sample.activity);
        sample.clone()
    }

    fn take_idx(&self) -> usize {
        (self.round % self.motions.len() as u64) as usize
    }
}

fn world(
    emulation: &Emulation,
    poses: &[Isometry3<f64>],
    seed: u64,
    round: u64,
) -> Result<TruthWorld, EmulationError> {
    let take_idx = (round % poses.len() as u64) as usize;
    let object = &emulation.station.objects[&emulation.plan.takes[take_idx].object];
    TruthWorld::new(emulation, object, &poses[take_idx], seed, round)
}
