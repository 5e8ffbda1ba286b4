//! Powers and exponentials, four at a time.
//!
//! A value has the same bits wherever it stands among others, and by itself.

use wide::f64x4;

/// Raises each of `values` to the power of `exponent`, which is above zero; what is not above zero becomes zero.
pub fn powers(values: &mut [f64], exponent: f64) {
    let raised = |values: f64x4| {
        // Sensors rest most of the time.
        if values == f64x4::ZERO { values } else { values.max(f64x4::ZERO).powf_simd(f64x4::splat(exponent)) }
    };
    four_at_a_time(values, 0.0, raised);
}

/// Makes each of `values` its exponential.
pub fn exponentials(values: &mut [f64]) {
    four_at_a_time(values, f64::NEG_INFINITY, f64x4::exp);
}

/// [`exponentials`] of one value.
pub fn exponential(value: f64) -> f64 {
    f64x4::splat(value).exp().to_array()[0]
}

/// Puts `made` of `values` in their place; where the last are fewer than four, `filler` stands in for the others.
fn four_at_a_time(values: &mut [f64], filler: f64, made: impl Fn(f64x4) -> f64x4) {
    let (fours, rest) = values.as_chunks_mut::<4>();
    for four in fours {
        *four = made(f64x4::new(*four)).to_array();
    }
    if !rest.is_empty() {
        let mut four = [filler; 4];
        four[..rest.len()].copy_from_slice(rest);
        rest.copy_from_slice(&made(f64x4::new(four)).to_array()[..rest.len()]);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn they_are_those_of_the_standard_library_to_the_last_digits(
            values in prop::collection::vec(prop_oneof![Just(0.0), -1.0..1e-9_f64, 1e-12..1e9_f64], 1..11),
            exponent in 0.1..10.0_f64,
        ) {
            let mut raised = values.clone();
            powers(&mut raised, exponent);
            for (&value, &raised) in values.iter().zip(&raised) {
                let expected = value.max(0.0).powf(exponent);
                prop_assert!((raised - expected).abs() <= 1e-14 * expected, "{value}^{exponent}: {raised}, {expected}");
                let mut alone = [value];
                powers(&mut alone, exponent);
                prop_assert_eq!(alone[0].to_bits(), raised.to_bits());
            }
        }

        #[test]
        fn exponentials_are_too(values in prop::collection::vec(-800.0..300.0_f64, 1..11)) {
            let mut made = values.clone();
            exponentials(&mut made);
            for (&value, &made) in values.iter().zip(&made) {
                let expected = value.exp();
                let off = (made - expected).abs();
                prop_assert!(off <= 1e-14 * expected + f64::MIN_POSITIVE, "e^{value}: {made}, {expected}");
                prop_assert_eq!(exponential(value).to_bits(), made.to_bits());
            }
        }
    }
}
