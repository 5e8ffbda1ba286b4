//! Many environments that feel side by side.

use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_sim::live::LiveTouch;
use rayon::prelude::*;

use crate::scene::pose;
use crate::{TouchError, TouchScene};

/// Environments of one scene, each with what its effects remember.
///
/// Environments are independent: readings have the same bits for any number of threads and of other environments.
#[derive(Debug)]
pub struct TouchBatch {
    scene: Arc<TouchScene>,
    envs: Vec<Env>,
    pool: rayon::ThreadPool,
}

#[derive(Debug)]
struct Env {
    touch: LiveTouch,
    /// Of the step that is under way.
    base_from_object: Isometry3<f64>,
    active: Vec<bool>,
}

/// Environments that one thread takes at a time: enough work to be worth handing over.
const ENVS_PER_TASK: usize = 8;

/// Environments beyond which a mistake is likelier than a machine that holds them.
const MAX_ENVS: usize = 1 << 24;

impl TouchBatch {
    /// `num_envs` environments in which nothing has happened yet, on `num_threads` (0: one for every core).
    pub fn new(scene: Arc<TouchScene>, num_envs: usize, num_threads: usize) -> Result<Self, TouchError> {
        if !(1..=MAX_ENVS).contains(&num_envs) {
            return Err(TouchError::Input(format!("{num_envs} environments, expected 1 to {MAX_ENVS}")));
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .thread_name(|idx| format!("palpate touch {idx}"))
            .build()
            .map_err(|err| TouchError::Input(format!("failed to start {num_threads} threads: {err}")))?;
        let env = || Env {
            touch: LiveTouch::new(Arc::clone(scene.live())),
            base_from_object: Isometry3::identity(),
            active: vec![false; scene.station().layout.num_channels()],
        };
        Ok(Self { envs: (0..num_envs).map(|_| env()).collect(), scene, pool })
    }

    /// Its scene.
    pub fn scene(&self) -> &TouchScene {
        &self.scene
    }

    /// Number of environments.
    pub fn num_envs(&self) -> usize {
        self.envs.len()
    }

    /// One frame of every environment: `times_s` one each, `positions` a row of joint positions each, `poses` the object's
    /// pose each. Puts a row of readings each into `raw`, and of 0 or 1 into `active`.
    ///
    /// A step that is refused changes nothing, in no environment.
    ///
    /// # Panics
    /// If a slice has the wrong length: a caller's bug.
    pub fn step(
        &mut self,
        times_s: &[f64],
        positions: &[f64],
        poses: &[[f64; 7]],
        raw: &mut [f64],
        active: &mut [u8],
    ) -> Result<(), TouchError> {
        let station = self.scene.station();
        let (num_dofs, num_channels) = (station.robot.num_dofs(), station.layout.num_channels());
        let num_envs = self.envs.len();
        assert_eq!([times_s.len(), poses.len()], [num_envs; 2], "a time and a pose for each environment");
        assert_eq!(positions.len(), num_envs * num_dofs, "a position for each joint");
        assert_eq!([raw.len(), active.len()], [num_envs * num_channels; 2], "a reading for each channel");
        if num_channels == 0 {
            return Ok(());
        }
        let envs = &mut self.envs;
        let rows = || positions.par_chunks_exact(num_dofs.max(1));
        self.pool.install(|| {
            envs.par_iter_mut()
                .with_min_len(ENVS_PER_TASK)
                .zip(times_s)
                .zip(rows())
                .zip(poses)
                .enumerate()
                .map(|(idx, (((env, &time_s), positions), values))| {
                    env.base_from_object = pose(values)
                        .map_err(|problem| TouchError::Input(format!("environment {idx}: {problem}")))?;
                    env.touch
                        .check(time_s, positions, &env.base_from_object)
                        .map_err(|error| TouchError::of("environment", idx, &error))
                })
                // The first one, for any number of threads.
                .find_first(Result::is_err)
                .unwrap_or(Ok(()))?;
            envs.par_iter_mut()
                .with_min_len(ENVS_PER_TASK)
                .zip(times_s)
                .zip(rows())
                .zip(raw.par_chunks_exact_mut(num_channels))
                .zip(active.par_chunks_exact_mut(num_channels))
                .for_each(|((((env, &time_s), positions), raw), active)| {
                    let Env { touch, base_from_object, active: is_active } = env;
                    touch.feel_checked(time_s, positions, base_from_object, raw, is_active);
                    active.iter_mut().zip(is_active).for_each(|(to, from)| *to = u8::from(*from));
                });
            Ok(())
        })
    }

    /// A new episode begins in the environments for which `which` is not 0; `None`: in all.
    ///
    /// # Panics
    /// If `which` has another length than there are environments: a caller's bug.
    pub fn restart(&mut self, which: Option<&[u8]>) {
        match which {
            None => self.envs.iter_mut().for_each(|env| env.touch.restart()),
            Some(which) => {
                assert_eq!(which.len(), self.envs.len(), "one for each environment");
                let wanted = self.envs.iter_mut().zip(which).filter(|(_, which)| **which != 0);
                wanted.for_each(|(env, _)| env.touch.restart());
            }
        }
    }
}
