//! `palpate-rollout` without learned policies, which need a tensor library: to be killed or stopped by tests.

fn main() -> std::process::ExitCode {
    palpate_rollout::command("rollout")
}
