//! The calibration job.

use std::collections::{BTreeMap, BTreeSet};

use palpate_reports::{
    CalibrationReport, HeldOut, MetricsPair, Objective, StreamFit, StreamThetaReport, TakeMetrics,
    ThetaReport,
};
use palpate_robot_model::{SensorKind, TactileLayout};
use palpate_sim::{
    SensorModel, StreamTheta, Theta,
    job::{Cancel, Progress},
    tactile,
};
use rayon::prelude::*;

use crate::{
    PairedTake, TakeTimeline,
    bootstrap::intervals_95,
    hold_out::held_out,
    metrics::{MetricsSum, compare_take},
    sweep::{FitData, FittedStreams, Watch, fit_streams},
};

/// What to do.
#[derive(Clone, Debug)]
pub struct CalibrationConfig {
    /// Which search.
    pub method: Method,
    /// Which takes to keep for judging.
    pub hold_out: HoldOut,
    /// Values of alpha tried by the exact search before refinement, or on the grid's axis. At least 2.
    pub num_alphas: usize,
    /// Values of each lambda on the grid. At least 2.
    pub num_lambdas: usize,
    /// Whether streams of a kind share one theta. Else each stream of a layout in which several have the same kind has its
    /// own, because skins of different make do not soften or switch alike.
    pub shared_theta: bool,
    /// Bootstrap resamples of takes for the 95 % intervals; 0 leaves them out.
    pub bootstrap_resamples: usize,
    /// Seed of the bootstrap.
    pub seed: u64,
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            method: Method::Exact,
            hold_out: HoldOut::Auto,
            num_alphas: 20,
            num_lambdas: 20,
            shared_theta: false,
            bootstrap_resamples: 2000,
            seed: 0,
        }
    }
}

/// Which search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// One sort per alpha finds the best threshold over all real values.
    Exact,
    /// The paper's grid over (lambda_con, alpha, lambda_pre).
    Grid,
}

impl Method {
    /// `exact` or `grid`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Grid => "grid",
        }
    }
}

/// Which takes to keep for judging.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HoldOut {
    /// About a third of the takes, every object among both parts where possible.
    Auto,
    /// These takes, by id.
    Takes(Vec<String>),
}

/// What a calibration found.
#[derive(Clone, Debug)]
pub struct CalibrationOutcome {
    /// The report, as the command line prints it and the page shows it.
    pub report: CalibrationReport,
    /// The fitted model.
    pub model: SensorModel,
    /// Trigger events of every take, for [`crate::report::html()`].
    pub timelines: Vec<TakeTimeline>,
}

/// A calibration that cannot be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// The takes or the configuration do not make a calibration: which, why, and what to do.
    #[error("{0}")]
    Input(String),
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// Fits theta, one for each stream where streams are several of a kind, on the takes that are not held out, and judges it on
/// all of them.
///
/// Refuses a `nominal` model with effects: the searches know theta alone, and thresholds that are fitted as if an
/// effect were absent absorb a part of it.
///
/// A parameter that the fitted takes say nothing about (a modality without any real contact) keeps its nominal value,
/// and the report's notes say so. `clock_s` gives seconds since any fixed moment; only its differences are used, for the
/// report. All else depends on the other arguments alone, to the bit, for any number of threads.
pub fn calibrate(
    config: &CalibrationConfig,
    layout: &TactileLayout,
    nominal: &SensorModel,
    takes: &[PairedTake],
    progress: &dyn Progress,
    cancel: &Cancel,
    clock_s: &dyn Fn() -> f64,
) -> Result<CalibrationOutcome, CalibrationError> {
    check_inputs(config, layout, nominal, takes)?;
    let held_out = held_out(&config.hold_out, takes)?;
    let fitted_takes: Vec<&PairedTake> =
        takes.iter().zip(&held_out).filter(|&(_, &held_out)| !held_out).map(|(take, _)| take).collect();
    let data = FitData::new(layout, fitted_takes.iter().copied());
    if ![SensorKind::Proximity, SensorKind::Pressure].into_iter().any(|kind| data.has_real_contact(kind)) {
        let ids: Vec<&str> = fitted_takes.iter().map(|take| take.id.as_str()).collect();
        return Err(CalibrationError::Input(format!(
            "no real contact in the takes to fit ({}), so there is nothing to match; check the stream thresholds of the \
             station, or hold out other takes",
            ids.join(", ")
        )));
    }

    let watch = Watch { progress, cancel, span: [0.0, 0.8] };
    let start_s = clock_s();
    let fitted = fit_streams(config, &data, nominal, watch)?;
    let seconds = clock_s() - start_s;

    let theta = fitted.shared.as_ref().map_or(nominal.theta, |(theta, _)| *theta);
    let model = SensorModel {
        streams: fitted.streams.iter().map(|(id, (own, _))| (id.clone(), *own)).collect(),
        provenance: provenance(config, takes, &held_out),
        ..SensorModel::plain(format!("{}, calibrated", nominal.name), theta)
    };
    watch.within([0.8, 0.95]).step(0, 1, "judging both models on every take")?;
    let judged: Vec<JudgedTake> = takes
        .par_iter()
        .zip(&held_out)
        .map(|(take, &held_out)| {
            if cancel.is_cancelled() {
                return Err(CalibrationError::Cancelled);
            }
            Ok(JudgedTake::new(layout, take, held_out, nominal, &model))
        })
        .collect::<Result<_, _>>()?;
    watch.within([0.95, 1.0]).step(0, 1, "resampling takes")?;
    let report = Judgement { layout, judged: &judged }.report(config, nominal, theta, fitted, seconds);
    progress.report(1.0, "done");
    let timelines = judged.into_iter().map(|take| take.timeline).collect();
    Ok(CalibrationOutcome { report, model, timelines })
}

