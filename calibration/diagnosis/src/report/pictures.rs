//! The pictures: residual maps, evidence against the bar, the gap step by step.

use std::fmt::{self, Write as _};

use palpate_calibration::report::Escaped;
use palpate_reports::{ChannelResidual, DiagnosisReport, wording};

const NAMES: f64 = 250.0;
const BARS: f64 = 520.0;
const NUMBERS: f64 = 150.0;
const ROW: f64 = 24.0;
/// Candidates shown; the JSON report has them all.
const MOST_CANDIDATES: usize = 14;
const PHASES: [&str; 4] = ["onset", "sustained", "release", "no_contact"];

/// Channels by phases, before and after, on one scale.
pub(super) fn write_residual_maps(page: &mut String, report: &DiagnosisReport) -> fmt::Result {
    let channels = &report.residual_map;
    if channels.is_empty() {
        return Ok(());
    }
    let values = channels.iter().flat_map(|c| c.calibrated.values().chain(c.diagnosed.values()));
    let full = values.copied().filter(|value| value.is_finite()).fold(f64::MIN_POSITIVE, f64::max);
    page.push_str("<div class=\"pictures\">\n");
    type ByPhase = fn(&ChannelResidual) -> &std::collections::BTreeMap<String, f64>;
    let sides: [(&str, ByPhase); 2] = [
        ("Before: the calibrated model", |channel| &channel.calibrated),
        ("After: with the named effects", |channel| &channel.diagnosed),
    ];
    for (title, of) in sides {
        let (left, width) = (84.0, 440.0);
        let cell = width / channels.len() as f64;
        let height = ROW * PHASES.len() as f64;
        writeln!(
            page,
            "<figure>\n<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{title}\">",
            left + width + 4.0,
            height + 4.0
        )?;
        for (row, phase) in PHASES.iter().enumerate() {
            let y = row as f64 * ROW;
            writeln!(page, "<text x=\"0\" y=\"{:.1}\">{}</text>", y + 16.0, wording::words(phase))?;
            for (column, channel) in channels.iter().enumerate() {
                let Some(&value) = of(channel).get(*phase) else { continue };
                let share = (value / full).clamp(0.0, 1.0);
                writeln!(
                    page,
                    "<rect x=\"{:.1}\" y=\"{y:.1}\" width=\"{:.2}\" height=\"{ROW}\" fill=\"{}\"><title>{}, {}: {}</title></rect>",
                    left + column as f64 * cell,
                    cell + 0.1,
                    colour(share),
                    Escaped(&channel.channel),
                    wording::words(phase),
                    wording::number(value)
                )?;
            }
        }
        writeln!(
            page,
            "</svg>\n<figcaption>{title}. Columns are channels in the layout's order.</figcaption>\n</figure>"
        )?;
    }
    writeln!(
        page,
        "</div>\n<p class=\"caption\">Mismatch a second on the judging takes, from 0 (dark) to {} (bright), the same scale \
         on both sides.</p>",
        wording::number(full)
    )
}

/// Evidence for what was named and what was tried.
pub(super) fn write_evidence(page: &mut String, report: &DiagnosisReport) -> fmt::Result {
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
    if rows.is_empty() {
        return Ok(());
    }
    let bar = report.bar.evidence;
    let highest = rows.iter().map(|(_, evidence, _)| *evidence).chain([bar, 1.0]).fold(0.0, f64::max) * 1.05;
    // Evidence is a square: its root spreads the candidates near the bar over the picture.
    let x_of = |evidence: f64| NAMES + BARS * (evidence.max(0.0) / highest).sqrt().min(1.0);
    let height = ROW * rows.len() as f64;
    open(page, "Evidence for what was tried", height + 22.0)?;
    for (idx, (name, evidence, is_named)) in rows.iter().enumerate() {
        let class = if *is_named { "diagnosed" } else { "other" };
        row(page, idx, name, x_of(*evidence), class, &wording::number(*evidence))?;
    }
    let x = x_of(bar);
    writeln!(page, "<path class=\"limit\" d=\"M{x:.1} 0V{height}\"/>")?;
    for &chance in &report.bar.null_maxima {
        let x = x_of(chance);
        writeln!(page, "<path class=\"axis\" d=\"M{x:.1} {height}v6\"/>")?;
    }
    let source = match report.bar.null_sessions {
        0 => "the shipped default".to_owned(),
        sessions => format!("from {sessions} simulated sessions with nothing missing, a tick each"),
    };
    writeln!(
        page,
        "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">the bar, {}</text>\n</svg>\n<figcaption>Evidence (named: \
         green) against the bar, {source}.</figcaption>\n</figure>",
        height + 18.0,
        wording::number(bar)
    )
}

