//! What is wrong with the axes of taxels.

use palpate_reports::Severity;

use crate::{StreamLog, Take, format::axes_topic};

/// Problems of what the axes of `take`'s streams measured, with their places; none of streams of one axis.
pub(crate) fn problems(take: &Take) -> Vec<(Severity, String, String)> {
    let layout = &take.station.layout;
    let mut problems = Vec::new();
    for (stream, log) in layout.streams.iter().zip(&take.streams) {
        let (num_axes, num_channels) = (stream.axes.count(), stream.channels.len());
        if num_axes == 1 || log.raw.is_empty() {
            continue;
        }
        let mut warn = |place: String, problem: String| problems.push((Severity::Warning, place, problem));
        let StreamLog { axes, .. } = log;
        if axes.times_s != log.times_s {
            let problem = format!(
                "{} samples of the {num_axes} axes for {} readings that were made of them; the readings count, and what the axes \
                 measured is lost in between",
                axes.times_s.len(),
                log.times_s.len()
            );
            warn(axes_topic(&stream.id), problem);
        }
        if axes.times_s.len() < 2 {
            continue;
        }
        for cell in 0..num_channels * num_axes {
            let mut values = axes.values.iter().skip(cell).step_by(num_channels * num_axes);
            let first = values.next();
            if values.all(|value| Some(value) == first) {
                let id = layout.axis_id(stream.channels.start + cell / num_axes, cell % num_axes);
                warn(id, "this axis never changes; is it connected?".to_owned());
            }
        }
    }
    problems
}
