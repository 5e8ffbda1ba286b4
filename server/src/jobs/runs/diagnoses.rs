//! Diagnoses, and what becomes of the effects that they name.

use palpate_reports::{DiagnosisReport, NamedEffect, wording};
use palpate_sim::SensorModel;
use palpate_wire::api::{DiagnosisRequest, ModelSummary, SaveDiagnosisRequest};

use super::{RunKind, Runs};
use crate::{
    Error,
    jobs::kinds::{BASE_FILE, CALIBRATED_FILE, DIAGNOSE, JobKind},
};

/// `palpate diagnose`.
pub(crate) struct Diagnoses;

impl RunKind for Diagnoses {
    type Report = DiagnosisReport;
    type Request = DiagnosisRequest;

    const HINT: &'static str = "GET /api/v1/diagnoses lists them";
    const KIND: &'static JobKind = &DIAGNOSE;
    const WHAT: &'static str = "diagnosis";
}

impl Runs<'_, Diagnoses> {
    /// The calibrated model of run `id`, without the effects that it named.
    pub(crate) fn calibrated(&self, id: &str) -> Result<SensorModel, Error> {
        // Says what is wrong with a run that has found no model.
        self.model(id)?;
        let text = self.file(id, CALIBRATED_FILE)?.ok_or_else(|| Error::NotFound {
            what: "calibrated model of diagnosis",
            id: id.to_owned(),
            hint: "its file is missing in runs/; run the diagnosis again",
        })?;
        Ok(SensorModel::from_toml(&format!("calibrated model of diagnosis {id}"), &text)?)
    }

    /// Keeps the model of run `id` with the chosen effects: as a new one, or in place of the one that it started from,
    /// whose earlier version stays.
    pub(crate) fn save(&self, id: &str, request: &SaveDiagnosisRequest) -> Result<ModelSummary, Error> {
        let mut model = self.model(id)?;
        let run = self.get(id)?;
        let named = run.report.map(|report| report.effects).unwrap_or_default();
        keep_effects(id, &mut model, &named, request.effects.as_deref())?;
        let store = self.jobs.store();
        let summary = match (&request.name, &request.to) {
            (Some(name), None) => {
                model.name = name.trim().to_owned();
                store.save_model(&model)?
            }
            (None, Some(to)) if run.request.model.as_ref() != Some(to) => {
                let (known, _) = store.model(to)?;
                return Err(Error::Conflict(format!(
                    "diagnosis {id:?} did not start from model {:?}, so its effects were not fitted beside that \
                     model's; start a diagnosis from it, or save a new model",
                    known.name
                )));
            }
            (None, Some(to)) => {
                let (known, text) = store.model(to)?;
                if self.file(id, BASE_FILE)?.as_ref() != Some(&text) {
                    return Err(Error::Conflict(format!(
                        "model {:?} has changed since diagnosis {id:?} started from it; undo that, diagnose again, or \
                         save a new model",
                        known.name
                    )));
                }
                model.name = known.name;
                model.provenance.splice(..0, known.provenance);
                store.replace_model(to, &model, id)?
            }
            _ => {
                return Err(Error::Argument(
                    "give either \"name\" for a new model or \"to\" for the model to add to".to_owned(),
                ));
            }
        };
        self.set_saved_as(id, &summary.id)?;
        Ok(summary)
    }
}

/// Takes those of the `named` effects out of `model` that were not chosen by their position.
fn keep_effects(
    id: &str,
    model: &mut SensorModel,
    named: &[NamedEffect],
    chosen: Option<&[usize]>,
) -> Result<(), Error> {
    if named.is_empty() {
        return Err(Error::Conflict(format!("diagnosis {id:?} named nothing, so there is nothing to add")));
    }
    let Some(chosen) = chosen else { return Ok(()) };
    if chosen.is_empty() {
        return Err(Error::Argument("no effect is chosen; choose at least one to add".to_owned()));
    }
    if let Some(unknown) = chosen.iter().find(|&&idx| idx >= named.len()) {
        return Err(Error::Argument(format!(
            "no effect {unknown}: diagnosis {id:?} named {}, counted from 0",
            named.len()
        )));
    }
    let left_out = named.iter().enumerate().filter(|(idx, _)| !chosen.contains(idx));
    for (_, named) in left_out {
        model.effects.retain(|effect| (&effect.id, &effect.place) != (&named.id, &named.place));
        let what = wording::effect_at(&named.id, &named.place);
        model.provenance.push(format!("left out by the operator: {what}"));
    }
    Ok(())
}
