//! Units of columns: which there are, how a header states one, and what turns one into another.

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Angle,
    Length,
    Time,
    Voltage,
    Pressure,
    Force,
}

/// Spelling, quantity, and how many of it make one of the quantity's base unit. Numbers that divide keep decimal
/// fractions as near to what was written as a double can be.
const UNITS: &[(&str, Quantity, f64)] = &[
    ("rad", Quantity::Angle, 1.0),
    ("mrad", Quantity::Angle, 1e3),
    ("deg", Quantity::Angle, 180.0 / std::f64::consts::PI),
    ("m", Quantity::Length, 1.0),
    ("cm", Quantity::Length, 1e2),
    ("mm", Quantity::Length, 1e3),
    ("um", Quantity::Length, 1e6),
    ("s", Quantity::Time, 1.0),
    ("ms", Quantity::Time, 1e3),
    ("us", Quantity::Time, 1e6),
    ("ns", Quantity::Time, 1e9),
    ("V", Quantity::Voltage, 1.0),
    ("mV", Quantity::Voltage, 1e3),
    ("uV", Quantity::Voltage, 1e6),
    ("Pa", Quantity::Pressure, 1.0),
    ("hPa", Quantity::Pressure, 1e-2),
    ("kPa", Quantity::Pressure, 1e-3),
    ("N", Quantity::Force, 1.0),
    ("mN", Quantity::Force, 1e3),
];

/// The unit of `spelling`, in the spelling of the table.
pub(super) fn known(spelling: &str) -> Option<&'static str> {
    let spelling = match spelling {
        "degrees" | "degree" | "°" => "deg",
        "radians" | "radian" => "rad",
        "sec" | "seconds" => "s",
        "µs" | "μs" => "us",
        other => other,
    };
    UNITS.iter().map(|&(unit, ..)| unit).find(|&unit| unit == spelling)
}

/// `value` of unit `from` in unit `to`; `None` where these are units of different things, or one is unknown. The same
/// spelling is the same unit, whatever it is: `counts`.
pub(super) fn converted(value: f64, from: &str, to: &str) -> Option<f64> {
    if from == to {
        return Some(value);
    }
    let entry = |spelling: &str| {
        let unit = known(spelling)?;
        UNITS.iter().find(|&&(name, ..)| name == unit)
    };
    let (&(from, quantity, per_from), &(to, other, per_to)) = (entry(from)?, entry(to)?);
    if quantity != other {
        return None;
    }
    Some(if from == to { value } else { value / per_from * per_to })
}

/// Seconds of a whole number of a smaller `unit` of time, exactly as near as a double can be: wall-clock times in ns
/// have more digits than one. `None` for other units.
pub(super) fn whole_seconds(number: i64, unit: &str) -> Option<f64> {
    let per_second = match unit {
        "ms" => 1_000,
        "us" => 1_000_000,
        "ns" => 1_000_000_000,
        _ => return None,
    };
    Some(number.div_euclid(per_second) as f64 + number.rem_euclid(per_second) as f64 / per_second as f64)
}

/// Units that can be converted to `to`, for messages.
pub(super) fn convertible_to(to: &str) -> String {
    let mut names = vec![to];
    names.extend(
        UNITS.iter().map(|&(name, ..)| name).filter(|&name| name != to && converted(1.0, name, to).is_some()),
    );
    names.join(", ")
}

/// A header as the name and the unit it states: `curl [deg]`, `curl (deg)`, `curl_deg`.
///
/// `after_underscore` says whether the unit may follow an underscore, which some names have of their own.
pub(super) fn split(header: &str, after_underscore: bool) -> (&str, Option<&str>) {
    let header = header.trim();
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some((name, unit)) = header.strip_suffix(close).and_then(|rest| rest.rsplit_once(open)) {
            return (name.trim_end().trim_end_matches('_'), Some(unit.trim()));
        }
    }
    if after_underscore
        && let Some((name, unit)) = header.rsplit_once('_')
        && (known(unit).is_some() || unit == "counts")
    {
        return (name, Some(unit));
    }
    (header, None)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn there_and_back_is_where_it_began(value in -1e9..1e9_f64, from in 0..UNITS.len(), to in 0..UNITS.len()) {
            let (from, to) = (UNITS[from].0, UNITS[to].0);
            match converted(value, from, to) {
                Some(there) => {
                    let back = converted(there, to, from).unwrap();
                    prop_assert!((back - value).abs() <= 4.0 * f64::EPSILON * value.abs(), "{value} {from} {there} {to} {back}");
                }
                None => prop_assert!(converted(value, to, from).is_none()),
            }
        }
    }

    #[test]
    fn known_values_are_converted() {
        for (value, from, to, expected) in [
            (180.0, "deg", "rad", std::f64::consts::PI),
            (25.0, "ms", "s", 0.025),
            (12.5, "mm", "m", 0.0125),
            (3.3, "V", "mV", 3300.0),
            (10.0, "kPa", "Pa", 10_000.0),
            (7.0, "counts", "counts", 7.0),
        ] {
            assert_eq!(converted(value, from, to), Some(expected), "{value} {from}");
        }
        assert_eq!(whole_seconds(1_700_000_000_250_000_000, "ns"), Some(1_700_000_000.25));
        assert_eq!((whole_seconds(-1_500, "ms"), whole_seconds(3, "s")), (Some(-1.5), None));
        assert_eq!(converted(1.0, "deg", "m"), None);
        assert_eq!(converted(1.0, "furlong", "m"), None);
        assert_eq!(convertible_to("m"), "m, cm, mm, um");
    }

    #[test]
    fn headers_state_units() {
        assert_eq!(split("curl [deg]", true), ("curl", Some("deg")));
        assert_eq!(split(" curl(rad) ", false), ("curl", Some("rad")));
        assert_eq!(split("curl_mm", true), ("curl", Some("mm")));
        assert_eq!(split("curl_mm", false), ("curl_mm", None));
        assert_eq!(split("index_side", true), ("index_side", None));
        assert_eq!(split("tip.0_counts", true), ("tip.0", Some("counts")));
        assert_eq!(split("t_(ms)", true), ("t", Some("ms")));
    }
}
