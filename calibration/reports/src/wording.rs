//! What documents say, in words: the same on the page, in reports and in the terminal.

use palpate_robot_model::Place;

use crate::{Cell, DiagnosisReport, EffectInDoubt, ModelEffect, NamedEffect, StreamThetaReport, Unexplained};

/// An id in the words it is made of: `joint_backlash` gives `joint backlash`.
pub fn words(id: &str) -> String {
    id.replace(['_', '-'], " ")
}

/// Two or three digits that count, with a true minus: `409`, `42.2`, `0.36`, `0.0058`.
pub fn number(value: f64) -> String {
    let text = match value.abs() {
        0.0 => "0".to_owned(),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 0.1 => format!("{value:.2}"),
        size if size >= 0.01 => format!("{value:.3}"),
        size if size >= 1e-3 => format!("{value:.4}"),
        _ => format!("{value:.1e}"),
    };
    text.replace('-', "\u{2212}")
}

/// Unit for people of a parameter or a signal called `name`, whose unit is its last word, and how many of it make one SI
/// unit.
fn unit_of(name: &str) -> (&'static str, f64) {
    let last = name.rsplit('_').next().unwrap_or_default();
    match last {
        "s" if name.ends_with("_per_s") => ("/s", 1.0),
        "m" if name.ends_with("_per_m") => ("/m", 1.0),
        "s" => ("ms", 1e3),
        "m" => ("mm", 1e3),
        "rad" => ("mrad", 1e3),
        "pa" => ("Pa", 1.0),
        "nm" => ("N m", 1.0),
        "v" => ("V", 1.0),
        "n" => ("N", 1.0),
        "hz" => ("Hz", 1.0),
        _ => ("", 1.0),
    }
}

/// A value of the parameter called `name`, with its unit: `("delay_s", 0.0618)` gives `61.8 ms`.
pub fn quantity(name: &str, value: f64) -> String {
    let (unit, scale) = unit_of(name);
    format!("{} {unit}", number(value * scale)).trim_end().to_owned()
}

/// What a stream has of theta for itself, in one line.
pub fn stream_theta(own: &StreamThetaReport) -> String {
    let named = [
        own.lambda_con_m.map(|value| format!("\u{3bb}con {}", quantity("lambda_con_m", value))),
        own.alpha_per_m.map(|value| format!("\u{3b1} {} /m", number(value))),
        own.lambda_pre_pa.map(|value| format!("\u{3bb}pre {} Pa", number(value))),
    ];
    named.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// An interval of the parameter called `name`, with its unit: `52.0 to 70.1 ms`.
pub fn range(name: &str, [low, high]: [f64; 2]) -> String {
    let (unit, scale) = unit_of(name);
    format!("{} to {} {unit}", number(low * scale), number(high * scale)).trim_end().to_owned()
}

/// A parameter's name without its unit, in words: `delay_s` gives `delay`.
pub fn parameter_name(name: &str) -> String {
    let (unit, _) = unit_of(name);
    let bare = name.rsplit_once('_').filter(|_| !unit.is_empty()).map_or(name, |(bare, _)| bare);
    words(bare.strip_suffix("_per").unwrap_or(bare))
}

/// A place for people: `stream fsr`, `joint 3`, `channels a, b`.
pub fn place(place: &Place) -> String {
    match place {
        Place::Stream(id) => format!("stream {id}"),
        Place::Patch(id) => format!("patch {id}"),
        Place::Channel(id) => format!("channel {id}"),
        Place::Channels(ids) => format!("channels {}", ids.join(", ")),
        Place::Joint(name) => format!("joint {name}"),
        Place::Group(id) => id.clone(),
        Place::Groups(ids) => ids.join(" and "),
        Place::Object(id) => format!("object {}", words(id)),
    }
}

/// Effect and place for people: `latency, stream fsr`.
pub fn effect_at(id: &str, at: &Place) -> String {
    format!("{}, {}", words(id), place(at))
}

/// An effect of a model on one line: `latency, stream fsr: delay 61.8 ms`.
pub fn model_effect(effect: &ModelEffect) -> String {
    let parameters = effect
        .parameters
        .iter()
        .map(|(name, &value)| format!("{} {}", parameter_name(name), quantity(name, value)));
    format!("{}: {}", effect_at(&effect.id, &effect.place), parameters.collect::<Vec<_>>().join(", "))
}

/// A share as people read it: `41 %`.
pub fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.0} %", share * 100.0) } else { "\u{2013}".to_owned() }
}

