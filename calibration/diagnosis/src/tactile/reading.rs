//! From the load on a channel to its raw reading.

use palpate_sim::vectors::powers;

/// The curve of a stream: `x^exponent` of a load `x` in units of that at which the channel switches, bent towards
/// the highest reading that its converter can give.
///
/// A force-sensing resistor in a voltage divider reads `C y / (C - 1 + y)` for a conductance `y` (Interlink, "FSR
/// 402 integration guide"): it comes near its ceiling `C` long before it is there. An amplifier is proportional up
/// to its ceiling. `knee` is 1 for the first and goes to 0 for the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Curve {
    /// The load that reads as one.
    pub(super) on_load: f64,
    pub(super) exponent: f64,
    pub(super) knee: f64,
}

/// Possible exponents.
pub(super) const EXPONENTS: [f64; 2] = [0.3, 3.0];
/// Possible knees of a stream that has one: the first is as good as none.
pub(super) const KNEES: [f64; 2] = [0.02, 1.0];

impl Curve {
    /// What readings depend on, as bits.
    pub(super) fn key(self) -> [u64; 3] {
        [self.on_load, self.exponent, self.knee].map(f64::to_bits)
    }

    /// The load of a reading that is well below the ceiling, each in units of that at which the channel switches.
    pub(super) fn load_of(self, reading: f64) -> f64 {
        reading.powf(self.exponent.recip())
    }

    /// Makes of each of `loads` the reading of a channel whose converter ends at `ceiling`, in units of the switching
    /// threshold: 1 where the channel switches.
    ///
    /// Negative loads (drift) read as they are.
    pub(super) fn read(self, ceiling: f64, loads: &mut [f64]) {
        let Self { on_load, exponent, knee } = self;
        loads.iter_mut().for_each(|load| *load /= on_load);
        let mut readings = loads.to_vec();
        powers(&mut readings, exponent);
        if knee > 0.0 && ceiling > 1.0 && ceiling.is_finite() {
            // So that a reading of one stays one.
            let at_threshold = (1.0 - ceiling.powf(-knee.recip())).powf(-knee);
            readings.iter_mut().for_each(|reading| *reading *= at_threshold);
            let mut bends: Vec<f64> = readings.iter().map(|reading| reading / ceiling).collect();
            powers(&mut bends, knee.recip());
            for (reading, bend) in readings.iter_mut().zip(&mut bends) {
                // Far above, it is where it ends.
                if bend.is_infinite() {
                    (*reading, *bend) = (ceiling, 0.0);
                }
                *bend += 1.0;
            }
            powers(&mut bends, knee);
            readings.iter_mut().zip(bends).for_each(|(reading, bend)| *reading /= bend);
        } else {
            readings.iter_mut().for_each(|reading| *reading = reading.min(ceiling));
        }
        let pressed = loads.iter_mut().zip(readings).filter(|(load, _)| **load > 0.0);
        pressed.for_each(|(load, reading)| *load = reading);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn reading(curve: Curve, ceiling: f64, load: f64) -> f64 {
        let mut readings = [load];
        curve.read(ceiling, &mut readings);
        readings[0]
    }

    #[test]
    fn a_divider_reads_as_one_is_computed() {
        let of = |load| reading(Curve { on_load: 2.0, exponent: 0.5, knee: 1.0 }, 20.0, load);
        for load in [0.1, 2.0, 30.0, 5e3] {
            let conductance = (load / 2.0_f64).sqrt();
            let expected = 20.0 * conductance / (19.0 + conductance);
            assert!((of(load) - expected).abs() < 1e-12, "{load}: {}, expected {expected}", of(load));
        }
    }

    proptest! {
        #[test]
        fn a_reading_is_one_at_the_threshold_grows_with_load_and_stays_below_the_ceiling(
            on_load in 1e-3..1e5_f64, exponent in EXPONENTS[0]..EXPONENTS[1], knee in KNEES[0]..KNEES[1],
            ceiling in 2.0..1e3_f64, load in 1e-3..1e4_f64, more in 1.0..10.0_f64,
        ) {
            let of = |load| reading(Curve { on_load, exponent, knee }, ceiling, load);
            prop_assert!((of(on_load) - 1.0).abs() < 1e-9);
            let (less, most) = (of(load * on_load), of(load * on_load * more));
            prop_assert!(less <= most * (1.0 + 1e-12) && most <= ceiling * (1.0 + 1e-9), "{less} {most}");
        }

        #[test]
        fn an_amplifier_is_proportional_up_to_its_ceiling(load in 0.0..1e3_f64) {
            let of = |load| reading(Curve { on_load: 1.0, exponent: 1.0, knee: KNEES[0] }, 20.0, load);
            let expected = load.min(20.0);
            prop_assert!((of(load) - expected).abs() <= 0.02 * expected, "{load}: {}", of(load));
        }
    }
}
