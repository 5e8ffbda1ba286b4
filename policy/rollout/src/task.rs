//! What a policy is tied to, and what remembers it.

use palpate_grasp::learn::{Curriculum, ObservationLayout};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// What for: "station", "world", "script", "model" or "truth", "object", "learning", "policy".
    pub role: String,
    /// Where it was.
    pub path: String,
    /// Of its bytes, in hexadecimal digits.
    pub sha256: String,
}

/// In hexadecimal digits, as `sha256sum` prints it.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What a policy that imitates an expert has to know of a station in a world.
#[cfg(feature = "learned")]
pub fn robot(
    station: &palpate_robot_model::Station,
    world: &palpate_grasp::GraspConfig,
) -> palpate_cloning::Robot {
    palpate_cloning::Robot {
        joints: station.robot.dofs().map(|joint| joint.name.clone()).collect(),
        channels: station.layout.channels.iter().map(|channel| channel.id.clone()).collect(),
        control_rate_hz: world.control_rate_hz,
    }
}

/// What a policy is tied to: it fits no other object, script, learning file or layout than it was trained with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskRecord {
    /// Name of the object.
    object: String,
    /// SHA-256 of its files.
    object_sha256: String,
    /// Of the script; nothing without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    script_sha256: Option<String>,
    /// Of the learning file.
    learning_sha256: String,
    /// Of the names and units of every number of observations and actions.
    layout_sha256: String,
}

impl TaskRecord {
    /// Of the object with this id, observations and actions laid out like this, and the files that were read.
    ///
    /// # Errors
    /// A layout that cannot be written down.
    pub fn of(object: &str, layout: &ObservationLayout, sources: &[Source]) -> serde_json::Result<Self> {
        let digest = |role: &str| {
            let of_role: Vec<&str> = sources
                .iter()
                .filter(|source| source.role == role)
                .map(|source| source.sha256.as_str())
                .collect();
            match of_role[..] {
                [] => None,
                [one] => Some(one.to_owned()),
                _ => Some(sha256(of_role.concat().as_bytes())),
            }
        };
        Ok(Self {
            object: object.to_owned(),
            object_sha256: digest("object").unwrap_or_default(),
            script_sha256: digest("script"),
            learning_sha256: digest("learning").unwrap_or_default(),
            layout_sha256: sha256(serde_json::to_string(layout)?.as_bytes()),
        })
    }

    /// Name of the object.
    pub fn object(&self) -> &str {
        &self.object
    }

    /// Whether it was trained on top of a script.
    pub fn has_script(&self) -> bool {
        self.script_sha256.is_some()
    }

    /// Says what differs between `self`, which a policy was trained with, and `given`.
    ///
    /// # Errors
    /// The first difference, with the flag that makes it.
    pub fn check(&self, given: &Self) -> Result<(), String> {
        if self.object != given.object {
            return Err(format!("it was trained with the object {:?}, not {:?}", self.object, given.object));
        }
        match (&self.script_sha256, &given.script_sha256) {
            (None, Some(_)) => return Err("it was trained without a script; add --without-script".to_owned()),
            (Some(_), None) => {
                return Err("it was trained on top of a script; leave --without-script out".to_owned());
            }
            _ => (),
        }
        let none = String::new();
        let compared = [
            ("object's file", "--object", &self.object_sha256, &given.object_sha256),
            (
                "script",
                "--script",
                self.script_sha256.as_ref().unwrap_or(&none),
                given.script_sha256.as_ref().unwrap_or(&none),
            ),
            ("learning file", "--learning", &self.learning_sha256, &given.learning_sha256),
            (
                "layout of observations and actions (joints and channels of the station)",
                "--station",
                &self.layout_sha256,
                &given.layout_sha256,
            ),
        ];
        match compared.iter().find(|(_, _, trained, given)| trained != given) {
            None => Ok(()),
            Some((what, flag, trained, given)) => {
                Err(format!("it was trained with another {what} ({flag}): SHA-256 {trained}, not {given}"))
            }
        }
    }
}

/// What outlives the episodes of a training, as TOML, whose numbers come back with the same bits.
#[derive(Debug, Serialize, Deserialize)]
pub struct Memory {
    /// How wide the region of starts is.
    pub curriculum: Curriculum,
    /// What was learned.
    pub task: TaskRecord,
}

impl Memory {
    /// Its text.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_default()
    }

    /// Of its text.
    ///
    /// # Errors
    /// Another text.
    pub fn from_toml(text: &str) -> Result<Self, String> {
        toml::from_str(text)
            .map_err(|err| format!("it does not say what it was trained with: {}", err.message()))
    }
}
