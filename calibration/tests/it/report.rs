//! The HTML report.

use palpate_calibration::{
    CalibrationConfig, CalibrationOutcome, calibrate,
    report::{ReportSource, headline, html},
};
use palpate_sim::job::{Cancel, NoProgress};

use crate::synthetic::{self, Size};

const SOURCE: ReportSource<'static> =
    ReportSource { session: "bench <1>", station: "made-up & small", created: "2026-11-21T08:00:00Z" };

fn outcome(size: Size, num_alphas: usize) -> CalibrationOutcome {
    let layout = synthetic::layout(size);
    let takes = synthetic::takes(size, &layout, 3);
    let config = CalibrationConfig { num_alphas, bootstrap_resamples: 100, ..CalibrationConfig::default() };
    calibrate(&config, &layout, &crate::nominal(), &takes, &NoProgress, &Cancel::default(), &|| 0.25)
        .expect("a sound session")
}

const TINY: Size =
    Size { pads: 1, taxels_per_pad: 2, nodes_per_side: 3, patches: 1, takes: 4, frames_per_take: 80 };

#[test]
fn tiny_report_looks_like_this() {
    // Pictures have hundreds of cells and points; their text parts and everything else are kept.
    let page = html(SOURCE, &outcome(TINY, 3)).replace("><", ">\n<");
    let kept = page.lines().filter(|line| !line.starts_with("<rect") && line.len() < 800);
    let style_end = page.find("</style>").expect("a style");
    let kept: String = kept.skip(page[..style_end].lines().count()).flat_map(|line| [line, "\n"]).collect();
    insta::assert_snapshot!(kept);
}

#[test]
fn json_report_looks_like_this() {
    let mut report = outcome(TINY, 3).report;
    // The pictures are long and covered elsewhere.
    report.objective.lambda_pres_pa.clear();
    report.objective.pressure_l1.clear();
    report.objective.lambda_cons_m.clear();
    report.objective.proximity_l1.clear();
    insta::with_settings!({sort_maps => true}, { insta::assert_json_snapshot!(report) });
}

#[test]
fn report_refers_to_nothing_outside_itself() {
    let page = html(SOURCE, &outcome(crate::SMALL, 20));
    for outside in ["http:", "https:", "src=", "href=", "url(", "@import", "<script"] {
        assert!(!page.contains(outside), "{outside}");
    }
}

#[test]
fn texts_are_escaped() {
    let page = html(SOURCE, &outcome(TINY, 3));
    assert!(page.contains("bench &lt;1&gt;") && page.contains("made-up &amp; small"));
    assert!(page.contains("pad &lt;&amp;&gt; &quot;pad&quot;"));
    assert!(!page.contains("<1>") && !page.contains("<&>"));
}

#[test]
fn report_of_a_session_as_large_as_the_papers_stays_small() {
    let page = html(SOURCE, &outcome(Size::PAPER, 20));
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
}

#[test]
fn headline_is_about_unseen_takes() {
    let line = headline(&outcome(TINY, 3).report);
    assert!(
        line.starts_with("Calibrated: onset error ") && line.ends_with("on takes it has not seen."),
        "{line}"
    );
}
