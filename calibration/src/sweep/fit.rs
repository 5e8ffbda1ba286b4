//! From either search to theta and the picture of the objective.

use std::collections::BTreeMap;

use palpate_reports::Objective;
use palpate_robot_model::{SensorKind, TactileLayout};
use palpate_sim::{SensorModel, StreamTheta, Theta, replay::NEAR_M};

use super::{
    ExactResult, FitData, GridAxes, GridResult, Watch,
    axes::{alpha_axis_of, linear_spaced, log_spaced},
    exact::{REFINEMENT_ROUNDS, exact},
    grid::grid,
};
use crate::{CalibrationConfig, CalibrationError, Method};

/// Columns of the heat map of the exact search.
const HEAT_MAP_COLUMNS: usize = 48;
/// Points of the curve of the exact search.
const CURVE_POINTS: usize = 121;

/// What a search came to.
#[derive(Clone, Debug)]
struct Fitted {
    theta: Theta,
    evaluations: u64,
    objective: Objective,
    notes: Vec<String>,
}

/// What the searches of all streams came to.
#[derive(Clone, Debug, Default)]
pub(crate) struct FittedStreams {
    /// What streams share; `None` where each has its own, in `streams`.
    pub(crate) shared: Option<(Theta, Objective)>,
    /// By stream id.
    pub(crate) streams: BTreeMap<String, (StreamTheta, Objective)>,
    pub(crate) evaluations: u64,
    pub(crate) notes: Vec<String>,
}

/// Searches theta on `data`: one for all streams where `config` wants it or no two streams have the same kind of sensor, else
/// one for each stream. Parts that the data say nothing about stay as in `nominal`.
pub(crate) fn fit_streams(
    config: &CalibrationConfig,
    data: &FitData<'_>,
    nominal: &SensorModel,
    watch: Watch<'_>,
) -> Result<FittedStreams, CalibrationError> {
    let layout = data.layout();
    let is_alone = |kind| data.streams(kind).count() <= 1;
    if config.shared_theta || (is_alone(SensorKind::Proximity) && is_alone(SensorKind::Pressure)) {
        let Fitted { theta, evaluations, objective, notes } =
            fit(config, data, nominal_shared(nominal, layout), watch)?;
        return Ok(FittedStreams {
            shared: Some((theta, objective)),
            evaluations,
            notes,
            ..FittedStreams::default()
        });
    }
    let mut all = FittedStreams::default();
    let num_streams = layout.streams.len();
    let [start, end] = watch.span;
    for (idx, stream) in layout.streams.iter().enumerate() {
        let at = |idx: usize| start + (end - start) * idx as f64 / num_streams as f64;
        let wanted = (0..num_streams).map(|other| other == idx).collect();
        let of_stream = FitData::of_streams(layout, wanted, data.takes().iter().copied());
        let nominal = nominal.thetas().of(&stream.id);
        let fitted = fit(config, &of_stream, nominal, watch.within([at(idx), at(idx + 1)]))?;
        let own = StreamTheta::of_kind(stream.kind, &fitted.theta);
        all.streams.insert(stream.id.clone(), (own, fitted.objective));
        all.evaluations += fitted.evaluations;
        all.notes.extend(fitted.notes.into_iter().map(|note| format!("stream {:?}: {note}", stream.id)));
    }
    Ok(all)
}

/// theta of `nominal` for a layout whose streams share one: that of a stream that has its own, where it is the only one of
/// its kind.
fn nominal_shared(nominal: &SensorModel, layout: &TactileLayout) -> Theta {
    let mut theta = nominal.theta;
    for stream in &layout.streams {
        let own = nominal.thetas().of(&stream.id);
        match stream.kind {
            SensorKind::Proximity => theta.lambda_con_m = own.lambda_con_m,
            SensorKind::Pressure => {
                (theta.alpha_per_m, theta.lambda_pre_pa) = (own.alpha_per_m, own.lambda_pre_pa);
            }
        }
    }
    theta
}

/// Searches theta on `data`. Parts that the data say nothing about stay as in `nominal`.
fn fit(
    config: &CalibrationConfig,
    data: &FitData<'_>,
    nominal: Theta,
    watch: Watch<'_>,
) -> Result<Fitted, CalibrationError> {
    let axis = alpha_axis_of(data.layout(), data.wanted(), config.num_alphas);
    let mut fitted = match config.method {
        Method::Exact => {
            // With the nominal alpha among those tried, the fit cannot be worse than the nominal model.
            let mut alphas = axis.clone();
            alphas.push(nominal.alpha_per_m);
            alphas.sort_by(f64::total_cmp);
            alphas.dedup();
            from_exact(&exact(data, &alphas, REFINEMENT_ROUNDS, watch)?, &axis, nominal)
        }
        Method::Grid => {
            let axes = GridAxes::from_data(data, axis.clone(), config.num_lambdas);
            from_grid(grid(data, axes, watch)?, nominal)
        }
    };
    keep_nominal_where_untouched(data, nominal, &mut fitted);
    if let Some(&last) = axis.last()
        && axis.len() > 1
        && fitted.theta.alpha_per_m >= last
    {
        fitted.notes.push(format!(
            "the best alpha is the largest one tried ({last:.4} /m): the taxels show no crosstalk that the model needs"
        ));
    }
    Ok(fitted)
}