/// So many things, in the singular or the plural with an s: `1 gap`, `2 gaps`.
pub fn counted(count: u64, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// A probability as people read it.
pub fn p_value(p_value: f64) -> String {
    if p_value < 0.001 { "p < 0.001".to_owned() } else { format!("p = {p_value:.3}") }
}

/// What a rule that withholds names has found, as `doubt.check` names the rule; the id in words for a rule of a later version.
pub fn objection(rule: &str) -> String {
    let known = match rule {
        "usual" => "effects like it are found in sessions in which nothing is wrong",
        "size_by_take" => "its size differs from take to take",
        "remainder" => "a stronger effect at the same place explains more",
        "alike" => "another effect would add nearly the same",
        "one_place" => "other effects would stand at the same place",
        "weak_beside_rest" => "its evidence is small beside what is left",
        "repeats_more" => "more repeats with it than without",
        "left_at_patch" => "most of what repeats is left at one patch",
        "posture" => "a gain that bends with a joint explains more",
        "gap_grows" => "more frames are mistaken with it than without",
        "signal_raised" => "a signal is matched worse with it than without",
        "left_by_constants" => "constants alone leave too much of the misfit",
        "left_by_one" => "it leaves too much of the misfit before it",
        "left_by_all" => "all effects together leave too much of the misfit",
        other => return words(other),
    };
    known.to_owned()
}

/// What an operator should know of a withheld effect: which it is, and what speaks against it.
pub fn in_doubt_sentence(effect: &EffectInDoubt) -> String {
    let doubts: Vec<String> = effect
        .doubt
        .iter()
        .map(|doubt| {
            let (measured, limit) = (number(doubt.measured), number(doubt.limit));
            format!("{} ({measured}, limit {limit})", objection(&doubt.check))
        })
        .collect();
    format!("{} comes near, but is in doubt: {}", effect_at(&effect.id, &effect.place), doubts.join("; "))
}

/// In which streams touches differ most from the model and from each other; `None` of takes without readings.
pub fn touch_to_touch_sentence(left: &Unexplained) -> Option<String> {
    let streams: Vec<String> = left
        .touch_to_touch
        .iter()
        .map(|(stream, variances)| format!("{stream} {}", number(*variances)))
        .collect();
    (!streams.is_empty()).then(|| {
        format!(
            "Response differs from touch to touch, beyond the model, by this many variances (1 is noise alone; up to 24 where \
             nothing is missing on emulated stations): {}.",
            streams.join(", ")
        )
    })
}

/// How likely evidence as strong as that for a named effect is by chance, where null sessions of the station tell.
pub fn chance(p_value: Option<f64>) -> String {
    p_value
        .map_or_else(|| "no null sessions of this station say how likely by chance".to_owned(), self::p_value)
}

/// Share of the calibrated model's gap that adding `effect` removes, on takes that nothing was fitted to.
pub fn share_removed(effect: &NamedEffect, report: &DiagnosisReport) -> Option<f64> {
    let whole = report.held_out.calibrated;
    (whole > 0.0).then(|| (effect.gap_before - effect.gap_after) / whole)
}

/// What an operator should know of a named effect: what it is and how sure that is, who agrees, what adding it brings.
/// "The FSR stream arrives 62 ms late (52 to 70 ms). 8 of 9 takes agree. Adding it removes 41 % of the gap."
pub fn effect_sentences(effect: &NamedEffect, report: &DiagnosisReport) -> String {
    let mut text = effect.explanation.trim().trim_end_matches('.').to_owned();
    // With several parameters the sentence would be a table; the evidence is one.
    if let (1, Some((name, &interval))) = (effect.interval.len(), effect.interval.first_key_value()) {
        text += &format!(" ({})", range(name, interval));
    }
    text.push('.');
    if let Some((improved, all)) = effect.takes_improved.split_once('/') {
        text += &format!(" {improved} of {all} takes agree.");
    }
    match share_removed(effect, report) {
        Some(share) if share >= 0.005 => {
            text += &format!(" Adding it removes {} of the gap.", percent(share));
        }
        Some(_) => text += " Adding it does not lower the gap on the takes kept for judging.",
        None => {}
    }
    text
}

/// Name for people of step `idx` of the waterfall: the effects follow in the order in which they were added.
pub fn step_name(report: &DiagnosisReport, idx: usize) -> String {
    let Some(step) = report.waterfall.get(idx) else { return String::new() };
    let before = report.waterfall.len().saturating_sub(report.effects.len());
    match idx.checked_sub(before).and_then(|effect_idx| report.effects.get(effect_idx)) {
        Some(effect) if effect.id == step.step => format!("+ {}", effect_at(&effect.id, &effect.place)),
        _ => words(&step.step),
    }
}

/// That an effect cannot be told from others, if so: "Cannot tell latency from backlash on these takes."
pub fn rivals_sentence(effect: &NamedEffect) -> Option<String> {
    let mut others: Vec<String> =
        effect.rivals.iter().map(|rival| effect_at(&rival.id, &rival.place)).collect();
    let of_class = effect.class.iter().filter(|id| **id != effect.id);
    others
        .extend(of_class.filter(|id| effect.rivals.iter().all(|rival| rival.id != **id)).map(|id| words(id)));
    // The same effect elsewhere is a rival too: then both places are said.
    let same = effect.rivals.iter().any(|rival| rival.id == effect.id);
    let this = if same { effect_at(&effect.id, &effect.place) } else { words(&effect.id) };
    (!others.is_empty()).then(|| format!("Cannot tell {this} from {} on these takes.", others.join(" or ")))
}

/// A part of the data on one line: `fsr: index.0, index.1; onset; take-01, take-03`.
pub fn cell(cell: &Cell) -> String {
    let channels = match cell.channels.as_slice() {
        [a, b, c, rest @ ..] if rest.len() > 1 => format!("{a}, {b}, {c} and {} more", rest.len()),
        few => few.join(", "),
    };
    let head = match (&cell.stream, channels.is_empty()) {
        (Some(stream), false) => format!("{stream}: {channels}"),
        (Some(stream), true) => stream.clone(),
        (None, _) => channels,
    };
    let joints = (!cell.joints.is_empty()).then(|| format!("with motion of {}", cell.joints.join(", ")));
    let takes = match cell.takes.len() {
        0 => None,
        1..=3 => Some(cell.takes.join(", ")),
        count => Some(format!("{count} takes")),
    };
    let parts = [Some(head).filter(|head| !head.is_empty()), Some(words(&cell.phase)), joints, takes];
    parts.into_iter().flatten().collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::{Bar, Gap, Rival, Unexplained, Verdict};

    fn latency() -> NamedEffect {
        NamedEffect {
            id: "latency".into(),
            place: Place::Stream("fsr".into()),
            parameters: BTreeMap::from([("delay_s".into(), 0.0618)]),
            interval: BTreeMap::from([("delay_s".into(), [0.0521, 0.0704])]),
            gap_before: 0.5,
            gap_after: 0.3,
            p_value: Some(0.0001),
            evidence: 80.0,
            takes_improved: "8/9".into(),
            class: vec!["latency".into()],
            rivals: Vec::new(),
            explanation: "The FSR stream arrives 62 ms late.".into(),
        }
    }

    fn report() -> DiagnosisReport {
        let gap = || Gap { nominal: 1.0, calibrated: 0.5, diagnosed: 0.3, noise_floor: None };
        DiagnosisReport {
            verdict: Verdict::Explained,
            sentence: String::new(),
            effects: Vec::new(),
            in_doubt: Vec::new(),
            fitted: Gap::default(),
            candidates: Vec::new(),
            cells: Vec::new(),
            gap: gap(),
            held_out: gap(),
            waterfall: Vec::new(),
            metrics: BTreeMap::new(),
            unexplained: Unexplained::default(),
            next_experiment: None,
            residual_map: Vec::new(),
            takes: BTreeMap::new(),
            bar: Bar::default(),
            reference_sessions: None,
            notes: Vec::new(),
            seconds: 1.0,
        }
    }

    #[test]
    fn one_thing_is_singular() {
        assert_eq!([0, 1, 2].map(|count| counted(count, "gap")), ["0 gaps", "1 gap", "2 gaps"]);
    }

    #[test]
    fn named_effect_reads_as_an_operator_would_say_it() {
        let said = effect_sentences(&latency(), &report());
        let expected = "The FSR stream arrives 62 ms late (52.1 to 70.4 ms). 8 of 9 takes agree. \
            Adding it removes 40 % of the gap.";
        assert_eq!(said, expected);
        let useless = NamedEffect { gap_after: 0.6, ..latency() };
        assert!(effect_sentences(&useless, &report()).contains("does not lower the gap"));
    }

    #[test]
    fn rivals_are_named_with_their_places() {
        assert_eq!(rivals_sentence(&latency()), None);
        let rival = Rival { id: "joint_backlash".into(), place: Place::Joint("3".into()), gap_after: 0.31 };
        let elsewhere = Rival { id: "latency".into(), place: Place::Stream("gel".into()), gap_after: 0.31 };
        let twice = NamedEffect { rivals: vec![elsewhere], ..latency() };
        let said = rivals_sentence(&twice).expect("a rival");
        assert_eq!(said, "Cannot tell latency, stream fsr from latency, stream gel on these takes.");
        let effect = NamedEffect {
            class: vec!["latency".into(), "joint_backlash".into(), "low_pass".into()],
            rivals: vec![rival],
            ..latency()
        };
        let said = rivals_sentence(&effect).expect("rivals");
        assert_eq!(said, "Cannot tell latency from joint backlash, joint 3 or low pass on these takes.");
    }

    #[test]
    fn quantities_carry_the_unit_of_their_name() {
        assert_eq!(quantity("delay_s", 0.0618), "61.8 ms");
        assert_eq!(quantity("offset_rad", -0.008), "\u{2212}8.00 mrad");
        assert_eq!(quantity("rate_per_s", 12.0), "12.0 /s");
        assert_eq!(quantity("fraction", 0.25), "0.25");
        assert_eq!(
            [409.4, 42.24, 0.357, 0.0361, 0.00584].map(number),
            ["409", "42.2", "0.36", "0.036", "0.0058"]
        );
        assert_eq!(quantity("x_m", 0.0005), "0.50 mm");
        assert_eq!(parameter_name("rate_per_s"), "rate");
        assert_eq!(parameter_name("off_fraction"), "off fraction");
    }
}
