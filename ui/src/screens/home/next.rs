//! Decides what is to be done next, from what there is. Pure: it draws nothing and asks for nothing.

use palpate_wire::api::{CampaignSummary, JobState, ModelSummary, Role, Run, SessionSummary};

use crate::{
    route::{Route, Screen},
    screens::{controls::OfSession, jobs::waits_text},
};

/// What the decision needs to know.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Facts {
    /// What whoever sits here may do; `None` until it is known.
    pub role: Option<Role>,
    /// A live station takes commands.
    pub commandable: bool,
    /// A session is being recorded.
    pub recording: bool,
    /// Takes that a diagnosis asked for.
    pub wanted: usize,
    /// The newest session that can be opened, holds takes and is not being recorded.
    pub newest: Option<SessionFacts>,
    /// Campaigns that can be read, newest first.
    pub campaigns: Vec<CampaignFacts>,
    /// Ids of the jobs that work now, as far as they are known.
    pub working: Vec<String>,
}

/// The newest session and what was made of it.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct SessionFacts {
    /// Its id.
    pub id: String,
    /// The newest calibration on it.
    pub calibration: Option<RunFacts>,
    /// The newest diagnosis of it.
    pub diagnosis: Option<RunFacts>,
    /// A saved model that was fitted to it.
    pub model: Option<String>,
    /// Effects that the newest diagnosis named; `None` where that is not known.
    pub num_named: Option<usize>,
}

/// A run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunFacts {
    /// Its id.
    pub id: String,
    /// Where it stands.
    pub state: JobState,
    /// The model that was made of it.
    pub saved_as: Option<String>,
}

/// A campaign.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct CampaignFacts {
    /// Its id.
    pub id: String,
    /// Its name.
    pub name: String,
    /// Trials in all.
    pub planned: u32,
    /// Trials that have a verdict.
    pub scored: u32,
    /// Trials that wait for a score.
    pub to_score: u32,
    /// Nothing more is done in it.
    pub is_closed: bool,
}

/// Something to do.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Go on with the session that is being recorded.
    GoOnRecording,
    /// Record a session.
    Record,
    /// Bring in a session.
    Import,
    /// Fit the sensor model to a session.
    Calibrate {
        /// Id of the session.
        session: String,
    },
    /// Keep what a calibration found.
    SaveModel {
        /// Id of the session.
        session: String,
        /// Id of the calibration.
        run: String,
    },
    /// Name what the model lacks.
    Diagnose {
        /// Id of the session.
        session: String,
        /// Id of the model to start from.
        model: Option<String>,
    },
    /// Look at the effects that a diagnosis named, and add them.
    LookAtNames {
        /// Id of the session.
        session: String,
        /// Id of the diagnosis.
        run: String,
        /// How many.
        num_named: usize,
    },
    /// Watch a run that works, or waits for its turn.
    Watch {
        /// Where it is shown.
        screen: Screen,
        /// Id of the session.
        session: String,
        /// Id of the run.
        run: String,
        /// It waits, while these jobs work; `None` once it works.
        waits_for: Option<Vec<String>>,
    },
    /// Record what a diagnosis asked for.
    RecordWanted(usize),
    /// Score trials.
    Score(CampaignFacts),
    /// Make trials.
    RunTrials(CampaignFacts),
    /// Try policies.
    PlanCampaign,
}

