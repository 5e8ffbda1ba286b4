//! Many environments at once, on every core.

use std::sync::Arc;

use rayon::prelude::*;

use crate::{GraspEnv, GraspError, GraspScene, Start};

/// Environments of one scene that step together. Each has its own random numbers and its own world, and they do not
/// meet, so that results have the same bits for any number of threads.
#[derive(Debug)]
pub struct GraspBatch {
    scene: Arc<GraspScene>,
    envs: Vec<GraspEnv>,
}

impl GraspBatch {
    /// `num_envs` environments at the nominal start; number i draws from stream i of `seed`.
    pub fn new(scene: Arc<GraspScene>, num_envs: usize, seed: u64) -> Result<Self, GraspError> {
        let env = |idx| GraspEnv::new(Arc::clone(&scene), seed, idx as u64);
        let envs = (0..num_envs).into_par_iter().map(env).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { scene, envs })
    }

    /// The environments, in order.
    pub fn envs(&self) -> &[GraspEnv] {
        &self.envs
    }

    /// Begins a new episode in each.
    pub fn reset(&mut self) -> Result<(), GraspError> {
        self.envs.par_iter_mut().try_for_each(|env| env.reset().map(drop))
    }

    /// Begins a new episode in each, at the start of the same number.
    ///
    /// # Panics
    /// If there are not as many starts as environments: a caller's bug.
    pub fn begin(&mut self, starts: &[Start]) -> Result<(), GraspError> {
        assert_eq!(starts.len(), self.envs.len(), "one start an environment");
        self.envs.par_iter_mut().zip(starts).try_for_each(|(env, start)| env.begin(start))
    }

    /// One control step of each: `targets` is `num_envs x num_dofs`, `observations` `num_envs x num_observations`, both
    /// row-major.
    ///
    /// # Panics
    /// If either has the wrong length: a caller's bug.
    pub fn step(&mut self, targets: &[f64], observations: &mut [f32]) -> Result<(), GraspError> {
        let num_dofs = self.scene.station().robot.num_dofs();
        let num_observations = self.scene.num_observations();
        assert_eq!(targets.len(), self.envs.len() * num_dofs, "targets of every environment");
        assert_eq!(observations.len(), self.envs.len() * num_observations, "room for every environment");
        self.envs
            .par_iter_mut()
            .zip(targets.par_chunks(num_dofs))
            .zip(observations.par_chunks_mut(num_observations))
            .try_for_each(|((env, targets), observations)| {
                env.step(targets)?;
                env.observe(observations);
                Ok(())
            })
    }
}
