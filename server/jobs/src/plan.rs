//! Which jobs start next: a decision without a clock, a file or a process.

use std::collections::HashMap;

use palpate_wire::api::Resources;

use crate::{database::QueuedJob, runner::Capacity};

/// What running jobs hold.
#[derive(Debug, Default)]
pub(crate) struct Holdings {
    by_runner: HashMap<String, Held>,
    /// There is one station, whatever runner works with it.
    station: bool,
}

#[derive(Debug, Default)]
struct Held {
    /// Jobs that are not short.
    long_jobs: u32,
    cores: u32,
    gpu: bool,
    short_jobs: u32,
    /// A job waits for cores: none that came after it may take them.
    cores_are_awaited: bool,
}

impl Holdings {
    /// Adds what `job` holds. `capacity` is that of its runner.
    pub(crate) fn add(&mut self, job: &QueuedJob, capacity: Option<Capacity>) {
        self.station |= job.station;
        let held = self.by_runner.entry(job.runner.clone()).or_default();
        held.gpu |= job.gpu;
        if job.station {
            return;
        }
        if job.short {
            held.short_jobs += 1;
        } else {
            held.long_jobs += 1;
            // Of a runner with a queue of its own nobody adds them up: each of its jobs may want all that there are.
            held.cores = held.cores.saturating_add(cores_of(job, capacity));
        }
    }
}

fn cores_of(job: &QueuedJob, capacity: Option<Capacity>) -> u32 {
    let all = capacity.map_or(u32::MAX, |capacity| capacity.cores.max(1));
    if job.cores == 0 { all } else { job.cores.min(all) }
}

/// Shards of a divided job that work at once, on a runner of this `capacity`, in the cores that the job holds.
pub(crate) fn shards_at_once(resources: &Resources, capacity: Option<Capacity>) -> u32 {
    let wanted = resources.max_at_once();
    let Some(capacity) = capacity else { return wanted };
    if resources.cores == 0 || resources.gpu || resources.short {
        return 1;
    }
    let fit = capacity.cores / resources.cores;
    wanted.min(fit).max(1)
}

