//! What a pipeline found, as one HTML file without any reference outside itself, as lines for people and as a document.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use base64::Engine as _;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use palpate_cloning::{METRICS_FILE, POLICY_FILE};
use serde::Deserialize;
use serde_json::{Value, json};

use super::config::{EvaluationConfig, PipelineConfig};
use super::manifest::Manifest;
use super::stages::{EXPERT, Training, comparison, encoder_dir, pictures, trainings};
use super::tables::{self, GROUPS, Kind, Line, Trials};
use crate::files;

/// What the paper reports of its best policy in simulation, percent: seen, unseen and all objects.
const PAPER_PERCENT: [f64; 3] = [60.4, 43.2, 51.8];
/// Name of the protocol that the paper's trials are of.
const PAPER_PROTOCOL: &str = "paper";
const COLOURS: [&str; 6] = ["#1565c0", "#ef6c00", "#2e7d32", "#8e24aa", "#00838f", "#c62828"];
/// Size of the picture of curves, and its margins left, top, right and bottom.
const PICTURE: [f64; 2] = [640.0, 260.0];
const MARGIN: [f64; 4] = [56.0, 12.0, 140.0, 32.0];

/// Everything that is told.
pub(super) struct Report<'a> {
    manifest: &'a Manifest,
    /// The first policy, relative to the pipeline's folder.
    policy: String,
    encoder: Option<Encoder>,
    curves: Vec<Curve>,
    evaluations: Vec<Evaluation>,
}

/// How one training went.
struct Curve {
    name: String,
    points: Vec<Point>,
}

/// A checkpoint of a training.
#[derive(Deserialize)]
struct Point {
    update: u64,
    train: f64,
    held_out: f64,
}

/// What came of a pretraining.
struct Encoder {
    /// The last checkpoint's line of metrics.
    last: EncoderPoint,
    /// Names of the policies that see its features.
    seen_by: Vec<String>,
}

/// A checkpoint of a pretraining.
#[derive(Deserialize)]
struct EncoderPoint {
    update: u64,
    /// Losses by name, before their weights, and their weighted sum `total`.
    held_out: BTreeMap<String, f64>,
}

/// How policies were scored under one protocol.
struct Evaluation {
    name: String,
    protocol: String,
    settings: Value,
    /// The policy first, then what it was compared with.
    arms: Vec<Arm>,
    /// What parts of policies are worth, where two policies of the paper differ in one.
    parts: Vec<Line>,
    pictures: Vec<Picture>,
}

/// Of a single trial.
struct Picture {
    /// Object, how it ended and who moved the hand.
    name: String,
    svg: Vec<u8>,
}

struct Arm {
    name: String,
    /// As the comparison's file has it.
    document: Value,
}

impl<'a> Report<'a> {
    /// Reads what the stages left in the folder `out`.
    pub(super) fn read(config: &PipelineConfig, manifest: &'a Manifest, out: &Path) -> anyhow::Result<Self> {
        let trainings = trainings(config, out);
        let curves = trainings.iter().map(Curve::read).collect::<anyhow::Result<_>>()?;
        let encoder = match &config.encoder {
            Some(_) => Some(Encoder::read(&trainings, out)?),
            None => None,
        };
        let read = |evaluation| Evaluation::read(evaluation, &trainings, out);
        let evaluations = config.evaluations.iter().map(read).collect::<anyhow::Result<_>>()?;
        let first = trainings.first().map(|training| training.folder.join(POLICY_FILE));
        let first = first.as_deref().and_then(|path| path.strip_prefix(out).ok());
        let policy = first.map(files::shown).unwrap_or_default();
        Ok(Self { manifest, policy, encoder, curves, evaluations })
    }

    /// In a few lines.
    pub(super) fn summary(&self) -> String {
        let line = |evaluation: &Evaluation| {
            let arms = evaluation.arms.iter().filter_map(|arm| {
                let (won, of) = arm.counts("overall")?;
                Some(format!("{} {won} of {of}", arm.name))
            });
            format!("{}: {}", evaluation.name, arms.collect::<Vec<_>>().join(", "))
        };
        self.evaluations.iter().map(line).collect::<Vec<_>>().join("\n")
    }

