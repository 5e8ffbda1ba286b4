//! A handle on a station that somebody else runs: what stands in front of it, what is wrong with it, who pushes it, and
//! where everything truly is.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palpate_robot_model::Station;

use super::faults::Faults;
use super::wire::LineTraffic;
use palpate_truth::{EmulationError, Placed};

/// Most steps that a log of the motion keeps: two minutes of them.
const MOST_LOGGED: usize = 120_000;

/// A handle on an [`EmulatedStation`](super::EmulatedStation), for any thread, while the station runs in another one.
///
/// What is asked for happens at the station's next step. A station that nobody runs does nothing.
#[derive(Clone)]
pub struct StationControl {
    shared: Arc<Shared>,
}

/// How a joint is pushed by hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Push {
    /// With this torque, N m, within what a hand can do.
    Torque(f64),
    /// With as much torque as this speed takes, rad/s, within what a hand can do.
    Speed(f64),
}

/// A person's hand: how strong it is, and how much torque it uses against a joint that is too slow.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hand {
    pub(super) most_nm: f64,
    pub(super) nm_s_per_rad: f64,
}

impl Push {
    /// Nobody pushes.
    pub const NONE: Self = Self::Torque(0.0);

    /// What `hand` does to a joint that moves with `rad_per_sec`.
    pub(super) fn torque_nm(self, rad_per_sec: f64, hand: &Hand) -> f64 {
        let wanted_nm = match self {
            Self::Torque(torque_nm) => torque_nm,
            Self::Speed(wanted) => hand.nm_s_per_rad * (wanted - rad_per_sec),
        };
        wanted_nm.clamp(-hand.most_nm, hand.most_nm)
    }
}

/// Where a station truly is at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StationSnapshot {
    /// Time since the station started, ns.
    pub device_ns: u64,
    /// True positions of the joints in the station's order, rad.
    pub positions: Vec<f64>,
    /// Their velocities, rad/s.
    pub velocities: Vec<f64>,
    /// Whether each joint is driven: torque on for a servo, enabled with its brake released for a joint of the arm.
    pub torque_on: Vec<bool>,
    /// Where each joint is told to be, rad; `None` while it is told nothing.
    pub goals: Vec<Option<f64>>,
    /// The arm's box.
    pub arm: ArmSnapshot,
    /// The object in place, if one is.
    pub object: Option<String>,
    /// What has passed each serial line, in the order of [`EmulatedStation::lines`](super::EmulatedStation::lines).
    pub traffic: Vec<LineTraffic>,
    /// How far the station's time was behind the clock at most since the start, ns. Time that was left out counts.
    pub most_behind_ns: u64,
    /// Time that was left out because the computer was too slow or stood still, ns.
    pub left_out_ns: u64,
}

/// What the arm's box says of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ArmSnapshot {
    /// 0 position, 1 servo, 2 lead-through, 4 joint velocity.
    pub mode: u8,
    /// 1 moving, 2 ready, 3 paused, 4 stopped, 5 changed.
    pub state: u8,
    /// Code of the error, 0 for none.
    pub error: u8,
    /// Code of the warning, 0 for none.
    pub warning: u8,
}

/// The motion step by step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotionLog {
    /// Oldest first, one every ms of the station's time.
    pub steps: Vec<LoggedStep>,
    /// Older ones that there was no room for.
    pub num_dropped: u64,
}

/// One step of the motion.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedStep {
    /// Time since the station started, ns.
    pub device_ns: u64,
    /// True positions of the joints in the station's order, rad.
    pub positions: Vec<f64>,
    /// Their velocities, rad/s.
    pub velocities: Vec<f64>,
    /// Where they are told to be, rad; `None` for a joint that is told nothing.
    pub goals: Vec<Option<f64>>,
}

