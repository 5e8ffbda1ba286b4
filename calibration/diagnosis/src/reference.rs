//! What sessions of a station leave in which nothing is wrong: what other sessions of that station are judged by.
//!
//! A library describes no station quite right. How much it leaves of skin, boards and operators that nobody told it about
//! differs from station to station by a factor of ten and more, so that limits in variances of noise which hold on one of them
//! silence a diagnosis on another. Sessions that are known to miss nothing say what is usual.

use std::collections::BTreeMap;

use palpate_robot_model::{Place, Station};
use palpate_sim::effects::Effect;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::DiagnosisError;
use crate::tactile::adequacy::Adequacy;
use crate::tactile::posture::Least;

/// Probability with which one more session in which nothing is wrong stays below a limit.
const BELOW_LIMIT: f64 = 0.99;
/// Values from which a spread can be told.
const FEWEST_VALUES: usize = 3;

/// What sessions of a station leave in which nothing is wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Id of the station.
    station: String,
    /// Number of sessions; none for the shipped limits.
    sessions: Option<usize>,
    /// Limits of what is left.
    pub(crate) left: Adequacy,
    /// The same of a gain that bends with a joint, squares in variances.
    pub(crate) posture: Least,
    /// Highest evidence of effects that are alike.
    evidence: BTreeMap<Reach, f64>,
}

impl Reference {
    /// What the emulated tuning stations leave, for one that has no reference of its own.
    pub(crate) fn shipped(station: &Station) -> Self {
        Self {
            station: station.id.clone(),
            sessions: None,
            left: Adequacy::SHIPPED,
            posture: Least::SHIPPED,
            evidence: BTreeMap::new(),
        }
    }

    /// Number of sessions that it was made of; none if its limits are the shipped ones.
    pub(crate) fn sessions(&self) -> Option<usize> {
        self.sessions
    }

    /// Itself, if it is of `station`.
    pub(crate) fn check(&self, station: &Station) -> Result<&Self, DiagnosisError> {
        if self.station == station.id {
            return Ok(self);
        }
        Err(DiagnosisError::Input(format!(
            "the reference sessions are of station {:?}, but the session is of {:?}; give sessions of the same station",
            self.station, station.id
        )))
    }

    /// Of sessions of `station` that were measured.
    pub(crate) fn of(station: &Station, measured: &[Measured]) -> Self {
        let mut made = Self { sessions: Some(measured.len()), ..Self::shipped(station) };
        let limit =
            |of: fn(&Measured) -> f64, shipped: f64| prediction_limit(measured.iter().map(of)).max(shipped);
        made.left = Adequacy {
            repeating: limit(|of| of.left.repeating, made.left.repeating),
            at_patch: limit(|of| of.left.at_patch, made.left.at_patch),
            common_mode: limit(|of| of.left.common_mode, made.left.common_mode),
            loss: limit(|of| of.left.loss, made.left.loss),
            switching: limit(|of| of.left.switching, made.left.switching),
            ..made.left
        };
        made.posture.evidence = limit(|of| of.posture, made.posture.evidence);
        for (effect, evidence) in measured.iter().flat_map(|of| &of.named) {
            let most = made.evidence.entry(Reach::of(effect)).or_insert(0.0);
            *most = most.max(*evidence);
        }
        made
    }

    /// Highest evidence that an effect like this one has in reference sessions; none where none is found there.
    pub(crate) fn evidence_of(&self, effect: &Effect) -> Option<f64> {
        self.evidence.get(&Reach::of(effect)).copied()
    }
}

/// What effects are alike by from session to session: what the library lacks of a stream is told now as one effect and now as
/// another, and at one patch as well as at the next.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Reach {
    Stream(String),
    Patch,
    Channels,
    Joint,
    Groups,
    Object,
}

impl Reach {
    fn of(effect: &Effect) -> Self {
        match &effect.place {
            Place::Stream(stream) => Self::Stream(stream.clone()),
            Place::Patch(_) => Self::Patch,
            Place::Channel(_) | Place::Channels(_) => Self::Channels,
            Place::Joint(_) => Self::Joint,
            Place::Group(_) | Place::Groups(_) => Self::Groups,
            Place::Object(_) => Self::Object,
        }
    }
}

/// What one reference session leaves.
pub(crate) struct Measured {
    pub(crate) left: Adequacy,
    /// Squares that a gain which bends with a joint removes, at the patch where it removes most, variances.
    pub(crate) posture: f64,
    /// What is named in it, with the evidence for each.
    pub(crate) named: Vec<(Effect, f64)>,
}

/// What one more of `values` stays below with a probability of 99 %, if their logarithms are normally distributed. Sessions that
/// show nothing of a measure (0) are left out; where fewer than three show something, the largest.
fn prediction_limit(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.filter(|value| *value > 0.0).collect();
    let count = values.len() as f64;
    if values.len() < FEWEST_VALUES {
        return values.into_iter().fold(0.0, f64::max);
    }
    let mean = values.iter().map(|value| value.ln()).sum::<f64>() / count;
    let variance = values.iter().map(|value| (value.ln() - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let quantile = StudentsT::new(0.0, 1.0, count - 1.0).map_or(f64::NAN, |t| t.inverse_cdf(BELOW_LIMIT));
    let limit = (mean + quantile * (variance * (1.0 + 1.0 / count)).sqrt()).exp();
    if limit.is_finite() { rounded_up(limit) } else { f64::MAX }
}

/// The next number with three digits: limits are read by people.
fn rounded_up(limit: f64) -> f64 {
    let step = 10_f64.powf(limit.log10().floor() - 2.0);
    let rounded = (limit / step).ceil() * step;
    // Without the tail of digits that powers of ten leave.
    format!("{rounded:.6}").parse().unwrap_or(rounded)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_limit_is_above_all_that_it_was_made_of_and_grows_with_their_unit(
            values in prop::collection::vec(0.01_f64..100.0, 3..9),
            unit in 0.1_f64..10.0,
        ) {
            let limit = prediction_limit(values.iter().copied());
            let most = values.iter().copied().fold(0.0, f64::max);
            prop_assert!(limit > 0.99 * most, "{limit} of {values:?}");
            let scaled = prediction_limit(values.iter().map(|value| unit * value));
            prop_assert!((scaled / (unit * limit) - 1.0).abs() < 0.02, "{scaled} {limit}");
        }
    }

    #[test]
    fn a_limit_is_the_prediction_limit_of_a_textbook() {
        // Logarithms 0, 1 and 2: mean 1, deviation 1; Student's t with 2 degrees of freedom has its 99 % point at 6.965.
        let values = [0.0_f64, 1.0, 2.0].map(f64::exp);
        let expected = (1.0 + 6.9646 * (4.0_f64 / 3.0).sqrt()).exp();
        let limit = prediction_limit(values.into_iter());
        assert!((limit / expected - 1.0).abs() < 0.01, "{limit} {expected}");
        assert_eq!(prediction_limit([2.0; 3].into_iter()), 2.0, "all alike");
        assert_eq!(prediction_limit([0.0; 3].into_iter()), 0.0, "nothing shows it");
        assert_eq!(prediction_limit([0.0, 1.0, 3.0].into_iter()), 3.0, "two tell no spread");
        assert_eq!(prediction_limit([0.0, 2.0, 2.0, 2.0].into_iter()), 2.0, "what shows nothing is left out");
    }

    #[test]
    fn limits_have_three_digits() {
        assert_eq!([0.12341, 1.8944852, 255.913, 12.5].map(rounded_up), [0.124, 1.9, 256.0, 12.5]);
    }
}
