//! The search of a session: names first, and then what of them stands beside what every station has a little of.

use crate::DiagnosisError;
use crate::engine::{self, Model, Naming, NamingConfig, Watch};
use crate::tactile::TactileDomain;

/// Steps of the fit of what is fitted along beside the `start`.
const ALONG_STEPS: usize = 6;
/// Share of the work before that.
const FIRST_SHARE: f64 = 0.7;

/// Names what `start` lacks on `takes`. Zeros of joints, and of events alone how skins creep, are fitted along from then
/// on, in `start` too.
///
/// A hidden offset of one joint would be shared out among the zeros of all if these were fitted first, and a filter
/// among times of creep. So names come first, those that are not founded beside them are dropped, and where any were,
/// what they stood in the way of is looked for.
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
    progress(FIRST_SHARE, "fitting zeros of joints along")?;
    domain.fit_along([start, &mut naming.model]);
    *start = engine::refit(domain, start, takes, ALONG_STEPS)?;
    let num_names = naming.model.effects.len();
    let bar = config.bar.max(config.kept_bar);
    naming.weigh_again(domain, known, takes, bar)?;
    if naming.model.effects.len() < num_names {
        let again = engine::name(domain, &naming.model, takes, config, &|fraction, stage| {
            progress(FIRST_SHARE + (1.0 - FIRST_SHARE) * fraction, stage)
        })?;
        naming.go_on(again);
        naming.weigh_again(domain, known, takes, bar)?;
    }
    Ok(naming)
}

#[cfg(test)]
mod tests {
    use palpate_recording::Take;

    use super::*;
    use crate::engine::Domain as _;
    use crate::testing::{Session, session};

    #[test]
    fn small_errors_of_every_joint_are_fitted_along() {
        let Session { stage, takes, nominal } = session("small");
        let every_take: Vec<usize> = (0..takes.len()).collect();
        let (mut domain, mut start) =
            TactileDomain::new(stage.station(), &takes, &every_take, &nominal).unwrap();
        let num_others = start.base.len();
        let mut off = start.clone();
        domain.fit_along([&mut start, &mut off]);
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
        let fitted = engine::refit(&recorded, &start, &every_take, ALONG_STEPS).unwrap();
        let mut without = fitted.clone();
        without.base[num_others..].fill(0.0);
        assert!(loss(&fitted) < 0.8 * loss(&start), "{} of {}", loss(&fitted), loss(&start));
        assert!(loss(&fitted) < 0.9 * loss(&without), "{} of {}", loss(&fitted), loss(&without));
        let most = fitted.base[num_others..].iter().fold(0.0_f64, |most, zero| most.max(zero.abs()));
        assert!(most < 3e-3, "{most}");
        assert_eq!(recorded.base().len(), fitted.base.len());
    }

    /// Takes raw readings away, and leaves events.
    fn take_readings_away(take: &mut Take) {
        for log in &mut take.streams {
            log.raw.clear();
            log.reference.clear();
            log.later_references.clear();
        }
    }

    #[test]
    fn a_stream_that_stands_still_is_looked_for_in_readings_alone() {
        let Session { stage, mut takes, nominal } = session("small");
        takes.truncate(1);
        let looked_for = |takes: &[Take]| {
            let (domain, _) = TactileDomain::new(stage.station(), takes, &[0], &nominal).unwrap();
            domain.candidates().iter().any(|candidate| candidate.id == "sample_hold")
        };
        assert!(looked_for(&takes));
        takes.iter_mut().for_each(take_readings_away);
        assert!(!looked_for(&takes));
    }

    #[test]
    fn of_events_alone_creep_is_fitted_along_too() {
        let Session { stage, mut takes, nominal } = session("small");
        takes.truncate(1);
        let num_streams = stage.station().layout.streams.len();
        let num_creeps = |takes: &[Take]| {
            let (mut domain, mut start) = TactileDomain::new(stage.station(), takes, &[0], &nominal).unwrap();
            let num = |domain: &TactileDomain<'_>| -> usize {
                domain.base().iter().filter(|number| number.name.starts_with("creep_")).count()
            };
            let before = num(&domain);
            domain.fit_along([&mut start.clone(), &mut start]);
            let mut creeping = start.clone();
            for (value, number) in creeping.base.iter_mut().zip(domain.base()) {
                *value += if number.name.starts_with("creep_") { number.upper } else { 0.0 };
            }
            assert!(domain.predict(0, &creeping).unwrap() != domain.predict(0, &start).unwrap());
            [before, num(&domain)]
        };
        assert_eq!(num_creeps(&takes), [3 * num_streams; 2]);
        take_readings_away(&mut takes[0]);
        assert_eq!(num_creeps(&takes), [0, 3 * num_streams]);
    }
}
