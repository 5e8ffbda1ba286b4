//! Configurations as files that are refused by line and field.

use serde::de::DeserializeOwned;

use crate::TrainingError;

/// Where a field stands and what it may be.
#[derive(Clone, Debug)]
pub struct Expectation {
    /// Keys down to the field.
    pub path: &'static [&'static str],
    /// What it is.
    pub value: String,
    /// Whether that makes sense.
    pub holds: bool,
    /// What would.
    pub expected: &'static str,
}

impl Expectation {
    /// A count of one or more.
    pub fn count(path: &'static [&'static str], value: u64) -> Self {
        Self { path, value: value.to_string(), holds: value >= 1, expected: "1 or more" }
    }

    /// A number from 0 to 1.
    pub fn share(path: &'static [&'static str], value: f64) -> Self {
        let holds = (0.0..=1.0).contains(&value);
        Self { path, value: value.to_string(), holds, expected: "a number in 0..=1" }
    }

    /// A finite number above 0.
    pub fn positive(path: &'static [&'static str], value: f64) -> Self {
        let holds = value > 0.0 && value.is_finite();
        Self { path, value: value.to_string(), holds, expected: "a number above 0" }
    }

    /// A finite number that is not negative.
    pub fn not_negative(path: &'static [&'static str], value: f64) -> Self {
        let holds = value >= 0.0 && value.is_finite();
        Self { path, value: value.to_string(), holds, expected: "0 or more" }
    }
}

/// Reads `text`; `file` names it in errors.
///
/// # Errors
/// Unknown fields and wrong types, with their line.
pub fn parse<C: DeserializeOwned>(file: &str, text: &str) -> Result<C, TrainingError> {
    toml::from_str(text).map_err(|err| TrainingError::Config {
        file: file.to_owned(),
        line: err.span().map(|span| line_of(text, span.start)),
        problem: err.message().to_owned(),
    })
}

/// Whether all `expectations` of a configuration with this `text` hold.
///
/// # Errors
/// The first that does not, with the line of its field if `text` has it.
pub fn check(file: &str, text: &str, expectations: Vec<Expectation>) -> Result<(), TrainingError> {
    let Some(broken) = expectations.into_iter().find(|expectation| !expectation.holds) else {
        return Ok(());
    };
    Err(TrainingError::Config {
        file: file.to_owned(),
        line: line_of_field(text, broken.path),
        problem: format!("{} is {}, expected {}", broken.path.join("."), broken.value, broken.expected),
    })
}

/// Line of the byte at `offset`, from 1.
fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

/// Line of the field at `path`, if `text` has it.
fn line_of_field(text: &str, path: &[&str]) -> Option<usize> {
    let document = toml::de::DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let (field, tables) = path.split_last()?;
    for name in tables {
        table = table.get(*name)?.get_ref().as_table()?;
    }
    Some(line_of(text, table.get(*field)?.span().start))
}