/// Ids of the jobs of `queue` that start now, in order. `queue` is sorted: who comes first, starts first, unless it
/// waits for something that the next one does not need. `capacity` is that of a runner by name; `None` for one that is
/// not there.
///
/// Short jobs have a lane of their own beside all cores, because they end before anybody misses what they take; the job on
/// the station has one too, because somebody stands beside the robot, and it mostly waits for them.
pub(crate) fn plan(
    queue: &[QueuedJob],
    holdings: &mut Holdings,
    capacity: impl Fn(&str) -> Option<Option<Capacity>>,
) -> Vec<String> {
    let mut started = Vec::new();
    for job in queue {
        // A runner that is not there any more may come back with the next start.
        let Some(capacity) = capacity(&job.runner) else { continue };
        if job.station && holdings.station {
            continue;
        }
        if let Some(capacity) = capacity {
            let held = holdings.by_runner.entry(job.runner.clone()).or_default();
            if job.gpu && (held.gpu || !capacity.gpu) {
                continue;
            }
            if job.station {
                // It needs nothing else.
            } else if job.short {
                if held.short_jobs >= capacity.short_jobs.max(1) {
                    continue;
                }
            } else {
                let fits = held.long_jobs == 0
                    || held.cores.saturating_add(cores_of(job, Some(capacity))) <= capacity.cores;
                if held.cores_are_awaited || !fits {
                    held.cores_are_awaited = true;
                    continue;
                }
            }
        }
        holdings.add(job, capacity);
        started.push(job.id.clone());
    }
    started
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::database::held_cores;

    const CAPACITY: Capacity = Capacity { cores: 8, gpu: true, short_jobs: 2 };

    fn job(id: &str, cores: u32) -> QueuedJob {
        QueuedJob {
            id: id.to_owned(),
            runner: "process".to_owned(),
            cores,
            gpu: false,
            station: false,
            short: false,
        }
    }

    fn started(queue: &[QueuedJob], running: &[QueuedJob]) -> Vec<String> {
        let mut holdings = Holdings::default();
        for job in running {
            holdings.add(job, Some(CAPACITY));
        }
        plan(queue, &mut holdings, |name| (name == "process").then_some(Some(CAPACITY)))
    }

    #[test]
    fn jobs_share_the_cores_and_nobody_is_overtaken_for_ever() {
        let queue = [job("a", 4), job("b", 6), job("c", 2)];
        assert_eq!(started(&queue, &[]), ["a"], "c would fit, but b waits for the cores first");
        assert_eq!(started(&queue[1..], &[]), ["b", "c"]);
        assert_eq!(started(&[job("all", 0)], &[job("a", 1)]), Vec::<String>::new());
        assert_eq!(started(&[job("huge", 100)], &[]), ["huge"], "it gets all that there are");
    }

    #[test]
    fn short_work_passes_long_work() {
        let short = |id: &str| QueuedJob { short: true, ..job(id, 0) };
        assert_eq!(started(&[short("s1"), short("s2"), short("s3")], &[job("a", 0)]), ["s1", "s2"]);
        assert_eq!(started(&[job("b", 0)], &[short("s1")]), ["b"], "nor does it hold long work up");
    }

    #[test]
    fn gpu_and_station_belong_to_one_job_at_a_time() {
        let gpu = |id: &str| QueuedJob { gpu: true, ..job(id, 1) };
        assert_eq!(started(&[gpu("a"), gpu("b"), job("c", 1)], &[]), ["a", "c"]);
        let station =
            |id: &str, runner: &str| QueuedJob { station: true, runner: runner.to_owned(), ..job(id, 1) };
        let mut holdings = Holdings::default();
        let queue = [
            station("a", "process"),
            station("b", "cluster"),
            QueuedJob { runner: "gone".into(), ..job("c", 1) },
        ];
        let by_name = |name: &str| match name {
            "process" => Some(Some(CAPACITY)),
            "cluster" => Some(None),
            _ => None,
        };
        assert_eq!(plan(&queue, &mut holdings, by_name), ["a"]);
    }

    #[test]
    fn nobody_beside_the_robot_waits_for_a_training() {
        let on_station = QueuedJob { station: true, ..job("trials", 1) };
        assert_eq!(started(std::slice::from_ref(&on_station), &[job("training", 0)]), ["trials"]);
        assert_eq!(started(&[job("training", 0)], &[on_station]), ["training"], "nor the other way round");
    }

    #[test]
    fn shards_stay_within_the_cores_of_their_job() {
        let at_once = |cores, shards, at_once| {
            let resources = Resources { cores, shards, at_once, ..Resources::default() };
            shards_at_once(&resources, Some(CAPACITY))
        };
        assert_eq!(at_once(2, 10, 0), 4);
        assert_eq!(at_once(2, 10, 3), 3);
        assert_eq!(at_once(3, 10, 0), 2, "2 cores are left over");
        assert_eq!((at_once(0, 10, 0), at_once(100, 10, 0)), (1, 1), "each takes all cores");
        let gpu = Resources { cores: 1, gpu: true, shards: 4, ..Resources::default() };
        assert_eq!((shards_at_once(&gpu, Some(CAPACITY)), shards_at_once(&gpu, None)), (1, 4));
        // Such a job holds the cores of all that work at once.
        let wide = Resources { cores: 2, shards: 3, ..Resources::default() };
        let held = QueuedJob { cores: held_cores(&wide), ..job("divided", 0) };
        assert_eq!(started(&[job("b", 3)], std::slice::from_ref(&held)), Vec::<String>::new());
        assert_eq!(started(&[job("b", 2)], &[held]), ["b"]);
    }

    #[test]
    fn cores_of_a_runner_with_a_queue_of_its_own_are_not_counted() {
        let all: Vec<QueuedJob> =
            ["a", "b", "c"].iter().map(|id| QueuedJob { runner: "cluster".into(), ..job(id, 0) }).collect();
        let mut holdings = Holdings::default();
        holdings.add(&all[0], None);
        assert_eq!(plan(&all[1..], &mut holdings, |_| Some(None)), ["b", "c"]);
    }

    proptest! {
        #[test]
        fn what_runs_never_needs_more_than_there_is_and_something_runs(
            wishes in proptest::collection::vec((0u32..12, any::<bool>(), any::<bool>(), any::<bool>()), 1..20),
        ) {
            let queue: Vec<QueuedJob> = wishes.iter().enumerate().map(|(idx, &(cores, gpu, station, short))| QueuedJob {
                gpu, station, short, ..job(&idx.to_string(), cores)
            }).collect();
            let started = started(&queue, &[]);
            let running: Vec<&QueuedJob> = queue.iter().filter(|job| started.contains(&job.id)).collect();
            prop_assert_eq!(&started[0], "0", "the first in the queue starts when nothing runs");
            let long: Vec<&&QueuedJob> = running.iter().filter(|job| !job.short && !job.station).collect();
            let cores: u32 = long.iter().map(|job| cores_of(job, Some(CAPACITY))).sum();
            prop_assert!(cores <= CAPACITY.cores);
            prop_assert!(running.iter().filter(|job| job.gpu).count() <= 1);
            prop_assert!(running.iter().filter(|job| job.station).count() <= 1);
            prop_assert!(running.iter().filter(|job| job.short && !job.station).count() <= CAPACITY.short_jobs as usize);
        }
    }
}
