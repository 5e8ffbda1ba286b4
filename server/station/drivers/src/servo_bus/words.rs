//! What is wrong with the servos, in words for the operator, with what to do.

use std::path::Path;
use std::time::Duration;

use palpate_device_protocol::dynamixel::HardwareError;

use super::line::latency_timer_ms;

/// Answers that take longer than this on average are held back by somebody.
const SLOW_ANSWER: Duration = Duration::from_millis(6);

/// A servo's hardware errors; empty for none.
pub(crate) fn hardware_error(error: HardwareError) -> String {
    [
        (
            HardwareError::INPUT_VOLTAGE,
            "its supply voltage is out of range: check the 5 V supply and its connectors (3.7 to 6.0 V at the servo)",
        ),
        (
            HardwareError::OVERHEATING,
            "overheating: let it cool below its limit, then clear the fault; grasp with less current",
        ),
        (HardwareError::MOTOR_ENCODER, "its encoder fails: clear the fault; if it comes back, replace the servo"),
        (
            HardwareError::ELECTRICAL_SHOCK,
            "its electronics had a shock or too weak a supply: check the supply, then clear the fault",
        ),
        (
            HardwareError::OVERLOAD,
            "overload, it pushed for too long and switched itself off: free the joint, then clear the fault",
        ),
    ]
    .into_iter()
    .filter_map(|(fault, text)| error.contains(fault).then_some(text))
    .collect::<Vec<_>>()
    .join("; ")
}

/// A servo that does not answer.
pub(crate) fn missing() -> &'static str {
    "does not answer: check that its cable is plugged in on both ends, that it has power (its LED flashes once at \
     power-up), and that its id and baud rate are those of the station file"
}

/// A servo of a make that the driver does not know.
pub(crate) fn unknown_model(number: u16) -> String {
    format!(
        "is of model {number}, expected an XL330-M288 (1200) or XC330-M288 (1240); its units may differ, so it is not \
         driven"
    )
}

/// A port that cannot be opened.
pub(crate) fn cannot_open(path: &Path, error: &serialport::Error) -> String {
    let advice = match error.kind() {
        serialport::ErrorKind::NoDevice if !path.exists() => {
            "there is no such port: plug the adapter in, or correct `port` in the station file"
        }
        serialport::ErrorKind::NoDevice => "another program has it open: close that program",
        serialport::ErrorKind::Io(std::io::ErrorKind::NotFound) => {
            "there is no such port: plug the adapter in, or correct `port` in the station file"
        }
        serialport::ErrorKind::Io(std::io::ErrorKind::PermissionDenied) => {
            "no permission: add yourself to the group `dialout` and log in again"
        }
        _ => "unplug the adapter and plug it in again",
    };
    format!("failed to open {path:?}: {error}: {advice}")
}

/// What slows the line down, if anything does.
pub(crate) fn slow_line(path: &Path, mean_delay: Option<Duration>) -> Option<String> {
    let timer = latency_timer_ms(path);
    if let Some((file, timer_ms)) = &timer
        && *timer_ms > 1
    {
        return Some(format!(
            "the adapter holds answers back for up to {timer_ms} ms; mend it with: echo 1 | sudo tee {file} (see \
             docs/hardware.md for doing so at every start)"
        ));
    }
    let delay = mean_delay.filter(|&delay| delay > SLOW_ANSWER)?;
    Some(format!(
        "answers take {:.1} ms, expected 1 to 2: set the adapter's latency timer to 1 ms (docs/hardware.md), and use no \
         USB hub",
        delay.as_secs_f64() * 1e3
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_hardware_error_says_what_to_do() {
        for bit in [0, 2, 3, 4, 5] {
            let text = hardware_error(HardwareError(1 << bit));
            assert!(text.contains(": "), "{text}");
        }
        assert!(hardware_error(HardwareError(0)).is_empty());
        let both = hardware_error(HardwareError(HardwareError::OVERLOAD.0 | HardwareError::OVERHEATING.0));
        assert!(both.contains("overheating") && both.contains("overload"), "{both}");
    }

    #[test]
    fn a_slow_line_without_a_latency_timer_is_told_by_its_answers() {
        let path = Path::new("/no/such/port");
        assert_eq!(slow_line(path, None), None);
        assert_eq!(slow_line(path, Some(Duration::from_millis(2))), None);
        assert!(
            slow_line(path, Some(Duration::from_millis(16))).is_some_and(|text| text.contains("16.0 ms"))
        );
    }
}
