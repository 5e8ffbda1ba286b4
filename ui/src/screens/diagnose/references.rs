//! Reference sessions: those in which nothing is wrong.

use std::collections::BTreeSet;

use palpate_reports::MIN_REFERENCES;
use palpate_wire::api::SessionSummary;

use crate::theme::Palette;

/// Check boxes for the sessions of the station of `session`, other than itself; what is wrong with the choice, in words.
pub(super) fn references_ui(
    ui: &mut egui::Ui,
    palette: &Palette,
    chosen: &mut BTreeSet<String>,
    sessions: &[SessionSummary],
    session: &str,
) -> Option<String> {
    let station = sessions.iter().find(|known| known.id == session).map(|known| known.station.as_str());
    let is_other = |known: &&SessionSummary| {
        known.error.is_none() && known.id != session && Some(known.station.as_str()) == station
    };
    let others: Vec<&SessionSummary> = sessions.iter().filter(is_other).collect();
    // A session that went to the trash, or is of another station, is no reference.
    chosen.retain(|id| others.iter().any(|other| other.id == *id));
    let title = match chosen.len() {
        0 => "Reference sessions: none".to_owned(),
        count => format!("Reference sessions: {count}"),
    };
    egui::CollapsingHeader::new(title).id_salt("references").show(ui, |ui| {
        ui.label(
            egui::RichText::new(
                "Sessions of this station in which nothing is wrong. What they leave unexplained is usual here, and sets the \
                 limits for this session. Each is searched first, which takes as long as the diagnosis.",
            )
            .color(palette.text_weak),
        );
        if others.len() < MIN_REFERENCES {
            let found = match others.len() {
                0 => "There is no other session of this station".to_owned(),
                1 => "There is one other session of this station".to_owned(),
                count => format!("There are {count} other sessions of this station"),
            };
            ui.label(format!("{found}; record at least {MIN_REFERENCES} while the hand works as it should."));
        }
        for other in &others {
            let mut is_chosen = chosen.contains(&other.id);
            let response = ui.checkbox(&mut is_chosen, egui::AtomExt::atom_shrink(other.id.as_str(), true));
            if response.changed() {
                if is_chosen {
                    chosen.insert(other.id.clone());
                } else {
                    chosen.remove(&other.id);
                }
            }
        }
    });
    (1..MIN_REFERENCES)
        .contains(&chosen.len())
        .then(|| format!("Tick at least {MIN_REFERENCES} reference sessions, or none."))
}
