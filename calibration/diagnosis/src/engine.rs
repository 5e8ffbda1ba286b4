//! The part of a diagnosis that knows no sensors: what a [`Domain`] must offer, and the naming of effects in it.
//!
//! - [`rows`]: how the rows of takes are numbered
//! - [`segment`]: one signal of one take under a model
//! - [`linear`]: a model's surroundings to first order: weighted residuals, nuisances projected out, doses of candidates
//! - [`normal`]: normal matrices
//! - [`screen`]: every candidate by its dose response
//! - [`descend`]: steps of a fit
//! - [`fit`]: candidates and whole models, fitted for real
//! - [`evidence`]: what speaks for an effect beside all others
//! - [`agreement`]: whether names are of one size in all takes, and of different things
//! - [`adequacy`]: whether names account for what is there
//! - [`choose`]: what to name of what was tried
//! - [`merge`]: one name for what several explain in parts
//! - [`reconsider`]: a second look at names that little tells apart
//! - [`mod@name`]: rounds of screening and fitting, until nothing reaches the bar

mod adequacy;
mod agreement;
mod choose;
mod descend;
mod evidence;
mod fit;
mod linear;
mod merge;
mod name;
mod naming;
mod normal;
mod reconsider;
mod robust;
mod rows;
mod screen;
mod segment;
#[cfg(test)]
mod tests;

pub(crate) use adequacy::{loss_by_unit, share_left};
pub(crate) use agreement::Contributions;
pub(crate) use choose::RIVAL_SHARE;
pub(crate) use fit::{Fit, Nearby, refit};
pub use name::name;
pub(crate) use name::strongest;
pub use naming::{Naming, NamingConfig, Round, Tried};
pub(crate) use normal::inverse;

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use palpate_sim::effects::{Effect, Parameter};
use rayon::prelude::*;

use crate::DiagnosisError;

/// A model: the domain's own parameters, and effects.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Values of [`Domain::base`], in its order.
    pub base: Vec<f64>,
    /// Effects, in the order in which they were added.
    pub effects: Vec<Effect>,
}

/// A parameter of the model that is there whatever effects there are: fitted along, never named.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseParameter {
    /// Its name, with its unit.
    pub name: String,
    /// Lowest value.
    pub lower: f64,
    /// Highest value.
    pub upper: f64,
    /// Step for derivatives.
    pub dose: f64,
}

/// A value for every sample of a take. Predictions of two models share what they have in common, so that what did not
/// change need not be looked at again.
pub type Series = Arc<[f64]>;

/// Measurements, and a family of models that predict them.
///
/// Every take is a table: each of its samples has a row for every signal, which is one kind of measurement of one unit,
/// `signal = unit * num_kinds + kind`. What they mean is the domain's affair. Samples of one block may depend on each
/// other, samples of different blocks nearly do not.
pub trait Domain: Sync {
    /// Number of takes.
    fn num_takes(&self) -> usize;

    /// Consecutive ranges that cover the samples of `take`.
    fn blocks(&self, take: usize) -> &[Range<usize>];

    /// Measured values of a signal, one a sample; NaN where nothing was measured.
    fn observed(&self, take: usize, signal: usize) -> &[f64];

    /// The model's own parameters.
    fn base(&self) -> &[BaseParameter];

    /// Every effect at every place, at its neutral parameters.
    fn candidates(&self) -> Vec<Effect>;

    /// Parameters of `effect` at its place.
    fn parameters(&self, effect: &Effect) -> Vec<Parameter>;

    /// Number of units: parts of the measurement (channels) that effects reach separately.
    fn num_units(&self) -> usize;

    /// Number of kinds of signals: kinds of measurement (events, readings) of which an effect may change one and not
    /// another.
    fn num_kinds(&self) -> usize {
        1
    }

    /// Number of signals.
    fn num_signals(&self) -> usize {
        self.num_units() * self.num_kinds()
    }

    /// Standard deviation around zero that the parameter `idx` of [`Self::base`] is known to have before anything
    /// is measured; `None` where nothing is known.
    fn prior_standard_deviation(&self, _idx: usize) -> Option<f64> {
        None
    }

