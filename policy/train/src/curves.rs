//! Learning curves: kept small beside a policy, and drawn.

use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_ppo::{METRICS_FILE, Metrics};
use serde::{Deserialize, Serialize};

use crate::files::{self, write_in_one_move};
use crate::ppo::START_HALF_WIDTH;

/// Beside a policy's file.
const EXTENSION: &str = "jsonl";

#[derive(clap::Args)]
pub(crate) struct CurvesArgs {
    /// Folder of policies, each with its learning curve beside it
    #[arg(long, default_value = "assets/policies")]
    policies: PathBuf,
    /// Picture to write (SVG)
    #[arg(long)]
    out: PathBuf,
}

/// An update of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Point {
    /// Steps so far, of all environments.
    steps: u64,
    /// Episodes that ended so far.
    episodes: u64,
    /// Share of those that ended in the update; nothing if none did.
    success_rate: Option<f64>,
    /// Half the edge length of the square that objects started in, m.
    start_half_width_m: f64,
}

/// Writes the curve of the training in `folder` beside the policy at `policy`.
pub(crate) fn export(folder: &Path, policy: &Path) -> anyhow::Result<()> {
    let path = folder.join(METRICS_FILE);
    let metrics: Vec<Metrics> = lines(&path)?;
    let mut text = String::new();
    for metrics in metrics {
        let point = Point {
            steps: metrics.steps,
            episodes: metrics.episodes,
            success_rate: metrics.success_rate,
            start_half_width_m: *metrics
                .environment
                .get(START_HALF_WIDTH)
                .with_context(|| format!("{path:?} does not say {START_HALF_WIDTH}"))?,
        };
        text.push_str(&serde_json::to_string(&point)?);
        text.push('\n');
    }
    write_in_one_move(&policy.with_extension(EXTENSION), text.as_bytes())
}

pub(crate) fn run(args: &CurvesArgs) -> anyhow::Result<()> {
    let folder = &args.policies;
    let entries = std::fs::read_dir(folder).with_context(|| format!("failed to read {folder:?}"))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == EXTENSION));
    paths.sort();
    if paths.is_empty() {
        bail!("{folder:?} holds no learning curve (*.{EXTENSION}); `palpate-train export` writes them");
    }
    let curve = |path: &PathBuf| -> anyhow::Result<(String, Vec<Point>)> {
        let name = path.file_stem().map(|name| name.to_string_lossy().replace('_', " ")).unwrap_or_default();
        Ok((name, lines(path)?))
    };
    let curves = paths.iter().map(curve).collect::<anyhow::Result<Vec<_>>>()?;
    let mut picture = String::new();
    draw(&mut picture, &curves)?;
    write_in_one_move(&args.out, picture.as_bytes())
}

/// A value for each line of JSON.
fn lines<T: serde::de::DeserializeOwned>(path: &Path) -> anyhow::Result<Vec<T>> {
    let parse = |(idx, line)| {
        serde_json::from_str(line)
            .with_context(|| format!("{}:{} is no line of metrics", path.display(), idx + 1))
    };
    files::text(path)?.lines().enumerate().map(parse).collect()
}

const COLUMNS: usize = 5;
const PANEL: [f64; 2] = [180.0, 110.0];
const GAP: [f64; 2] = [24.0, 44.0];
const MARGIN: [f64; 4] = [44.0, 60.0, 40.0, 30.0];
/// A rate is that of at least so many episodes.
const WINDOW: u64 = 100;

