//! A long command as another program sees it: one JSON object a line on standard output.
//!
//! - `{"event": "progress", "fraction": 0.25, "stage": "trials"}`: how far it is, ten times a second at most.
//! - `{"event": "metrics", "point": {"step": 7, "loss": 0.5}}`: a point of its curves, numbers by name.
//! - `{"event": "report", "report": {...}}`: what came out, once.
//!
//! What is meant for people stays on standard error. Whoever reads the events holds the command's standard input open:
//! the command ends when that ends, so that it does not outlive a program that was killed.

use std::{
    io::{Read as _, Write as _},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use serde::Serialize;
use serde_json::{Map, Value, json};

/// Progress is told this often at most; a change of stage at once.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);

static ARE_PRINTED: AtomicBool = AtomicBool::new(false);
static LAST: Mutex<Option<(Instant, String)>> = Mutex::new(None);

/// Prints events from now on, and ends the process when standard input ends.
///
/// # Errors
/// No thread can be had that watches standard input.
pub fn print_events() -> std::io::Result<()> {
    ARE_PRINTED.store(true, Ordering::Relaxed);
    let watch = || {
        let mut buffer = [0; 256];
        let mut input = std::io::stdin().lock();
        loop {
            match input.read(&mut buffer) {
                Ok(0) => break,
                Err(err) if err.kind() != std::io::ErrorKind::Interrupted => break,
                _ => {}
            }
        }
        std::process::exit(1);
    };
    std::thread::Builder::new().name("stdin".to_owned()).spawn(watch).map(drop)
}

/// Whether events are printed.
pub fn are_printed() -> bool {
    ARE_PRINTED.load(Ordering::Relaxed)
}

/// Tells how far the command is, if events are printed.
pub fn progress(fraction: f64, stage: &str) {
    if !are_printed() {
        return;
    }
    let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    let is_due =
        last.as_ref().is_none_or(|(when, before)| when.elapsed() >= PROGRESS_PERIOD || before != stage);
    if is_due {
        *last = Some((Instant::now(), stage.to_owned()));
        print(&json!({ "event": "progress", "fraction": fraction, "stage": stage }));
    }
}

/// Adds a point to the curves, if events are printed: the numbers of `values` by name, those of objects in it by both
/// names.
pub fn metrics(step: u64, values: &impl Serialize) {
    if are_printed() {
        print(&json!({ "event": "metrics", "point": point(step, values) }));
    }
}

/// Tells what came out, if events are printed.
pub fn report(report: &impl Serialize) {
    if are_printed() {
        print(&json!({ "event": "report", "report": value_of(report) }));
    }
}

fn point(step: u64, values: &impl Serialize) -> Value {
    let mut point = Map::new();
    collect("", &value_of(values), &mut point);
    point.insert("step".to_owned(), step.into());
    Value::Object(point)
}

fn value_of(values: &impl Serialize) -> Value {
    // Names and numbers always serialise.
    serde_json::to_value(values).unwrap_or(Value::Null)
}

fn collect(prefix: &str, value: &Value, point: &mut Map<String, Value>) {
    for (name, value) in value.as_object().into_iter().flatten() {
        let name = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        if value.is_number() {
            point.insert(name, value.clone());
        } else {
            collect(&name, value, point);
        }
    }
}

fn print(event: &Value) {
    let mut out = std::io::stdout().lock();
    if writeln!(out, "{event}").and_then(|()| out.flush()).is_err() {
        // Nobody reads them any more.
        std::process::exit(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_has_every_number_by_name_and_nothing_else() {
        let values = json!({
            "loss": 0.5, "label": "cube", "missing": null, "best": true,
            "terms": { "lift": 1.0, "deep": { "er": 2 } }, "list": [1, 2],
        });
        let expected = json!({ "loss": 0.5, "terms.lift": 1.0, "terms.deep.er": 2, "step": 7 });
        assert_eq!(point(7, &values), expected);
        assert_eq!(point(0, &Value::Null), json!({ "step": 0 }));
    }
}
