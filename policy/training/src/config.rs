//! Configurations as files that are refused by line and field.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

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

/// The first field in which two configurations differ, by its keys with dots between them: its name, its value in `left` and
/// that in `right`.
pub fn difference<C: Serialize>(left: &C, right: &C) -> Option<(String, String, String)> {
    // JSON and not TOML, whose integers do not reach as far as a seed does.
    let value = |config: &C| serde_json::to_value(config).expect("fields have names");
    first_difference("", &value(left), &value(right))
}

fn first_difference(path: &str, left: &Value, right: &Value) -> Option<(String, String, String)> {
    match (left, right) {
        (Value::Object(left), Value::Object(right)) => {
            // Fields that are left out of either count as null.
            let added = right.keys().filter(|field| !left.contains_key(*field));
            left.keys().chain(added).find_map(|field| {
                let path = if path.is_empty() { field.clone() } else { format!("{path}.{field}") };
                let of =
                    |side: &serde_json::Map<String, Value>| side.get(field).cloned().unwrap_or(Value::Null);
                first_difference(&path, &of(left), &of(right))
            })
        }
        _ => (left != right).then(|| (path.to_owned(), left.to_string(), right.to_string())),
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Serialize)]
    struct Config {
        seed: u64,
        network: Network,
    }

    #[derive(Clone, Serialize)]
    struct Network {
        widths: Vec<usize>,
        dropout: Option<f64>,
    }

    #[test]
    fn configurations_differ_by_field_however_large_their_numbers_are() {
        let left = Config { seed: u64::MAX, network: Network { widths: vec![8, 4], dropout: None } };
        assert_eq!(difference(&left, &left), None);
        let told =
            |right: &Config| difference(&left, right).map(|(field, a, b)| format!("{field}: {a}, {b}"));
        let right = Config { seed: u64::MAX - 1, ..left.clone() };
        assert_eq!(told(&right).as_deref(), Some("seed: 18446744073709551615, 18446744073709551614"));
        let mut right = left.clone();
        right.network.widths = vec![8];
        assert_eq!(told(&right).as_deref(), Some("network.widths: [8,4], [8]"));
        right = left.clone();
        right.network.dropout = Some(0.5);
        assert_eq!(told(&right).as_deref(), Some("network.dropout: null, 0.5"));
    }
}
