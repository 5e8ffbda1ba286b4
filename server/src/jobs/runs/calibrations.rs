//! Calibration runs.

use palpate_calibration::{CalibrationConfig, Method};
use palpate_recording::Session;
use palpate_wire::api::{CalibrationReport, CalibrationRequest, ModelSummary};

use super::{Finished, RunKind, Runs, Work, hold_out};
use crate::{Error, Store, jobs::calibrate_session};

/// `palpate calibrate`.
pub(crate) struct Calibrations;

impl RunKind for Calibrations {
    type Report = CalibrationReport;
    type Request = CalibrationRequest;

    const HINT: &'static str = "GET /api/v1/calibrations lists them";
    const PREFIX: &'static str = "run-";
    const WHAT: &'static str = "calibration";

    fn check(store: &Store, request: &CalibrationRequest) -> Result<(), Error> {
        config_of(request, &store.session(&request.session)?).map(|_| ())
    }

    fn work(cx: &Work<'_>, request: &CalibrationRequest) -> Result<Finished<CalibrationReport>, Error> {
        let session = cx.store.session(&request.session)?;
        let config = config_of(request, &session)?;
        let artifacts = calibrate_session(cx.library, &session, &config, cx.progress, cx.cancel)?;
        Ok(Finished {
            report: artifacts.report,
            model: artifacts.model,
            files: vec![("html", artifacts.html)],
        })
    }
}

impl Runs<Calibrations> {
    /// Keeps the model that run `id` found.
    pub(crate) fn save_model(&self, id: &str, name: &str) -> Result<ModelSummary, Error> {
        let mut model = self.model(id)?;
        model.name = name.trim().to_owned();
        let summary = self.table.store.save_model(&model)?;
        self.set_saved_as(id, Some(&summary.id))?;
        Ok(summary)
    }
}

/// What `request` asks of `session`, or why it cannot be done.
fn config_of(request: &CalibrationRequest, session: &Session) -> Result<CalibrationConfig, Error> {
    let method = match request.method.as_deref() {
        None | Some("exact") => Method::Exact,
        Some("grid") => Method::Grid,
        Some(other) => {
            return Err(Error::Argument(format!("no method {other:?}; expected \"exact\" or \"grid\"")));
        }
    };
    let hold_out = hold_out(request.hold_out.as_deref(), session)?;
    Ok(CalibrationConfig { method, hold_out, ..CalibrationConfig::default() })
}
