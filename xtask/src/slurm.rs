//! Slurm, for the tests that run jobs on a cluster of one node.

use std::path::Path;

use anyhow::Context as _;

use crate::{shell, skip};

/// What the tests start; the packages start nothing by themselves where there is no init system.
const PROGRAMS: [&str; 4] =
    ["/usr/sbin/slurmctld", "/usr/sbin/slurmd", "/usr/bin/sbatch", "/usr/sbin/munged"];

/// Installs Slurm where it is missing, unless `PALPATE_SKIP` names it.
pub(crate) fn install() -> anyhow::Result<()> {
    if skip::names("slurm") || PROGRAMS.iter().all(|program| Path::new(program).exists()) {
        return Ok(());
    }
    shell::install_debian_packages(
        &["slurmctld", "slurmd", "slurm-client", "munge"],
        "running jobs on a test cluster",
    )
    .context("PALPATE_SKIP=slurm leaves these tests out")
}
