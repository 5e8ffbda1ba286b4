//! What the verdicts say: rates with intervals, failures, comparisons, agreement, and ways to take them along.

use egui::RichText;
use palpate_wire::api::{
    Campaign, CampaignResults, PolicyComparison, PolicyResult, Role, Scope, SuccessRate,
};

use super::beside::{BesideState, beside_ui};
use crate::screens::{ScreenContext, duration_text, loaded_ui};

/// With less room than this, points, names stand above their lines.
const BESIDE: f32 = 520.0;
/// Height of a line of the picture.
const LINE: f32 = 24.0;

pub(super) fn results_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut BesideState,
    campaign: &Campaign,
) {
    let id = &campaign.summary.id;
    let is_kept_back = campaign.plan.is_blind
        && campaign.summary.closed.is_none()
        && cx.store.people.lacks(Role::Operator, Scope::Read).is_some();
    if is_kept_back {
        ui.label("This campaign is blind: its results stand here once it is closed.");
        return;
    }
    let results = cx.store.campaigns.results(id);
    let Some(results) = loaded_ui(ui, cx, results, "Counting", "The results did not arrive") else { return };
    if results.scored == 0 {
        ui.label("No trial has a verdict yet. Rates with their intervals stand here as soon as one has.");
    }
    picture_ui(ui, cx, &results);
    ui.add_space(8.0);
    for comparison in &results.comparisons {
        comparison_ui(ui, cx, comparison);
    }
    agreement_ui(ui, &results);
    ui.add_space(8.0);
    table_ui(ui, cx, &results);
    ui.add_space(8.0);
    failures_ui(ui, cx, &results);
    ui.add_space(8.0);
    ui.horizontal_wrapped(|ui| {
        ui.label("Take along:");
        for (ending, label) in [("csv", "CSV"), ("tex", "LaTeX"), ("svg", "picture"), ("txt", "text")] {
            ui.hyperlink_to(label, format!("/api/v1/campaigns/{id}/tables/results.{ending}"));
        }
        ui.hyperlink_to("JSON", format!("/api/v1/campaigns/{id}/results"));
        ui.hyperlink_to("every trial (CSV)", format!("/api/v1/campaigns/{id}/tables/trials.csv"));
    });
    beside_ui(ui, cx, state, campaign);
    for published in &results.published {
        ui.label(
            RichText::new(format!("{}: {}.", published.label, published.source))
                .color(cx.palette.text_weak)
                .small(),
        );
    }
    ui.add_space(12.0);
}

/// A line of the picture.
struct Line {
    name: String,
    rate: SuccessRate,
    is_published: bool,
}

fn lines(
    results: &CampaignResults,
    of: impl Fn(&PolicyResult) -> Option<SuccessRate>,
    published: usize,
) -> Vec<Line> {
    let own = results.policies.iter().filter_map(|policy| {
        Some(Line { name: policy.policy.clone(), rate: of(policy)?, is_published: false })
    });
    let beside = results.published.iter().filter_map(|result| {
        let both = [result.seen[0] + result.unseen[0], result.seen[1] + result.unseen[1]];
        let [successes, trials] = [result.seen, result.unseen, both][published];
        let rate = (trials > 0).then(|| successes as f64 / trials as f64)?;
        // Only the rate: intervals of published figures are in the files.
        let ends = [rate, rate];
        let rate =
            SuccessRate { successes, trials, rate: Some(rate), wilson_95: ends, clopper_pearson_95: ends };
        Some(Line { name: result.label.clone(), rate, is_published: true })
    });
    let own: Vec<Line> = own.collect();
    if own.is_empty() { own } else { own.into_iter().chain(beside).collect() }
}

