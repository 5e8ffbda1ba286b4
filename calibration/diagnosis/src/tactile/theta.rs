//! theta in a model's base: the shared numbers, and those that streams have of their own.

use std::collections::BTreeMap;

use palpate_robot_model::{SensorKind, Station};
use palpate_sim::{Response, SensorModel, StreamTheta, Theta};

use super::{Base, TactileDomain, known_off_fractions};
use crate::engine::Model;

/// Which streams a number of theta belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Of {
    /// All that have none of their own.
    Shared,
    /// One that has its own.
    Stream(usize),
}

/// Where a stream keeps a number of its own.
type OwnOf = fn(&mut StreamTheta) -> &mut Option<f64>;

/// Who has a number of theta in `start` (the shared one first, if any stream of `kind` uses it), the theta that it is of, and
/// what its name ends with.
pub(super) fn holders(
    station: &Station,
    start: &SensorModel,
    kind: SensorKind,
    has_own: impl Fn(&StreamTheta) -> bool,
) -> Vec<(Of, Theta, String)> {
    let streams = &station.layout.streams;
    let has_own = |idx: usize| start.streams.get(&streams[idx].id).is_some_and(&has_own);
    let of_kind = || (0..streams.len()).filter(|&idx| streams[idx].kind == kind);
    let shared = of_kind().any(|idx| !has_own(idx)).then(|| (Of::Shared, start.theta, String::new()));
    let own = of_kind().filter(|&idx| has_own(idx)).map(|idx| {
        let id = &streams[idx].id;
        (Of::Stream(idx), start.thetas().of(id), format!(".{id}"))
    });
    shared.into_iter().chain(own).collect()
}

/// The shared theta of `start`; zero for sensors that the station does not have, of which nothing is known.
pub(super) fn shared(station: &Station, start: &SensorModel) -> Theta {
    let has = |kind: SensorKind| station.layout.streams.iter().any(|stream| stream.kind == kind);
    let mut theta = Theta { lambda_con_m: 0.0, alpha_per_m: 0.0, lambda_pre_pa: 0.0 };
    if has(SensorKind::Proximity) {
        theta.lambda_con_m = start.theta.lambda_con_m;
    }
    if has(SensorKind::Pressure) {
        (theta.alpha_per_m, theta.lambda_pre_pa) = (start.theta.alpha_per_m, start.theta.lambda_pre_pa);
    }
    theta
}

impl TactileDomain<'_> {
    /// The sensor model that `model` stands for, besides its effects.
    pub fn theta_and_response(&self, model: &Model) -> (Theta, BTreeMap<String, StreamTheta>, Response) {
        let (mut theta, mut own) = (self.shared, self.own.clone());
        let mut set = |of: Of, value: f64, shared: fn(&mut Theta) -> &mut f64, own_of: OwnOf| match of {
            Of::Shared => *shared(&mut theta) = value,
            Of::Stream(idx) => {
                let id = &self.station.layout.streams[idx].id;
                *own_of(own.entry(id.clone()).or_default()) = Some(value);
            }
        };
        let mut response =
            Response { off_fractions: known_off_fractions(self.station), ..Response::default() };
        for (kind, &value) in self.kinds.iter().zip(&model.base) {
            match kind {
                Base::LambdaCon(of) => {
                    set(*of, value, |theta| &mut theta.lambda_con_m, |own| &mut own.lambda_con_m);
                }
                Base::Alpha(of) => {
                    set(*of, value, |theta| &mut theta.alpha_per_m, |own| &mut own.alpha_per_m);
                }
                Base::LambdaPre(of) => {
                    set(*of, value.exp(), |theta| &mut theta.lambda_pre_pa, |own| &mut own.lambda_pre_pa);
                }
                Base::Band => response.proximity_band_m = value,
                Base::Softness => response.pad_softness_m = value,
                Base::Width(_)
                | Base::Exponent(_)
                | Base::Knee(_)
                | Base::Lag(_)
                | Base::Creep(..)
                | Base::Zero(_)
                | Base::Pattern(..) => {}
            }
        }
        (theta, own, response)
    }

    /// Whether channels of `stream` use the number of theta at `idx` of the base; of no other number.
    pub(super) fn has_number(&self, idx: usize, stream: usize) -> bool {
        let of_stream = &self.station.layout.streams[stream];
        let own = self.own.get(&of_stream.id).copied().unwrap_or_default();
        let (kind, of, value) = match self.kinds[idx] {
            Base::LambdaCon(of) => (SensorKind::Proximity, of, own.lambda_con_m),
            Base::Alpha(of) => (SensorKind::Pressure, of, own.alpha_per_m),
            Base::LambdaPre(of) => (SensorKind::Pressure, of, own.lambda_pre_pa),
            _ => return false,
        };
        of_stream.kind == kind && of == value.map_or(Of::Shared, |_| Of::Stream(stream))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Domain as _;
    use crate::testing::{Session, session};

    #[test]
    fn what_streams_have_of_their_own_is_fitted_and_kept_for_them() {
        let Session { stage, mut takes, nominal: shared } = session("small");
        let station = stage.station();
        takes.truncate(1);
        let mut own = shared.clone();
        for stream in &station.layout.streams {
            own.streams.insert(stream.id.clone(), StreamTheta::of_kind(stream.kind, &shared.theta));
        }
        own.theta = Theta { lambda_con_m: -0.01, alpha_per_m: 5.0, lambda_pre_pa: 5.0 };

        let (of_shared, model_of_shared) = TactileDomain::new(station, &takes, &[0], &shared).unwrap();
        let (of_own, mut model) = TactileDomain::new(station, &takes, &[0], &own).unwrap();
        assert_eq!(model.base, model_of_shared.base);
        assert_eq!(of_own.predict(0, &model).unwrap(), of_shared.predict(0, &model_of_shared).unwrap());
        for idx in 0..model.base.len() {
            assert_eq!(of_own.base_support(idx), of_shared.base_support(idx), "number {idx}");
        }
        // A fit moves the stream's own number and nothing else.
        let idx = of_own.kinds.iter().position(|kind| matches!(kind, Base::Alpha(_))).unwrap();
        model.base[idx] += 10.0;
        let (theta, streams, _) = of_own.theta_and_response(&model);
        assert_eq!(theta, own.theta);
        let Base::Alpha(Of::Stream(moved)) = of_own.kinds[idx] else { panic!("{:?}", of_own.kinds[idx]) };
        let moved = &station.layout.streams[moved].id;
        assert_eq!(streams[moved].alpha_per_m, own.streams[moved].alpha_per_m.map(|alpha| alpha + 10.0));
        for (id, stream) in streams.iter().filter(|(id, _)| *id != moved) {
            assert_eq!(stream.lambda_con_m, own.streams[id].lambda_con_m);
        }
        assert_ne!(of_own.predict(0, &model).unwrap(), of_shared.predict(0, &model_of_shared).unwrap());
    }
}
