//! `palpate retention`: what goes, and why.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use palpate_server::{Error, carry_out_retention, plan_retention};

use super::{Outcome, output, retention_days::RetentionArgs, serve::Config};

#[derive(Args)]
pub(crate) struct RetentionCommand {
    /// The data folder of `palpate serve` [default: the configuration's, or data]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Configuration file of `palpate serve`; what the command line says wins
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    days: RetentionArgs,
    /// Say what would go, and touch nothing
    #[arg(long)]
    dry_run: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &RetentionCommand) -> Outcome {
    let file = args.config.as_deref().map(Config::read).transpose()?.unwrap_or_default();
    let config = args.days.or(file.retention);
    let beside = |data: PathBuf| {
        let folder = args.config.as_deref().and_then(|path| path.parent());
        folder.map_or(data.clone(), |folder| folder.join(data))
    };
    let data = args.data.clone().or(file.data.map(beside)).unwrap_or_else(|| "data".into());
    if !config.is_on() {
        return Err(Error::Argument(
            "nothing is to go: give --jobs-days, --log-days or --trash-days, or a configuration with [retention] (--config)"
                .to_owned(),
        ));
    }
    let plan = plan_retention(&data, config, std::time::SystemTime::now())?;
    if !args.dry_run {
        carry_out_retention(&data, &plan)?;
    }
    if args.json {
        output::json(&plan)?;
        return Ok(ExitCode::SUCCESS);
    }
    for step in &plan.goes {
        let what = step.act.words(args.dry_run);
        output::line(&format!("{what} {} ({} kB): {}", step.path, step.bytes.div_ceil(1000), step.why))?;
    }
    for kept in &plan.stays {
        output::line(&format!("kept {}: {}", kept.path, kept.why))?;
    }
    let bytes: u64 = plan.goes.iter().map(|step| step.bytes).sum();
    let verb = if args.dry_run { "would go" } else { "gone" };
    output::line(&format!("{} entries, {:.1} MB {verb}", plan.goes.len(), bytes as f64 / 1e6))?;
    Ok(ExitCode::SUCCESS)
}