    /// As JSON: won and tried by evaluation, arm and group of objects, what parts of policies are worth by evaluation,
    /// the first policy's file, seconds by stage, and the encoder's held-out losses if there is one.
    pub(super) fn document(&self) -> Value {
        let of_arm = |arm: &Arm| {
            let groups = GROUPS.iter().filter_map(|group| {
                let (won, of) = arm.counts(group)?;
                Some(((*group).to_owned(), json!({"successes": won, "trials": of})))
            });
            (arm.name.clone(), groups.collect::<serde_json::Map<_, _>>().into())
        };
        let of_evaluation = |evaluation: &Evaluation| {
            let arms: serde_json::Map<String, Value> = evaluation.arms.iter().map(of_arm).collect();
            (evaluation.name.clone(), arms.into())
        };
        let parts_of = |evaluation: &Evaluation| (evaluation.name.clone(), json!(evaluation.parts));
        let seconds = self.manifest.stages.iter().map(|(name, record)| (name.clone(), json!(record.seconds)));
        json!({
            "policy": self.policy,
            "evaluations": self.evaluations.iter().map(of_evaluation).collect::<serde_json::Map<_, _>>(),
            "parts": self.evaluations.iter().map(parts_of).collect::<serde_json::Map<_, _>>(),
            "stage_seconds": seconds.collect::<serde_json::Map<_, _>>(),
            "encoder": self.encoder.as_ref().map(Encoder::document),
        })
    }

    /// As a page.
    pub(super) fn html(&self) -> String {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    title { "From sensor model to scored policies" }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    main {
                        h1 { "From sensor model to scored policies" }
                        @for evaluation in &self.evaluations { (evaluation.section()) }
                        @if let Some(encoder) = &self.encoder { (encoder.section()) }
                        h2 { "How policies learned" }
                        p { "Mean squared error (of actions, or of noise for diffusion), on a logarithmic scale: solid on held-out "
                            "trials, dotted on the trials that are learned from." }
                        (self.picture())
                        h2 { "Stages" }
                        div.wide { table {
                            thead { tr { th { "stage" } th { "minutes" } th { "command" } } }
                            tbody {
                                @for (name, record) in &self.manifest.stages {
                                    tr {
                                        td { (name) }
                                        td.number { (format!("{:.1}", record.seconds / 60.0)) }
                                        td { code { (record.command) } }
                                    }
                                }
                            }
                        } }
                        h2 { "What it was made with" }
                        p { "palpate-train " (self.manifest.software) ". Every file with its SHA-256 stands in "
                            code { "manifest.json" } " and in the files that it names." }
                        details { summary { "Configuration" } pre { (self.manifest.config) } }
                    }
                }
            }
        };
        page.into_string()
    }

    /// Learning curves as SVG.
    fn picture(&self) -> Markup {
        let points = || self.curves.iter().flat_map(|curve| &curve.points);
        let last = points().map(|point| point.update).max().unwrap_or(1).max(1) as f64;
        let losses = || points().flat_map(|point| [point.train, point.held_out]).filter(|loss| *loss > 0.0);
        let (low, high) =
            losses().fold((f64::INFINITY, 0.0_f64), |(low, high), loss| (low.min(loss), high.max(loss)));
        if low >= high {
            return html! { p { "Nothing was learned in this run." } };
        }
        let [width, height] = PICTURE;
        let [left, top, right, bottom] = MARGIN;
        let x = |update: u64| left + (width - left - right) * update as f64 / last;
        let y = |loss: f64| top + (height - top - bottom) * (high / loss).ln() / (high / low).ln();
        let line = |curve: &Curve, loss: fn(&Point) -> f64| {
            let places = curve.points.iter().filter(|point| loss(point) > 0.0);
            let places: Vec<String> =
                places.map(|point| format!("{:.1},{:.1}", x(point.update), y(loss(point)))).collect();
            places.join(" ")
        };
        let base = height - bottom;
        html! {
            svg viewBox=(format!("0 0 {width} {height}")) role="img" aria-label="Learning curves" {
                path.axis d=(format!("M{left} {top}V{base}H{}", width - right)) {}
                text x=(left - 6.0) y=(top + 10.0) text-anchor="end" { (format!("{high:.3}")) }
                text x=(left - 6.0) y=(base) text-anchor="end" { (format!("{low:.3}")) }
                text x=(width - right) y=(base + 18.0) text-anchor="end" { (format!("{last} updates")) }
                @for (idx, curve) in self.curves.iter().enumerate() {
                    @let colour = COLOURS[idx % COLOURS.len()];
                    polyline fill="none" stroke=(colour) stroke-width="1.5" points=(line(curve, |point| point.held_out)) {}
                    polyline fill="none" stroke=(colour) stroke-dasharray="2 3" points=(line(curve, |point| point.train)) {}
                    text x=(width - right + 8.0) y=(top + 12.0 + 16.0 * idx as f64) fill=(colour) { (curve.name) }
                }
            }
        }
    }
}

