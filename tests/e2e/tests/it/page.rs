//! The page in a real browser.

use std::process::Command;

use e2e::{Studio, Tools, demo_session};

#[test]
fn operator_calibrates_by_clicking() {
    let Some(tools) = Tools::find() else { return };
    let data = demo_session(&tools).unwrap();
    let studio = Studio::start(&tools, &data).unwrap();
    let status = Command::new("node")
        .arg("studio.mjs")
        .arg(&studio.url)
        .arg(&tools.artifacts)
        .current_dir(&tools.browser_tests)
        .status()
        .unwrap();
    assert!(status.success(), "the browser test failed; see {:?}", tools.artifacts);
}
