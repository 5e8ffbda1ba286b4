//! The search of a session: names first, and then what of them stands beside small errors of every joint.

use crate::DiagnosisError;
use crate::engine::{self, Model, Naming, NamingConfig, Watch};
use crate::tactile::TactileDomain;

/// Steps of the fit of the zeros beside the `start`.
const ZERO_STEPS: usize = 6;
/// Share of the work before zeros are fitted.
const FIRST_SHARE: f64 = 0.7;

/// Names what `start` lacks on `takes`. Zeros of joints are fitted along from then on, in `start` too.
///
/// A hidden offset of one joint would be shared out among the zeros of all if these were fitted first. So names
/// come first, those that small errors of all joints account for as well are dropped, and where any were, what they
/// stood in the way of is looked for.
pub(crate) fn search(
    domain: &mut TactileDomain<'_>,
    start: &mut Model,
    takes: &[usize],
    config: &NamingConfig,
    progress: &Watch<'_>,
) -> Result<Naming, DiagnosisError> {
    let known = start.effects.len();
    let mut naming = engine::name(domain, start, takes, config, &|fraction, stage| {
        progress(FIRST_SHARE * fraction, stage)
    })?;
    if naming.model.effects.len() > known {
        naming.settle(domain, takes)?;
    }
    progress(FIRST_SHARE, "fitting the zeros of joints")?;
    domain.fit_zeros([start, &mut naming.model]);
    *start = engine::refit(domain, start, takes, ZERO_STEPS)?;
    let num_names = naming.model.effects.len();
    naming.weigh_again(domain, known, takes, config.kept_bar)?;
    if naming.model.effects.len() < num_names {
        let again = engine::name(domain, &naming.model, takes, config, &|fraction, stage| {
            progress(FIRST_SHARE + (1.0 - FIRST_SHARE) * fraction, stage)
        })?;
        naming.go_on(again);
        naming.weigh_again(domain, known, takes, config.kept_bar)?;
    }
    Ok(naming)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use palpate_sim::SensorModel;
    use palpate_truth::Stage;

    use super::*;
    use crate::engine::Domain as _;

    #[test]
    fn small_errors_of_every_joint_are_fitted_along() {
        let truth = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets/truth/small.toml"));
        let stage = Stage::read(truth).unwrap();
        let takes = stage.record(&[], 1).unwrap();
        let nominal = SensorModel::from_toml("nominal", &stage.station().nominal_model_toml).unwrap();
        let every_take: Vec<usize> = (0..takes.len()).collect();
        let (mut domain, mut start) =
            TactileDomain::new(stage.station(), &takes, &every_take, &nominal).unwrap();
        let num_others = start.base.len();
        let mut off = start.clone();
        domain.fit_zeros([&mut start, &mut off]);
        assert!(
            start.base.len() > num_others + 16 && start.base[num_others..].iter().all(|zero| *zero == 0.0)
        );
        for (idx, zero) in off.base[num_others..].iter_mut().enumerate() {
            *zero = if idx % 3 == 0 { 1e-3 } else { -6e-4 };
        }
        let recorded = domain.simulated(&off, 3).unwrap();
        let loss = |model: &Model| -> f64 {
            engine::loss_by_unit(&recorded, model, &every_take).unwrap().into_iter().sum()
        };
        let fitted = engine::refit(&recorded, &start, &every_take, ZERO_STEPS).unwrap();
        let mut without = fitted.clone();
        without.base[num_others..].fill(0.0);
        assert!(loss(&fitted) < 0.8 * loss(&start), "{} of {}", loss(&fitted), loss(&start));
        assert!(loss(&fitted) < 0.9 * loss(&without), "{} of {}", loss(&fitted), loss(&without));
        let most = fitted.base[num_others..].iter().fold(0.0_f64, |most, zero| most.max(zero.abs()));
        assert!(most < 3e-3, "{most}");
        assert_eq!(recorded.base().len(), fitted.base.len());
    }
}