impl Encoder {
    fn read(trainings: &[Training<'_>], out: &Path) -> anyhow::Result<Self> {
        let path = encoder_dir(out).join(METRICS_FILE);
        let text = files::text(&path)?;
        let last = text.lines().last().with_context(|| format!("{path:?} has no line of metrics"))?;
        let last = serde_json::from_str(last)
            .with_context(|| format!("the last line of {path:?} is no line of metrics"))?;
        let mut seen_by = Vec::new();
        for training in trainings {
            if training.policy.clone_config()?.observation.features {
                seen_by.push(training.name());
            }
        }
        Ok(Self { last, seen_by })
    }

    fn document(&self) -> Value {
        json!({ "updates": self.last.update, "held_out": self.last.held_out, "seen_by": self.seen_by })
    }

    fn section(&self) -> Markup {
        html! {
            h2 { "Encoder" }
            p {
                "Pretrained on the trials that policies learn from, " (self.last.update) " updates. Its features are seen by "
                (self.seen_by.join(", ")) ". Held-out losses before their weights, and their weighted sum (total):"
            }
            div.wide { table {
                thead { tr { @for name in self.last.held_out.keys() { th { (name) } } } }
                tbody { tr {
                    @for loss in self.last.held_out.values() { td.number { (format!("{loss:.4}")) } }
                } }
            } }
        }
    }
}

impl Curve {
    fn read(training: &Training<'_>) -> anyhow::Result<Self> {
        let path = training.folder.join("metrics.jsonl");
        let points = files::text(&path)?
            .lines()
            .enumerate()
            .map(|(idx, line)| {
                serde_json::from_str(line)
                    .with_context(|| format!("{}:{} is no line of metrics", path.display(), idx + 1))
            })
            .collect::<anyhow::Result<_>>()?;
        Ok(Self { name: training.name(), points })
    }
}

impl Evaluation {
    fn read(evaluation: &EvaluationConfig, trainings: &[Training<'_>], out: &Path) -> anyhow::Result<Self> {
        let path = comparison(out, evaluation);
        let document: Value = serde_json::from_str(&files::text(&path)?)
            .with_context(|| format!("{path:?} is no comparison of palpate-train evaluate"))?;
        let first = trainings.first().map(Training::name).unwrap_or_default();
        let controls = document["controls"].as_object().into_iter().flatten();
        let mut arms: Vec<Arm> = controls
            .map(|(name, document)| {
                let training =
                    trainings.iter().find(|training| training.as_policy().to_string_lossy() == *name);
                let name = match training {
                    Some(training) => training.name(),
                    None => control_name(name, &first),
                };
                Arm { name, document: document.clone() }
            })
            .collect();
        // In the order of the configuration, then the controls.
        let order: Vec<String> = trainings.iter().map(Training::name).collect();
        arms.sort_by_key(|arm| order.iter().position(|name| *name == arm.name).unwrap_or(order.len()));
        let (protocol, settings) =
            (document["protocol"].as_str().unwrap_or_default().to_owned(), document["settings"].clone());
        arms.insert(0, Arm { name: first, document });
        let parts = Self::parts(evaluation, trainings, &arms)?;
        let pictures = Picture::all_in(&pictures(out, evaluation))?;
        Ok(Self { name: evaluation.name(), protocol, settings, arms, parts, pictures })
    }

    /// What parts of the paper's policies among `trainings` are worth in `evaluation`, whose arms are `arms`.
    fn parts(
        evaluation: &EvaluationConfig,
        trainings: &[Training<'_>],
        arms: &[Arm],
    ) -> anyhow::Result<Vec<Line>> {
        let mut trials = Vec::new();
        for training in trainings.iter().filter(|training| training.round == 0) {
            let arm = arms.iter().find(|arm| arm.name == training.name());
            if let (Some(policy), Some(arm)) = (training.policy.policy, arm) {
                let kind =
                    Kind { policy, sees_strengths: training.policy.clone_config()?.observation.strengths };
                trials.push(Trials::of_arm(kind, training.seed, &arm.document)?);
            }
        }
        let mut objects = Vec::new();
        for name in files::objects(&evaluation.objects)? {
            let object = files::object(&name, &files::Sources::default())?;
            objects.push((object.id, object.group));
        }
        tables::lines(&trials, &objects)
    }

    fn section(&self) -> Markup {
        let first = self.arms.first();
        let groups: Vec<&str> =
            GROUPS.into_iter().filter(|group| first.is_some_and(|arm| arm.counts(group).is_some())).collect();
        let half_width_cm = 100.0 * self.settings["half_width_m"].as_f64().unwrap_or_default();
        let episode_s = self.settings["episode_s"].as_f64().unwrap_or_default();
        html! {
            h2 { "Evaluation " (self.name) }
            p {
                "Objects start within ±" (half_width_cm) " cm, episodes last " (episode_s) " s, all on the same starts. "
                "Won of tried, in brackets the 95 % interval (Wilson). The last column compares on the same starts with the "
                "first row: won by the first alone, by this one alone, McNemar's exact p."
            }
            div.wide { table {
                thead { tr {
                    th { "policy" }
                    @for group in &groups { th { (group) } }
                    th { "empty, slip, stop" } th { "s" } th { "against the first" }
                } }
                tbody {
                    @for arm in &self.arms {
                        tr {
                            td { (arm.name) }
                            @for group in &groups { td { (arm.share(group)) } }
                            td { (arm.failures()) }
                            td.number { (arm.seconds()) }
                            td { (arm.pairs()) }
                        }
                    }
                    @if self.protocol == PAPER_PROTOCOL && groups.len() == PAPER_PERCENT.len() {
                        tr.apart {
                            td { "the paper's best policy (its own simulator and objects)" }
                            @for percent in PAPER_PERCENT { td { (percent) " %" } }
                            td {} td {} td {}
                        }
                    }
                }
            } }
            (tables::section(&self.parts))
            @if let Some(first) = first {
                details {
                    summary { "Object by object: won of tried, in brackets empty grasps, slips and emergency stops" }
                    div.wide { table {
                        thead { tr { th { "object" } @for arm in &self.arms { th { (arm.name) } } } }
                        tbody {
                            @for object in first.objects() {
                                tr {
                                    td { (object) }
                                    @for arm in &self.arms { td { (arm.of_object(&object)) } }
                                }
                            }
                        }
                    } }
                }
            }
            @if !self.pictures.is_empty() {
                details {
                    summary { "Single trials: where the hand searched, what it felt, what the expert believed" }
                    @for picture in &self.pictures { (picture.shown()) }
                }
            }
        }
    }
}

impl Picture {
    /// The pictures in a folder, by name.
    fn all_in(folder: &Path) -> anyhow::Result<Vec<Self>> {
        let failed = || format!("failed to read {folder:?}");
        let mut pictures = Vec::new();
        for entry in std::fs::read_dir(folder).with_context(failed)? {
            let path = entry.with_context(failed)?.path();
            let name = path.file_stem().unwrap_or_default().to_string_lossy().replace('_', " ");
            let svg = std::fs::read(&path).with_context(|| format!("failed to read {path:?}"))?;
            pictures.push(Self { name, svg });
        }
        pictures.sort_by(|one, other| one.name.cmp(&other.name));
        Ok(pictures)
    }

    /// The picture inside the page.
    fn shown(&self) -> Markup {
        let encoded = base64::engine::general_purpose::STANDARD.encode(&self.svg);
        html! { p { img alt=(self.name) loading="lazy" src=(format!("data:image/svg+xml;base64,{encoded}")) {} } }
    }
}

/// What a control is called, where the policy is `policy`.
fn control_name(name: &str, policy: &str) -> String {
    match name {
        EXPERT => "searching expert".to_owned(),
        "script" => "closing script".to_owned(),
        "repetition" => "blind repetition".to_owned(),
        "oracle" => "told the place (oracle)".to_owned(),
        "silenced" => format!("{policy}, silenced"),
        "tracking_hidden" => format!("{policy}, tracking errors hidden"),
        "clock_only" => format!("{policy}, both hidden"),
        other => other.to_owned(),
    }
}

impl Arm {
    /// Won and tried on a group of objects.
    fn counts(&self, group: &str) -> Option<(u64, u64)> {
        counts(&self.document[group])
    }

    fn share(&self, group: &str) -> String {
        let interval = |side: usize| self.document[group]["interval_95"][side].as_f64();
        let (Some((won, of)), Some(low), Some(high)) = (self.counts(group), interval(0), interval(1)) else {
            return "-".to_owned();
        };
        format!("{won} of {of} ({low:.2} to {high:.2})")
    }

    fn failures(&self) -> String {
        failures(&self.document["overall"])
    }

    /// Mean time to success.
    fn seconds(&self) -> String {
        self.document["mean_seconds"].as_f64().map_or_else(|| "-".to_owned(), |mean_s| format!("{mean_s:.1}"))
    }

    fn pairs(&self) -> String {
        let paired = &self.document["paired"]["overall"];
        let (Some(first), Some(other), Some(p_value)) =
            (paired["only_policy"].as_u64(), paired["only_control"].as_u64(), paired["p_value"].as_f64())
        else {
            return String::new();
        };
        format!("{first} and {other}, p {p_value:.2e}")
    }

    fn objects(&self) -> Vec<String> {
        let objects = self.document["objects"].as_object().into_iter().flatten();
        objects.map(|(name, _)| name.clone()).collect()
    }

    fn of_object(&self, object: &str) -> String {
        let document = &self.document["objects"][object];
        let found = counts(document);
        found.map_or_else(|| "-".to_owned(), |(won, of)| format!("{won} of {of} ({})", failures(document)))
    }
}

/// Empty grasps, slips and emergency stops.
fn failures(document: &Value) -> String {
    let number = |name: &str| document[name].as_u64().unwrap_or_default();
    format!("{}, {}, {}", number("empty_grasp"), number("slip"), number("emergency_stop"))
}

fn counts(document: &Value) -> Option<(u64, u64)> {
    Some((document["successes"].as_u64()?, document["trials"].as_u64()?))
}

const STYLE: &str = ":root{color-scheme:light dark;--line:#8886;--faint:#8882}\
    body{font:15px/1.5 system-ui,sans-serif;margin:0}main{max-width:70rem;margin:auto;padding:1rem}\
    h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}.wide{overflow-x:auto}\
    table{border-collapse:collapse}th,td{padding:.25rem .7rem;text-align:left;border-bottom:1px solid var(--line);\
    vertical-align:top;font-variant-numeric:tabular-nums}td.number{text-align:right}tr.apart td{background:var(--faint)}\
    code,pre{font-size:.85em;overflow-wrap:anywhere}img{max-width:100%;background:#fff}svg{max-width:44rem;width:100%}svg text{font-size:11px;fill:currentColor}\
    svg .axis{fill:none;stroke:currentColor;opacity:.5}";
