//! `palpate diagnose`.

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use palpate_calibration::HoldOut;
use palpate_diagnosis::DiagnosisConfig;
use palpate_recording::Session;
use palpate_reports::{DiagnosisReport, Metrics, wording};
use palpate_server::{
    Error,
    data::{bars::Bars, files, library::Library},
    jobs::{BarConfig, check_diagnosis, diagnose_sessions, next_plan, take_of_session},
};
use palpate_sim::SensorModel;
use palpate_terminal::{Bar, cancel_on_ctrl_c};

use super::{Outcome, calibrate::hold_out, output, report::ReportArgs};

#[derive(Args)]
pub(crate) struct DiagnoseArgs {
    /// Folder of the session; may be given for several of one station, which are diagnosed together. Their takes are called
    /// SESSION/TAKE
    #[arg(long = "session", value_name = "SESSION", required = true)]
    sessions: Vec<PathBuf>,
    /// Start from this sensor model instead of the station's nominal one
    #[arg(long, value_name = "MODEL.toml")]
    model: Option<PathBuf>,
    /// Takes that nothing is fitted to, by id; `auto` keeps about a third of them
    #[arg(long, value_name = "TAKE,...|auto", default_value = "auto")]
    hold_out: String,
    /// Most effects to name
    #[arg(long, value_name = "N")]
    max_effects: Option<usize>,
    /// Effects to leave out of the library, by id
    #[arg(long, value_name = "ID,...", value_delimiter = ',')]
    without: Vec<String>,
    /// Folder of a session of the same station in which nothing is wrong; give three or more, better five. What such sessions
    /// leave unexplained sets the limits for this one, instead of the shipped ones
    #[arg(long = "reference", value_name = "SESSION")]
    references: Vec<PathBuf>,
    /// First set the station's bar: diagnose N sessions simulated with nothing missing, and keep what chance gives there
    /// for this and later diagnoses (200 is a good number; takes N times as long as a diagnosis)
    #[arg(long, value_name = "N")]
    null_bar: Option<usize>,
    /// Where the bars of stations are kept: the data folder of `palpate serve`
    #[arg(long, value_name = "DIR", default_value = "data")]
    data: PathBuf,
    /// Write what to record next as a plan for a session of its own (docs/plans.md); nothing where nothing is open
    #[arg(long, value_name = "FILE")]
    plan: Option<PathBuf>,
    /// Write the model with the named effects here
    #[arg(long, value_name = "MODEL.toml")]
    out: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
}

