//! The pictures: residual maps, evidence against the bar, the gap step by step.

use maud::{Markup, html};
use palpate_reports::{ChannelResidual, DiagnosisReport, wording};

const NAMES: f64 = 250.0;
const BARS: f64 = 520.0;
const NUMBERS: f64 = 150.0;
const ROW: f64 = 24.0;
/// Candidates shown; the JSON report has them all.
const MOST_CANDIDATES: usize = 14;
const PHASES: [&str; 4] = ["onset", "sustained", "release", "no_contact"];

/// A channel's mismatch by phase, in one of two models.
type ByPhase = fn(&ChannelResidual) -> &std::collections::BTreeMap<String, f64>;

/// Channels by phases, before and after, on one scale; nothing without channels.
pub(super) fn residual_maps(report: &DiagnosisReport) -> Markup {
    let channels = &report.residual_map;
    let values = channels.iter().flat_map(|c| c.calibrated.values().chain(c.diagnosed.values()));
    let full = values.copied().filter(|value| value.is_finite()).fold(f64::MIN_POSITIVE, f64::max);
    html! {
        @if !channels.is_empty() {
            div.pictures {
                (residual_map(channels, full, "Before: the calibrated model", |channel| &channel.calibrated))
                (residual_map(channels, full, "After: with the named effects", |channel| &channel.diagnosed))
            }
            p.caption {
                "Mismatch a second on the judging takes, from 0 (dark) to " (wording::number(full))
                " (bright), the same scale on both sides."
            }
        }
    }
}

fn residual_map(channels: &[ChannelResidual], full: f64, title: &str, of: ByPhase) -> Markup {
    let (left, width) = (84.0, 440.0);
    let cell = width / channels.len() as f64;
    let height = ROW * PHASES.len() as f64;
    html! {
        figure {
            svg viewBox=(format!("0 0 {} {}", left + width + 4.0, height + 4.0)) role="img" aria-label=(title) {
                @for (row, phase) in PHASES.iter().enumerate() {
                    @let y = row as f64 * ROW;
                    text x="0" y=(tenths(y + 16.0)) { (wording::words(phase)) }
                    @for (column, channel) in channels.iter().enumerate() {
                        @if let Some(&value) = of(channel).get(*phase) {
                            rect x=(tenths(left + column as f64 * cell)) y=(tenths(y)) width=(format!("{:.2}", cell + 0.1))
                                height=(ROW) fill=(colour((value / full).clamp(0.0, 1.0))) {
                                title { (channel.channel) ", " (wording::words(phase)) ": " (wording::number(value)) }
                            }
                        }
                    }
                }
            }
            figcaption { (title) ". Columns are channels in the layout's order." }
        }
    }
}

/// Evidence for what was named and what was tried; nothing where nothing was.
pub(super) fn evidence(report: &DiagnosisReport) -> Markup {
    let named = report
        .effects
        .iter()
        .map(|effect| (wording::effect_at(&effect.id, &effect.place), effect.evidence, true));
    let tried = report
        .candidates
        .iter()
        .filter(|tried| {
            !report.effects.iter().any(|named| named.id == tried.id && named.place == tried.place)
        })
        .map(|tried| (wording::effect_at(&tried.id, &tried.place), tried.evidence, false));
    let mut rows: Vec<(String, f64, bool)> = named.chain(tried).collect();
    rows.sort_by(|a, b| b.1.total_cmp(&a.1));
    rows.truncate(MOST_CANDIDATES.max(report.effects.len()));
    let bar = report.bar.evidence;
    let highest = rows.iter().map(|(_, evidence, _)| *evidence).chain([bar, 1.0]).fold(0.0, f64::max) * 1.05;
    // Evidence is a square: its root spreads the candidates near the bar over the picture.
    let x_of = |evidence: f64| NAMES + BARS * (evidence.max(0.0) / highest).sqrt().min(1.0);
    let height = ROW * rows.len() as f64;
    let source = match report.bar.null_sessions {
        0 => "the shipped default".to_owned(),
        sessions => format!("from {sessions} simulated sessions with nothing missing, a tick each"),
    };
    html! {
        @if !rows.is_empty() {
            figure {
                svg viewBox=(view_box(height + 22.0)) role="img" aria-label="Evidence for what was tried" {
                    @for (idx, (name, evidence, is_named)) in rows.iter().enumerate() {
                        @let class = if *is_named { "diagnosed" } else { "other" };
                        (row(idx, name, x_of(*evidence), class, &wording::number(*evidence)))
                    }
                    path.limit d=(format!("M{:.1} 0V{height}", x_of(bar))) {}
                    @for &chance in &report.bar.null_maxima {
                        path.axis d=(format!("M{:.1} {height}v6", x_of(chance))) {}
                    }
                    text x=(tenths(x_of(bar))) y=(tenths(height + 18.0)) text-anchor="middle" {
                        "the bar, " (wording::number(bar))
                    }
                }
                figcaption { "Evidence (named: green) against the bar, " (source) "." }
            }
        }
    }
}

