//! `palpate people`: who may log in to the studio of a data folder, whether it runs or not.

use std::{
    fs,
    io::{self, BufRead as _, IsTerminal as _, Write as _},
    process::ExitCode,
};

use clap::{Args, Subcommand};
use palpate_people::now_s;
use palpate_server::{Error, open_people};
use palpate_wire::api::{Person, Role};
use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};

use super::{Outcome, folder::FolderArgs, output};

#[derive(Subcommand)]
pub(crate) enum PeopleCommand {
    /// Add somebody; the password is asked for, or read from standard input
    Add(AddArgs),
    /// Everybody, with their roles
    List(FolderArgs),
    /// Remove somebody, with their logins and tokens
    Remove(PersonArgs),
    /// Give somebody another role
    Role(RoleArgs),
    /// Give somebody another password, and end their logins
    Password(PersonArgs),
}

#[derive(Args)]
pub(crate) struct AddArgs {
    /// Name to log in with: a-z, 0-9, dot, dash and underscore
    name: String,
    /// What they may do: viewer, scorer, operator or admin
    #[arg(long, value_parser = role)]
    role: Role,
    #[command(flatten)]
    folder: FolderArgs,
}

#[derive(Args)]
pub(crate) struct PersonArgs {
    /// Whom
    name: String,
    #[command(flatten)]
    folder: FolderArgs,
}

#[derive(Args)]
pub(crate) struct RoleArgs {
    /// Whom
    name: String,
    /// viewer, scorer, operator or admin
    #[arg(value_parser = role)]
    role: Role,
    #[command(flatten)]
    folder: FolderArgs,
}

pub(super) fn role(name: &str) -> Result<Role, String> {
    Role::from_name(name)
        .ok_or_else(|| format!("{name:?} is no role; expected viewer, scorer, operator or admin"))
}

pub(super) fn run(command: &PeopleCommand) -> Outcome {
    match command {
        PeopleCommand::Add(AddArgs { name, role, folder }) => {
            // The first person comes before the first studio.
            fs::create_dir_all(&folder.data).map_err(Error::io("make", &folder.data))?;
            let people = open_people(&folder.data)?;
            let password = ask_password(name)?;
            show(&[people.add(name, *role, &password, now_s())?], folder.json)?;
        }
        PeopleCommand::List(folder) => show(&open_people(&folder.data)?.list(), folder.json)?,
        PeopleCommand::Remove(PersonArgs { name, folder }) => {
            let people = open_people(&folder.data)?;
            people.remove(name)?;
            show(&people.list(), folder.json)?;
        }
        PeopleCommand::Role(RoleArgs { name, role, folder }) => {
            show(&[open_people(&folder.data)?.set_role(name, *role)?], folder.json)?;
        }
        PeopleCommand::Password(PersonArgs { name, folder }) => {
            let people = open_people(&folder.data)?;
            let password = ask_password(name)?;
            show(&[people.set_password(name, &password)?], folder.json)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn show(people: &[Person], as_json: bool) -> Result<(), Error> {
    if as_json {
        return output::json(&people);
    }
    output::line(&format!("{:<32} {:<10} {:<22} last login", "name", "role", "added"))?;
    people.iter().try_for_each(|Person { name, role, created, last_login }| {
        let last_login = last_login.as_deref().unwrap_or("never");
        output::line(&format!("{name:<32} {:<10} {created:<22} {last_login}", role.name()))
    })
}

/// Asks for a password twice at a terminal, without showing it; or reads one line of standard input.
fn ask_password(name: &str) -> Result<String, Error> {
    let read = |source| Error::Io { action: "read the password from", path: "standard input".into(), source };
    if !io::stdin().is_terminal() {
        return read_line().map_err(read);
    }
    let password = ask_hidden(&format!("Password of {name}: ")).map_err(read)?;
    let again = ask_hidden("Again: ").map_err(read)?;
    if password != again {
        return Err(Error::Argument("the two passwords are different; try again".to_owned()));
    }
    Ok(password)
}

fn read_line() -> io::Result<String> {
    let mut line = String::new();
    io::stdin().lock().read_line(&mut line)?;
    Ok(line.trim_end_matches(['\n', '\r']).to_owned())
}

fn ask_hidden(question: &str) -> io::Result<String> {
    let terminal = io::stdin();
    eprint!("{question}");
    io::stderr().flush()?;
    let shown = tcgetattr(&terminal)?;
    let mut hidden = shown.clone();
    hidden.local_modes.remove(LocalModes::ECHO);
    tcsetattr(&terminal, OptionalActions::Flush, &hidden)?;
    let line = read_line();
    tcsetattr(&terminal, OptionalActions::Flush, &shown)?;
    eprintln!();
    line
}
