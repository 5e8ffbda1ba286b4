//! Trials on the hand beside the same starts in simulation.

use palpate_statistics::mcnemar_exact;
use palpate_wire::api::{ComparedPairing, TrialVerdict};

use crate::{TrialsError, results::rate};

/// The trials of `hand` beside those of `simulated`, which begin alike one by one, with the model of this id. Of which policy
/// and object, and how touch agrees, is left open.
pub fn paired(
    hand: &[TrialVerdict],
    simulated: &[TrialVerdict],
    model: &str,
) -> Result<ComparedPairing, TrialsError> {
    let (mut both, mut only_hand, mut only_simulated, mut same_verdict) = (0, 0, 0, 0);
    for (on_hand, in_simulation) in hand.iter().zip(simulated) {
        same_verdict += u64::from(on_hand == in_simulation);
        match (*on_hand == TrialVerdict::Success, *in_simulation == TrialVerdict::Success) {
            (true, true) => both += 1,
            (true, false) => only_hand += 1,
            (false, true) => only_simulated += 1,
            (false, false) => {}
        }
    }
    let trials = hand.len().min(simulated.len()) as u64;
    Ok(ComparedPairing {
        policy: None,
        object: None,
        model: model.to_owned(),
        hand: rate(both + only_hand, trials)?,
        simulated: rate(both + only_simulated, trials)?,
        same_verdict,
        only_hand,
        only_simulated,
        p_mcnemar: mcnemar_exact(only_hand, only_simulated),
        touch: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_only_one_side_wins_is_counted_apart() {
        use TrialVerdict::{EmptyGrasp, Slip, Success};
        let hand = [Success, Success, Slip, EmptyGrasp, Success];
        let simulated = [Success, Slip, Success, Slip, EmptyGrasp];
        let found = paired(&hand, &simulated, "nominal").unwrap();
        assert_eq!((found.hand.successes, found.simulated.successes, found.hand.trials), (3, 2, 5));
        assert_eq!((found.same_verdict, found.only_hand, found.only_simulated), (1, 2, 1));
        // Of three pairs that differ, two against one: as likely as any.
        assert!((found.p_mcnemar - 1.0).abs() < 1e-12);
        assert!(found.hand.wilson_95[0] < 0.6 && found.hand.wilson_95[1] > 0.6);
    }
}
