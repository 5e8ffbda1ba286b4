//! Lineage: what was made from what, from takes over sensor models and policies to trials.

use std::fmt;

use serde::{Deserialize, Serialize};

/// `GET /api/v1/lineage`: everything that is made here, and what it was made from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Lineage {
    /// By sort, then newest first; what has no time is last, by id.
    pub artifacts: Vec<Artifact>,
}

/// Something that was recorded, fitted, trained or tried.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Artifact {
    /// Which one.
    #[serde(flatten)]
    pub key: ArtifactKey,
    /// Name for people.
    pub name: String,
    /// When it was made, RFC 3339; absent where nothing tells.
    #[serde(default)]
    pub made: Option<String>,
    /// It comes with the program.
    #[serde(default)]
    pub is_shipped: bool,
    /// Jobs that made it, first the one that began it.
    #[serde(default)]
    pub jobs: Vec<String>,
    /// What these read. Something that is there no more is named all the same.
    #[serde(default)]
    pub made_from: Vec<ArtifactKey>,
    /// What was asked of the newest of these jobs, and other facts, for people.
    #[serde(default)]
    pub facts: Vec<ArtifactFact>,
}

/// Which artifact.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ArtifactKey {
    /// What it is.
    pub sort: ArtifactSort,
    /// Id among its sort. Where a job's outcome has no name of its own, it is the job's.
    pub id: String,
}

/// A fact about an artifact.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ArtifactFact {
    /// Of what, e.g. `seed`.
    pub name: String,
    /// As text.
    pub value: String,
}

/// What an artifact is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ArtifactSort {
    /// Recorded takes.
    Session,
    /// A sensor model.
    Model,
    /// A script of a grasp.
    Script,
    /// Trials of an expert, for others to learn from.
    Demonstrations,
    /// A tactile encoder.
    Encoder,
    /// A policy.
    Policy,
    /// A policy's success rates in simulation.
    Evaluation,
    /// Trials on the hand.
    Campaign,
}

impl ArtifactSort {
    /// All, from what is recorded to what is tried.
    pub const ALL: [Self; 8] = [
        Self::Session,
        Self::Model,
        Self::Script,
        Self::Demonstrations,
        Self::Encoder,
        Self::Policy,
        Self::Evaluation,
        Self::Campaign,
    ];

    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::Model => "model",
            Self::Script => "script",
            Self::Demonstrations => "demonstrations",
            Self::Encoder => "encoder",
            Self::Policy => "policy",
            Self::Evaluation => "evaluation",
            Self::Campaign => "campaign",
        }
    }
}

impl ArtifactKey {
    /// Artifact `id` of this sort.
    pub fn new(sort: ArtifactSort, id: impl Into<String>) -> Self {
        Self { sort, id: id.into() }
    }

    /// Reads what [`fmt::Display`] writes.
    pub fn parse(text: &str) -> Option<Self> {
        let (name, id) = text.split_once(':')?;
        let sort = ArtifactSort::ALL.into_iter().find(|sort| sort.name() == name)?;
        (!id.is_empty()).then(|| Self::new(sort, id))
    }
}

impl fmt::Display for ArtifactKey {
    /// `model:bench-monday`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.sort.name(), self.id)
    }
}

impl Lineage {
    /// The artifact of this key, if it is there.
    pub fn get(&self, key: &ArtifactKey) -> Option<&Artifact> {
        self.artifacts.iter().find(|artifact| artifact.key == *key)
    }

    /// What was made from the artifact of this key.
    pub fn made_of(&self, key: &ArtifactKey) -> impl Iterator<Item = &Artifact> {
        self.artifacts.iter().filter(move |artifact| artifact.made_from.contains(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_survives_its_text() {
        for sort in ArtifactSort::ALL {
            let key = ArtifactKey::new(sort, "a:b c");
            assert_eq!(ArtifactKey::parse(&key.to_string()), Some(key));
        }
        for text in ["", "model", "model:", "mode:x", ":x"] {
            assert_eq!(ArtifactKey::parse(text), None, "{text}");
        }
    }
}
