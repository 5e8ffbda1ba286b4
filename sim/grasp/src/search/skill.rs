//! How to try once: go to a place, come down, close, lift.

use std::sync::Arc;

use nalgebra::Vector3;
use palpate_robot_model::Station;

use super::felt::Feeling;
use super::{Felt, SearchConfig};
use crate::hand::HandMove;
use crate::scene::{digits, links_of_hand};
use crate::script::between;
use crate::{GraspConfig, GraspError, Observation, Script};

/// A place that the hand can be brought to.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Along x and y of the base, seen from where the script closes, m.
    pub at_m: [f64; 2],
    /// Every degree of freedom with the hand open and raised there.
    pub raised: Vec<f64>,
    /// With the hand open and down.
    down: Vec<f64>,
    /// Lifted; the hand's own joints do not count.
    lifted: Vec<f64>,
}

/// A hand that can try to grasp at any of its places.
#[derive(Clone, Debug)]
pub struct Skill {
    pub(super) config: SearchConfig,
    places: Vec<Place>,
    /// Every degree of freedom when the hand has closed; carriers do not count.
    closed: Vec<f64>,
    pub(super) hand_dofs: Vec<usize>,
    in_hand: Vec<bool>,
    pub(super) digit_of_dof: Vec<Option<usize>>,
    pub(super) num_digits: usize,
    opposing: usize,
    /// Digit of each channel; the number of digits for the rest of the hand.
    pub(super) group_of_channel: Vec<usize>,
    pub(super) channels_of_group: Vec<f32>,
    control_rate_hz: f64,
    pub(super) hold_s: f64,
    pub(super) episode_s: f64,
    pub(super) one_claim: bool,
    hand_root: usize,
    station: Arc<Station>,
}

