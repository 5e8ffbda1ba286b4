//! From either search to theta and the picture of the objective.

use palpate_robot_model::SensorKind;
use palpate_sim::{Theta, replay::NEAR_M};
use palpate_wire::api::Objective;

use super::{
    ExactResult, FitData, GridAxes, GridResult, Watch, alpha_axis,
    axes::{linear_spaced, log_spaced},
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
pub(crate) struct Fitted {
    pub(crate) theta: Theta,
    pub(crate) evaluations: u64,
    pub(crate) objective: Objective,
    pub(crate) notes: Vec<String>,
}

/// Searches theta on `data`. Parts that the data say nothing about stay as in `nominal`.
pub(crate) fn fit(
    config: &CalibrationConfig,
    data: &FitData<'_>,
    nominal: Theta,
    watch: Watch<'_>,
) -> Result<Fitted, CalibrationError> {
    let axis = alpha_axis(data.layout(), config.num_alphas);
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
    let untouched = |kind| !data.takes().iter().any(|take| take.has_real_contact(data.layout(), kind));
    let streams = |kind| {
        let streams = data.layout().streams.iter().filter(|stream| stream.kind == kind);
        streams.map(|stream| stream.label.as_str()).collect::<Vec<_>>().join(", ")
    };
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
