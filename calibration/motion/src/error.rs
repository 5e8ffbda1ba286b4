//! What can be wrong with a plan, and checks of its numbers.

/// A plan or primitive that cannot be used, or a take for which no motion was found: where, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {place}: {problem}")]
pub struct PlanError {
    /// Which file.
    pub file: String,
    /// Where in it: a line, a section, `take 3`.
    pub place: String,
    /// What is wrong and what to do.
    pub problem: String,
}

impl PlanError {
    /// An error at `place` in `file`.
    pub fn new(file: impl Into<String>, place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { file: file.into(), place: place.into(), problem: problem.into() }
    }
}

/// The TOML `text` as `T`; what is wrong with it comes with its line.
pub(crate) fn parse<T: serde::de::DeserializeOwned>(file: &str, text: &str) -> Result<T, PlanError> {
    toml::from_str(text).map_err(|error| {
        let place = error.span().map_or_else(
            || "file".to_owned(),
            |span| {
                format!("line {}", 1 + text.bytes().take(span.start).filter(|&byte| byte == b'\n').count())
            },
        );
        PlanError::new(file, place, error.message())
    })
}

/// Refuses the first of `values` that is not a positive number, as `(place, problem)`.
pub(crate) fn positive(place: &str, values: &[(&str, f64)]) -> Result<(), (String, String)> {
    match values.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
        Some((name, value)) => Err((place.into(), format!("{name} = {value} must be a positive number"))),
        None => Ok(()),
    }
}

/// Refuses the first of `values` that is negative or not finite, as `(place, problem)`.
pub(crate) fn not_negative(place: &str, values: &[(&str, f64)]) -> Result<(), (String, String)> {
    match values.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
        Some((name, value)) => Err((place.into(), format!("{name} = {value} must not be negative"))),
        None => Ok(()),
    }
}