/// Rates as dots on their intervals; published ones hollow.
fn picture_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, results: &CampaignResults) {
    for (idx, (group, of)) in [
        ("Seen objects", (|policy: &PolicyResult| policy.seen) as fn(&PolicyResult) -> Option<SuccessRate>),
        ("Unseen objects", |policy| policy.unseen),
        ("All objects", |policy| Some(policy.overall)),
    ]
    .into_iter()
    .enumerate()
    {
        let lines = lines(results, of, idx);
        if lines.is_empty() {
            continue;
        }
        ui.strong(group);
        for line in &lines {
            line_ui(ui, cx, line);
        }
        scale_ui(ui, cx);
        ui.add_space(4.0);
    }
    ui.label(
        RichText::new(
            "Dots are success rates, lines Wilson's 95 % intervals; hollow dots are published results.",
        )
        .color(cx.palette.text_weak)
        .small(),
    );
}

/// Where the parts of a line are: the name, the share from 0 to 1, and the count.
struct Columns {
    width: f32,
    /// The name has a line of its own, because it would have no room beside the picture.
    name_above: bool,
    plot: egui::Rangef,
}

impl Columns {
    /// In `available` points from `left` on.
    fn of(left: f32, available: f32) -> Self {
        let width = available.min(720.0);
        let name_above = width < BESIDE;
        let name_width = if name_above { 6.0 } else { (0.34 * width).min(230.0) };
        Self { width, name_above, plot: egui::Rangef::new(left + name_width, left + width - 64.0) }
    }

    fn x(&self, share: f64) -> f32 {
        egui::lerp(self.plot.min..=self.plot.max, share as f32)
    }
}

const SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

fn line_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, line: &Line) {
    let columns = Columns::of(ui.cursor().left(), ui.available_width());
    if columns.name_above {
        // The line below says it to those who do not see it.
        ui.add(egui::Label::new(RichText::new(&line.name).small()).truncate());
    }
    let (rect, response) = ui.allocate_exact_size(egui::vec2(columns.width, LINE), egui::Sense::hover());
    let count = format!("{}/{}", line.rate.successes, line.rate.trials);
    let words = match line.rate.rate {
        Some(rate) if !line.is_published => {
            let [low, high] = line.rate.wilson_95.map(|end| 100.0 * end);
            format!("{}: {count}, {:.0} % ({low:.0} to {high:.0})", line.name, 100.0 * rate)
        }
        _ => format!("{}: {count}", line.name),
    };
    response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Label, true, &words));
    let response = response.on_hover_text(&words);
    let painter = ui.painter_at(response.rect);
    let font = egui::FontId::proportional(13.0);
    let text = ui.visuals().text_color();
    if !columns.name_above {
        let name_clip = egui::Rect::from_min_max(rect.min, egui::pos2(columns.plot.min - 8.0, rect.max.y));
        painter.with_clip_rect(name_clip).text(
            rect.left_center(),
            egui::Align2::LEFT_CENTER,
            &line.name,
            font.clone(),
            text,
        );
    }
    let y = rect.center().y;
    for share in SHARES {
        painter.vline(columns.x(share), rect.y_range(), egui::Stroke::new(1.0, cx.palette.line));
    }
    if let Some(rate) = line.rate.rate {
        let colour = cx.palette.calibrated;
        let [low, high] = line.rate.wilson_95;
        painter.hline(columns.x(low)..=columns.x(high), y, egui::Stroke::new(2.0, colour));
        let at = egui::pos2(columns.x(rate), y);
        if line.is_published {
            painter.circle(at, 5.0, cx.palette.surface, egui::Stroke::new(2.0, colour));
        } else {
            painter.circle_filled(at, 5.0, colour);
        }
    }
    painter.text(rect.right_center(), egui::Align2::RIGHT_CENTER, count, font, text);
}

/// What the lines are measured by.
fn scale_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>) {
    let columns = Columns::of(ui.cursor().left(), ui.available_width());
    let (rect, _) = ui.allocate_exact_size(egui::vec2(columns.width, 16.0), egui::Sense::hover());
    for share in SHARES {
        let at = egui::pos2(columns.x(share), rect.center().y);
        let (text, font) = (format!("{:.0} %", 100.0 * share), egui::FontId::proportional(12.0));
        let align = if share == 0.0 && columns.name_above {
            egui::Align2::LEFT_CENTER
        } else {
            egui::Align2::CENTER_CENTER
        };
        ui.painter().text(at, align, text, font, cx.palette.text_weak);
    }
}

