//! Which threads come first on a busy computer.

use std::sync::Once;

use thread_priority::{
    NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue,
    ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};

/// Among what runs in real time: above audio, below the kernel's own threads (1 to 99).
const REAL_TIME: u8 = 60;
/// The crate's middle of 0 to 99 for ordinary threads: nice 0.
const ORDINARY: u8 = 50;
/// In the same measure, for work that gives way: nice 10.
const BACKGROUND: u8 = 25;
/// In the same measure, for what carries operators' messages: nice -10.
const AHEAD: u8 = 75;

/// The calling thread comes before all ordinary ones from now on, where the system permits it; where it does not, that is
/// said once. Only for threads that mostly wait, and never longer than a few ms.
pub fn real_time() {
    static SAID: Once = Once::new();
    if set(ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo), REAL_TIME).is_err() {
        SAID.call_once(|| {
            tracing::info!(
                "threads that speak to devices have no real-time priority, so other work on this computer may make them \
                 late; docs/hardware.md says how to permit it"
            );
        });
    }
}

/// The calling thread waits for its turn like any other: what a thread in real time starts is in real time too otherwise.
pub fn ordinary() {
    // The policy is set first; a nice value that may not be raised again stays as it is.
    let _ = set(ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other), ORDINARY);
}

/// The calling thread comes before ordinary ones from now on, where the system permits it: for threads that carry
/// messages and compute little.
pub fn ahead() {
    // Where it is not permitted it stays as it is.
    let _ = set(ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other), AHEAD);
}

/// The calling thread gives way to every ordinary one from now on: for work that takes seconds and that nobody steers by.
pub fn background() {
    // Whoever may not even lower it loses nothing but the order.
    let _ = set(ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other), BACKGROUND);
}

fn set(policy: ThreadSchedulePolicy, priority: u8) -> Result<(), thread_priority::Error> {
    let priority =
        ThreadPriorityValue::try_from(priority).map_or(ThreadPriority::Min, ThreadPriority::Crossplatform);
    set_thread_priority_and_policy(thread_native_id(), priority, policy)
}

#[cfg(test)]
mod tests {
    use thread_priority::{Error, thread_schedule_policy};

    use super::*;

    #[test]
    fn thread_comes_first_where_that_is_permitted_and_goes_back() {
        let policies = || {
            real_time();
            let first = thread_schedule_policy()?;
            ordinary();
            Ok::<_, Error>((first, thread_schedule_policy()?))
        };
        let (first, then) = std::thread::spawn(policies).join().unwrap().unwrap();
        let permitted =
            set(ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo), REAL_TIME).is_ok();
        ordinary();
        let realtime = matches!(first, ThreadSchedulePolicy::Realtime(_));
        assert_eq!(realtime, permitted);
        assert!(matches!(then, ThreadSchedulePolicy::Normal(_)));
    }
}
