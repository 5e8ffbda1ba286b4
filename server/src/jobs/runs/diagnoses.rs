//! Diagnoses, and what becomes of the effects that they name.

use palpate_diagnosis::DiagnosisConfig;
use palpate_recording::Session;
use palpate_sim::SensorModel;
use palpate_wire::{
    api::{DiagnosisReport, DiagnosisRequest, ModelSummary, NamedEffect, SaveDiagnosisRequest},
    wording,
};

use super::{Finished, RunKind, Runs, Work, hold_out};
use crate::{
    Error, Store,
    data::bars::Bars,
    jobs::{BarConfig, check_diagnosis, diagnose_session},
};

/// The calibrated model, as a file of the run.
const CALIBRATED: &str = "calibrated.toml";
/// The text of the saved model that the run started from.
const BASE: &str = "base.toml";

/// `palpate diagnose`.
pub(crate) struct Diagnoses;

impl RunKind for Diagnoses {
    type Report = DiagnosisReport;
    type Request = DiagnosisRequest;

    const HINT: &'static str = "GET /api/v1/diagnoses lists them";
    const PREFIX: &'static str = "diagnosis-";
    const WHAT: &'static str = "diagnosis";

    fn check(store: &Store, request: &DiagnosisRequest) -> Result<(), Error> {
        let config = config_of(request, &store.session(&request.session)?)?;
        check_diagnosis(&config, request.null_sessions)?;
        request.model.as_deref().map_or(Ok(()), |model| store.model(model).map(|_| ()))
    }

    fn work(cx: &Work<'_>, request: &DiagnosisRequest) -> Result<Finished<DiagnosisReport>, Error> {
        let session = cx.store.session(&request.session)?;
        let config = config_of(request, &session)?;
        let start = request.model.as_deref().map(|model| cx.store.model(model)).transpose()?;
        let bars = Bars::of(cx.store.root());
        let artifacts = diagnose_session(
            cx.library,
            &session,
            &config,
            start.as_ref().map(|(model, _)| model),
            BarConfig { bars: &bars, null_sessions: request.null_sessions },
            cx.progress,
            cx.cancel,
        )?;
        let mut files = vec![("html", artifacts.html), (CALIBRATED, artifacts.calibrated.to_toml())];
        files.extend(start.map(|(_, text)| (BASE, text)));
        Ok(Finished { report: artifacts.report, model: artifacts.model, files })
    }
}

impl Runs<Diagnoses> {
    /// The calibrated model of run `id`, without the effects that it named.
    pub(crate) fn calibrated(&self, id: &str) -> Result<SensorModel, Error> {
        // Says what is wrong with a run that has found no model.
        self.model(id)?;
        let text = self.table.store.run_file(id, CALIBRATED)?.ok_or_else(|| Error::NotFound {
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
        let store = &self.table.store;
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
                if store.run_file(id, BASE)?.as_ref() != Some(&text) {
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
        self.set_saved_as(id, Some(&summary.id))?;
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

/// What `request` asks of `session`, or why it cannot be done.
fn config_of(request: &DiagnosisRequest, session: &Session) -> Result<DiagnosisConfig, Error> {
    let default = DiagnosisConfig::default();
    Ok(DiagnosisConfig {
        hold_out: hold_out(request.hold_out.as_deref(), session)?,
        max_effects: request.max_effects.unwrap_or(default.max_effects),
        without: request.without.clone(),
        ..default
    })
}
