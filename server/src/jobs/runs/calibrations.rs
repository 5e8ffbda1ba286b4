//! Calibration runs.

use palpate_reports::CalibrationReport;
use palpate_wire::api::{CalibrationRequest, ModelSummary};

use super::{RunKind, Runs};
use crate::{
    Error,
    jobs::kinds::{CALIBRATE, JobKind},
};

/// `palpate calibrate`.
pub(crate) struct Calibrations;

impl RunKind for Calibrations {
    type Report = CalibrationReport;
    type Request = CalibrationRequest;

    const HINT: &'static str = "GET /api/v1/calibrations lists them";
    const KIND: &'static JobKind = &CALIBRATE;
    const WHAT: &'static str = "calibration";
}

impl Runs<'_, Calibrations> {
    /// Keeps the model that run `id` found.
    pub(crate) fn save_model(&self, id: &str, name: &str) -> Result<ModelSummary, Error> {
        let mut model = self.model(id)?;
        model.name = name.trim().to_owned();
        let summary = self.jobs.store().save_model(&model)?;
        self.set_saved_as(id, &summary.id)?;
        Ok(summary)
    }
}
