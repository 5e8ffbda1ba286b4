//! Processes as the operating system knows them, so that a number is never taken for the process that had it before.

use std::fs;

/// When process `pid` began, clock ticks since boot; `None` if there is none, or it has ended and only waits to be
/// noticed.
pub(crate) fn start_ticks(pid: u32) -> Option<u64> {
    start_ticks_of(&fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
}

/// The same from the text of `/proc/PID/stat`. The name, in parentheses, may hold anything.
fn start_ticks_of(stat: &str) -> Option<u64> {
    let after_name = stat.rsplit_once(')')?.1;
    let mut fields = after_name.split_ascii_whitespace();
    let state = fields.next()?;
    // The state is field 3 of proc(5), the start time field 22.
    let ticks = fields.nth(18)?.parse().ok()?;
    (!matches!(state, "Z" | "X" | "x")).then_some(ticks)
}

/// Id of this boot of the computer; empty where there is none.
pub(crate) fn boot_id() -> String {
    fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default().trim().to_owned()
}

/// Name of this computer.
pub(crate) fn host() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn start_time_is_found_behind_any_name() {
        let stat =
            "7 (a) b (c)) S 1 7 7 0 -1 4194560 1 2 3 4 5 6 7 8 20 0 1 0 12345 999 888 1844674407370955";
        assert_eq!(start_ticks_of(stat), Some(12345));
        assert_eq!(
            start_ticks_of(&stat.replace(" S ", " Z ")),
            None,
            "one that has ended is no process any more"
        );
        assert_eq!(start_ticks_of("7 (sh"), None);
        let own = start_ticks(std::process::id()).unwrap();
        assert_eq!(start_ticks(std::process::id()), Some(own));
        assert_eq!(start_ticks(u32::MAX), None);
    }
}
