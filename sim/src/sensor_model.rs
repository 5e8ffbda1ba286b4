//! The sensor model file: theta, and where its numbers came from.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use toml::Spanned;

use crate::replay::NEAR_M;

/// A sensor model as stored in TOML. Replay, live twin and training load this same file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// Version of the format; 1.
    pub format: u32,
    /// Name for people.
    pub name: String,
    /// The three parameters of the paper.
    pub theta: Theta,
    /// Where the numbers came from: free text lines such as session, held-out takes, software version.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub provenance: Vec<String>,
}

/// theta = (lambda_con, alpha, lambda_pre) of the paper, section "Real-to-Sim Tactile Sensor Calibration".
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Theta {
    /// A proximity patch is active if any node's signed distance is below this, m. Below [`NEAR_M`]; negative values
    /// ask for penetration.
    pub lambda_con_m: f64,
    /// Spatial decay rate of pressure along the elastomer, 1/m; not negative. At zero every taxel of a patch reads
    /// the same; beyond a few thousand only nodes right at a taxel count.
    pub alpha_per_m: f64,
    /// A taxel is active if its propagated pressure is above this, Pa; not negative, so that a taxel that nothing
    /// touches is inactive.
    pub lambda_pre_pa: f64,
}

/// What a model knows of sensors beyond theta. The defaults are the paper's model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Response {
    /// A proximity sensor begins to read this far before `lambda_con` is reached, m: the travel over which its reading
    /// rises from nothing to its threshold.
    #[serde(default = "Response::default_band_m")]
    pub proximity_band_m: f64,
    /// By stream id, the load below which a channel switches off again, over the one at which it switches on; 1
    /// (no hysteresis) where absent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub off_fractions: BTreeMap<String, f64>,
}

impl Default for Response {
    fn default() -> Self {
        Self { proximity_band_m: Self::default_band_m(), off_fractions: BTreeMap::new() }
    }
}

impl Response {
    fn default_band_m() -> f64 {
        1e-3
    }

    /// Signed distance at which proximity sensors begin to read, m.
    pub fn reach_m(&self, theta: &Theta) -> f64 {
        theta.lambda_con_m + self.proximity_band_m
    }

    /// Of the stream called `stream`.
    pub fn off_fraction(&self, stream: &str) -> f64 {
        self.off_fractions.get(stream).copied().unwrap_or(1.0)
    }
}

/// A sensor model that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct SensorModelError {
    /// Which file was being read.
    pub file: String,
    /// What is wrong and what was expected.
    pub problem: String,
}

/// The only format there is.
const FORMAT: u32 = 1;

impl SensorModel {
    /// Reads and checks a model file. Problems name their line.
    ///
    /// Refused: another format, unknown or missing keys, numbers that are not finite, a negative alpha or lambda_pre,
    /// and a lambda_con that is not below [`NEAR_M`].
    pub fn from_toml(file: &str, text: &str) -> Result<Self, SensorModelError> {
        let error = |problem: String| SensorModelError { file: file.to_owned(), problem };
        let syntax = |err: toml::de::Error| match err.span() {
            Some(span) => error(format!("line {}: {}", line(text, span.start), err.message())),
            None => error(err.message().to_owned()),
        };
        let at = |span: std::ops::Range<usize>, problem: String| {
            error(format!("line {}: {problem}", line(text, span.start)))
        };

        // The format first: other versions may have other keys.
        let format = toml::from_str::<FormatOnly>(text).map_err(syntax)?.format;
        if *format.get_ref() != FORMAT {
            return Err(at(
                format.span(),
                format!("format is {}, expected {FORMAT}; this version reads no other", format.get_ref()),
            ));
        }
        let model: SensorModelText = toml::from_str(text).map_err(syntax)?;
        let number = |name: &str, value: &Spanned<f64>, ok: &dyn Fn(f64) -> bool, expected: &str| {
            let number = *value.get_ref();
            if number.is_finite() && ok(number) {
                Ok(number)
            } else {
                Err(at(value.span(), format!("theta.{name} is {number}, expected {expected}")))
            }
        };
        let theta = &model.theta;
        let not_negative = |value: f64| value >= 0.0;
        Ok(Self {
            format: FORMAT,
            name: model.name,
            theta: Theta {
                lambda_con_m: number(
                    "lambda_con_m",
                    &theta.lambda_con_m,
                    &|value| value < NEAR_M,
                    &format!("a finite number below {NEAR_M} m, up to where replays know distances"),
                )?,
                alpha_per_m: number(
                    "alpha_per_m",
                    &theta.alpha_per_m,
                    &not_negative,
                    "a finite number of 1/m, not negative: pressure decays with distance",
                )?,
                lambda_pre_pa: number(
                    "lambda_pre_pa",
                    &theta.lambda_pre_pa,
                    &not_negative,
                    "a finite number of Pa, not negative: a taxel that nothing touches is inactive",
                )?,
            },
            provenance: model.provenance,
        })
    }