fn check_inputs(
    config: &CalibrationConfig,
    layout: &TactileLayout,
    nominal: &SensorModel,
    takes: &[PairedTake],
) -> Result<(), CalibrationError> {
    let fail = |problem: String| Err(CalibrationError::Input(problem));
    if !nominal.effects.is_empty() {
        let ids: Vec<&str> = nominal.effects.iter().map(|effect| effect.id.as_str()).collect();
        return fail(format!(
            "model {:?} has effects ({}), beside which theta cannot be calibrated alone; diagnose the session from this \
             model, or calibrate a model without effects",
            nominal.name,
            ids.join(", ")
        ));
    }
    nominal.check_streams(layout).map_err(|err| CalibrationError::Input(err.to_string()))?;
    if config.shared_theta && !nominal.streams.is_empty() {
        let ids: Vec<&str> = nominal.streams.keys().map(String::as_str).collect();
        return fail(format!(
            "model {:?} has parameters of their own for streams ({}), which a shared theta would drop; calibrate a theta \
             for each stream, or start from a model without them",
            nominal.name,
            ids.join(", ")
        ));
    }
    if config.num_alphas < 2 || config.num_lambdas < 2 {
        return fail(format!(
            "a search needs at least 2 values of alpha and of each lambda, not {} and {}",
            config.num_alphas, config.num_lambdas
        ));
    }
    if takes.iter().all(|take| take.num_frames() == 0) {
        return fail(
            "nothing to fit: the session has no accepted take with frames; record or accept one".to_owned(),
        );
    }
    let mut ids = BTreeSet::new();
    for take in takes {
        take.check(layout)?;
        if !ids.insert(&take.id) {
            return fail(format!("two takes are called {:?}; rename one", take.id));
        }
    }
    Ok(())
}

fn provenance(config: &CalibrationConfig, takes: &[PairedTake], held_out: &[bool]) -> Vec<String> {
    let ids = |wanted: bool| {
        let ids: Vec<&str> = takes
            .iter()
            .zip(held_out)
            .filter(|&(_, &held)| held == wanted)
            .map(|(take, _)| take.id.as_str())
            .collect();
        if ids.is_empty() { "none".to_owned() } else { ids.join(", ") }
    };
    vec![
        format!(
            "calibrated by palpate {} with the {} search",
            env!("CARGO_PKG_VERSION"),
            config.method.name()
        ),
        format!("fitted takes: {}", ids(false)),
        format!("held-out takes: {}", ids(true)),
    ]
}

/// Both models on one take.
struct JudgedTake {
    /// Per channel.
    nominal: Vec<MetricsSum>,
    /// Per channel.
    calibrated: Vec<MetricsSum>,
    timeline: TakeTimeline,
    num_frames: usize,
}

impl JudgedTake {
    fn new(
        layout: &TactileLayout,
        take: &PairedTake,
        held_out: bool,
        nominal: &SensorModel,
        calibrated: &SensorModel,
    ) -> Self {
        let nominal = tactile::readings(layout, &take.contact, &nominal.thetas()).active;
        let calibrated = tactile::readings(layout, &take.contact, &calibrated.thetas()).active;
        let compare = |simulated: &[bool]| {
            compare_take(&take.frame_times_s, layout.num_channels(), &take.real_active, simulated)
        };
        Self {
            nominal: compare(&nominal),
            calibrated: compare(&calibrated),
            timeline: TakeTimeline::new(layout, take, held_out, &nominal, &calibrated),
            num_frames: take.num_frames(),
        }
    }

    fn held_out(&self) -> bool {
        self.timeline.held_out
    }

    /// Sums over `channels`.
    fn totals(&self, channels: std::ops::Range<usize>) -> [MetricsSum; 2] {
        [self.nominal[channels.clone()].iter().sum(), self.calibrated[channels].iter().sum()]
    }
}

/// Both models on every take, summed up in all the ways a report wants.
struct Judgement<'a> {
    layout: &'a TactileLayout,
    judged: &'a [JudgedTake],
}

