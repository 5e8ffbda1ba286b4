//! The diagnosis of a session: find where simulation and measurement disagree, name the missing effect, add it, show
//! the gap shrink.

use std::time::Instant;

use palpate_diagnosis::{DiagnosisConfig, diagnose, null_bar, reference, report};
use palpate_recording::{Session, Take};
use palpate_reports::{DiagnosisReport, MIN_REFERENCES};
use palpate_sim::{
    SensorModel, effects,
    job::{Cancel, Progress},
};

use super::{Section, accepted_takes};
use crate::{
    Error,
    data::{
        bars::Bars,
        library::{Library, nominal_model},
    },
};

/// What a diagnosis leaves.
#[derive(Clone, Debug)]
pub struct DiagnosisArtifacts {
    /// The numbers and the sentences.
    pub report: DiagnosisReport,
    /// The calibrated model with every named effect.
    pub model: SensorModel,
    /// The calibrated model without them.
    pub calibrated: SensorModel,
    /// The self-contained report for people.
    pub html: String,
}

/// What to diagnose against.
#[derive(Clone, Copy, Debug)]
pub struct BarConfig<'a> {
    /// Where the bars of stations are kept.
    pub bars: &'a Bars,
    /// Sessions with nothing missing to simulate first, to set the station's bar anew.
    pub null_sessions: Option<usize>,
}

/// Shares of the work after which takes are read, and sessions searched.
const READ: f64 = 0.05;
const SEARCHED: f64 = 0.97;

/// Fewest null sessions that hold a 95 % point.
const MIN_NULL_SESSIONS: usize = 20;

/// Refuses what no session can be diagnosed with.
pub fn check_diagnosis(
    config: &DiagnosisConfig,
    null_sessions: Option<usize>,
    references: usize,
) -> Result<(), Error> {
    for id in &config.without {
        if effects::tactile(id).is_none() {
            let known: Vec<&str> = effects::TACTILE.iter().map(|kind| kind.id()).collect();
            return Err(Error::Argument(format!(
                "no effect {id:?} to leave out; the library has {}",
                known.join(", ")
            )));
        }
    }
    if config.max_effects == 0 {
        return Err(Error::Argument("at most 0 effects can be named; allow at least 1".to_owned()));
    }
    if (1..MIN_REFERENCES).contains(&references) {
        return Err(Error::Argument(format!(
            "expected at least {MIN_REFERENCES} reference sessions, better 5, to tell what is usual; got {references}"
        )));
    }
    match null_sessions {
        Some(count) if count < MIN_NULL_SESSIONS => Err(Error::Argument(format!(
            "{count} null sessions cannot set a bar; simulate at least {MIN_NULL_SESSIONS}, better 200"
        ))),
        _ => Ok(()),
    }
}

/// Id of a take among those of several sessions, in which takes may be called alike.
pub fn take_of_session(session: &str, take: &str) -> String {
    format!("{session}/{take}")
}

/// The accepted takes of `session`.
fn all_takes(library: &Library, session: &Session, cancel: &Cancel) -> Result<Vec<Take>, Error> {
    let mut takes = Vec::new();
    accepted_takes(library, session, cancel, |idx, _| {
        takes.push((*library.take(session, idx)?).clone());
        Ok(())
    })?;
    Ok(takes)
}

/// Diagnoses the accepted takes of all `sessions`, of one station, together, from `start` or else from the station's nominal
/// model: a session and what was recorded after it, because its diagnosis asked for it. Takes of several sessions have the ids
/// of [`take_of_session`]. In the `references`, if there are any, nothing is wrong: what they leave sets the limits.
#[expect(
    clippy::too_many_arguments,
    reason = "what a diagnosis looks at, what it is asked, and how it is watched"
)]
pub fn diagnose_sessions(
    library: &Library,
    sessions: &[Session],
    references: &[Session],
    config: &DiagnosisConfig,
    start: Option<&SensorModel>,
    bar: BarConfig<'_>,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<DiagnosisArtifacts, Error> {
    let Some(session) = sessions.first() else {
        return Err(Error::Argument("no session to diagnose, expected at least one".to_owned()));
    };
    let mut takes: Vec<Take> = Vec::new();
    for (idx, session) in sessions.iter().enumerate() {
        accepted_takes(library, session, cancel, |take_idx, share| {
            let mut take: Take = (*library.take(session, take_idx)?).clone();
            let share = (idx as f64 + share) / sessions.len() as f64;
            progress.report(READ * share, &format!("reading {}", take.id));
            if sessions.len() > 1 {
                take.id = take_of_session(&session.id, &take.id);
            }
            takes.push(take);
            Ok(())
        })?;
    }
    let ids: Vec<&str> = sessions.iter().map(|session| session.id.as_str()).collect();
    let ids = ids.join(" + ");
    let first = &takes[0];
    let files = &first.station.files;
    let nominal = match start {
        Some(model) => {
            model.check_for(&first.station)?;
            model.clone()
        }
        None => nominal_model(first)?,
    };
    let begun = Instant::now();
    let clock_s = || begun.elapsed().as_secs_f64();
    // A null session and a reference are each as much work as the diagnosis.
    let shares = 1 + bar.null_sessions.unwrap_or(0) + references.len();
    let end_of = |done: usize| READ + (SEARCHED - READ) * done as f64 / shares as f64;
    let mut done = 0;
    let mut section = |count: usize| {
        let section = Section { whole: progress, start: end_of(done), end: end_of(done + count) };
        done += count;
        section
    };
    if let Some(sessions) = bar.null_sessions {
        // The bar is the station's, whatever this diagnosis leaves out.
        let of_station = DiagnosisConfig { without: Vec::new(), ..config.clone() };
        let start = nominal_model(first)?;
        let bar_found = null_bar(&of_station, &takes, &start, sessions, &section(sessions), cancel)?;
        bar.bars.put(files, &bar_found)?;
    }
    let reference = match references {
        [] => None,
        sessions => {
            let takes = sessions.iter().map(|session| all_takes(library, session, cancel));
            let takes = takes.collect::<Result<Vec<_>, _>>()?;
            Some(reference(config, &takes, &nominal, &section(sessions.len()), cancel)?)
        }
    };
    let config = &DiagnosisConfig { reference, ..config.clone() };
    let null = bar.bars.get(files)?;
    let outcome = diagnose(config, &takes, &nominal, null.as_ref(), &section(1), cancel, &clock_s)?;
    progress.report(SEARCHED, "writing the report");
    let source = palpate_calibration::report::ReportSource {
        session: &ids,
        station: &session.file.station,
        created: "",
    };
    let html = report::html(source, &outcome.report, &outcome.model);
    let about = |mut model: SensorModel, what: &str| {
        model.name = format!("{ids} ({what})");
        model.provenance.push(format!("session {ids}, station {}", session.file.station));
        model.provenance.push(format!("palpate {}", env!("CARGO_PKG_VERSION")));
        model
    };
    Ok(DiagnosisArtifacts {
        report: outcome.report,
        model: about(outcome.model, "diagnosed"),
        calibrated: about(outcome.calibrated, "calibrated"),
        html,
    })
}
