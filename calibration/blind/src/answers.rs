//! Answers on disk: one a line, so that a bench that was cut off goes on where it was, and a wrong name can be looked into.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use palpate_reports::{Candidate, DiagnosisReport, EffectInDoubt, Gap, NamedEffect, Unexplained, Verdict};
use palpate_sim::effects::Effect;
use palpate_truth::{Expected, Hidden};
use serde::{Deserialize, Serialize};

use crate::BlindError;

/// What was hidden in a session: for scoring alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Secret {
    /// The truth in which it was hidden.
    pub(crate) world: String,
    pub(crate) label: String,
    pub(crate) seed: u64,
    /// Ids, in no order.
    pub(crate) hidden: Vec<String>,
    /// With places and sizes, where they are drawn.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) details: Vec<Hidden>,
    /// `weak`, `medium` or `strong`; `None` for pairs and without effects.
    pub(crate) strength: Option<String>,
    pub(crate) expected: Expected,
}

impl Secret {
    /// The effect to leave out of the library when the session is diagnosed again.
    pub(crate) fn to_leave_out(&self) -> Option<&String> {
        let strong = self.strength.as_deref() == Some("strong") && self.expected == Expected::Named;
        self.hidden.first().filter(|_| strong)
    }
}

/// How a session is diagnosed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Asked {
    /// As it was recorded, with the whole library.
    AsRecorded,
    /// Without its raw readings.
    EventsOnly,
    /// With the effect that is hidden left out of the library.
    LeftOut,
}

/// What one diagnosis said about one session.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Answer {
    #[serde(flatten)]
    pub(crate) secret: Secret,
    pub(crate) asked: Asked,
    pub(crate) verdict: Verdict,
    /// In order.
    pub(crate) named: Vec<NamedEffect>,
    /// What rules withheld.
    #[serde(default)]
    pub(crate) withheld: Vec<EffectInDoubt>,
    /// On confirm takes.
    pub(crate) gap: Gap,
    /// The first of what was tried in the first round and not named.
    pub(crate) candidates: Vec<Candidate>,
    /// Why something is left, without where.
    #[serde(default)]
    pub(crate) unexplained: Unexplained,
    pub(crate) notes: Vec<String>,
    /// What would be named with rules changed one by one; only of a bench that asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) ablation: Vec<Otherwise>,
}

/// What would be named with one rule changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Otherwise {
    pub(crate) rule: String,
    /// Factor of its limit; `None` where the rule is switched off.
    pub(crate) scale: Option<f64>,
    /// Ids, the weightiest first.
    pub(crate) named: Vec<String>,
}

/// Candidates that are kept with an answer.
const CANDIDATES_KEPT: usize = 6;

impl Answer {
    pub(crate) fn new(secret: &Secret, asked: Asked, mut report: DiagnosisReport) -> Self {
        report.candidates.truncate(CANDIDATES_KEPT);
        Self {
            secret: secret.clone(),
            asked,
            verdict: report.verdict,
            named: report.effects,
            withheld: report.in_doubt,
            gap: report.held_out,
            candidates: report.candidates,
            unexplained: Unexplained { cells: Vec::new(), ..report.unexplained },
            notes: report.notes,
            ablation: Vec::new(),
        }
    }

    /// With what would be `named` with each of these factors of a rule.
    pub(crate) fn with_ablation(mut self, scales: &[(String, f64)], named: &[Vec<Effect>]) -> Self {
        let otherwise = scales.iter().zip(named).map(|((rule, scale), named)| Otherwise {
            rule: rule.clone(),
            scale: scale.is_finite().then_some(*scale),
            named: named.iter().map(|effect| effect.id.clone()).collect(),
        });
        self.ablation = otherwise.collect();
        self
    }

    /// Whether a class of a name holds `id`.
    pub(crate) fn has_in_class(&self, id: &str) -> bool {
        self.named.iter().flat_map(|name| &name.class).any(|member| member == id)
    }
}

/// The answers so far.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    known: Vec<Answer>,
    file: Option<(PathBuf, Mutex<File>)>,
}

impl Answers {
    /// Those in the file at `path`, which new ones are added to; without a path none are kept.
    ///
    /// A last line that was cut off in the middle is taken away.
    pub(crate) fn open(path: Option<&Path>) -> Result<Self, BlindError> {
        let Some(path) = path else { return Ok(Self::default()) };
        let failed = |source| BlindError::Answers { path: path.to_owned(), source };
        let text = match std::fs::read_to_string(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            text => text.map_err(failed)?,
        };
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let of_line = |(idx, line): (usize, &str)| {
            serde_json::from_str(line).map_err(|error| {
                let what =
                    format!("line {}: {error}; it holds no answer of this version's blind bench", idx + 1);
                failed(io::Error::new(io::ErrorKind::InvalidData, what))
            })
        };
        let known = text[..whole].lines().enumerate().map(of_line).collect::<Result<_, _>>()?;
        let file = OpenOptions::new().create(true).append(true).open(path).map_err(failed)?;
        file.set_len(whole as u64).map_err(failed)?;
        Ok(Self { known, file: Some((path.to_owned(), Mutex::new(file))) })
    }

    /// What was said about this session.
    pub(crate) fn find(&self, secret: &Secret, asked: Asked) -> Option<Answer> {
        self.known.iter().find(|answer| answer.asked == asked && answer.secret == *secret).cloned()
    }

    /// Keeps `answer`.
    pub(crate) fn add(&self, answer: &Answer) -> Result<(), BlindError> {
        let Some((path, file)) = &self.file else { return Ok(()) };
        let write = || {
            let line = serde_json::to_string(answer)? + "\n";
            file.lock().unwrap_or_else(PoisonError::into_inner).write_all(line.as_bytes())
        };
        write().map_err(|source| BlindError::Answers { path: path.clone(), source })
    }
}
