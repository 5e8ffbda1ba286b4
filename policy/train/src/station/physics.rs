//! Robot, table and object in MuJoCo, moved by the emulated servos' torques and the arm's box.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::Isometry3;
use palpate_emulator::{Drive, FeltObject, Mechanics};
use palpate_grasp::{GraspConfig, World};
use palpate_robot_model::Station;

/// Steps of a ms after which contacts are looked at: control steps of the grasp world, so that verdicts are those of
/// trials there.
const LOOK_STEPS: u64 = 50;
/// The same for what the arm's box looks at.
const HIT_STEPS: u64 = 10;
/// The same for where the object is: takes have it 20 times a second, and it should not be older than it has to be.
const POSE_STEPS: u64 = 2;

/// A world with an object newly placed.
pub(super) struct Placement {
    /// Driven by torques, in steps of a ms; its robot is wherever.
    pub(super) world: World,
    pub(super) felt: FeltObject,
}

/// What has become of the object since it was placed.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    /// Placements so far, the first included.
    pub(super) placements: u64,
    pub(super) object: String,
    pub(super) base_from_object: Isometry3<f64>,
    /// Since the placement, s.
    pub(super) time_s: f64,
    /// How far the object's origin is above where it was placed, m.
    pub(super) lift_m: f64,
    /// The robot has touched it.
    pub(super) was_touched: bool,
    /// It was `task.lift_m` up after it was touched.
    pub(super) was_lifted: bool,
    /// For how long it has been up without a break, and the longest, s.
    pub(super) held_s: f64,
    pub(super) longest_held_s: f64,
    /// Digits that touch it now.
    pub(super) num_digits: u32,
    /// Largest force between robot and table, N.
    pub(super) most_table_n: f64,
    /// That force has passed `task.max_table_force_n`, which stops the arm.
    pub(super) was_hit: bool,
    /// Why nothing moves any more; empty when all is well.
    pub(super) problem: String,
    /// True positions of the joints, rad or m.
    pub(super) positions: Vec<f64>,
}

/// What the station's thread and the operator's share. The first never waits for the second.
#[derive(Default)]
pub(super) struct Shared {
    has_next: AtomicBool,
    next: Mutex<Option<Placement>>,
    seen: Mutex<Seen>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(super) fn place(&self, next: Placement) {
        let mut waiting = lock(&self.next);
        *waiting = Some(next);
        self.has_next.store(true, Ordering::Release);
    }

    /// What is to be taken over, unless somebody is just about to say it.
    fn take(&self) -> Option<Placement> {
        if !self.has_next.load(Ordering::Acquire) {
            return None;
        }
        let next = self.next.try_lock().ok()?.take();
        self.has_next.store(false, Ordering::Release);
        next
    }

    pub(super) fn seen(&self) -> Seen {
        lock(&self.seen).clone()
    }
}

/// The station's bodies.
pub(super) struct Physics {
    world: World,
    felt: FeltObject,
    /// By degree of freedom, how long the world's servo of a joint before the hand lags behind, s.
    lags_s: Vec<f64>,
    targets: Vec<f64>,
    before: Vec<f64>,
    start_height_m: f64,
    num_steps: u64,
    lift_m: f64,
    hold_n: f64,
    is_hit: bool,
    seen: Seen,
    shared: Arc<Shared>,
}

impl Physics {
    pub(super) fn new(station: &Station, config: &GraspConfig, first: Placement) -> (Self, Arc<Shared>) {
        let shared = Arc::new(Shared::default());
        let lags_s = config.servos_by_dof(&station.robot).map(|servo| {
            (servo.damping_gain_n_m_s_per_rad + servo.joint_damping_n_m_s_per_rad)
                / servo.stiffness_n_m_per_rad
        });
        let lags_s: Vec<f64> = lags_s.collect();
        let mut new = Self {
            targets: vec![0.0; lags_s.len()],
            before: config.start_positions(&station.robot),
            lags_s,
            world: first.world,
            felt: first.felt,
            start_height_m: 0.0,
            num_steps: 0,
            lift_m: config.task.lift_m,
            hold_n: config.task.max_table_force_n,
            is_hit: false,
            seen: Seen::default(),
            shared: Arc::clone(&shared),
        };
        new.begin();
        (new, shared)
    }

