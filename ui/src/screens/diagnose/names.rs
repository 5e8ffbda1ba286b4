//! Channels and patches of a report under the names that they have everywhere on the page.

use palpate_reports::DiagnosisReport;
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
    report
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