impl Judgement<'_> {
    fn total(&self, channels: std::ops::Range<usize>, of: impl Fn(&JudgedTake) -> bool) -> [MetricsSum; 2] {
        let takes = self.judged.iter().filter(|take| of(take));
        takes
            .map(|take| take.totals(channels.clone()))
            .fold([MetricsSum::default(); 2], |[n, c], [nominal, calibrated]| [n + nominal, c + calibrated])
    }

    fn stream_fits(
        &self,
        nominal: &SensorModel,
        fitted: BTreeMap<String, (StreamTheta, Objective)>,
    ) -> BTreeMap<String, StreamFit> {
        let kinds = self.layout.streams.iter().map(|stream| (stream.id.as_str(), stream.kind));
        let kinds: BTreeMap<&str, SensorKind> = kinds.collect();
        let of_stream = |(id, (theta, objective)): (String, (StreamTheta, Objective))| {
            let before = nominal.thetas().of(&id);
            let before = kinds.get(id.as_str()).map(|kind| StreamTheta::of_kind(*kind, &before));
            let fit = StreamFit {
                theta: stream_theta_report(&theta),
                nominal_theta: stream_theta_report(&before.unwrap_or_default()),
                objective,
            };
            (id, fit)
        };
        fitted.into_iter().map(of_stream).collect()
    }

    fn report(
        &self,
        config: &CalibrationConfig,
        nominal: &SensorModel,
        theta: Theta,
        fitted: FittedStreams,
        seconds: f64,
    ) -> CalibrationReport {
        let FittedStreams { shared, streams: of_streams, evaluations, mut notes } = fitted;
        let all_channels = 0..self.layout.num_channels();
        let pair = |[nominal, calibrated]: [MetricsSum; 2]| MetricsPair {
            nominal: nominal.metrics(),
            calibrated: calibrated.metrics(),
        };
        let everything = pair(self.total(all_channels.clone(), |_| true));
        let unseen = self.total(all_channels.clone(), JudgedTake::held_out);
        let num_held_out = self.judged.iter().filter(|take| take.held_out()).count();
        if num_held_out == 0 {
            notes.push("no take is held out: the figures are from the takes that were fitted".to_owned());
        } else if unseen[0].real_contacts == 0 {
            notes.push("the held-out takes hold no real contact: hold out others".to_owned());
        }

        let resample_all = num_held_out < 2;
        let resampled = self.judged.iter().filter(|take| resample_all || take.held_out());
        let (nominal_sums, calibrated_sums): (Vec<_>, Vec<_>) =
            resampled.map(|take| take.totals(all_channels.clone())).map(|[n, c]| (n, c)).unzip();
        let streams = self.layout.streams.iter();
        let by_modality =
            streams.map(|s| (s.id.clone(), pair(self.total(s.channels.clone(), |_| true)))).collect();
        let by_take = self.judged.iter().map(|take| {
            let MetricsPair { nominal, calibrated } = pair(take.totals(all_channels.clone()));
            (take.timeline.take.clone(), TakeMetrics { nominal, calibrated, held_out: take.held_out() })
        });
        let channels = self.layout.channels.iter().enumerate();
        let by_channel: BTreeMap<_, _> =
            channels.map(|(idx, c)| (c.id.clone(), pair(self.total(idx..idx + 1, |_| true)))).collect();
        let held_out_takes = self.judged.iter().filter(|take| take.held_out());
        CalibrationReport {
            nominal: everything.nominal,
            calibrated: everything.calibrated,
            held_out: HeldOut { nominal: unseen[0].metrics(), calibrated: unseen[1].metrics() },
            theta: theta_report(theta),
            nominal_theta: theta_report(nominal.theta),
            streams: self.stream_fits(nominal, of_streams),
            frames: self.judged.iter().map(|take| take.num_frames).sum(),
            channels: self.layout.num_channels(),
            evaluations,
            seconds,
            method: config.method.name().to_owned(),
            by_modality,
            by_take: by_take.collect(),
            by_channel,
            intervals_95: intervals_95(
                &nominal_sums,
                &calibrated_sums,
                config.bootstrap_resamples,
                config.seed,
            ),
            objective: shared.map(|(_, objective)| objective).unwrap_or_default(),
            held_out_takes: held_out_takes.map(|take| take.timeline.take.clone()).collect(),
            notes,
        }
    }
}

/// What a stream has of its own, as reports have it.
pub fn stream_theta_report(theta: &StreamTheta) -> StreamThetaReport {
    StreamThetaReport {
        lambda_con_m: theta.lambda_con_m,
        alpha_per_m: theta.alpha_per_m,
        lambda_pre_pa: theta.lambda_pre_pa,
    }
}

fn theta_report(theta: Theta) -> ThetaReport {
    ThetaReport {
        lambda_con_m: theta.lambda_con_m,
        alpha_per_m: theta.alpha_per_m,
        lambda_pre_pa: theta.lambda_pre_pa,
    }
}
