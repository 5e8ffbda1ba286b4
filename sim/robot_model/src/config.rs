//! Reading TOML that people write: every complaint names the file and the line.

use std::{fmt::Display, ops::Range};

use serde::de::DeserializeOwned;

use crate::ModelError;

/// A TOML text and the name it goes by in errors.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) file: &'a str,
    pub(crate) text: &'a str,
}

impl Source<'_> {
    /// The text as `T`; unknown keys, wrong types and broken syntax are errors that name their line.
    pub(crate) fn parse<T: DeserializeOwned>(&self) -> Result<T, ModelError> {
        toml::from_str(self.text).map_err(|err| {
            let place = match err.span() {
                Some(span) => format!("line {}", self.line(span.start)),
                None => "whole file".to_owned(),
            };
            ModelError::new(self.file, place, err.message())
        })
    }

    /// An error about `what`, which the file describes at `span`.
    pub(crate) fn error(
        &self,
        span: Range<usize>,
        what: impl Display,
        problem: impl Into<String>,
    ) -> ModelError {
        ModelError::new(self.file, format!("line {}, {what}", self.line(span.start)), problem)
    }

    /// An error about the file as a whole, or about one of its top-level keys.
    pub(crate) fn error_at(&self, place: impl Into<String>, problem: impl Into<String>) -> ModelError {
        ModelError::new(self.file, place, problem)
    }

    fn line(&self, offset: usize) -> usize {
        1 + self.text.as_bytes().iter().take(offset).filter(|&&byte| byte == b'\n').count()
    }
}

/// `value` if it is a size, a rate or anything else that must be finite and above zero.
pub(crate) fn positive(name: &str, value: f64) -> Result<f64, String> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(format!("{name} is {value}, expected a finite number above zero"))
    }
}

/// `value` if it is a number at all.
pub(crate) fn finite(name: &str, value: f64) -> Result<f64, String> {
    if value.is_finite() { Ok(value) } else { Err(format!("{name} is {value}, expected a finite number")) }
}

/// Ids appear in topics, file names and URLs, so they are kept to characters that need no escaping anywhere.
pub(crate) fn check_id(name: &str, id: &str) -> Result<(), String> {
    if !id.is_empty() && id.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-') {
        Ok(())
    } else {
        Err(format!("{name} is {id:?}, expected letters, digits, `_` and `-` only, such as \"index_tip\""))
    }
}

/// A list of names for a message: `"a", "b"`, or `none`.
pub(crate) fn list<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let quoted: Vec<String> = names.into_iter().map(|name| format!("{name:?}")).collect();
    if quoted.is_empty() { "none".to_owned() } else { quoted.join(", ") }
}
