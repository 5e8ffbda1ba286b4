//! Contact maps of a session: learned on some takes, judged on takes that they have not seen.

use std::sync::Arc;

use palpate_calibration::{
    CalibrationConfig, HoldOut, PairedTake, calibrate,
    contact_map::{
        self, ContactMap, LAGS_S, MapConfig, MapFit, MapTake,
        judge::{self, Comparison, MAP, THRESHOLDS},
    },
    held_out,
};
use palpate_diagnosis::{DiagnosisConfig, diagnose};
use palpate_recording::{Session, Take};
use palpate_reports::{ContactMapReport, ContactMapStream};
use palpate_robot_model::Station;
use palpate_sim::{
    SensorModel,
    job::{Cancel, NoProgress, Progress},
};

use super::{Section, accepted_takes};
use crate::{
    Error,
    data::library::{Library, model_readings, nominal_model},
};

/// How to learn a contact map, and what to judge it beside.
#[derive(Clone, Debug)]
pub struct ContactMapConfig {
    /// Whose contacts the map learns.
    pub target: ContactTarget,
    /// Takes that judge and are not fitted to.
    pub hold_out: HoldOut,
    /// Judge every take by a map that was fitted to all others, instead of the held-out takes alone.
    pub leave_one_out: bool,
    /// Judge beside the diagnosed model as well, which takes longer.
    pub diagnose: bool,
    /// The learning itself.
    pub map: MapConfig,
    /// Resamples of takes for the 95 % intervals.
    pub resamples: usize,
}

/// Whose contacts a map learns.
#[derive(Clone, Debug, PartialEq)]
pub enum ContactTarget {
    /// Those of the station's nominal model: geometry, and nothing that was fitted.
    Nominal,
    /// Those of the model that is calibrated on the fitted takes.
    Calibrated,
    /// Those of the model that is diagnosed on the fitted takes.
    Diagnosed,
    /// Those of this model.
    Model(Box<SensorModel>),
}

/// What learning a contact map leaves.
#[derive(Clone, Debug)]
pub struct ContactMapArtifacts {
    /// The map.
    pub map: ContactMap,
    /// What it is worth.
    pub report: ContactMapReport,
}

/// The takes of a session, ready to learn from.
struct Takes {
    takes: Vec<Arc<Take>>,
    paired: Vec<PairedTake>,
    windows: Vec<MapTake>,
    nominal: SensorModel,
}