impl Step {
    /// What it says: why it is next.
    pub fn sentence(&self) -> String {
        match self {
            Self::GoOnRecording => "A session is being recorded.".into(),
            Self::Record => {
                "Record a session: takes of the hand touching known objects. Calibration and diagnosis start \
                from one."
                    .into()
            }
            Self::Import => "Bring in a session that was recorded elsewhere.".into(),
            Self::Calibrate { session } => {
                format!("No sensor model was fitted to session {session} yet.")
            }
            Self::SaveModel { session, run } => {
                format!(
                    "Calibration {run} on session {session} is done. See what it found, and keep it as a model."
                )
            }
            Self::Diagnose { session, model } => match model {
                Some(model) => {
                    format!("Model {model} was fitted to session {session}. Find out what it still lacks.")
                }
                None => format!("Session {session} is calibrated. Find out what the model still lacks."),
            },
            Self::LookAtNames { session, num_named, .. } => {
                let effects =
                    if *num_named == 1 { "1 effect".to_owned() } else { format!("{num_named} effects") };
                format!(
                    "The diagnosis of session {session} named {effects}. See them, and add what convinces you."
                )
            }
            Self::Watch { session, run, waits_for: Some(working), .. } => {
                waits_text(&format!("{run} on session {session}"), working)
            }
            Self::Watch { session, run, waits_for: None, .. } => format!("{run} works on session {session}."),
            Self::RecordWanted(1) => "A diagnosis asked for one more take.".into(),
            Self::RecordWanted(takes) => format!("A diagnosis asked for {takes} more takes."),
            Self::Score(campaign) => match campaign.to_score {
                1 => format!("1 trial of {} waits for a score.", campaign.name),
                several => format!("{several} trials of {} wait for a score.", campaign.name),
            },
            Self::RunTrials(campaign) => {
                format!(
                    "{}: {} of {} trials have a verdict.",
                    campaign.name, campaign.scored, campaign.planned
                )
            }
            Self::PlanCampaign => "Try policies on the hand: plan a campaign.".into(),
        }
    }

    /// What its button says.
    pub fn button(&self) -> String {
        match self {
            Self::GoOnRecording => "Go on recording".into(),
            Self::Record => "Record a session".into(),
            Self::Import => "Bring in a session".into(),
            Self::Calibrate { session } => format!("Calibrate on {session}"),
            Self::SaveModel { .. } => "See the calibration".into(),
            Self::Diagnose { session, .. } => format!("Diagnose {session}"),
            Self::LookAtNames { .. } => "See what was named".into(),
            Self::Watch { run, .. } => format!("Watch {run}"),
            Self::RecordWanted(_) => "Record what is wanted".into(),
            Self::Score(_) => "Score trials".into(),
            Self::RunTrials(_) => "Go on with the trials".into(),
            Self::PlanCampaign => "Plan a campaign".into(),
        }
    }

    /// The least that whoever does it must be.
    pub fn role(&self) -> Role {
        match self {
            Self::Watch { .. } | Self::LookAtNames { .. } | Self::SaveModel { .. } => Role::Viewer,
            Self::Score(_) => Role::Scorer,
            _ => Role::Operator,
        }
    }

    /// Where it is done. Calibrations and diagnoses are started from Home; this is where they are set up.
    pub fn route(&self) -> Route {
        let run = |screen, session: &String, run: &String| Route {
            run: Some(run.clone()),
            ..Route::to(screen).with_session(session.clone())
        };
        let campaign = |campaign: &CampaignFacts, part: &str| Route {
            campaign: Some(campaign.id.clone()),
            part: Some(part.to_owned()),
            ..Route::to(Screen::Trials)
        };
        match self {
            Self::GoOnRecording | Self::Record | Self::RecordWanted(_) => Route::to(Screen::Record),
            Self::Import => Route::to(Screen::Sessions),
            Self::Calibrate { session } => Route::to(Screen::Calibrate).with_session(session.clone()),
            Self::SaveModel { session, run: id } => run(Screen::Calibrate, session, id),
            Self::Diagnose { session, .. } => Route::to(Screen::Diagnose).with_session(session.clone()),
            Self::LookAtNames { session, run: id, .. } => run(Screen::Diagnose, session, id),
            Self::Watch { screen, session, run: id, .. } => run(*screen, session, id),
            Self::Score(facts) => campaign(facts, "score"),
            Self::RunTrials(facts) => campaign(facts, "run"),
            Self::PlanCampaign => Route::to(Screen::Trials),
        }
    }
}

