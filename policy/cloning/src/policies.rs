//! The five policies that the method's paper compares (appendix "Policy variants").

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::{CloneConfig, Head};

/// Layers of the paper's trunk, and those of its multilayer perceptron, which stand in the trunk's place where that is the head.
const PAPER_TRUNK: [usize; 3] = [896; 3];
const PAPER_PERCEPTRON: [usize; 5] = [896, 2048, 1024, 512, 256];

/// A policy of the paper: how it sees touch, and what predicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PaperPolicy {
    /// Which channels are on; diffusion.
    RawDp,
    /// Where each channel's taxel is, and whether it is on; diffusion.
    KinematicDp,
    /// The features that a pretrained encoder makes of that; diffusion.
    PretrainedDp,
    /// The same features; action chunking with Transformers.
    PretrainedAct,
    /// The same features; regression.
    PretrainedBc,
}

impl PaperPolicy {
    /// Each by its name.
    pub const ALL: [(&str, Self); 5] = [
        ("raw-dp", Self::RawDp),
        ("kinematic-dp", Self::KinematicDp),
        ("pretrained-dp", Self::PretrainedDp),
        ("pretrained-act", Self::PretrainedAct),
        ("pretrained-bc", Self::PretrainedBc),
    ];

    /// Makes `config` that of this policy; sizes, window and what else it sees stay.
    pub fn apply(self, config: &mut CloneConfig) {
        config.observation.points = self == Self::KinematicDp;
        config.observation.features = !matches!(self, Self::RawDp | Self::KinematicDp);
        config.head = match self {
            Self::RawDp | Self::KinematicDp | Self::PretrainedDp => Head::Diffusion,
            Self::PretrainedAct => Head::Act,
            Self::PretrainedBc => Head::Regression,
        };
        if self == Self::PretrainedBc && config.trunk == PAPER_TRUNK {
            config.trunk = PAPER_PERCEPTRON.to_vec();
        }
    }
}

impl FromStr for PaperPolicy {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|(name, _)| *name == text);
        let names = Self::ALL.map(|(name, _)| name).join(", ");
        found.map(|(_, policy)| policy).ok_or_else(|| format!("{text:?} is none of {names}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_policy_sees_touch_in_its_own_way_and_has_its_own_head() {
        let found = PaperPolicy::ALL.map(|(name, policy)| {
            let mut config = CloneConfig::preset("paper").expect("a preset");
            name.parse::<PaperPolicy>().expect("its name").apply(&mut config);
            assert_eq!(in_a_file(policy), format!("{name:?}"));
            config.validate().expect("it makes sense");
            (config.observation.points, config.observation.features, config.head, config.trunk.len())
        });
        assert_eq!(
            found,
            [
                (false, false, Head::Diffusion, 3),
                (true, false, Head::Diffusion, 3),
                (false, true, Head::Diffusion, 3),
                (false, true, Head::Act, 3),
                (false, true, Head::Regression, 5),
            ]
        );
        assert!("dp".parse::<PaperPolicy>().expect_err("no policy").contains("none of raw-dp, kinematic-dp"));
    }

    /// As a file of TOML has it.
    fn in_a_file(policy: PaperPolicy) -> String {
        toml::Value::try_from(policy).expect("a name").to_string()
    }
}