fn comparison_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, comparison: &PolicyComparison) {
    let PolicyComparison { a, b, pairs, only_a, only_b, p_mcnemar, sequential, .. } = comparison;
    if *pairs == 0 {
        ui.label(format!("{a} and {b} have no start from which both were tried and scored."));
        return;
    }
    let verdict = match (&sequential.better, sequential.is_exhausted, sequential.pairs_to_settle) {
        (Some(better), ..) => format!("{better} is better: this comparison may stop."),
        (None, true, _) => "all planned pairs are made, and neither is shown to be better.".to_owned(),
        (None, false, Some(more)) => {
            format!("nothing is shown yet; about {more} more pairs would settle it.")
        }
        (None, false, None) => {
            "nothing is shown yet, and the planned pairs will hardly settle it.".to_owned()
        }
    };
    ui.label(RichText::new(format!("{a} against {b}: {verdict}")).strong());
    ui.label(
        RichText::new(format!(
            "{pairs} matched starts, {only_a} won by {a} alone, {only_b} by {b} alone; McNemar's exact p = {p_mcnemar:.3}. \
             The sequential test of {} pairs calls equal policies different in {:.0} % at most.",
            sequential.max_pairs,
            100.0 * sequential.alpha
        ))
        .color(cx.palette.text_weak),
    );
    ui.add_space(4.0);
}

fn agreement_ui(ui: &mut egui::Ui, results: &CampaignResults) {
    let Some(agreement) = &results.agreement else { return };
    let kappa = agreement.kappa.map_or_else(String::new, |kappa| format!(", Cohen's kappa {kappa:.2}"));
    let [first, second] = &agreement.scorers;
    ui.label(format!(
        "{first} and {second} agree on {} of {} attempts{kappa}.",
        agreement.agreed, agreement.attempts
    ));
}

fn table_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, results: &CampaignResults) {
    let Some(first) = results.policies.first() else { return };
    ui.strong("By object");
    egui::ScrollArea::horizontal().id_salt("by_object").show(ui, |ui| {
        egui::Grid::new("by_object").striped(true).spacing([18.0, 4.0]).show(ui, |ui| {
            ui.label("");
            for policy in &results.policies {
                ui.label(RichText::new(&policy.policy).color(cx.palette.text_weak));
            }
            for published in &results.published {
                ui.label(RichText::new(&published.label).color(cx.palette.text_weak).italics());
            }
            ui.end_row();
            for (idx, object) in first.objects.iter().enumerate() {
                ui.label(&object.object);
                for policy in &results.policies {
                    let rate = policy.objects.get(idx).map(|object| object.rate);
                    ui.label(
                        rate.map_or_else(String::new, |rate| format!("{}/{}", rate.successes, rate.trials)),
                    );
                }
                for published in &results.published {
                    let counts = published.objects.get(&object.object);
                    ui.label(
                        counts
                            .map_or_else(String::new, |[successes, trials]| format!("{successes}/{trials}")),
                    );
                }
                ui.end_row();
            }
        });
    });
}

fn failures_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, results: &CampaignResults) {
    ui.strong("How trials failed");
    egui::ScrollArea::horizontal().id_salt("failures").show(ui, |ui| {
        egui::Grid::new("failures").striped(true).spacing([18.0, 4.0]).show(ui, |ui| {
            for name in ["", "Empty grasp", "Slip", "Emergency stop", "Void", "No verdict", "Time to grasp"] {
                ui.label(RichText::new(name).color(cx.palette.text_weak));
            }
            ui.end_row();
            for policy in &results.policies {
                ui.label(&policy.policy);
                let failures = &policy.failures;
                for count in
                    [failures.empty_grasp, failures.slip, failures.emergency_stop, policy.void, policy.open]
                {
                    ui.label(count.to_string());
                }
                ui.label(policy.median_time_to_grasp_s.map_or_else(|| "-".to_owned(), duration_text));
                ui.end_row();
            }
        });
    });
}
