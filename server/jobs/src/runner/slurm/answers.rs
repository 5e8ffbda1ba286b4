//! What Slurm's commands print.

use std::collections::HashMap;

/// What Slurm knows of a job.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Known {
    /// Slurm's number.
    pub(super) number: String,
    /// `PENDING`, `RUNNING`, `COMPLETED`...
    pub(super) state: String,
    /// Why it waits or failed.
    pub(super) reason: String,
}

impl Known {
    pub(super) fn is_waiting(&self) -> bool {
        matches!(
            self.state.as_str(),
            "PENDING" | "REQUEUED" | "REQUEUE_HOLD" | "SPECIAL_EXIT" | "RESV_DEL_HOLD"
        )
    }

    pub(super) fn is_running(&self) -> bool {
        matches!(
            self.state.as_str(),
            "RUNNING"
                | "CONFIGURING"
                | "COMPLETING"
                | "SUSPENDED"
                | "STOPPED"
                | "SIGNALING"
                | "STAGE_OUT"
                | "RESIZING"
        )
    }

    /// It is in nobody's way any more.
    pub(super) fn has_ended(&self) -> bool {
        !self.is_waiting() && !self.is_running()
    }

    /// Its process cannot have written how it ended.
    pub(super) fn ended_from_outside(&self) -> bool {
        matches!(self.state.as_str(), "NODE_FAIL" | "BOOT_FAIL" | "OUT_OF_MEMORY")
    }

    /// It is not the job's fault that it ended.
    pub(super) fn is_worth_another_attempt(&self) -> bool {
        matches!(self.state.as_str(), "NODE_FAIL" | "BOOT_FAIL" | "PREEMPTED" | "REVOKED")
    }
}

/// Jobs by name, from `squeue --array --format=%i|%T|%r|%j`; tasks of an array by name and index, `NAME_INDEX`. Of several
/// of one name the newest counts.
pub(super) fn parse_queue(text: &str) -> HashMap<String, Known> {
    let mut jobs: HashMap<String, Known> = HashMap::new();
    for line in text.lines() {
        let mut fields = line.trim().splitn(4, '|');
        let (Some(number), Some(state), Some(reason), Some(name)) =
            (fields.next(), fields.next(), fields.next(), fields.next())
        else {
            continue;
        };
        let order = |number: &str| number.split('_').next().and_then(|number| number.parse::<u64>().ok());
        let name = match number.split_once('_') {
            Some((_, idx)) if idx.bytes().all(|byte| byte.is_ascii_digit()) => format!("{name}_{idx}"),
            _ => name.to_owned(),
        };
        if jobs.get(&name).is_some_and(|known| order(&known.number) > order(number)) {
            continue;
        }
        let known = Known { number: number.to_owned(), state: state.to_owned(), reason: reason.to_owned() };
        jobs.insert(name, known);
    }
    jobs
}

/// Name and state of a job, from `scontrol --oneliner show job NUMBER`.
pub(super) fn parse_show_job(text: &str) -> Option<(String, Known)> {
    let line = text.lines().next()?;
    let field = |name: &str| {
        line.split_ascii_whitespace().find_map(|word| word.strip_prefix(name)?.strip_prefix('='))
    };
    let exit = field("ExitCode").map(|code| format!(", exit code {code}")).unwrap_or_default();
    let known = Known {
        number: field("JobId")?.to_owned(),
        state: field("JobState")?.to_owned(),
        reason: format!("{}{exit}", field("Reason").unwrap_or("no reason")),
    };
    Some((field("JobName")?.to_owned(), known))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queue_is_read_by_name_and_the_newest_number_counts() {
        let jobs = parse_queue(
            "16|COMPLETED|None|palpate-ab-run-1-1\n17|PENDING|Resources|palpate-ab-run-2-1\n\
             9|FAILED|NonZeroExitCode|palpate-ab-run-1-1\n18_[0-5%2]|PENDING|None|other|with|bars\n\n",
        );
        assert_eq!(jobs.len(), 3);
        assert_eq!(jobs["palpate-ab-run-1-1"].state, "COMPLETED");
        assert!(jobs["palpate-ab-run-2-1"].is_waiting());
        assert_eq!(jobs["other|with|bars"].number, "18_[0-5%2]");
    }

    #[test]
    fn tasks_of_an_array_are_told_apart_and_each_newest_counts() {
        let name = "palpate-ab-blind-1-shards-1";
        let jobs = parse_queue(&format!(
            "20_0|RUNNING|None|{name}\n20_1|NODE_FAIL|None|{name}\n20_2|PENDING|JobArrayTaskLimit|{name}\n\
             22_1|PENDING|Priority|palpate-ab-blind-1-shards-2\n19_0|CANCELLED|None|{name}\n"
        ));
        assert_eq!(jobs.len(), 4);
        assert!(jobs[&format!("{name}_0")].is_running());
        assert!(jobs[&format!("{name}_1")].is_worth_another_attempt());
        assert!(jobs[&format!("{name}_2")].is_waiting());
        assert_eq!(jobs["palpate-ab-blind-1-shards-2_1"].number, "22_1");
    }

    #[test]
    fn shown_job_says_its_name_state_and_exit_code() {
        // As Slurm 22.05 prints it.
        let text = "JobId=7 JobName=palpate-ab-run-1-1 UserId=root(0) GroupId=root(0) MCS_label=N/A Priority=4294901754 \
                    Nice=0 Account=(null) QOS=(null) JobState=FAILED Reason=NonZeroExitCode Dependency=(null) Requeue=0 \
                    Restarts=0 BatchFlag=1 Reboot=0 ExitCode=7:0 RunTime=00:00:01 TimeLimit=UNLIMITED\n";
        let (name, known) = parse_show_job(text).unwrap();
        assert_eq!(name, "palpate-ab-run-1-1");
        assert_eq!((known.number.as_str(), known.state.as_str()), ("7", "FAILED"));
        assert_eq!(known.reason, "NonZeroExitCode, exit code 7:0");
        assert!(!known.is_waiting() && !known.is_running() && !known.is_worth_another_attempt());
        assert_eq!(parse_show_job("slurm_load_jobs error: Invalid job id specified"), None);
    }
}
