//! Reads a sensor model file, keeping the lines of its numbers.

use std::collections::BTreeMap;
use std::ops::Range;

use palpate_robot_model::Place;
use serde::Deserialize;
use toml::Spanned;

use super::{SensorModel, SensorModelError, unknown_effect};
use crate::effects::{self, Effect};
use crate::replay::MOST_SOFTNESS_M;
use crate::replay::NEAR_M;
use crate::response::Response;
use crate::theta::{StreamTheta, Theta};

/// The newest format.
const FORMAT: u32 = 3;

impl SensorModel {
    /// Reads and checks a model file. Problems name their line.
    ///
    /// Refused: another format, unknown or missing keys, numbers that are not finite, a negative alpha or lambda_pre,
    /// a lambda_con that is not below [`NEAR_M`], effects that the library does not have, effects or a response in
    /// a file of format 1, and parameters of streams in one of a format before 3. Whether effects fit a station is for
    /// [`SensorModel::check_for`] to say.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, SensorModelError> {
        let source = Source { file, text };
        // The format first: other versions may have other keys.
        let format: FormatOnly = source.parse()?;
        let (span, format) = (format.format.span(), *format.format.get_ref());
        if !(1..=FORMAT).contains(&format) {
            return Err(source.at(
                span,
                format!("format is {format}, expected 1 to {FORMAT}; this version reads no other"),
            ));
        }
        let model: SensorModelText = source.parse()?;
        if format == 1 && (model.response.is_some() || !model.effect.is_empty()) {
            return Err(
                source.at(span, "format is 1, expected 2 in a file with `response` or `effect`".to_owned())
            );
        }
        if format < 3 && !model.stream.is_empty() {
            return Err(source.at(span, format!("format is {format}, expected 3 in a file with `stream`")));
        }
        let theta = &model.theta;
        Ok(Self {
            format,
            name: model.name,
            theta: Theta {
                lambda_con_m: source.lambda_con_m("theta", &theta.lambda_con_m)?,
                alpha_per_m: source.alpha_per_m("theta", &theta.alpha_per_m)?,
                lambda_pre_pa: source.lambda_pre_pa("theta", &theta.lambda_pre_pa)?,
            },
            streams: source.streams(&model.stream)?,
            provenance: model.provenance,
            response: source.response(model.response.unwrap_or_default())?,
            effects: model
                .effect
                .into_iter()
                .map(|effect| source.effect(effect))
                .collect::<Result<_, _>>()?,
        })
    }
}

/// A file being read.
struct Source<'a> {
    file: &'a str,
    text: &'a str,
}