    /// The object has just been placed.
    fn begin(&mut self) {
        let base_from_object = self.world.base_from_object();
        self.start_height_m = base_from_object.translation.z;
        self.num_steps = 0;
        self.is_hit = false;
        self.seen = Seen {
            placements: self.seen.placements + 1,
            object: self.felt.id().to_owned(),
            base_from_object,
            positions: self.before.clone(),
            ..Seen::default()
        };
        self.tell();
    }

    fn tell(&self) {
        // The operator holds the lock for as long as a copy takes.
        if let Ok(mut seen) = self.shared.seen.try_lock() {
            seen.clone_from(&self.seen);
        }
    }

    fn tell_pose(&self) {
        if let Ok(mut seen) = self.shared.seen.try_lock() {
            seen.base_from_object = self.world.base_from_object();
        }
    }

    fn look(&mut self) {
        let contacts = self.world.contacts();
        let look_s = LOOK_STEPS as f64 * 1e-3;
        let seen = &mut self.seen;
        seen.base_from_object = self.world.base_from_object();
        seen.time_s = self.num_steps as f64 * 1e-3;
        seen.lift_m = seen.base_from_object.translation.z - self.start_height_m;
        seen.was_touched |= contacts.robot_object_n > 0.0;
        seen.held_s = if seen.lift_m >= self.lift_m && seen.was_touched { seen.held_s + look_s } else { 0.0 };
        seen.was_lifted |= seen.held_s > 0.0;
        seen.longest_held_s = seen.longest_held_s.max(seen.held_s);
        seen.num_digits = contacts.digits.count_ones();
        seen.positions.clone_from(&self.before);
        self.tell();
    }
}

impl Mechanics for Physics {
    fn step(&mut self, drives: &[Drive], positions: &mut [f64], velocities: &mut [f64]) {
        if let Some(Placement { mut world, felt }) = self.shared.take() {
            // The robot goes on as it was.
            world.set_joints(&self.before, velocities);
            (self.world, self.felt) = (world, felt);
            self.begin();
        }
        if !self.seen.problem.is_empty() {
            positions.copy_from_slice(&self.before);
            velocities.fill(0.0);
            return;
        }
        for ((target, drive), lag_s) in self.targets.iter_mut().zip(drives).zip(&self.lags_s) {
            *target = match drive {
                Drive::Torque { torque_nm, .. } => *torque_nm,
                // A servo that follows a moving target stays behind it by its lag.
                Drive::Motion { position, velocity } => position + lag_s * velocity,
            };
        }
        self.world.set_targets(&self.targets);
        if let Err(err) = self.world.step() {
            self.seen.problem = format!("{err}; place the object again");
            positions.copy_from_slice(&self.before);
            velocities.fill(0.0);
            return self.tell();
        }
        self.world.positions_into(positions);
        self.world.velocities_into(velocities);
        let mut is_jammed = false;
        for (dof, drive) in drives.iter().enumerate() {
            if let Drive::Torque { is_jammed: true, .. } = drive {
                (positions[dof], velocities[dof]) = (self.before[dof], 0.0);
                is_jammed = true;
            }
        }
        if is_jammed {
            self.world.set_joints(positions, velocities);
        }
        self.before.copy_from_slice(positions);
        self.num_steps += 1;
        if self.num_steps.is_multiple_of(HIT_STEPS) {
            let table_n = self.world.contacts().robot_table_n;
            self.is_hit = table_n > self.hold_n;
            self.seen.most_table_n = self.seen.most_table_n.max(table_n);
            self.seen.was_hit |= self.is_hit;
        }
        if self.num_steps.is_multiple_of(LOOK_STEPS) {
            self.look();
        } else if self.num_steps.is_multiple_of(POSE_STEPS) {
            self.tell_pose();
        }
    }

    fn object(&self) -> Option<(&FeltObject, Isometry3<f64>)> {
        Some((&self.felt, self.world.base_from_object()))
    }

    fn arm_has_hit(&self) -> bool {
        self.is_hit
    }
}
