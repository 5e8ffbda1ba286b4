//! `palpate tokens`: API tokens of the people of a data folder.

use std::process::ExitCode;

use clap::{Args, Subcommand};
use palpate_people::{TokenRequest, now_s};
use palpate_server::{Error, open_people};
use palpate_wire::api::{CreatedToken, Role, Scope, Token};

use super::{Outcome, folder::FolderArgs, output, people::role};

#[derive(Subcommand)]
pub(crate) enum TokensCommand {
    /// Make a token; its secret is printed, this once
    Create(CreateArgs),
    /// All tokens, without their secrets
    List(FolderArgs),
    /// End a token at once
    Revoke(RevokeArgs),
}

#[derive(Args)]
pub(crate) struct CreateArgs {
    /// In whose name it acts
    person: String,
    /// What it is for
    #[arg(long)]
    name: String,
    /// What it may do, at most what the person may: viewer, scorer, operator or admin
    #[arg(long, value_parser = role)]
    role: Option<Role>,
    /// Parts of the API that it is good for, all without: read, score, jobs, data, control, people
    #[arg(long, value_delimiter = ',', value_parser = scope)]
    scopes: Option<Vec<Scope>>,
    /// When it ends, in days: 90d, or 90
    #[arg(long, default_value = "90d", value_parser = days)]
    expires: u32,
    #[command(flatten)]
    folder: FolderArgs,
}

#[derive(Args)]
pub(crate) struct RevokeArgs {
    /// Its number, as `palpate tokens list` shows it
    id: u64,
    #[command(flatten)]
    folder: FolderArgs,
}

fn scope(name: &str) -> Result<Scope, String> {
    Scope::from_name(name)
        .ok_or_else(|| format!("{name:?} is no scope; expected read, score, jobs, data, control or people"))
}

fn days(text: &str) -> Result<u32, String> {
    let digits = text.strip_suffix('d').unwrap_or(text);
    digits.parse().map_err(|_| format!("{text:?} is no number of days; expected 90d, for instance"))
}

pub(super) fn run(command: &TokensCommand) -> Outcome {
    match command {
        TokensCommand::Create(CreateArgs { person, name, role, scopes, expires, folder }) => {
            let request =
                TokenRequest { person, name, role: *role, scopes: scopes.as_deref(), expires_days: *expires };
            let (token, secret) = open_people(&folder.data)?.create_token(&request, now_s())?;
            match folder.json {
                true => output::json(&CreatedToken { token, secret })?,
                false => output::line(&secret)?,
            }
        }
        TokensCommand::List(folder) => show(&open_people(&folder.data)?.tokens(None), folder.json)?,
        TokensCommand::Revoke(RevokeArgs { id, folder }) => {
            let people = open_people(&folder.data)?;
            people.revoke(*id, None)?;
            show(&people.tokens(None), folder.json)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn show(tokens: &[Token], as_json: bool) -> Result<(), Error> {
    if as_json {
        return output::json(&tokens);
    }
    output::line(&format!(
        "{:<5} {:<20} {:<16} {:<9} {:<21} {:<21} scopes",
        "id", "name", "person", "role", "expires", "last used"
    ))?;
    tokens.iter().try_for_each(|token| {
        let scopes: Vec<&str> = token.scopes.iter().map(|scope| scope.name()).collect();
        output::line(&format!(
            "{:<5} {:<20} {:<16} {:<9} {:<21} {:<21} {}",
            token.id,
            token.name,
            token.person,
            token.role.name(),
            token.expires,
            token.last_used.as_deref().unwrap_or("never"),
            scopes.join(",")
        ))
    })
}
