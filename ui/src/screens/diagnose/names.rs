//! Channels and patches of a report under the names that they have everywhere on the page.

use palpate_reports::{DiagnosisReport, TooMuchLeft};
use palpate_robot_model::{Place, Station};

use crate::screens::channel_label;

/// `report` with the names that `station` has for the places of effects. Cells and the residual map keep ids: they lead to
/// the channel.
pub(super) fn named(report: &DiagnosisReport, station: &Station) -> DiagnosisReport {
    let mut report = report.clone();
    for effect in &mut report.effects {
        name(&mut effect.place, station);
        for rival in &mut effect.rivals {
            name(&mut rival.place, station);
        }
    }
    for tried in &mut report.candidates {
        name(&mut tried.place, station);
    }
    for doubtful in &mut report.in_doubt {
        name(&mut doubtful.place, station);
    }
    for because in &mut report.unexplained.because {
        because.sentence = sentence(because, station);
    }
    report
}

/// Its sentence with the label of its place. Reports of before have the id there.
fn sentence(because: &TooMuchLeft, station: &Station) -> String {
    let layout = &station.layout;
    let known = match &because.place {
        Some(Place::Patch(id)) => {
            layout.patches.iter().find(|patch| patch.id == *id).map(|patch| (id, &patch.label))
        }
        Some(Place::Stream(id)) => {
            layout.streams.iter().find(|stream| stream.id == *id).map(|stream| (id, &stream.label))
        }
        _ => None,
    };
    match known {
        Some((id, label)) if !because.sentence.contains(label.as_str()) => {
            with_word(&because.sentence, id, label)
        }
        _ => because.sentence.clone(),
    }
}

/// `text` with `label` in the place of the word `id`.
fn with_word(text: &str, id: &str, label: &str) -> String {
    let is_between = |c: char| !(c.is_alphanumeric() || matches!(c, '_' | '-'));
    let words = text.split_inclusive(is_between).map(|piece| {
        let word = piece.trim_end_matches(is_between);
        if word == id { format!("{label}{}", &piece[word.len()..]) } else { piece.to_owned() }
    });
    words.collect()
}

fn name(place: &mut Place, station: &Station) {
    match place {
        Place::Channel(id) => *id = channel_label(Some(station), id),
        Place::Channels(ids) => ids.iter_mut().for_each(|id| *id = channel_label(Some(station), id)),
        Place::Patch(id) => {
            if let Some(patch) = station.layout.patches.iter().find(|patch| patch.id == *id) {
                id.clone_from(&patch.label);
            }
        }
        Place::Stream(_) | Place::Joint(_) | Place::Group(_) | Place::Groups(_) | Place::Object(_) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::with_word;

    #[test]
    fn a_word_is_replaced_and_not_what_contains_it() {
        let text = "in readings of ring_tip, ring_tips and my-ring_tip: 0.9 (ring_tip)";
        let expected = "in readings of Ring tip, ring_tips and my-ring_tip: 0.9 (Ring tip)";
        assert_eq!(with_word(text, "ring_tip", "Ring tip"), expected);
    }
}