/// What is to be done, most pressing first. Nothing is in it that whoever sits here may not do; whoever may operate always
/// has something to do.
pub fn steps(facts: &Facts) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut running = Vec::new();
    if facts.recording && facts.commandable {
        steps.push(Step::GoOnRecording);
    }
    match &facts.newest {
        None => {
            if facts.commandable && !facts.recording {
                steps.push(Step::Record);
            }
            steps.push(Step::Import);
        }
        Some(session) => match of_session(session, &facts.working) {
            Some(step @ Step::Watch { .. }) => running.push(step),
            Some(step) => steps.push(step),
            None => {}
        },
    }
    for campaign in facts.campaigns.iter().filter(|campaign| !campaign.is_closed) {
        if campaign.to_score > 0 {
            steps.push(Step::Score(campaign.clone()));
        }
        // Trials that wait for a score have been made.
        if campaign.scored + campaign.to_score < campaign.planned {
            steps.push(Step::RunTrials(campaign.clone()));
        }
    }
    steps.append(&mut running);
    if facts.wanted > 0 && facts.commandable && !facts.recording {
        steps.push(Step::RecordWanted(facts.wanted));
    }
    if facts.newest.is_some() && facts.campaigns.is_empty() {
        steps.push(Step::PlanCampaign);
    }
    let role = facts.role;
    steps.retain(|step| role.is_some_and(|role| role >= step.role()));
    let operates = role.is_some_and(|role| role >= Role::Operator);
    if steps.is_empty() && operates {
        steps.push(if facts.commandable { Step::Record } else { Step::Import });
    }
    steps
}

/// The next step on the way of one session: calibrate, keep, diagnose, look.
fn of_session(session: &SessionFacts, working: &[String]) -> Option<Step> {
    let id = session.id.clone();
    let watch = |screen, run: &RunFacts| {
        let waits_for = (run.state == JobState::Queued).then(|| working.to_vec());
        Step::Watch { screen, session: session.id.clone(), run: run.id.clone(), waits_for }
    };
    let works = |run: &&RunFacts| matches!(run.state, JobState::Queued | JobState::Running);
    let is_done = |run: &&RunFacts| run.state == JobState::Done;
    let (calibration, diagnosis) = (session.calibration.as_ref(), session.diagnosis.as_ref());
    if let Some(run) = diagnosis.filter(works) {
        return Some(watch(Screen::Diagnose, run));
    }
    if let Some(run) = calibration.filter(works) {
        return Some(watch(Screen::Calibrate, run));
    }
    if let Some(run) = diagnosis.filter(is_done) {
        let num_named = session.num_named.filter(|named| *named > 0 && run.saved_as.is_none())?;
        return Some(Step::LookAtNames { session: id, run: run.id.clone(), num_named });
    }
    match (calibration.filter(is_done), &session.model) {
        (_, Some(model)) => Some(Step::Diagnose { session: id, model: Some(model.clone()) }),
        (Some(run), None) => match &run.saved_as {
            Some(model) => Some(Step::Diagnose { session: id, model: Some(model.clone()) }),
            None => Some(Step::SaveModel { session: id, run: run.id.clone() }),
        },
        (None, None) => Some(Step::Calibrate { session: id }),
    }
}

/// The session that was recorded last, of those that can be opened and hold something. The one that is being `recorded`
/// is not through yet.
pub fn newest_session<'a>(
    sessions: &'a [SessionSummary],
    recorded: Option<&str>,
) -> Option<&'a SessionSummary> {
    let is_usable = |session: &&SessionSummary| {
        session.error.is_none() && session.takes > 0 && recorded != Some(&session.id)
    };
    sessions.iter().filter(is_usable).max_by(|a, b| a.recorded.cmp(&b.recorded))
}

/// The newest run about `session`; runs come newest first.
pub fn newest_run<Q: OfSession, R>(runs: &[Run<Q, R>], session: &str) -> Option<RunFacts> {
    let run = runs.iter().find(|run| run.request.session() == session)?;
    Some(RunFacts { id: run.id.clone(), state: run.state, saved_as: run.saved_as.clone() })
}

/// A saved model that says that it was fitted to `session`, with as few effects as there are.
pub fn model_of(models: &[ModelSummary], session: &str) -> Option<String> {
    let origin = format!("session {session}, ");
    let fitted = models.iter().filter(|model| model.provenance.iter().any(|line| line.starts_with(&origin)));
    fitted.min_by_key(|model| model.effects.len()).map(|model| model.id.clone())
}

