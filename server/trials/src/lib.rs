//! Campaigns: policies tried on the hand, object by object, scored by people, counted as the field counts.
//!
//! A campaign is a folder: `campaign.json` holds the plan, which never changes; `log.jsonl` holds what happened, a line each,
//! on disk before anybody is told so. Everything else follows from the two: [`Campaigns`] reads them, checks what somebody
//! wants to add, and computes [`palpate_wire::api::CampaignResults`]. Nothing here moves a robot.

mod beside;
mod campaign;
mod error;
mod log;
mod plan;
mod results;
mod store;
mod tables;

pub use beside::paired;
pub use campaign::Viewer;
pub use error::TrialsError;
pub use plan::{MAX_TRIALS, PlannedTrial, check_plan, start_of, trials_of};
pub use store::{Campaigns, campaign_of_folder, results_of_folder};
pub use tables::{Format, render};