impl Takes {
    fn read(
        library: &Library,
        session: &Session,
        lags_s: &[f64],
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<Self, Error> {
        let (mut takes, mut paired, mut windows) = (Vec::new(), Vec::new(), Vec::new());
        accepted_takes(library, session, cancel, |take_idx, share| {
            let take = library.take(session, take_idx)?;
            progress.report(share, &format!("replaying {}", take.id));
            windows.push(MapTake::from_take(&take, lags_s)?);
            paired.push((*library.paired(session, take_idx)?).clone());
            takes.push(take);
            Ok(())
        })?;
        let nominal = nominal_model(&takes[0])?;
        Ok(Self { takes, paired, windows, nominal })
    }

    fn station(&self) -> &Station {
        &self.takes[0].station
    }

    fn ids(&self, which: &[bool]) -> Vec<String> {
        let takes = self.takes.iter().zip(which);
        takes.filter(|(_, which)| **which).map(|(take, _)| take.id.clone()).collect()
    }

    /// What channels are in contact at each frame of each take, if `model` is right.
    fn contacts(&self, model: &SensorModel) -> Result<Vec<Vec<bool>>, Error> {
        let takes = self.takes.iter().zip(&self.paired);
        takes.map(|(take, paired)| Ok(model_readings(take, paired, model)?.active)).collect()
    }

    /// Adds what thresholds make of the takes that judge, beside what `model` does.
    fn thresholds_beside(
        &self,
        name: &str,
        model: &SensorModel,
        judging: &[bool],
    ) -> Result<Comparison, Error> {
        let contacts = self.contacts(model)?;
        let layout = &self.station().layout;
        let judged = self.windows.iter().zip(&contacts).zip(judging).filter(|(_, judging)| **judging);
        let takes =
            judged.map(|((take, contacts), _)| judge::compare(layout, take, &take.thresholded, contacts));
        Ok(Comparison {
            hardware: THRESHOLDS.to_owned(),
            simulation: name.to_owned(),
            takes: takes.collect(),
        })
    }

    /// What `map` makes of the takes that judge, beside `contacts` of the model called `name`.
    fn map_beside(
        &self,
        map: &ContactMap,
        name: &str,
        contacts: &[Vec<bool>],
        judging: &[bool],
    ) -> Result<Comparison, Error> {
        let layout = &self.station().layout;
        let judged = self.windows.iter().zip(contacts).zip(judging).filter(|(_, judging)| **judging);
        let takes = judged
            .map(|((take, contacts), _)| Ok(judge::compare(layout, take, &map.contacts(take)?, contacts)));
        Ok(Comparison {
            hardware: MAP.to_owned(),
            simulation: name.to_owned(),
            takes: takes.collect::<Result<_, Error>>()?,
        })
    }
}

/// A map that has not seen the takes that judge it.
struct Fold {
    fit: MapFit,
    target: String,
    /// The map's is the last.
    comparisons: Vec<Comparison>,
}

/// Learns a contact map from the accepted takes of `session` and judges it, on takes that it has not seen, beside the station's
/// thresholds with the nominal model and with models that were fitted to the same takes as the map.
pub fn fit_contact_map(
    library: &Library,
    session: &Session,
    config: &ContactMapConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<ContactMapArtifacts, Error> {
    let reading = Section { whole: progress, start: 0.0, end: 0.3 };
    let takes = Takes::read(library, session, &LAGS_S, &reading, cancel)?;
    let num_takes = takes.takes.len();
    if num_takes < 2 {
        return Err(Error::Content(format!(
            "session {:?} has 1 accepted take, but a contact map is judged on takes that it was not fitted to; record or \
             accept at least 2",
            session.id
        )));
    }
    if let ContactTarget::Model(model) = &config.target {
        model.check_for(takes.station())?;
    }
    let judging = held_out(&config.hold_out, &takes.paired)?;
    if !judging.contains(&true) {
        return Err(Error::Argument(
            "no take is held out, so none would judge; hold out at least one".to_owned(),
        ));
    }
    let part = |from: usize, to: usize, of: usize| {
        let at = |done: usize| 0.3 + 0.65 * done as f64 / of as f64;
        Section { whole: progress, start: at(from), end: at(to) }
    };
    let num_folds = if config.leave_one_out { num_takes + 1 } else { 1 };
    let mut fold = fit_fold(config, &takes, &judging, &part(0, 1, num_folds), cancel)?;
    if config.leave_one_out {
        // The map that is written is still that of the fitted takes; the figures are of maps that saw all others.
        fold.comparisons.iter_mut().for_each(|comparison| comparison.takes.clear());
        for left_out in 0..num_takes {
            let alone: Vec<bool> = (0..num_takes).map(|take| take == left_out).collect();
            let section = part(left_out + 1, left_out + 2, num_folds);
            let of_take = fit_fold(config, &takes, &alone, &section, cancel)?;
            for (all, one) in fold.comparisons.iter_mut().zip(of_take.comparisons) {
                all.takes.extend(one.takes);
            }
        }
    }
    progress.report(0.95, "resampling takes");
    let Fold { fit: MapFit { mut map, streams, notes }, target, comparisons } = fold;
    map.name = format!("{} (contact map)", session.id);
    map.provenance.push(format!("session {}, station {}", session.id, session.file.station));
    map.provenance.push(format!("contacts of the {target} model"));
    let of_fit = |fitted: contact_map::StreamFitted| ContactMapStream {
        samples: fitted.samples,
        contact: fitted.contact,
        loss: fitted.loss,
        f1: fitted.f1,
    };
    let fitted: Vec<bool> = judging.iter().map(|judging| !judging).collect();
    let judged = if config.leave_one_out { vec![true; num_takes] } else { judging };
    let report = ContactMapReport {
        session: session.id.clone(),
        station: takes.station().id.clone(),
        target,
        fitted_takes: takes.ids(&fitted),
        judged_takes: takes.ids(&judged),
        leave_one_out: config.leave_one_out,
        rows: judge::rows(&takes.station().layout, &comparisons, config.resamples, config.map.seed),
        streams: streams.into_iter().map(|(id, fitted)| (id, of_fit(fitted))).collect(),
        resamples: config.resamples,
        seed: config.map.seed,
        notes,
    };
    Ok(ContactMapArtifacts { map, report })
}

/// Fits everything to the takes that are not `judging`, and compares on those that are.
fn fit_fold(
    config: &ContactMapConfig,
    takes: &Takes,
    judging: &[bool],
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Fold, Error> {
    let hold_out = HoldOut::Takes(takes.ids(judging));
    let mut models = vec![("nominal", takes.nominal.clone())];
    let needs_diagnosis = config.diagnose || config.target == ContactTarget::Diagnosed;
    progress.report(0.0, "calibrating");
    if needs_diagnosis {
        let diagnosis = DiagnosisConfig { hold_out, ..DiagnosisConfig::default() };
        let all: Vec<Take> = takes.takes.iter().map(|take| (**take).clone()).collect();
        let section = Section { whole: progress, start: 0.0, end: 0.8 };
        let found = diagnose(&diagnosis, &all, &takes.nominal, None, &section, cancel, &|| 0.0)?;
        models.push(("calibrated", found.calibrated));
        models.push(("diagnosed", found.model));
    } else {
        let calibration =
            CalibrationConfig { hold_out, bootstrap_resamples: 0, ..CalibrationConfig::default() };
        let layout = &takes.station().layout;
        let fitted =
            calibrate(&calibration, layout, &takes.nominal, &takes.paired, &NoProgress, cancel, &|| 0.0)?;
        models.push(("calibrated", fitted.model));
    }
    let wanted = match &config.target {
        ContactTarget::Nominal => "nominal",
        ContactTarget::Calibrated => "calibrated",
        ContactTarget::Diagnosed => "diagnosed",
        ContactTarget::Model(model) => {
            models.push((model.name.as_str(), (**model).clone()));
            model.name.as_str()
        }
    };
    let target =
        models.iter().rev().find(|(name, _)| *name == wanted).map_or(&takes.nominal, |(_, model)| model);
    progress.report(0.8, "learning a contact map");
    if cancel.is_cancelled() {
        return Err(Error::Cancelled);
    }
    let contacts = takes.contacts(target)?;
    let fitted = || judging.iter().enumerate().filter(|(_, judging)| !**judging).map(|(idx, _)| idx);
    let windows: Vec<&MapTake> = fitted().map(|idx| &takes.windows[idx]).collect();
    let targets: Vec<&[bool]> = fitted().map(|idx| contacts[idx].as_slice()).collect();
    let fit = contact_map::fit(&config.map, takes.station(), target, &windows, &targets)?;
    let mut comparisons = Vec::new();
    for (name, model) in &models {
        comparisons.push(takes.thresholds_beside(name, model, judging)?);
    }
    comparisons.push(takes.map_beside(&fit.map, wanted, &contacts, judging)?);
    Ok(Fold { fit, target: wanted.to_owned(), comparisons })
}

/// Judges `map` on the accepted takes of `session` that it was not fitted to, beside the station's thresholds with the model
/// that the map was learned for and with `models`.
pub fn judge_contact_map(
    library: &Library,
    session: &Session,
    map: &ContactMap,
    models: &[SensorModel],
    resamples: usize,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<ContactMapReport, Error> {
    let takes = Takes::read(library, session, &map.lags_s, progress, cancel)?;
    map.check(takes.station())?;
    let target = SensorModel::from_toml("the contact map's target", &map.target)?;
    let judging: Vec<bool> = takes.windows.iter().map(|take| map.fitted(take).is_none()).collect();
    let notes: Vec<String> = takes
        .windows
        .iter()
        .filter_map(|take| Some((take, map.fitted(take)?)))
        .map(|(take, fitted)| {
            format!("take {:?} does not judge: the map was fitted to it (as {:?})", take.id, fitted.id)
        })
        .collect();
    if !judging.contains(&true) {
        return Err(Error::Content(format!(
            "contact map {:?} was fitted to every accepted take of session {:?}; judge it on takes that it has not seen",
            map.name, session.id
        )));
    }
    let mut comparisons = Vec::new();
    for model in [&target].into_iter().chain(models) {
        model.check_for(takes.station())?;
        comparisons.push(takes.thresholds_beside(&model.name, model, &judging)?);
    }
    let contacts = takes.contacts(&target)?;
    comparisons.push(takes.map_beside(map, &target.name, &contacts, &judging)?);
    Ok(ContactMapReport {
        session: session.id.clone(),
        station: takes.station().id.clone(),
        target: target.name,
        fitted_takes: map.takes.iter().map(|take| take.id.clone()).collect(),
        judged_takes: takes.ids(&judging),
        leave_one_out: false,
        rows: judge::rows(&takes.station().layout, &comparisons, resamples, 0),
        streams: std::collections::BTreeMap::new(),
        resamples,
        seed: 0,
        notes,
    })
}
