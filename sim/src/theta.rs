//! theta, and what streams have of it for themselves.

use std::collections::BTreeMap;

use palpate_robot_model::{SensorKind, Stream, TactileLayout};
use serde::{Deserialize, Serialize};

/// theta = (lambda_con, alpha, lambda_pre) of the paper, section "Real-to-Sim Tactile Sensor Calibration".
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Theta {
    /// A proximity patch is active if any node's signed distance is below this, m. Below [`crate::replay::NEAR_M`];
    /// negative values ask for penetration.
    pub lambda_con_m: f64,
    /// Spatial decay rate of pressure along the elastomer, 1/m; not negative. At zero every taxel of a patch reads
    /// the same; beyond a few thousand only nodes right at a taxel count.
    pub alpha_per_m: f64,
    /// A taxel is active if its propagated pressure is above this, Pa; not negative, so that a taxel that nothing
    /// touches is inactive.
    pub lambda_pre_pa: f64,
}

/// The parameters that a stream has of its own, because its skin is of another kind than the others'. The rest of theta
/// is the shared one's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StreamTheta {
    /// As [`Theta::lambda_con_m`]; of a proximity stream only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambda_con_m: Option<f64>,
    /// As [`Theta::alpha_per_m`]; of a pressure stream only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alpha_per_m: Option<f64>,
    /// As [`Theta::lambda_pre_pa`]; of a pressure stream only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambda_pre_pa: Option<f64>,
}

impl StreamTheta {
    /// What a stream of `kind` uses of `theta`.
    pub fn of_kind(kind: SensorKind, theta: &Theta) -> Self {
        match kind {
            SensorKind::Proximity => Self { lambda_con_m: Some(theta.lambda_con_m), ..Self::default() },
            SensorKind::Pressure => Self {
                alpha_per_m: Some(theta.alpha_per_m),
                lambda_pre_pa: Some(theta.lambda_pre_pa),
                ..Self::default()
            },
        }
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// theta of every stream: what streams share, and what some have of their own.
#[derive(Clone, Copy, Debug)]
pub struct Thetas<'a> {
    shared: Theta,
    own: Option<&'a BTreeMap<String, StreamTheta>>,
}

impl From<Theta> for Thetas<'_> {
    fn from(shared: Theta) -> Self {
        Self { shared, own: None }
    }
}

impl<'a> Thetas<'a> {
    /// `shared`, but for what streams have of their `own`, by id.
    pub fn new(shared: Theta, own: &'a BTreeMap<String, StreamTheta>) -> Self {
        Self { shared, own: Some(own) }
    }

    /// theta of the stream called `id`.
    pub fn of(&self, id: &str) -> Theta {
        let own = self.own.and_then(|own| own.get(id)).copied().unwrap_or_default();
        Theta {
            lambda_con_m: own.lambda_con_m.unwrap_or(self.shared.lambda_con_m),
            alpha_per_m: own.alpha_per_m.unwrap_or(self.shared.alpha_per_m),
            lambda_pre_pa: own.lambda_pre_pa.unwrap_or(self.shared.lambda_pre_pa),
        }
    }

    /// Of every stream of `layout`, in order.
    pub fn by_stream(&self, layout: &TactileLayout) -> Vec<Theta> {
        layout.streams.iter().map(|stream| self.of(&stream.id)).collect()
    }

    /// Decay of pressure on every patch of `layout`, 1/m.
    pub fn alphas_per_m(&self, layout: &TactileLayout) -> Vec<f64> {
        let of_streams = self.by_stream(layout);
        layout.patches.iter().map(|patch| of_streams[patch.stream].alpha_per_m).collect()
    }
}

/// What keeps streams of `layout` from having `own`: one that is not there, or a parameter that its kind does not use.
pub(super) fn misfit(own: &BTreeMap<String, StreamTheta>, layout: &TactileLayout) -> Option<String> {
    own.iter().find_map(|(id, theta)| {
        let Some(stream) = layout.stream_index(id).map(|idx| &layout.streams[idx]) else {
            let known: Vec<&str> = layout.streams.iter().map(|stream| stream.id.as_str()).collect();
            let known = known.join(", ");
            return Some(format!(
                "stream.{id}: layout {:?} has no such stream (it has {known})",
                layout.name
            ));
        };
        let (unused, kind, expected) = unused(stream, theta)?;
        Some(format!(
            "stream.{id} has {unused}, which a {kind} stream does not use; expected {expected} there"
        ))
    })
}

fn unused(stream: &Stream, theta: &StreamTheta) -> Option<(&'static str, &'static str, &'static str)> {
    match stream.kind {
        SensorKind::Proximity => {
            let unused = [("alpha_per_m", theta.alpha_per_m), ("lambda_pre_pa", theta.lambda_pre_pa)];
            let (name, _) = unused.into_iter().find(|(_, value)| value.is_some())?;
            Some((name, "proximity", "lambda_con_m"))
        }
        SensorKind::Pressure => {
            theta.lambda_con_m?;
            Some(("lambda_con_m", "pressure", "alpha_per_m or lambda_pre_pa"))
        }
    }
}