impl MotionLog {
    /// When a joint was told for the last time to be elsewhere than before, ns since the station started; `None` if none
    /// ever was. That it is told nothing any more is no change.
    pub fn last_goal_ns(&self) -> Option<u64> {
        let elsewhere = |pair: &&[LoggedStep]| {
            let goals = pair[0].goals.iter().zip(&pair[1].goals);
            goals.filter_map(|(before, now)| Some((*before)? != (*now)?)).any(|changed| changed)
        };
        self.steps.windows(2).rev().find(elsewhere).map(|pair| pair[1].device_ns)
    }

    /// Since when no joint has been faster than `most_rad_per_s`, ns since the station started; `None` if one still is.
    pub fn still_since_ns(&self, most_rad_per_s: f64) -> Option<u64> {
        let moves =
            |step: &LoggedStep| step.velocities.iter().any(|velocity| velocity.abs() > most_rad_per_s);
        let still = self.steps.iter().rposition(moves).map_or(0, |last| last + 1);
        self.steps.get(still).map(|step| step.device_ns)
    }
}

/// Why a station does not do what it is asked for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ControlError {
    /// No place is known for the object.
    #[error("no place is known for the object {id:?}; expected one of {known}")]
    UnknownObject {
        /// What was asked for.
        id: String,
        /// What there is.
        known: String,
    },
    /// There is no such joint.
    #[error("the station has no joint {joint:?}; expected one of {known}")]
    UnknownJoint {
        /// What was asked for.
        joint: String,
        /// What there is.
        known: String,
    },
    /// Not a number, or without bounds.
    #[error("joint {joint:?} cannot be pushed with {push:?}: torque or speed must be finite")]
    NotFinite {
        /// Which joint.
        joint: String,
        /// With what.
        push: Push,
    },
    /// No share.
    #[error("the resistance {share} must be within 0..=1")]
    Resistance {
        /// What was asked for.
        share: f64,
    },
    /// Faults that this station cannot have.
    #[error(transparent)]
    Faults(#[from] EmulationError),
}

impl StationControl {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self { shared }
    }

    /// The station.
    pub fn station(&self) -> &Station {
        &self.shared.station
    }

    /// Ids of the objects that can be placed.
    pub fn objects(&self) -> impl Iterator<Item = &str> {
        self.shared.objects.keys().map(String::as_str)
    }

    /// Takes the object away and puts another one where the truth or its plan says that it stands, or none. Nothing else
    /// changes: layers that were pressed spring back, servos, arm and time go on.
    pub fn place_object(&self, id: Option<&str>) -> Result<(), ControlError> {
        let placed = match id {
            None => None,
            Some(id) => {
                let object = self.shared.objects.get(id).ok_or_else(|| ControlError::UnknownObject {
                    id: id.to_owned(),
                    known: self.objects().collect::<Vec<_>>().join(", "),
                })?;
                Some((id.to_owned(), Arc::clone(object)))
            }
        };
        self.shared.ask(Wish::Place(placed));
        Ok(())
    }

    /// Says what is wrong, in place of what was. A file of faults that changes later says it anew.
    pub fn set_faults(&self, faults: Faults) -> Result<(), ControlError> {
        faults.check("faults", &self.shared.station)?;
        self.shared.lock().faults = faults.clone();
        self.shared.ask(Wish::Faults(faults));
        Ok(())
    }

    /// What is wrong.
    pub fn faults(&self) -> Faults {
        self.shared.lock().faults.clone()
    }

    /// Where everything truly is.
    pub fn snapshot(&self) -> StationSnapshot {
        self.shared.lock().snapshot.clone()
    }

    /// Pushes a joint by hand from now on, until another push; [`Push::NONE`] lets go.
    ///
    /// A joint of the arm yields in lead-through (mode 2, enabled and ready) only; a servo always as far as its own
    /// torque lets it.
    pub fn push(&self, joint: &str, push: Push) -> Result<(), ControlError> {
        let joints = || self.shared.station.robot.dofs();
        let dof = joints().position(|known| known.name == joint).ok_or_else(|| {
            let known: Vec<&str> = joints().map(|joint| joint.name.as_str()).collect();
            ControlError::UnknownJoint { joint: joint.to_owned(), known: known.join(", ") }
        })?;
        let (Push::Torque(value) | Push::Speed(value)) = push;
        if !value.is_finite() {
            return Err(ControlError::NotFinite { joint: joint.to_owned(), push });
        }
        self.shared.ask(Wish::Push { dof, push });
        Ok(())
    }

    /// Which share (0..=1) of the soft layers' forces the servos feel from now on. At first it is 0: the object gives way
    /// to nobody and costs nobody anything. At 1 a finger that presses draws current, and yields where that is bounded.
    pub fn set_resistance(&self, share: f64) -> Result<(), ControlError> {
        if !(0.0..=1.0).contains(&share) {
            return Err(ControlError::Resistance { share });
        }
        self.shared.ask(Wish::Resistance(share));
        Ok(())
    }

    /// Starts a log of the motion that keeps the newest `most_steps` (at most 120 000, two minutes); 0 ends it. What was
    /// logged before is forgotten.
    pub fn log_motion(&self, most_steps: usize) {
        self.shared.lock().log = (most_steps > 0).then(|| Log {
            steps: VecDeque::new(),
            most_steps: most_steps.min(MOST_LOGGED),
            num_dropped: 0,
        });
    }

    /// What was logged since the last call, or since the log was started; the log goes on.
    pub fn take_motion_log(&self) -> MotionLog {
        match &mut self.shared.lock().log {
            None => MotionLog::default(),
            Some(log) => MotionLog {
                steps: std::mem::take(&mut log.steps).into(),
                num_dropped: std::mem::take(&mut log.num_dropped),
            },
        }
    }
}

