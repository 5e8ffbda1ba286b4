//! Plans motions that touch every channel: contact postures, primitives, joint paths.
//!
//! A [`Plan`] says what a calibration session is: where objects stand and which take touches what, with which
//! [`Primitive`]. [`plan_take`] turns one of its takes into a [`TakeMotion`], joint positions at any time; with
//! [`MotionLimits`] it is as slow as a real robot wants it. Carriers (an arm, a gantry) bring a taxel to the object's
//! surface, limbs (the joints between carrier and taxel) take a posture and sometimes press by themselves; nothing here
//! knows a particular robot, moves one, or reads a clock.

mod plan;
mod primitive;

mod closing;
mod contact;
mod limits;
mod path;
mod planner;
mod scene;
mod touch;

mod experiment;
mod first_plan;
mod text;

mod coverage;
mod error;

pub use coverage::{ChannelCoverage, coverage};
pub use error::PlanError;
pub use experiment::{Experiment, experiment_plan};
pub use first_plan::{FirstPlan, ObjectInPlan, first_plan};
pub use limits::MotionLimits;
pub use plan::{MotionConfig, Plan, PlannedTake, channel_named};
pub use planner::{TakeMotion, plan_approach, plan_in, plan_take};
pub use primitive::{Actuator, Motion, Primitive, Primitives, Speed};
pub use scene::Scene;
pub use text::plan_text;