/// The gap on confirm takes: nominal, calibrated, then one more effect each; nothing without steps.
pub(super) fn waterfall(report: &DiagnosisReport) -> Markup {
    let reach =
        report.waterfall.iter().map(|step| step.interval_95.map_or(step.gap, |[_, high]| high.max(step.gap)));
    let full = reach.fold(f64::MIN_POSITIVE, f64::max) * 1.02;
    let x_of = |gap: f64| NAMES + BARS * (gap / full).clamp(0.0, 1.0);
    let height = ROW * report.waterfall.len() as f64;
    let floor = report.held_out.noise_floor.filter(|floor| *floor <= full);
    let class = |step: &str| match step {
        "nominal" => "nominal",
        "calibrated" => "calibrated",
        _ => "diagnosed",
    };
    let whisker = |idx: usize, [low, high]: [f64; 2]| {
        let y = (idx as f64 + 0.5) * ROW;
        let (low, high, top) = (x_of(low), x_of(high), y - 4.0);
        format!("M{low:.1} {y:.1}H{high:.1}M{low:.1} {top:.1}v8M{high:.1} {top:.1}v8")
    };
    html! {
        @if !report.waterfall.is_empty() {
            figure {
                svg viewBox=(view_box(height + 4.0)) role="img" aria-label="Gap step by step" {
                    @for (idx, step) in report.waterfall.iter().enumerate() {
                        @let interval = step.interval_95.map_or_else(String::new, |[low, high]| {
                            format!(" ({} to {})", wording::number(low), wording::number(high))
                        });
                        @let number = format!("{}{interval}", wording::number(step.gap));
                        (row(idx, &wording::step_name(report, idx), x_of(step.gap), class(&step.step), &number))
                        @if let Some(interval) = step.interval_95 { path.whisker d=(whisker(idx, interval)) {} }
                    }
                    @if let Some(floor) = floor { path.floor d=(format!("M{:.1} 0V{height}", x_of(floor))) {} }
                }
                figcaption {
                    "Mismatch a channel-second on takes that nothing was fitted to, with 95 % intervals over repetitions."
                    @if floor.is_some() { " Dashed: what repetitions of one motion differ by." }
                }
            }
        }
    }
}

fn view_box(height: f64) -> String {
    format!("0 0 {} {height}", NAMES + BARS + NUMBERS)
}

/// A length in a picture.
fn tenths(length: f64) -> String {
    format!("{length:.1}")
}

/// A name, its bar from zero to `x`, its number.
fn row(idx: usize, name: &str, x: f64, class: &str, number: &str) -> Markup {
    let top = idx as f64 * ROW;
    let y = tenths(top + 16.0);
    html! {
        text x="0" y=(y) { (name) }
        rect class={ "bar fill-" (class) } x=(NAMES) y=(tenths(top + 5.0)) width=(tenths((x - NAMES).max(1.0))) height="14" {}
        text x=(tenths(NAMES + BARS + 8.0)) y=(y) { (number) }
    }
}

/// Of viridis, from dark violet (0) to bright yellow (1).
fn colour(share: f64) -> String {
    format!("#{:x}", colorous::VIRIDIS.eval_continuous(share))
}
