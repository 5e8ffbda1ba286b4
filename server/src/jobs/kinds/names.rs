//! Names of kinds of jobs by which other kinds know what they need.

/// `tune`.
pub(super) const TUNE: &str = "tune";
/// `expert`.
pub(super) const EXPERT: &str = "expert";
/// `demonstrations`.
pub(super) const DEMONSTRATIONS: &str = "demonstrations";
/// `pretraining`.
pub(super) const PRETRAINING: &str = "pretraining";
/// `gathering`.
pub(super) const GATHERING: &str = "gathering";
/// `imitation`.
pub(super) const IMITATION: &str = "imitation";
/// `pipeline`.
pub(super) const PIPELINE: &str = "pipeline";
