//! A script under way.

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};
use palpate_robot_model::Station;

use super::{Again, Script, between};
use crate::GraspConfig;
use crate::hand::HandMove;

/// How often a way that the arm does not reach is halved before the hand stays where it is.
const MOST_HALVINGS: usize = 6;

/// Follows a script, and begins again where too little is felt.
#[derive(Clone, Debug, PartialEq)]
pub struct ScriptRun {
    /// `(time in s, target of every degree of freedom)`, times increasing: what is left of the script from its last try on.
    timeline: Vec<(f64, Vec<f64>)>,
    /// Tries made after the first.
    num_again: usize,
    /// How far the next key to look at, and the last key of all, lie behind where the script has them, s.
    late_s: f64,
    /// Where the hand is, seen from the script's own positions, m.
    offset_m: Vector2<f64>,
    /// Where each channel was when it first felt something in this try, in the base frame.
    felt_at: Vec<Option<Point3<f64>>>,
}

/// What a script knows of the robot at a moment.
#[derive(Clone, Copy, Debug)]
pub struct Sensed<'a> {
    /// Time since the episode began, s.
    pub time_s: f64,
    /// Position of every degree of freedom, rad or m.
    pub positions: &'a [f64],
    /// Whether each channel feels something.
    pub active: &'a [bool],
}

impl ScriptRun {
    /// At the beginning of `script`.
    pub fn new(script: &Script) -> Self {
        Self {
            timeline: script.targets.clone(),
            num_again: 0,
            late_s: 0.0,
            offset_m: Vector2::zeros(),
            felt_at: Vec::new(),
        }
    }

    /// Targets for the control step that begins now, one per degree of freedom. Moments come in order.
    pub fn targets(
        &mut self,
        script: &Script,
        station: &Station,
        config: &GraspConfig,
        now: Sensed<'_>,
    ) -> Vec<f64> {
        if let Some(again) = script.again.get(self.num_again) {
            self.feel(station, now);
            let looks_s = script.targets[again.at_key].0 + self.late_s;
            // A step's rounding is no reason to look a step later.
            let is_time = now.time_s >= looks_s - 0.5 / config.control_rate_hz;
            let num_active = now.active.iter().filter(|&&active| active).count();
            if is_time && num_active >= again.channels as usize {
                // It has the object: what comes later is no reason to let go.
                self.num_again = script.again.len();
            } else if is_time {
                self.begin_again(script, again, station, config, now);
            }
        }
        between(&self.timeline, now.time_s)
    }

    /// Remembers where channels are that feel something for the first time.
    fn feel(&mut self, station: &Station, now: Sensed<'_>) {
        self.felt_at.resize(now.active.len(), None);
        let is_new = |(channel, &active): (usize, &bool)| active && self.felt_at[channel].is_none();
        if !now.active.iter().enumerate().any(is_new) {
            return;
        }
        let mut frames = Vec::new();
        station.robot.forward_kinematics(now.positions, &mut frames);
        for (channel, at) in self.felt_at.iter_mut().enumerate() {
            if now.active[channel] && at.is_none() {
                *at = Some(channel_in_base(station, channel, &frames));
            }
        }
    }

    /// Goes back as `again` says.
    fn begin_again(
        &mut self,
        script: &Script,
        again: &Again,
        station: &Station,
        config: &GraspConfig,
        now: Sensed<'_>,
    ) {
        let keys = &script.targets[again.to_key..];
        let here = between(&self.timeline, now.time_s);
        let (before_m, mut after_m) = (self.offset_m, self.next_offset_m(again, config));
        // Where the arm does not reach all the way, it goes as far as it does.
        let (offset_m, way) = (0..=MOST_HALVINGS)
            .find_map(|_| {
                let way = way(keys, again.raise_m, before_m, after_m, station, config);
                let found = way.map(|way| (after_m, way));
                after_m = before_m + 0.5 * (after_m - before_m);
                found
            })
            .unwrap_or_else(|| (before_m, vec![here.clone(); keys.len() + 2]));
        let leg_s = again.within_s / 3.0;
        self.late_s = now.time_s + again.within_s - keys[0].0;
        let of_keys = keys.iter().map(|(at_s, _)| at_s + self.late_s);
        let times_s = [now.time_s + leg_s, now.time_s + 2.0 * leg_s].into_iter().chain(of_keys);
        self.timeline = vec![(now.time_s, here)];
        self.timeline.extend(times_s.zip(way));
        self.offset_m = offset_m;
        self.num_again += 1;
        self.felt_at.fill(None);
    }

    /// Where the hand is to be in the next try.
    fn next_offset_m(&self, again: &Again, config: &GraspConfig) -> Vector2<f64> {
        let felt: Vec<Point2<f64>> = self.felt_at.iter().flatten().map(|at| at.xy()).collect();
        if felt.is_empty() {
            return again.unfelt_m.into();
        }
        let sum: Vector2<f64> = felt.iter().map(|at| at.coords).sum();
        let from_middle = sum / felt.len() as f64 - Vector2::from(config.task.center_m);
        Vector2::from(again.felt_m) + from_middle.component_mul(&Vector2::from(again.towards))
    }
}

/// Up where the hand is, over to where it goes, and from there on as `keys` have it; nothing where the arm does not reach.
fn way(
    keys: &[(f64, Vec<f64>)],
    raise_m: f64,
    before_m: Vector2<f64>,
    after_m: Vector2<f64>,
    station: &Station,
    config: &GraspConfig,
) -> Option<Vec<Vec<f64>>> {
    let moved = |positions: &[f64], offset_m: Vector2<f64>, raise_m: f64| {
        let hand = HandMove { offset_m: Vector3::new(offset_m.x, offset_m.y, raise_m), yaw_rad: 0.0 };
        let mut moved = positions.to_vec();
        hand.reach(&station.robot, config, &mut moved).then_some(moved)
    };
    let first = &keys.first()?.1;
    let over = [moved(first, before_m, raise_m), moved(first, after_m, raise_m)];
    over.into_iter().chain(keys.iter().map(|(_, positions)| moved(positions, after_m, 0.0))).collect()
}

/// Where a channel's taxel is.
fn channel_in_base(station: &Station, channel: usize, frames: &[Isometry3<f64>]) -> Point3<f64> {
    let layout = &station.layout;
    let channel = &layout.channels[channel];
    let patch = &layout.patches[channel.patch];
    frames[patch.link] * patch.taxels_in_link[channel.taxel]
}