    /// Which units the parameter `idx` of [`Self::base`] reaches.
    fn base_support(&self, _idx: usize) -> Vec<bool> {
        vec![true; self.num_units()]
    }

    /// Whether `effect` can change anything in `take`.
    fn reaches_take(&self, _effect: &Effect, _take: usize) -> bool {
        true
    }

    /// Which units a parameter of `effect` can reach.
    fn support(&self, effect: &Effect, parameter: &str) -> Vec<bool>;

    /// Which units `effect` can reach, with any of its parameters.
    fn reach(&self, effect: &Effect) -> Vec<bool> {
        let supports = self.parameters(effect).into_iter().map(|p| self.support(effect, &p.name));
        supports.fold(vec![false; self.num_units()], |mut reach, support| {
            reach.iter_mut().zip(support).for_each(|(reached, of_parameter)| *reached |= of_parameter);
            reach
        })
    }

    /// What `model` predicts for the signals of `take`.
    fn predict(&self, take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError>;

    /// [`Self::predict`] of each of `takes`, side by side.
    fn predict_takes(&self, takes: &[usize], model: &Model) -> Result<Vec<Vec<Series>>, DiagnosisError> {
        takes.par_iter().map(|&take| self.predict(take, model)).collect()
    }

    /// How far `model` is from what is known of it before anything is measured, as a datasheet or a scale has it:
    /// squares of standard deviations, summed. 0 where nothing is known.
    fn strain(&self, _model: &Model) -> Result<f64, DiagnosisError> {
        Ok(0.0)
    }

    /// One over the standard deviation that each sample of `signal` is allowed around `prediction`.
    fn weights(&self, take: usize, signal: usize, prediction: &[f64]) -> Vec<f64>;
}

/// Whether two sets have anything in common.
fn overlap(one: &[bool], other: &[bool]) -> bool {
    one.iter().zip(other).any(|(one, other)| *one && *other)
}

/// Adds `other` to `units`.
fn unite(units: &mut [bool], other: &[bool]) {
    units.iter_mut().zip(other).for_each(|(unit, other)| *unit |= other);
}

/// Whether all units of `inner` are in `outer`.
fn within(inner: &[bool], outer: &[bool]) -> bool {
    inner.iter().zip(outer).all(|(inner, outer)| !inner || *outer)
}

/// Share of a `loss` that a `gain` is; none of no loss, where what is gained is gained elsewhere.
fn share(gain: f64, loss: f64) -> f64 {
    if loss > 0.0 { gain / loss } else { 0.0 }
}

/// Hears which fraction of some work is done and what is being done now, and may stop it.
pub type Watch<'w> = dyn Fn(f64, &str) -> Result<(), DiagnosisError> + Sync + 'w;

/// What `work` makes of each of `items`, in their order, on every core. `begun` hears the fraction of the work that
/// is done and the item that comes next, and may stop it; what it hears never decreases.
pub(crate) fn each<T: Send, R: Send>(
    items: Vec<T>,
    begun: impl Fn(f64, &T) -> Result<(), DiagnosisError> + Sync,
    work: impl Fn(T) -> Result<R, DiagnosisError> + Sync,
) -> Result<Vec<R>, DiagnosisError> {
    let (num_items, num_begun) = (items.len(), Mutex::new(0));
    let one = |item: T| {
        {
            let mut num_begun = num_begun.lock().unwrap_or_else(PoisonError::into_inner);
            begun(f64::from(*num_begun) / num_items as f64, &item)?;
            *num_begun += 1;
        }
        work(item)
    };
    items.into_par_iter().with_max_len(1).map(one).collect()
}

/// Residuals beyond this many standard deviations count no more than linearly.
pub(crate) const HUBER: f64 = 4.0;

/// Huber's loss of a residual in standard deviations, scaled to be its square in the middle.
pub(crate) fn huber(residual: f64) -> f64 {
    let size = residual.abs();
    if size <= HUBER { size * size } else { HUBER * (2.0 * size - HUBER) }
}

/// `effect` with every parameter where the effect is absent.
pub(crate) fn neutral(effect: &Effect, parameters: &[Parameter]) -> Effect {
    let mut effect = effect.clone();
    effect.parameters = parameters.iter().map(|p| (p.name.clone(), p.neutral)).collect();
    effect
}