impl Skill {
    /// Postures of `script` at every place of `search` that the arm reaches.
    ///
    /// # Errors
    /// Keys that the script lacks, an opposing link that is none of a digit's, a hand that reaches no place.
    pub fn new(
        station: &Arc<Station>,
        config: &GraspConfig,
        script: &Script,
        search: &SearchConfig,
    ) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: "search".to_owned(), problem };
        let robot = &station.robot;
        let num_keys = script.keys().len();
        if search.closed_key > num_keys {
            return Err(error(format!(
                "closed_key is {}, but the script has {num_keys} keys",
                search.closed_key
            )));
        }
        let of_links = digits(robot, config);
        let num_digits = of_links.iter().flatten().max().map_or(0, |last| last + 1);
        let opposing =
            robot.link_index(&search.opposing_link).and_then(|link| of_links[link]).ok_or_else(|| {
                error(format!(
                    "opposing_link names link {:?}, which belongs to no digit",
                    search.opposing_link
                ))
            })?;
        let link_in_hand = links_of_hand(robot, config);
        let in_hand: Vec<bool> = robot.dofs().map(|joint| link_in_hand[joint.child_link]).collect();
        let layout = &station.layout;
        let group_of_channel: Vec<usize> = layout
            .channels
            .iter()
            .map(|channel| of_links[layout.patches[channel.patch].link].unwrap_or(num_digits))
            .collect();
        let mut channels_of_group = vec![0.0; num_digits + 1];
        for &group in &group_of_channel {
            channels_of_group[group] += 1.0;
        }
        let down = script.targets_at_key(search.down_key - 1);
        let place = |at_m: [f64; 2]| {
            let moved = |height_m: f64| {
                let hand = HandMove { offset_m: Vector3::new(at_m[0], at_m[1], height_m), yaw_rad: 0.0 };
                let mut positions = down.to_vec();
                hand.reach(robot, config, &mut positions).then_some(positions)
            };
            let (raised, down, lifted) = (moved(search.raise_m)?, moved(0.0)?, moved(search.lift_m)?);
            Some(Place { at_m, raised, down, lifted })
        };
        let [step_m, reach_m] = search.places;
        let steps = (reach_m / step_m + 1e-9).floor() as i32;
        let places: Vec<Place> = (-steps..=steps)
            .flat_map(|x| (-steps..=steps).map(move |y| [f64::from(x) * step_m, f64::from(y) * step_m]))
            .filter_map(place)
            .collect();
        if places.is_empty() {
            return Err(error("the arm reaches no place".to_owned()));
        }
        Ok(Self {
            config: search.clone(),
            places,
            closed: script.targets_at_key(search.closed_key - 1).to_vec(),
            hand_dofs: (0..in_hand.len()).filter(|&dof| in_hand[dof]).collect(),
            digit_of_dof: robot.dofs().map(|joint| of_links[joint.child_link]).collect(),
            in_hand,
            num_digits,
            opposing,
            group_of_channel,
            channels_of_group,
            control_rate_hz: config.control_rate_hz,
            hold_s: config.task.hold_s,
            episode_s: config.task.episode_s,
            one_claim: config.task.one_claim,
            hand_root: robot.link_index(&config.hand_root).unwrap_or(0),
            station: Arc::clone(station),
        })
    }

    /// Every place that the hand can be brought to, in a fixed order.
    pub fn places(&self) -> &[Place] {
        &self.places
    }

    /// Lengths of [`Felt::touch`] and [`Felt::tracking`].
    pub fn num_felt(&self) -> [usize; 2] {
        [3 * (self.num_digits + 1), self.hand_dofs.len() + self.num_digits]
    }

    /// Number of the place nearest to `at_m`.
    pub fn nearest(&self, at_m: [f64; 2]) -> usize {
        let off = |place: &Place| (place.at_m[0] - at_m[0]).hypot(place.at_m[1] - at_m[1]);
        let nearest = self.places.iter().enumerate().min_by(|one, other| off(one.1).total_cmp(&off(other.1)));
        nearest.map_or(0, |(idx, _)| idx)
    }

    /// The time that the hand needs from `before` to `after`, a whole number of control steps, s.
    fn leg_s(&self, before: &[f64], after: &[f64]) -> f64 {
        let of_dof = |(dof, (before, after)): (usize, (&f64, &f64))| {
            let per_s = if self.in_hand[dof] { self.config.opening_per_s } else { self.config.carrier_per_s };
            (after - before).abs() / per_s
        };
        let longest_s = before.iter().zip(after).enumerate().map(of_dof).fold(0.0, f64::max);
        ((longest_s * self.control_rate_hz - 1e-6).ceil().max(1.0)) / self.control_rate_hz
    }

    /// The way from `here`, whatever posture it is, to the hand down and open at `place`, beginning at `time_s`.
    fn way(&self, here: &[f64], place: usize, time_s: f64) -> Vec<(f64, Vec<f64>)> {
        let to = &self.places[place];
        let mut frames = Vec::new();
        let mut height_m = |positions: &[f64]| {
            self.station.robot.forward_kinematics(positions, &mut frames);
            frames[self.hand_root].translation.vector
        };
        let (at, raised) = (height_m(here), height_m(&to.raised));
        let mut way = vec![(time_s, here.to_vec())];
        if at.z < raised.z - 5e-3 {
            // Straight up before it goes over, so that it drags nothing along.
            let from_place = [to.at_m[0] + at.x - raised.x, to.at_m[1] + at.y - raised.y];
            way.push((0.0, self.places[self.nearest(from_place)].raised.clone()));
        }
        way.push((0.0, to.raised.clone()));
        way.push((0.0, to.down.clone()));
        for leg in 1..way.len() {
            way[leg].0 = way[leg - 1].0 + self.leg_s(&way[leg - 1].1, &way[leg].1);
        }
        way
    }

    /// The time from `here` to the judgement about a closing at `place`, s, when nothing stops a digit.
    pub(super) fn try_s(&self, here: &[f64], place: usize) -> f64 {
        let way = self.way(here, place, 0.0);
        way.last().map_or(0.0, |(at_s, _)| *at_s) + self.config.close_s + self.config.squeeze_s
    }

    /// The time from the glance to the judgement about a closing, s, when nothing stops a digit.
    pub(super) fn rest_s(&self) -> f64 {
        (1.0 - self.config.glance.unwrap_or(1.0)) * self.config.close_s + self.config.squeeze_s
    }

    /// The time of a lift at `place`, s.
    pub(super) fn lift_s(&self, place: usize) -> f64 {
        let place = &self.places[place];
        self.leg_s(&place.down, &place.lifted)
    }
}

/// One try under way.
#[derive(Clone, Debug)]
pub(super) struct Try {
    pub(super) place: usize,
    phase: Phase,
    feeling: Feeling,
}

#[derive(Clone, Debug)]
enum Phase {
    Going(Vec<(f64, Vec<f64>)>),
    Closing {
        /// Of each digit, 0 open to 1 closed.
        progress: Vec<f64>,
        /// For how long each has waited, s.
        waited_s: Vec<f64>,
        gripping: bool,
        glanced: bool,
        closed_s: Option<f64>,
    },
    Lifting(Vec<(f64, Vec<f64>)>),
}

