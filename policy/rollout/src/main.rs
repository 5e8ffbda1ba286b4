//! The `palpate-rollout` command: trials of a policy on the hand that a studio drives.

fn main() -> std::process::ExitCode {
    palpate_rollout::command("palpate-rollout")
}