/// What the station does on request.
pub(super) enum Wish {
    Place(Option<(String, Arc<Placed>)>),
    Faults(Faults),
    Push { dof: usize, push: Push },
    Resistance(f64),
}

/// What a station and its handles share.
pub(super) struct Shared {
    station: Arc<Station>,
    objects: BTreeMap<String, Arc<Placed>>,
    /// Whether there are wishes, so that a station without any need not look.
    asked: AtomicBool,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    wishes: Vec<Wish>,
    faults: Faults,
    snapshot: StationSnapshot,
    log: Option<Log>,
}

struct Log {
    steps: VecDeque<LoggedStep>,
    most_steps: usize,
    num_dropped: u64,
}

impl Shared {
    pub(super) fn new(station: Arc<Station>, objects: BTreeMap<String, Arc<Placed>>) -> Self {
        Self { station, objects, asked: AtomicBool::new(false), inner: Mutex::default() }
    }

    /// Nothing under this lock can panic half-way through a change.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ask(&self, wish: Wish) {
        self.lock().wishes.push(wish);
        self.asked.store(true, Ordering::Release);
    }

    /// What was asked for since the last call, in order.
    pub(super) fn wishes(&self) -> Vec<Wish> {
        if self.asked.swap(false, Ordering::Acquire) {
            std::mem::take(&mut self.lock().wishes)
        } else {
            Vec::new()
        }
    }

    pub(super) fn tell_faults(&self, faults: &Faults) {
        self.lock().faults.clone_from(faults);
    }

    pub(super) fn note_clock(&self, behind_ns: u64, left_out_ns: u64) {
        let snapshot = &mut self.lock().snapshot;
        snapshot.most_behind_ns = snapshot.most_behind_ns.max(behind_ns);
        snapshot.left_out_ns = left_out_ns;
    }

    /// Brings the snapshot up to date by `update`, and the log.
    pub(super) fn tell(&self, update: impl FnOnce(&mut StationSnapshot)) {
        let mut inner = self.lock();
        let Inner { snapshot, log, .. } = &mut *inner;
        update(snapshot);
        if let Some(log) = log {
            while log.steps.len() >= log.most_steps {
                log.steps.pop_front();
                log.num_dropped += 1;
            }
            log.steps.push_back(LoggedStep {
                device_ns: snapshot.device_ns,
                positions: snapshot.positions.clone(),
                velocities: snapshot.velocities.clone(),
                goals: snapshot.goals.clone(),
            });
        }
    }
}

#[cfg(test)]
mod tests;