impl CampaignFacts {
    /// Of a campaign that can be read.
    pub fn of(campaign: &CampaignSummary) -> Option<Self> {
        campaign.error.is_none().then(|| Self {
            id: campaign.id.clone(),
            name: campaign.name.clone(),
            planned: campaign.planned,
            scored: campaign.scored,
            to_score: campaign.to_score,
            is_closed: campaign.closed.is_some(),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn run(id: &str, state: JobState, saved_as: Option<&str>) -> RunFacts {
        RunFacts { id: id.into(), state, saved_as: saved_as.map(str::to_owned) }
    }

    fn first(facts: &Facts) -> Step {
        steps(facts).into_iter().next().expect("there is always something to do")
    }

    fn operator(newest: Option<SessionFacts>) -> Facts {
        Facts { role: Some(Role::Operator), newest, ..Facts::default() }
    }

    #[test]
    fn a_session_is_led_from_calibration_to_named_effects() {
        let mut session = SessionFacts { id: "demo".into(), ..SessionFacts::default() };
        let next = |session: &SessionFacts| first(&operator(Some(session.clone())));
        assert_eq!(next(&session), Step::Calibrate { session: "demo".into() });
        // What failed or was cancelled leaves the session as it was.
        session.calibration = Some(run("run-1", JobState::Failed, None));
        assert_eq!(next(&session), Step::Calibrate { session: "demo".into() });
        session.calibration = Some(run("run-2", JobState::Done, None));
        assert_eq!(next(&session), Step::SaveModel { session: "demo".into(), run: "run-2".into() });
        session.calibration = Some(run("run-2", JobState::Done, Some("demo-exact")));
        let diagnose = Step::Diagnose { session: "demo".into(), model: Some("demo-exact".into()) };
        assert_eq!(next(&session), diagnose);
        session.diagnosis = Some(run("diagnosis-1", JobState::Cancelled, None));
        assert_eq!(next(&session), diagnose);
        session.diagnosis = Some(run("diagnosis-2", JobState::Done, None));
        session.num_named = Some(3);
        let look = Step::LookAtNames { session: "demo".into(), run: "diagnosis-2".into(), num_named: 3 };
        assert_eq!(next(&session), look);
        session.diagnosis = Some(run("diagnosis-2", JobState::Done, Some("demo-exact")));
        assert_eq!(next(&session), Step::PlanCampaign);
    }

    #[test]
    fn a_run_that_waits_is_not_said_to_work() {
        let sentence = |state, working: &[&str]| {
            let diagnosis = Some(run("diagnosis-1", state, None));
            let session = SessionFacts { id: "demo".into(), diagnosis, ..SessionFacts::default() };
            let working = working.iter().map(|&id| id.to_owned()).collect();
            first(&Facts { working, ..operator(Some(session)) }).sentence()
        };
        assert_eq!(sentence(JobState::Running, &["diagnosis-1"]), "diagnosis-1 works on session demo.");
        let waits = |working: &[&str]| sentence(JobState::Queued, working);
        assert_eq!(waits(&[]), "diagnosis-1 on session demo waits for its turn.");
        assert_eq!(waits(&["expert-1"]), "diagnosis-1 on session demo waits for its turn: expert-1 works.");
        assert!(waits(&["expert-1", "run-2"]).ends_with("turn: expert-1 and run-2 work."));
        assert!(waits(&["expert-1", "run-2", "run-3"]).ends_with("turn: expert-1 and 2 others work."));
    }

    #[test]
    fn nothing_yet_means_record_where_there_is_a_hand_and_import_where_there_is_none() {
        assert_eq!(steps(&operator(None)), [Step::Import]);
        let facts = Facts { commandable: true, ..operator(None) };
        assert_eq!(steps(&facts), [Step::Record, Step::Import]);
        let facts = Facts { recording: true, ..facts };
        assert_eq!(first(&facts), Step::GoOnRecording);
    }

    #[test]
    fn an_open_campaign_goes_on_and_a_closed_one_does_not() {
        let campaign =
            CampaignFacts { id: "c".into(), planned: 4, scored: 1, to_score: 1, ..Default::default() };
        let facts = Facts { role: Some(Role::Scorer), campaigns: vec![campaign.clone()], ..Facts::default() };
        assert_eq!(steps(&facts), [Step::Score(campaign.clone())], "a scorer scores and nothing else");
        let facts = Facts { role: Some(Role::Admin), ..facts };
        assert!(steps(&facts).contains(&Step::RunTrials(campaign.clone())));
        let closed = CampaignFacts { is_closed: true, ..campaign };
        assert_eq!(steps(&Facts { campaigns: vec![closed], ..facts }), [Step::Import]);
    }

    #[test]
    fn a_model_that_was_fitted_elsewhere_counts() {
        let model = |id: &str, line: &str| ModelSummary {
            id: id.into(),
            name: id.into(),
            theta: palpate_reports::ThetaReport { lambda_con_m: 0.0, alpha_per_m: 1.0, lambda_pre_pa: 0.0 },
            streams: Default::default(),
            provenance: vec![line.into()],
            effects: Vec::new(),
            earlier_versions: 0,
        };
        let models = [model("a", "session demo-2, station s"), model("b", "session demo, station s")];
        assert_eq!(model_of(&models, "demo").as_deref(), Some("b"));
        assert_eq!(model_of(&models, "dem"), None);
    }

    fn role() -> impl Strategy<Value = Role> {
        prop::sample::select(Role::ALL.to_vec())
    }

    fn any_run() -> impl Strategy<Value = Option<RunFacts>> {
        let states =
            [JobState::Queued, JobState::Running, JobState::Done, JobState::Failed, JobState::Cancelled];
        let state = prop::sample::select(states.to_vec());
        let run = (state, prop::option::of("[a-z]{1,4}"));
        prop::option::of(run.prop_map(|(state, saved_as)| RunFacts { id: "run-1".into(), state, saved_as }))
    }

    fn session() -> impl Strategy<Value = Option<SessionFacts>> {
        let parts = (
            "[a-z]{1,6}",
            any_run(),
            any_run(),
            prop::option::of("[a-z]{1,4}"),
            prop::option::of(0..9_usize),
        );
        prop::option::of(parts.prop_map(|(id, calibration, diagnosis, model, num_named)| SessionFacts {
            id,
            calibration,
            diagnosis,
            model,
            num_named,
        }))
    }

    fn campaigns() -> impl Strategy<Value = Vec<CampaignFacts>> {
        let campaign =
            (0..9_u32, 0..9_u32, 0..9_u32, any::<bool>()).prop_map(|(a, b, c, is_closed)| CampaignFacts {
                id: "c".into(),
                name: "C".into(),
                planned: a + b + c,
                scored: a,
                to_score: b,
                is_closed,
            });
        prop::collection::vec(campaign, 0..4)
    }

    prop_compose! {
        fn facts()(
            role in role(), commandable in any::<bool>(), recording in any::<bool>(), wanted in 0..3_usize,
            newest in session(), campaigns in campaigns(),
            working in prop::collection::vec("[a-z]{1,6}-[1-9]", 0..4),
        ) -> Facts {
            Facts { role: Some(role), commandable, recording, wanted, newest, campaigns, working }
        }
    }

    proptest! {
        #[test]
        fn whoever_may_operate_always_has_something_to_do(facts in facts()) {
            let steps = steps(&facts);
            prop_assert!(facts.role < Some(Role::Operator) || !steps.is_empty());
            prop_assert_eq!(&steps, &super::steps(&facts));
        }

        #[test]
        fn nothing_is_offered_that_is_not_allowed_or_not_there(facts in facts()) {
            let steps = steps(&facts);
            for step in &steps {
                prop_assert!(facts.role >= Some(step.role()), "{step:?}");
                let needs_station = step.route().screen == Screen::Record;
                prop_assert!(!needs_station || facts.commandable, "{step:?}");
                if let Some(session) = step.route().session {
                    prop_assert_eq!(Some(session), facts.newest.as_ref().map(|known| known.id.clone()));
                }
                prop_assert!(!step.sentence().is_empty() && !step.button().is_empty());
            }
            for (idx, step) in steps.iter().enumerate() {
                prop_assert!(!steps[..idx].contains(step) || matches!(step, Step::Score(_) | Step::RunTrials(_)));
            }
            // Nobody knows who asks: nothing is offered.
            let unknown = super::steps(&Facts { role: None, ..facts });
            prop_assert!(unknown.is_empty());
        }

        #[test]
        fn nothing_is_started_while_the_same_works(facts in facts()) {
            let works = |run: &Option<RunFacts>| {
                run.as_ref().is_some_and(|run| matches!(run.state, JobState::Queued | JobState::Running))
            };
            let busy = facts.newest.as_ref().is_some_and(|s| works(&s.calibration) || works(&s.diagnosis));
            let starts = |step: &Step| matches!(step, Step::Calibrate { .. } | Step::Diagnose { .. });
            prop_assert!(!busy || !steps(&facts).iter().any(starts));
        }
    }
}
