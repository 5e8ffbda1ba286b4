//! What of the machine this process uses, and what others leave it.

use std::{collections::BTreeMap, fs};

/// Processor time that this process has used so far by thread name and number, s; empty where there is no `/proc`.
pub(super) fn cpu_seconds() -> BTreeMap<(String, String), f64> {
    /// Ticks of `/proc` on every Linux.
    const TICKS_PER_S: f64 = 100.0;
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let used = tasks.filter_map(|task| {
        let text = fs::read_to_string(task.path().join("stat")).ok()?;
        // The name stands in brackets and may hold anything.
        let (start, rest) = text.rsplit_once(") ")?;
        let name = start.split_once('(')?.1.to_owned();
        let fields: Vec<&str> = rest.split(' ').collect();
        let ticks = fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
        Some(((name, task.file_name().to_string_lossy().into_owned()), ticks / TICKS_PER_S))
    });
    used.collect()
}

/// Processor time by thread name, s.
pub(super) fn cpu_difference(
    before: &BTreeMap<(String, String), f64>,
    after: &BTreeMap<(String, String), f64>,
) -> BTreeMap<String, f64> {
    let mut used = BTreeMap::new();
    for (thread, seconds) in after {
        let since = before.get(thread).copied().unwrap_or(0.0);
        *used.entry(thread.0.clone()).or_insert(0.0) += seconds - since;
    }
    used
}

/// Processes that wanted to run in the last minute; 0 where there is no `/proc`.
pub(in super::super) fn load_average() -> f64 {
    let text = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().and_then(|first| first.parse().ok()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_is_counted_by_thread_name() {
        let thread = |name: &str, id: &str| (name.to_owned(), id.to_owned());
        let before = BTreeMap::from([(thread("control", "7"), 1.0), (thread("worker", "8"), 2.0)]);
        let after = BTreeMap::from([
            (thread("control", "7"), 1.5),
            (thread("worker", "8"), 3.0),
            (thread("worker", "9"), 0.25),
        ]);
        let used = cpu_difference(&before, &after);
        assert_eq!(used, BTreeMap::from([("control".to_owned(), 0.5), ("worker".to_owned(), 1.25)]));
    }
}