/// What a try has come to.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Stage {
    /// Something is under way.
    Moving,
    /// The hand has closed as far as it looks whether that is worth going on with, and felt this; it says so once.
    Glanced(Felt),
    /// The hand has closed, and felt this.
    Closed(Felt),
    /// The hand is up, and feels this since it began to lift; it says so at every step from then on.
    Lifted(Felt),
}

impl Try {
    /// Begins at `time_s` from the commands `here`.
    pub(super) fn new(skill: &Skill, here: &[f64], place: usize, time_s: f64) -> Self {
        let way = skill.way(here, place, time_s);
        Self { place, phase: Phase::Going(way), feeling: Feeling::new(skill, time_s, 1.0) }
    }

    /// Goes on from [`Stage::Closed`] with the lift.
    pub(super) fn lift(&mut self, skill: &Skill, commands: &[f64], time_s: f64) {
        let mut up = skill.places[self.place].lifted.clone();
        for &dof in &skill.hand_dofs {
            up[dof] = commands[dof];
        }
        let lift_s = skill.lift_s(self.place);
        self.feeling = Feeling::new(skill, time_s, lift_s);
        self.phase = Phase::Lifting(vec![(time_s, commands.to_vec()), (time_s + lift_s, up)]);
    }

    /// What it has come to by `now`, and where every degree of freedom goes in the control step that begins.
    pub(super) fn go_on(&mut self, skill: &Skill, now: &Observation<'_>) -> (Stage, Vec<f64>) {
        let half_step_s = 0.5 / skill.control_rate_hz;
        let next_s = now.time_s + 1.0 / skill.control_rate_hz;
        if let Phase::Going(way) = &self.phase {
            if way.last().is_some_and(|(end_s, _)| now.time_s < end_s - half_step_s) {
                return (Stage::Moving, between(way, next_s));
            }
            self.feeling = Feeling::new(skill, now.time_s, skill.config.close_s);
            self.phase = Phase::Closing {
                progress: vec![0.0; skill.num_digits],
                waited_s: vec![0.0; skill.num_digits],
                gripping: false,
                glanced: false,
                closed_s: None,
            };
        }
        self.feeling.look(skill, now);
        match &mut self.phase {
            Phase::Lifting(way) => {
                let is_up = way.last().is_some_and(|(end_s, _)| now.time_s >= end_s - half_step_s);
                let stage = if is_up { Stage::Lifted(self.feeling.felt()) } else { Stage::Moving };
                (stage, between(way, next_s))
            }
            Phase::Closing { progress, waited_s, gripping, glanced, closed_s } => {
                let contacts = Feeling::contacts(skill, now);
                let others = contacts.iter().enumerate().any(|(digit, on)| *on && digit != skill.opposing);
                *gripping |= contacts[skill.opposing] && others;
                let step_s = 1.0 / skill.control_rate_hz;
                for (digit, progress) in progress.iter_mut().enumerate() {
                    let waits = contacts[digit] && !*gripping && waited_s[digit] < skill.config.wait_s;
                    if waits {
                        waited_s[digit] += step_s;
                    } else {
                        *progress = (*progress + step_s / skill.config.close_s).min(1.0);
                    }
                }
                if progress.iter().all(|progress| *progress >= 1.0) {
                    closed_s.get_or_insert(now.time_s + step_s);
                }
                let open = &skill.places[self.place].down;
                let mut targets = open.clone();
                for &dof in &skill.hand_dofs {
                    let share = skill.digit_of_dof[dof].map_or(1.0, |digit| progress[digit]);
                    targets[dof] = open[dof] + share * (skill.closed[dof] - open[dof]);
                }
                let is_judged =
                    closed_s.is_some_and(|at_s| now.time_s >= at_s + skill.config.squeeze_s - half_step_s);
                let mean = progress.iter().sum::<f64>() / progress.len().max(1) as f64;
                let glances = !*glanced && skill.config.glance.is_some_and(|glance| mean >= glance);
                *glanced |= glances;
                let stage = match (is_judged, glances) {
                    (true, _) => Stage::Closed(self.feeling.felt()),
                    (false, true) => Stage::Glanced(self.feeling.felt()),
                    (false, false) => Stage::Moving,
                };
                (stage, targets)
            }
            Phase::Going(way) => (Stage::Moving, between(way, next_s)),
        }
    }
}