/// Draws a panel for each of `curves`, all on the same axes.
fn draw(svg: &mut String, curves: &[(String, Vec<Point>)]) -> fmt::Result {
    let points = || curves.iter().flat_map(|(_, points)| points);
    let most_steps = points().map(|point| point.steps).max().unwrap_or(1).max(1) as f64;
    let widest_m = points().map(|point| point.start_half_width_m).fold(f64::MIN_POSITIVE, f64::max);
    let columns = curves.len().min(COLUMNS);
    let rows = curves.len().div_ceil(COLUMNS);
    let extent = |axis: usize, count: usize| {
        MARGIN[axis] + MARGIN[axis + 2] + count as f64 * (PANEL[axis] + GAP[axis]) - GAP[axis]
    };
    let (width, height) = (extent(0, columns), extent(1, rows));
    writeln!(
        svg,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"11\" fill=\"#333\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n\
         <text x=\"{x}\" y=\"18\" fill=\"{RATE}\">share of episodes won (mean of {WINDOW}, noise of exploration included)\
         </text>\n<text x=\"{x}\" y=\"33\" fill=\"{START}\">half width of the region of starts, up to {:.0} cm</text>",
        100.0 * widest_m,
        x = MARGIN[0],
    )?;
    for (idx, (name, points)) in curves.iter().enumerate() {
        let left = MARGIN[0] + (idx % COLUMNS) as f64 * (PANEL[0] + GAP[0]);
        let top = MARGIN[1] + (idx / COLUMNS) as f64 * (PANEL[1] + GAP[1]);
        let (right, bottom) = (left + PANEL[0], top + PANEL[1]);
        let place = |(steps, share): (u64, f64)| {
            format!("{:.1} {:.1}", left + PANEL[0] * steps as f64 / most_steps, bottom - PANEL[1] * share)
        };
        let path = |values: Vec<(u64, f64)>| values.into_iter().map(place).collect::<Vec<_>>().join("L");
        writeln!(
            svg,
            "<path d=\"M{left} {top}V{bottom}H{right}\" fill=\"none\" stroke=\"#999\"/>\n\
             <path d=\"M{left} {top}H{right}M{left} {mid}H{right}\" stroke=\"#ddd\"/>\n\
             <text x=\"{left}\" y=\"{}\" font-weight=\"bold\">{}</text>\n\
             <text x=\"{left}\" y=\"{}\">0</text>\n\
             <text x=\"{right}\" y=\"{}\" text-anchor=\"end\">{:.0} k steps</text>",
            top - 6.0,
            escaped(name),
            bottom + 14.0,
            bottom + 14.0,
            1e-3 * most_steps,
            mid = 0.5 * (top + bottom),
        )?;
        if idx % COLUMNS == 0 {
            let x = left - 4.0;
            writeln!(
                svg,
                "<text x=\"{x}\" y=\"{}\" text-anchor=\"end\">100 %</text>\n\
                 <text x=\"{x}\" y=\"{}\" text-anchor=\"end\">0 %</text>",
                top + 4.0,
                bottom + 4.0
            )?;
        }
        let starts = points.iter().map(|point| (point.steps, point.start_half_width_m / widest_m)).collect();
        for (values, colour) in [(starts, START), (rates(points), RATE)] {
            let values: Vec<(u64, f64)> = values;
            if !values.is_empty() {
                writeln!(
                    svg,
                    "<path d=\"M{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>",
                    path(values)
                )?;
            }
        }
    }
    writeln!(svg, "</svg>")
}

/// `text` as the content of an XML element: names of files may hold `<` and `&`.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

const RATE: &str = "#1565c0";
const START: &str = "#ef6c00";

/// The share of episodes won over the newest [`WINDOW`] or a few more, from where there are as many.
fn rates(points: &[Point]) -> Vec<(u64, f64)> {
    let mut updates: std::collections::VecDeque<(u64, f64)> = std::collections::VecDeque::new();
    let mut before = 0;
    let mut rates = Vec::new();
    for point in points {
        let ended = point.episodes - before;
        before = point.episodes;
        updates.push_back((ended, ended as f64 * point.success_rate.unwrap_or(0.0)));
        let count =
            |updates: &std::collections::VecDeque<(u64, f64)>| updates.iter().map(|(n, _)| n).sum::<u64>();
        while updates.front().is_some_and(|(first, _)| count(&updates) - first >= WINDOW) {
            updates.pop_front();
        }
        let episodes = count(&updates);
        if episodes >= WINDOW {
            rates.push((point.steps, updates.iter().map(|(_, won)| won).sum::<f64>() / episodes as f64));
        }
    }
    rates
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(steps: u64, episodes: u64, success_rate: Option<f64>) -> Point {
        Point { steps, episodes, success_rate, start_half_width_m: 0.03 }
    }

    #[test]
    fn a_rate_is_that_of_the_newest_hundred_episodes_and_waits_for_them() {
        let points = [
            point(100, 60, Some(0.5)),
            point(200, 60, None),
            point(300, 120, Some(1.0)),
            point(400, 160, Some(0.25)),
        ];
        assert_eq!(rates(&points), [(300, 90.0 / 120.0), (400, 70.0 / 100.0)]);
    }

    #[test]
    fn a_name_is_text_and_no_markup() {
        let mut svg = String::new();
        draw(&mut svg, &[("cube <b> & co".to_owned(), vec![point(50, 3, None)])]).expect("a picture");
        assert!(svg.contains(">cube &lt;b&gt; &amp; co</text>") && !svg.contains("<b>"), "{svg}");
    }

    #[test]
    fn each_curve_has_its_panel_and_starts_that_stay_are_a_level_line() {
        let curve = (0..5).map(|i| point(100 * i, 100 * i, Some(1.0))).collect();
        let mut svg = String::new();
        draw(&mut svg, &[("big egg".to_owned(), curve), ("cube".to_owned(), vec![point(50, 3, None)])])
            .expect("a picture");
        assert!(svg.contains(">big egg<") && svg.contains(">cube<") && svg.contains("up to 3 cm"), "{svg}");
        // 400 steps are the full width, a rate of 1 and the widest start the full height.
        let top = MARGIN[1];
        assert!(
            svg.contains(&format!("L{:.1} {top:.1}\" fill=\"none\" stroke=\"{RATE}\"", MARGIN[0] + PANEL[0]))
        );
        assert_eq!(svg.matches(RATE).count(), 2, "the legend and one curve: the other has too few episodes");
    }
}
