//! Tests that are left out because `PALPATE_SKIP` names the tool that they need: `e2e`, `browser`, `slurm`, with commas
//! between. A test asks [`leaves_out`] first; where nothing is left out and its tool is missing, it fails.

use std::{fs::OpenOptions, io::Write as _};

/// Whether the test that asks is left out because `PALPATE_SKIP` names `tool`. It is noted then in the file that
/// `PALPATE_SKIPPED` names, so that `cargo xtask test` says how many tests were left out.
///
/// # Panics
/// If it cannot be noted: nobody would know that the test was left out.
pub fn leaves_out(tool: &str) -> bool {
    let is_named = std::env::var("PALPATE_SKIP").is_ok_and(|skip| names(&skip, tool));
    if let Some(list) = std::env::var_os("PALPATE_SKIPPED").filter(|_| is_named) {
        let test = std::thread::current().name().unwrap_or("a test").to_owned();
        let file = OpenOptions::new().append(true).create(true).open(&list);
        let noted = file.and_then(|mut file| file.write_all(format!("{tool} {test}\n").as_bytes()));
        noted.unwrap_or_else(|err| {
            panic!("failed to write to the list of tests that are left out, {list:?}: {err}")
        });
    }
    is_named
}

fn names(skip: &str, tool: &str) -> bool {
    skip.split([',', ' ']).any(|word| word == tool)
}

#[cfg(test)]
mod tests {
    use super::names;

    #[test]
    fn tools_are_named_between_commas_or_blanks() {
        assert!(names("slurm,browser", "browser") && names("slurm, e2e", "e2e") && names("e2e", "e2e"));
        assert!(!names("", "e2e") && !names("browsers", "browser") && !names("slurm,e2e", "browser"));
    }
}