impl Source<'_> {
    fn error(&self, problem: String) -> SensorModelError {
        SensorModelError { file: self.file.to_owned(), problem }
    }

    fn at(&self, span: Range<usize>, problem: String) -> SensorModelError {
        let line = 1 + self.text.as_bytes().iter().take(span.start).filter(|&&byte| byte == b'\n').count();
        self.error(format!("line {line}: {problem}"))
    }

    fn parse<T: serde::de::DeserializeOwned>(&self) -> Result<T, SensorModelError> {
        toml::from_str(self.text).map_err(|err| match err.span() {
            Some(span) => self.at(span, err.message().to_owned()),
            None => self.error(err.message().to_owned()),
        })
    }

    fn number(
        &self,
        key: &str,
        value: &Spanned<f64>,
        ok: impl Fn(f64) -> bool,
        expected: &str,
    ) -> Result<f64, SensorModelError> {
        let number = *value.get_ref();
        if number.is_finite() && ok(number) {
            Ok(number)
        } else {
            Err(self.at(value.span(), format!("{key} is {number}, expected {expected}")))
        }
    }

    fn lambda_con_m(&self, table: &str, value: &Spanned<f64>) -> Result<f64, SensorModelError> {
        let expected = format!("a finite number below {NEAR_M} m, up to where replays know distances");
        self.number(&format!("{table}.lambda_con_m"), value, |value| value < NEAR_M, &expected)
    }

    fn alpha_per_m(&self, table: &str, value: &Spanned<f64>) -> Result<f64, SensorModelError> {
        let expected = "a finite number of 1/m, not negative: pressure decays with distance";
        self.number(&format!("{table}.alpha_per_m"), value, |value| value >= 0.0, expected)
    }

    fn lambda_pre_pa(&self, table: &str, value: &Spanned<f64>) -> Result<f64, SensorModelError> {
        let expected = "a finite number of Pa, not negative: a taxel that nothing touches is inactive";
        self.number(&format!("{table}.lambda_pre_pa"), value, |value| value >= 0.0, expected)
    }

    fn streams(
        &self,
        texts: &BTreeMap<String, Spanned<StreamThetaText>>,
    ) -> Result<BTreeMap<String, StreamTheta>, SensorModelError> {
        let of_stream = |(id, text): (&String, &Spanned<StreamThetaText>)| {
            let table = format!("stream.{id}");
            let StreamThetaText { lambda_con_m, alpha_per_m, lambda_pre_pa } = text.get_ref();
            let theta = StreamTheta {
                lambda_con_m: lambda_con_m
                    .as_ref()
                    .map(|value| self.lambda_con_m(&table, value))
                    .transpose()?,
                alpha_per_m: alpha_per_m.as_ref().map(|value| self.alpha_per_m(&table, value)).transpose()?,
                lambda_pre_pa: lambda_pre_pa
                    .as_ref()
                    .map(|value| self.lambda_pre_pa(&table, value))
                    .transpose()?,
            };
            if theta.is_empty() {
                let problem = format!(
                    "{table} has no parameter, expected some of lambda_con_m, alpha_per_m, lambda_pre_pa; leave it out \
                     where the stream shares theta"
                );
                return Err(self.at(text.span(), problem));
            }
            Ok((id.clone(), theta))
        };
        texts.iter().map(of_stream).collect()
    }

    fn response(&self, text: ResponseText) -> Result<Response, SensorModelError> {
        let mut response = Response::default();
        if let Some(band_m) = text.proximity_band_m {
            response.proximity_band_m = self.number(
                "response.proximity_band_m",
                &band_m,
                |value| value > 0.0 && value <= NEAR_M,
                &format!("a positive number of m, at most {NEAR_M}"),
            )?;
        }
        if let Some(softness_m) = text.pad_softness_m {
            response.pad_softness_m = self.number(
                "response.pad_softness_m",
                &softness_m,
                |value| (0.0..=MOST_SOFTNESS_M).contains(&value),
                &format!("a number of m between 0 and {MOST_SOFTNESS_M}"),
            )?;
        }
        for (stream, fraction) in &text.off_fractions {
            let fraction = self.number(
                &format!("response.off_fractions.{stream}"),
                fraction,
                |value| value > 0.0 && value <= 1.0,
                "a number above 0, at most 1: channels switch off at or below the load that switches them on",
            )?;
            response.off_fractions.insert(stream.clone(), fraction);
        }
        Ok(response)
    }

    fn effect(&self, text: EffectText) -> Result<Effect, SensorModelError> {
        let id = text.id.get_ref();
        let Some(kind) = effects::tactile(id) else {
            return Err(self.at(text.id.span(), unknown_effect(id)));
        };
        let since = kind.parameters_since().iter().map(|(name, value)| ((*name).to_owned(), *value));
        let mut parameters: BTreeMap<String, f64> = since.collect();
        for (name, value) in &text.parameters {
            let key = format!("parameter {name} of effect {id}");
            parameters.insert(name.clone(), self.number(&key, value, |_| true, "a finite number")?);
        }
        let mut interval = BTreeMap::new();
        for (name, bounds) in &text.interval {
            let [lower, upper] = *bounds.get_ref();
            if !parameters.contains_key(name) {
                let problem =
                    format!("effect {id} has an interval for {name}, which is none of its parameters");
                return Err(self.at(bounds.span(), problem));
            }
            if !(lower.is_finite() && upper.is_finite() && lower <= upper) {
                let problem = format!(
                    "interval of {name} of effect {id} is [{lower}, {upper}], expected two finite numbers, the lower first"
                );
                return Err(self.at(bounds.span(), problem));
            }
            interval.insert(name.clone(), [lower, upper]);
        }
        Ok(Effect { id: id.clone(), place: text.place, parameters, interval, takes: text.takes })
    }
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
    stream: BTreeMap<String, Spanned<StreamThetaText>>,
    #[serde(default)]
    provenance: Vec<String>,
    response: Option<ResponseText>,
    #[serde(default)]
    effect: Vec<EffectText>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ThetaText {
    lambda_con_m: Spanned<f64>,
    alpha_per_m: Spanned<f64>,
    lambda_pre_pa: Spanned<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StreamThetaText {
    lambda_con_m: Option<Spanned<f64>>,
    alpha_per_m: Option<Spanned<f64>>,
    lambda_pre_pa: Option<Spanned<f64>>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct ResponseText {
    proximity_band_m: Option<Spanned<f64>>,
    pad_softness_m: Option<Spanned<f64>>,
    #[serde(default)]
    off_fractions: BTreeMap<String, Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EffectText {
    id: Spanned<String>,
    #[serde(rename = "where")]
    place: Place,
    parameters: BTreeMap<String, Spanned<f64>>,
    #[serde(default)]
    interval: BTreeMap<String, Spanned<[f64; 2]>>,
    #[serde(default)]
    takes: Vec<String>,
}
