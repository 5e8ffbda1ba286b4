//! Which takes are kept for judging.

use std::collections::BTreeMap;

use crate::{CalibrationError, HoldOut, PairedTake};

/// For each of `takes`, whether `choice` holds it out.
///
/// # Errors
/// A take that is not there, or a choice that leaves none to fit.
pub fn held_out(choice: &HoldOut, takes: &[PairedTake]) -> Result<Vec<bool>, CalibrationError> {
    let held_out = match choice {
        HoldOut::Auto => automatic(takes),
        HoldOut::Takes(ids) => by_id(ids, takes)?,
    };
    if held_out.iter().all(|&held_out| held_out) {
        return Err(CalibrationError::Input(format!(
            "all {} takes are held out, so none is left to fit; hold out fewer",
            takes.len()
        )));
    }
    Ok(held_out)
}

fn by_id(ids: &[String], takes: &[PairedTake]) -> Result<Vec<bool>, CalibrationError> {
    if let Some(unknown) = ids.iter().find(|&id| takes.iter().all(|take| take.id != *id)) {
        let known: Vec<&str> = takes.iter().map(|take| take.id.as_str()).collect();
        return Err(CalibrationError::Input(format!(
            "cannot hold out take {unknown:?}: the session's usable takes are {}",
            known.join(", ")
        )));
    }
    Ok(takes.iter().map(|take| ids.contains(&take.id)).collect())
}

/// About a third of the takes of each object, spread evenly over the session, at least one of each object and never
/// all. Where no object has two takes, a third of all takes. A session of one take holds out nothing.
fn automatic(takes: &[PairedTake]) -> Vec<bool> {
    let mut by_object: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (take_idx, take) in takes.iter().enumerate() {
        by_object.entry(&take.object).or_default().push(take_idx);
    }
    let mut groups: Vec<Vec<usize>> = by_object.into_values().filter(|group| group.len() > 1).collect();
    if groups.is_empty() {
        groups.push((0..takes.len()).collect());
    }
    let mut held_out = vec![false; takes.len()];
    for group in groups.iter().filter(|group| group.len() > 1) {
        let num_held_out = ((group.len() + 1) / 3).max(1);
        for i in 0..num_held_out {
            held_out[group[(2 * i + 1) * group.len() / (2 * num_held_out)]] = true;
        }
    }
    held_out
}

#[cfg(test)]
mod tests {
    use palpate_sim::replay::ContactTrace;

    use super::*;

    fn takes(objects: &[&str]) -> Vec<PairedTake> {
        let take = |(idx, object): (usize, &&str)| PairedTake {
            id: format!("take-{:02}", idx + 1),
            object: (*object).to_owned(),
            frame_times_s: Vec::new(),
            contact: ContactTrace { num_frames: 0, patches: Vec::new() },
            real_active: Vec::new(),
        };
        objects.iter().enumerate().map(take).collect()
    }

    fn auto(objects: &[&str]) -> Vec<usize> {
        let held_out = held_out(&HoldOut::Auto, &takes(objects)).expect("something is left");
        (0..objects.len()).filter(|&idx| held_out[idx]).collect()
    }

    #[test]
    fn a_third_is_held_out_with_every_object_on_both_sides() {
        let session = ["ball", "ball", "ball", "ball", "ball", "can", "can", "can", "can"];
        assert_eq!(auto(&session), [1, 3, 7]);
    }

    #[test]
    fn object_with_one_take_is_fitted() {
        assert_eq!(auto(&["ball", "can", "can"]), [2]);
    }

    #[test]
    fn without_a_repeated_object_a_third_of_all_is_held_out() {
        assert_eq!(auto(&["a", "b", "c"]), [1]);
        assert_eq!(auto(&["a", "b"]), [1]);
        assert_eq!(auto(&["a"]), [0_usize; 0]);
    }

    #[test]
    fn unknown_take_is_refused_with_the_known_ones() {
        let choice = HoldOut::Takes(vec!["take-09".to_owned()]);
        let err = held_out(&choice, &takes(&["a", "b"])).expect_err("no such take");
        let expected = "cannot hold out take \"take-09\": the session's usable takes are take-01, take-02";
        assert_eq!(err.to_string(), expected);
    }

    #[test]
    fn holding_out_everything_is_refused() {
        let choice = HoldOut::Takes(vec!["take-01".to_owned(), "take-02".to_owned()]);
        let err = held_out(&choice, &takes(&["a", "b"])).expect_err("nothing is left");
        assert_eq!(err.to_string(), "all 2 takes are held out, so none is left to fit; hold out fewer");
    }
}