    /// The file's text.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("numbers, texts and lists of them have a TOML form")
    }
}

fn line(text: &str, offset: usize) -> usize {
    1 + text.as_bytes().iter().take(offset).filter(|&&byte| byte == b'\n').count()
}

#[derive(Deserialize)]
struct FormatOnly {
    format: Spanned<u32>,
}

/// [`SensorModel`] with the places of its numbers.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorModelText {
    #[serde(rename = "format")]
    _format: u32,
    name: String,
    theta: ThetaText,
    #[serde(default)]
    provenance: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ThetaText {
    lambda_con_m: Spanned<f64>,
    alpha_per_m: Spanned<f64>,
    lambda_pre_pa: Spanned<f64>,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const MODEL: &str = "format = 1\nname = \"nominal\"\n\n[theta]\nlambda_con_m = 0.002\nalpha_per_m = 250\nlambda_pre_pa = 1200.0\n";

    fn refusal(from: &str, to: &str) -> String {
        assert!(MODEL.contains(from), "{from:?} is not in the fixture");
        SensorModel::from_toml("model.toml", &MODEL.replacen(from, to, 1))
            .expect_err("must be refused")
            .to_string()
    }

    #[test]
    fn a_model_is_read() {
        let model = SensorModel::from_toml("model.toml", MODEL).expect("valid");
        assert_eq!(model.theta, Theta { lambda_con_m: 0.002, alpha_per_m: 250.0, lambda_pre_pa: 1200.0 });
        assert_eq!((model.name.as_str(), model.provenance.len()), ("nominal", 0));
    }

    #[test]
    fn bad_files_name_the_line_and_what_was_expected() {
        let cases = [
            ("format = 1", "format = 2\nnew_key = 3", "model.toml: line 1: format is 2, expected 1"),
            ("format = 1\n", "", "missing field `format`"),
            (
                "alpha_per_m = 250",
                "alpha_per_m = -1",
                "line 6: theta.alpha_per_m is -1, expected a finite number",
            ),
            ("alpha_per_m = 250", "alpha_per_m = nan", "line 6: theta.alpha_per_m is NaN"),
            ("alpha_per_m = 250", "alpha_per_m = \"x\"", "line 6: invalid type"),
            ("lambda_pre_pa = 1200.0", "lambda_pre_pa = inf", "line 7: theta.lambda_pre_pa is inf"),
            ("lambda_pre_pa = 1200.0", "lambda_pre_pa = -0.5", "line 7: theta.lambda_pre_pa is -0.5"),
            (
                "lambda_con_m = 0.002",
                "lambda_con_m = 0.05",
                "line 5: theta.lambda_con_m is 0.05, expected a finite number below 0.05",
            ),
            ("lambda_con_m = 0.002\n", "", "missing field `lambda_con_m`"),
            ("name", "nmae", "line 2: unknown field `nmae`"),
            ("[theta]", "[theta", "line 4: "),
        ];
        for (from, to, expected) in cases {
            let message = refusal(from, to);
            assert!(message.contains(expected), "{to:?}: {message}");
        }
    }

    proptest! {
        #[test]
        fn text_and_model_are_the_same(
            lambda_con_m in -0.01..0.0499, alpha_per_m in 0.0..1e5, lambda_pre_pa in 0.0..1e6,
            name in "\\PC{0,20}", provenance in prop::collection::vec("\\PC{0,20}", 0..3),
        ) {
            let theta = Theta { lambda_con_m, alpha_per_m, lambda_pre_pa };
            let model = SensorModel { format: 1, name, theta, provenance };
            prop_assert_eq!(SensorModel::from_toml("model.toml", &model.to_toml()).expect("own text"), model);
        }
    }
}