pub(super) fn run(args: &DiagnoseArgs) -> Outcome {
    let sessions = args.sessions.iter().map(|dir| Session::open(dir)).collect::<Result<Vec<_>, _>>()?;
    let references = args.references.iter().map(|dir| Session::open(dir)).collect::<Result<Vec<_>, _>>()?;
    check_sessions("--session", &sessions)?;
    check_sessions("--reference", &references)?;
    check_not_references(&args.sessions, &args.references)?;
    for out in args.out.iter().chain(&args.plan) {
        files::check_target(out)?;
    }
    let default = DiagnosisConfig::default();
    let config = DiagnosisConfig {
        hold_out: hold_out_of(&args.hold_out, &sessions)?,
        max_effects: args.max_effects.unwrap_or(default.max_effects),
        without: args.without.iter().map(|id| id.trim().to_owned()).collect(),
        seed: args.report.seed,
        ..default
    };
    check_diagnosis(&config, args.null_bar, references.len())?;
    let start = args.model.as_ref().map(read_model).transpose()?;
    let library = Library::default();
    let artifacts = {
        let bar = Bar::new();
        let (bars, cancel) = (Bars::of(&args.data), cancel_on_ctrl_c());
        let null = BarConfig { bars: &bars, null_sessions: args.null_bar };
        diagnose_sessions(&library, &sessions, &references, &config, start.as_ref(), null, &bar, &cancel)?
    };
    args.report.write(args.out.as_deref(), &artifacts.report, &artifacts.html, &artifacts.model)?;
    args.report.print(&artifacts.report, text)?;
    if let Some(plan) = &args.plan {
        // Last, so that what cannot be planned costs nobody the diagnosis.
        let said = write_plan(&library, &sessions, &artifacts.report, plan)?;
        if args.report.json {
            // Standard output holds one document.
            eprintln!("{said}");
        } else {
            output::line(&said)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes what to record next into the plan file `path`, where there is something; what was done, in words.
fn write_plan(
    library: &Library,
    sessions: &[Session],
    report: &DiagnosisReport,
    path: &Path,
) -> Result<String, Error> {
    let Some(next) = &report.next_experiment else {
        return Ok(format!(
            "no plan was written to {}: this diagnosis asks for no experiment, because nothing is open that a motion of this \
             session would tell",
            path.display()
        ));
    };
    let id = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    files::write(path, next_plan(library, sessions, next, &id)?.as_bytes())?;
    Ok(format!("plan of what to record next: {}", path.display()))
}

/// Refuses sessions that are called alike: nobody could tell their takes apart.
fn check_sessions(flag: &str, sessions: &[Session]) -> Result<(), Error> {
    for (idx, session) in sessions.iter().enumerate() {
        if sessions[..idx].iter().any(|other| other.id == session.id) {
            return Err(Error::Argument(format!(
                "{flag}: two of the sessions are called {:?}; give each once, or rename a folder",
                session.id
            )));
        }
    }
    Ok(())
}

/// Refuses to judge a session by itself.
fn check_not_references(sessions: &[PathBuf], references: &[PathBuf]) -> Result<(), Error> {
    let same = |one: &Path, other: &Path| match (one.canonicalize(), other.canonicalize()) {
        (Ok(one), Ok(other)) => one == other,
        _ => one == other,
    };
    match references.iter().find(|reference| sessions.iter().any(|session| same(session, reference))) {
        Some(both) => Err(Error::Argument(format!(
            "--reference: {} is also the session that is diagnosed; a session cannot be judged by itself",
            both.display()
        ))),
        None => Ok(()),
    }
}

/// [`hold_out`] for takes of several sessions.
fn hold_out_of(text: &str, sessions: &[Session]) -> Result<HoldOut, Error> {
    match sessions {
        [only] => hold_out(text, only),
        _ if text == "auto" => Ok(HoldOut::Auto),
        _ => {
            let known: Vec<String> = sessions
                .iter()
                .flat_map(|session| {
                    session.file.takes.iter().map(|take| take_of_session(&session.id, take.id()))
                })
                .collect();
            let ids: Vec<String> = text.split(',').map(|id| id.trim().to_owned()).collect();
            match ids.iter().find(|id| !known.contains(id)) {
                Some(id) => Err(Error::Argument(format!(
                    "--hold-out: no take {id:?} in these sessions; their takes are {}",
                    known.join(", ")
                ))),
                None => Ok(HoldOut::Takes(ids)),
            }
        }
    }
}

fn read_model(path: &PathBuf) -> Result<SensorModel, Error> {
    let text = fs::read_to_string(path).map_err(Error::io("read", path))?;
    Ok(SensorModel::from_toml(&path.display().to_string(), &text)?)
}

/// Columns of a bar at full length.
const BAR_COLUMNS: usize = 40;

fn text(report: &DiagnosisReport) -> String {
    let mut lines = vec![report.sentence.clone()];
    for (idx, effect) in report.effects.iter().enumerate() {
        lines.push(format!("\n{}. {}", idx + 1, wording::effect_sentences(effect, report)));
        let parameters = effect.parameters.iter().map(|(name, &value)| {
            let interval = effect
                .interval
                .get(name)
                .map_or_else(String::new, |&interval| format!(" (95 % {})", wording::range(name, interval)));
            format!("{} {}{interval}", wording::parameter_name(name), wording::quantity(name, value))
        });
        let at = wording::effect_at(&effect.id, &effect.place);
        lines.push(format!("   {at}: {}", parameters.collect::<Vec<_>>().join(", ")));
        lines.push(format!(
            "   evidence {}, bar {}, {}",
            wording::number(effect.evidence),
            wording::number(report.bar.evidence),
            wording::chance(effect.p_value)
        ));
        lines.extend(wording::rivals_sentence(effect).map(|rivals| format!("   {rivals}")));
    }
    lines.push(format!("\nGap on the judging takes (mismatch a channel-second){}", floor_text(report)));
    lines.extend(waterfall(report));
    lines.extend(metrics(report));
    if !report.cells.is_empty() {
        lines.push("\nWhere the calibrated model and the hand disagree".to_owned());
        lines.extend(
            report
                .cells
                .iter()
                .map(|cell| format!("  {:>5}  {}", wording::percent(cell.excess), wording::cell(cell))),
        );
    }
    let left = &report.unexplained;
    let repeats =
        if left.significant { "and it repeats: something is missing" } else { "and it does not repeat" };
    lines
        .push(format!("\nUnexplained: {} of the excess is left, {repeats}", wording::percent(left.fraction)));
    lines.extend(left.because.iter().map(|because| format!("  {}", because.sentence)));
    lines.extend(wording::touch_to_touch_sentence(left).map(|sentence| format!("  {sentence}")));
    lines.extend(
        left.cells
            .iter()
            .map(|cell| format!("  {:>5}  {}", wording::percent(cell.excess), wording::cell(cell))),
    );
    if let Some(next) = &report.next_experiment {
        lines.push(format!("\nNext: {}", next.sentence));
    }
    lines.push(String::new());
    for (part, takes) in &report.takes {
        lines
            .push(format!("{part}: {}", if takes.is_empty() { "none".to_owned() } else { takes.join(", ") }));
    }
    lines.push(match report.bar.null_sessions {
        0 => "bar: the shipped default; --null-bar 200 sets it for this station".to_owned(),
        sessions => format!("bar: from {sessions} simulated sessions with nothing missing"),
    });
    lines.push(format!("{:.1} s", report.seconds));
    lines.extend(report.in_doubt.iter().map(wording::in_doubt_sentence));
    lines.extend(report.notes.iter().map(|note| format!("note: {note}")));
    lines.join("\n")
}

fn floor_text(report: &DiagnosisReport) -> String {
    report
        .held_out
        .noise_floor
        .map_or_else(String::new, |floor| format!("; repetitions differ by {}", wording::number(floor)))
}

fn waterfall(report: &DiagnosisReport) -> Vec<String> {
    let highest = report.waterfall.iter().map(|step| step.gap).fold(f64::MIN_POSITIVE, f64::max);
    let rows = report.waterfall.iter().enumerate().map(|(idx, step)| {
        let name = wording::step_name(report, idx);
        let columns = (step.gap / highest * BAR_COLUMNS as f64).round().max(0.0) as usize;
        let interval = step.interval_95.map_or_else(String::new, |[low, high]| {
            format!("  ({} to {})", wording::number(low), wording::number(high))
        });
        let bar = "#".repeat(columns.min(BAR_COLUMNS));
        format!("  {name:<34} {bar:<BAR_COLUMNS$} {:>7}{interval}", wording::number(step.gap))
    });
    rows.collect()
}

fn metrics(report: &DiagnosisReport) -> Vec<String> {
    if report.metrics.is_empty() {
        return Vec::new();
    }
    let number = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    let mut lines =
        vec![format!("\n  {:<24} {:>12} {:>12} {:>8} {:>9}", "", "onset (ms)", "offset (ms)", "F1", "FPR")];
    let row = |name: &str, metrics: &Metrics| {
        format!(
            "  {name:<24} {:>12} {:>12} {:>8} {:>9}",
            number(metrics.onset_error_ms, 0),
            number(metrics.offset_error_ms, 0),
            number(metrics.f1, 3),
            number(metrics.fpr, 4)
        )
    };
    let models = ["nominal", "calibrated", "diagnosed"];
    lines.extend(models.iter().filter_map(|name| Some(row(name, report.metrics.get(*name)?))));
    lines
}