/// A modality without any real contact would be silenced by the fit; it stays as it was instead.
fn keep_nominal_where_untouched(data: &FitData<'_>, nominal: Theta, fitted: &mut Fitted) {
    let untouched = |kind| !data.has_real_contact(kind);
    let streams =
        |kind| data.streams(kind).map(|stream| stream.label.as_str()).collect::<Vec<_>>().join(", ");
    let mut keep = |kind, names: &str| {
        let labels = streams(kind);
        if !labels.is_empty() && untouched(kind) {
            let note = format!("no real contact on {labels} in the fitted takes: {names} stays nominal");
            fitted.notes.push(note);
        }
        untouched(kind)
    };
    if keep(SensorKind::Proximity, "lambda_con") {
        fitted.theta.lambda_con_m = nominal.lambda_con_m;
    }
    if keep(SensorKind::Pressure, "alpha and lambda_pre") {
        (fitted.theta.alpha_per_m, fitted.theta.lambda_pre_pa) = (nominal.alpha_per_m, nominal.lambda_pre_pa);
    }
}

fn no_contact_in_replay(has_channels: bool, what: &str, names: &str) -> Option<String> {
    has_channels.then(|| {
        format!(
            "the replay never brings a {what} patch to the object, so {names} stays nominal; check the object's pose and the joint log"
        )
    })
}

fn from_exact(found: &ExactResult, axis: &[f64], nominal: Theta) -> Fitted {
    let mut theta = nominal;
    let mut notes = Vec::new();
    match found.lambda_con_m {
        Some(best) => theta.lambda_con_m = best.threshold,
        None => {
            notes.extend(no_contact_in_replay(found.proximity.num_samples() > 0, "proximity", "lambda_con"));
        }
    }
    match found.best_alpha() {
        Some((alpha_per_m, best)) => (theta.alpha_per_m, theta.lambda_pre_pa) = (alpha_per_m, best.threshold),
        None => {
            notes.extend(no_contact_in_replay(!found.tried.is_empty(), "pressure", "alpha and lambda_pre"));
        }
    }
    Fitted { theta, evaluations: found.evaluations, objective: picture(found, axis, theta, nominal), notes }
}

/// The objective over the alphas of `axis` and around their best thresholds.
fn picture(found: &ExactResult, axis: &[f64], theta: Theta, nominal: Theta) -> Objective {
    let mut objective = Objective::default();
    let rows: Vec<_> = found.tried.iter().filter(|tried| axis.contains(&tried.alpha_per_m)).collect();
    let best_of_rows = || rows.iter().filter_map(|row| row.lambda_pre_pa).map(|best| best.threshold);
    let low =
        best_of_rows().chain([theta.lambda_pre_pa]).filter(|&pa| pa > 0.0).fold(f64::INFINITY, f64::min);
    let high = best_of_rows().chain([theta.lambda_pre_pa]).fold(0.0, f64::max);
    if !rows.is_empty() && high > 0.0 {
        // Half a decade of margin on both sides, but no more than six decades in all.
        let (low, high) = ((low / 3.0).max(high * 1e-6), high * 3.0);
        objective.lambda_pres_pa = log_spaced(low, high, HEAT_MAP_COLUMNS);
        objective.alphas_per_m = rows.iter().map(|row| row.alpha_per_m).collect();
        let row_l1 =
            |ranked: &super::Ranked| objective.lambda_pres_pa.iter().map(|&pa| ranked.l1_at(pa)).collect();
        objective.pressure_l1 = rows.iter().map(|row| row_l1(&row.pressure)).collect();
    }
    if let (Some(far), Some(deep)) =
        (found.proximity.active_quantile(0.02), found.proximity.active_quantile(0.98))
    {
        let shown = [-far, -deep, theta.lambda_con_m, nominal.lambda_con_m];
        let low = shown.into_iter().fold(f64::INFINITY, f64::min) - 1e-3;
        let high = (shown.into_iter().fold(f64::NEG_INFINITY, f64::max) + 1e-3).min(NEAR_M);
        objective.lambda_cons_m = linear_spaced(low, high, CURVE_POINTS);
        objective.proximity_l1 = objective.lambda_cons_m.iter().map(|&m| found.proximity.l1_at(-m)).collect();
    }
    objective
}

fn from_grid(found: GridResult, nominal: Theta) -> Fitted {
    let mut theta = nominal;
    if let Some((lambda_con_m, _)) = found.best_lambda_con_m() {
        theta.lambda_con_m = lambda_con_m;
    }
    if let Some((alpha_per_m, lambda_pre_pa, _)) = found.best_alpha() {
        (theta.alpha_per_m, theta.lambda_pre_pa) = (alpha_per_m, lambda_pre_pa);
    }
    let objective = Objective {
        alphas_per_m: found.axes.alphas_per_m,
        lambda_pres_pa: found.axes.lambda_pres_pa,
        pressure_l1: found.pressure_l1,
        lambda_cons_m: found.axes.lambda_cons_m,
        proximity_l1: found.proximity_l1,
    };
    Fitted { theta, evaluations: found.evaluations, objective, notes: Vec::new() }
}