/// The gap on confirm takes: nominal, calibrated, then one more effect each.
pub(super) fn write_waterfall(page: &mut String, report: &DiagnosisReport) -> fmt::Result {
    if report.waterfall.is_empty() {
        return Ok(());
    }
    let reach =
        report.waterfall.iter().map(|step| step.interval_95.map_or(step.gap, |[_, high]| high.max(step.gap)));
    let full = reach.fold(f64::MIN_POSITIVE, f64::max) * 1.02;
    let x_of = |gap: f64| NAMES + BARS * (gap / full).clamp(0.0, 1.0);
    let height = ROW * report.waterfall.len() as f64;
    open(page, "Gap step by step", height + 4.0)?;
    for (idx, step) in report.waterfall.iter().enumerate() {
        let name = wording::step_name(report, idx);
        let class = match step.step.as_str() {
            known @ ("nominal" | "calibrated") => known,
            _ => "diagnosed",
        };
        let interval = step.interval_95.map_or_else(String::new, |[low, high]| {
            format!(" ({} to {})", wording::number(low), wording::number(high))
        });
        row(page, idx, &name, x_of(step.gap), class, &format!("{}{interval}", wording::number(step.gap)))?;
        if let Some([low, high]) = step.interval_95 {
            let y = (idx as f64 + 0.5) * ROW;
            let (low, high) = (x_of(low), x_of(high));
            let top = y - 4.0;
            writeln!(
                page,
                "<path class=\"whisker\" d=\"M{low:.1} {y:.1}H{high:.1}M{low:.1} {top:.1}v8M{high:.1} {top:.1}v8\"/>"
            )?;
        }
    }
    let floor = report.held_out.noise_floor.filter(|floor| *floor <= full);
    if let Some(floor) = floor {
        writeln!(page, "<path class=\"floor\" d=\"M{:.1} 0V{height}\"/>", x_of(floor))?;
    }
    let floor = if floor.is_some() { " Dashed: what repetitions of one motion differ by." } else { "" };
    writeln!(
        page,
        "</svg>\n<figcaption>Mismatch a channel-second on takes that nothing was fitted to, with 95 % intervals over \
         repetitions.{floor}</figcaption>\n</figure>"
    )
}

fn open(page: &mut String, label: &str, height: f64) -> fmt::Result {
    writeln!(
        page,
        "<figure>\n<svg viewBox=\"0 0 {} {height}\" role=\"img\" aria-label=\"{label}\">",
        NAMES + BARS + NUMBERS
    )
}

/// A name, its bar from zero to `x`, its number.
fn row(page: &mut String, idx: usize, name: &str, x: f64, class: &str, number: &str) -> fmt::Result {
    let top = idx as f64 * ROW;
    writeln!(
        page,
        "<text x=\"0\" y=\"{y:.1}\">{}</text><rect class=\"bar fill-{class}\" x=\"{NAMES}\" y=\"{:.1}\" width=\"{:.1}\" \
         height=\"14\"/><text x=\"{:.1}\" y=\"{y:.1}\">{}</text>",
        Escaped(name),
        top + 5.0,
        (x - NAMES).max(1.0),
        NAMES + BARS + 8.0,
        Escaped(number),
        y = top + 16.0
    )
}

/// Of viridis, from dark violet (0) to bright yellow (1).
fn colour(share: f64) -> String {
    format!("#{:x}", colorous::VIRIDIS.eval_continuous(share))
}
