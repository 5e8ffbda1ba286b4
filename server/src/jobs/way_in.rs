//! The way from a job that moves the robot to the studio that has it: an address of this computer, and a token that is
//! good for as long as the job works.

use std::{path::PathBuf, sync::Arc};

use palpate_jobs::{Database, JobsError, Launch, StationVariables};
use palpate_people::{People, PeopleError, TokenRequest, now_s};
use palpate_wire::api::{Job, Scope};

/// Where the studio is, for a job.
pub(crate) const URL_VARIABLE: &str = "PALPATE_URL";
/// Where the operator of an emulated station listens, for a job.
pub(crate) const OPERATOR_VARIABLE: &str = "PALPATE_OPERATOR";
/// What lets it in, where people have to log in.
const TOKEN_VARIABLE: &str = "PALPATE_TOKEN";
/// A token of a job whose studio was killed is good for no longer than this, days.
const TOKEN_DAYS: u32 = 7;
/// What a trial needs: to look, and to move.
const SCOPES: [Scope; 2] = [Scope::Read, Scope::Control];

/// How jobs on the station reach their studio.
pub(crate) struct WayIn {
    /// An address that this computer reaches without TLS; `None` where the studio listens nowhere.
    pub(crate) url: Option<String>,
    /// Socket of the operator of an emulated station, who places objects and sees where they are.
    pub(crate) operator: Option<PathBuf>,
    /// Whether it takes a token.
    pub(crate) login: bool,
    pub(crate) people: Arc<People>,
}

impl WayIn {
    /// What an attempt is told when it starts.
    pub(crate) fn variables(self: &Arc<Self>, database: Arc<Database>) -> StationVariables {
        let way_in = self.clone();
        Arc::new(move |launch: &Launch| {
            let problem = |problem: String| JobsError::Runner(problem);
            let url = way_in.url.clone();
            let url = url.ok_or_else(|| problem("this studio listens at no address".to_owned()))?;
            let mut variables = vec![(URL_VARIABLE.to_owned(), url)];
            if let Some(operator) = &way_in.operator {
                variables.push((OPERATOR_VARIABLE.to_owned(), operator.display().to_string()));
            }
            if way_in.login {
                let job = database.job(&launch.id)?.ok_or_else(|| JobsError::NotFound(launch.id.clone()))?;
                let token = way_in.token(&job).map_err(|err| problem(err.to_string()))?;
                variables.push((TOKEN_VARIABLE.to_owned(), token));
            }
            Ok(variables)
        })
    }

    /// A token of whoever asked for `job`.
    fn token(&self, job: &Job) -> Result<String, PeopleError> {
        self.revoke(job)?;
        let request = TokenRequest {
            person: &job.owner,
            name: &name_of(&job.id),
            role: None,
            scopes: Some(&SCOPES),
            expires_days: TOKEN_DAYS,
        };
        self.people.create_token(&request, now_s()).map(|(_, secret)| secret)
    }

    /// Ends what lets `job` in.
    fn revoke(&self, job: &Job) -> Result<(), PeopleError> {
        let name = name_of(&job.id);
        let its = self.people.tokens(Some(&job.owner)).into_iter().filter(|token| token.name == name);
        its.into_iter().try_for_each(|token| self.people.revoke(token.id, Some(&job.owner)))
    }

    /// Ends what lets `job` in, once it has ended.
    pub(crate) fn close(&self, job: &Job) {
        if !self.login || !job.spec.resources.station || job.is_unfinished() {
            return;
        }
        if let Err(err) = self.revoke(job) {
            tracing::error!(job = job.id, err = crate::chain(&err), "the token of a job cannot be revoked");
        }
    }
}

/// What the token of job `id` is called among those of its owner.
fn name_of(id: &str) -> String {
    format!("job {id}")
}
