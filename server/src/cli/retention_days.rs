//! For how long things are kept, on the command line.

use clap::Args;
use palpate_server::RetentionConfig;

/// Numbers of days, as the configuration has them.
#[derive(Args)]
pub(crate) struct RetentionArgs {
    /// Jobs that ended longer ago than this go to the trash, unless something refers to them [default: none goes]
    #[arg(long, value_name = "DAYS")]
    jobs_days: Option<u32>,
    /// Logs and curves of jobs that ended longer ago than this are deleted [default: none is]
    #[arg(long, value_name = "DAYS")]
    log_days: Option<u32>,
    /// What has been in the trash for longer than this is deleted [default: nothing is]
    #[arg(long, value_name = "DAYS")]
    trash_days: Option<u32>,
}

impl RetentionArgs {
    pub(crate) fn config(&self) -> RetentionConfig {
        RetentionConfig { jobs_days: self.jobs_days, log_days: self.log_days, trash_days: self.trash_days }
    }

    /// Takes what is not given from `config`.
    pub(crate) fn fill_in(&mut self, config: RetentionConfig) {
        self.jobs_days = self.jobs_days.or(config.jobs_days);
        self.log_days = self.log_days.or(config.log_days);
        self.trash_days = self.trash_days.or(config.trash_days);
    }

    pub(super) fn or(&self, config: RetentionConfig) -> RetentionConfig {
        RetentionConfig {
            jobs_days: self.jobs_days.or(config.jobs_days),
            log_days: self.log_days.or(config.log_days),
            trash_days: self.trash_days.or(config.trash_days),
        }
    }
}
