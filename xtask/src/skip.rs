//! Tests that are left out because `PALPATE_SKIP` names the tool that they need: `e2e`, `browser`, `slurm`, `mujoco`, with
//! commas between. Without it a test whose tool is missing fails.

use std::{collections::BTreeMap, path::Path};

const TOOLS: [&str; 4] = ["e2e", "browser", "slurm", "mujoco"];

/// The tools that `PALPATE_SKIP` names.
fn named() -> Vec<String> {
    let skip = std::env::var("PALPATE_SKIP").unwrap_or_default();
    skip.split([',', ' ']).filter(|word| !word.is_empty()).map(str::to_owned).collect()
}

/// Refuses names of no tool.
pub(crate) fn check() -> anyhow::Result<()> {
    for name in named() {
        anyhow::ensure!(
            TOOLS.contains(&name.as_str()),
            "PALPATE_SKIP names {name:?}, expected some of {TOOLS:?}"
        );
    }
    Ok(())
}

/// Whether what needs `tool` is left out.
pub(crate) fn names(tool: &str) -> bool {
    named().iter().any(|name| name == tool)
}

/// Says how many tests were left out for which tool, as `list` has them.
pub(crate) fn report(list: &Path) {
    let text = std::fs::read_to_string(list).unwrap_or_default();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for line in text.lines() {
        *counts.entry(line.split(' ').next().unwrap_or(line)).or_default() += 1;
    }
    let each: Vec<String> = counts.iter().map(|(tool, count)| format!("{count} need {tool}")).collect();
    match text.lines().count() {
        0 => eprintln!("no test was left out"),
        total => eprintln!("{total} tests were left out, as PALPATE_SKIP says: {}", each.join(", ")),
    }
}
