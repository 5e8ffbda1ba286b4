use super::*;

const NOW_S: i64 = 1_800_000_000;
const PASSWORD: &str = "correct horse battery";

struct Folder {
    dir: tempfile::TempDir,
}

impl Folder {
    fn new() -> Self {
        Self { dir: tempfile::tempdir().unwrap() }
    }

    fn path(&self) -> PathBuf {
        self.dir.path().join("palpate.sqlite")
    }

    fn open(&self) -> People {
        People::open(&self.path()).unwrap()
    }
}

fn token_for<'a>(person: &'a str, role: Option<Role>) -> TokenRequest<'a> {
    TokenRequest { person, name: "ci", role, scopes: None, expires_days: 30 }
}

#[test]
fn logins_and_tokens_survive_a_restart_and_no_secret_is_on_disk() {
    let folder = Folder::new();
    let (cookie, token) = {
        let people = folder.open();
        assert!(people.is_empty());
        people.add("ada", Role::Operator, PASSWORD, NOW_S).unwrap();
        let login = people.log_in("ada", PASSWORD, NOW_S).unwrap();
        let (_, token) = people.create_token(&token_for("ada", Some(Role::Viewer)), NOW_S).unwrap();
        (login.secret, token)
    };
    let people = folder.open();
    let by_cookie = people.authenticate(Presented::Cookie(&cookie), NOW_S + 1).unwrap();
    assert_eq!(
        (&**by_cookie.name(), by_cookie.role(), by_cookie.via()),
        ("ada", Role::Operator, palpate_wire::api::Via::Session)
    );
    let by_token = people.authenticate(Presented::Bearer(&token), NOW_S + 1).unwrap();
    assert_eq!((by_token.role(), by_token.label().as_str()), (Role::Viewer, "ada by token \"ci\""));
    // One is not good for the other.
    assert_eq!(people.authenticate(Presented::Bearer(&cookie), NOW_S), Err(Denied::Unknown));
    assert_eq!(people.authenticate(Presented::Cookie(&token), NOW_S), Err(Denied::Unknown));
    drop(people);
    for entry in folder.dir.path().read_dir().unwrap() {
        let bytes = std::fs::read(entry.unwrap().path()).unwrap();
        for secret in [&cookie, &token, token.trim_start_matches("plp_"), PASSWORD] {
            assert!(!bytes.windows(secret.len()).any(|window| window == secret.as_bytes()));
        }
    }
}

#[test]
fn logins_and_tokens_end_by_time_by_hand_and_with_their_person() {
    let folder = Folder::new();
    let people = folder.open();
    people.add("root", Role::Admin, PASSWORD, NOW_S).unwrap();
    people.add("ada", Role::Operator, PASSWORD, NOW_S).unwrap();
    let login = people.log_in("ada", PASSWORD, NOW_S).unwrap();
    let (token, secret) = people.create_token(&token_for("ada", None), NOW_S).unwrap();
    let cookie = |now_s| people.authenticate(Presented::Cookie(&login.secret), now_s);
    let bearer = |now_s| people.authenticate(Presented::Bearer(&secret), now_s);
    assert!(cookie(NOW_S + login.lasts_s - 1).is_ok());
    assert_eq!(cookie(NOW_S + login.lasts_s), Err(Denied::Expired));
    assert!(bearer(NOW_S + 30 * 86_400 - 1).is_ok());
    assert_eq!(bearer(NOW_S + 30 * 86_400), Err(Denied::Expired));

    let principal = cookie(NOW_S).unwrap();
    people.log_out(&principal).unwrap();
    assert_eq!(cookie(NOW_S), Err(Denied::Unknown));
    assert!(!people.is_still_valid(&principal, NOW_S));

    assert!(people.revoke(token.id, Some("root")).is_err(), "it is not root's");
    let by_token = bearer(NOW_S).unwrap();
    people.revoke(token.id, None).unwrap();
    assert_eq!(bearer(NOW_S), Err(Denied::Unknown));
    assert!(!people.is_still_valid(&by_token, NOW_S));
    assert!(people.revoke(token.id, None).is_err());

    let again = people.log_in("ada", PASSWORD, NOW_S).unwrap();
    people.set_password("ada", "another good one").unwrap();
    assert_eq!(people.authenticate(Presented::Cookie(&again.secret), NOW_S), Err(Denied::Unknown));
    assert!(matches!(people.log_in("ada", PASSWORD, NOW_S), Err(PeopleError::WrongLogin)));
    let again = people.log_in("ada", "another good one", NOW_S).unwrap();
    people.remove("ada").unwrap();
    assert_eq!(people.authenticate(Presented::Cookie(&again.secret), NOW_S), Err(Denied::Unknown));
    assert!(people.tokens(None).is_empty());
}

#[test]
fn a_token_may_do_no_more_than_its_person_at_the_time() {
    let folder = Folder::new();
    let people = folder.open();
    people.add("ada", Role::Operator, PASSWORD, NOW_S).unwrap();
    let err = people.create_token(&token_for("ada", Some(Role::Admin)), NOW_S).unwrap_err().to_string();
    assert!(err.contains("operator") && err.contains("no more than its person"), "{err}");
    let (_, secret) = people.create_token(&token_for("ada", None), NOW_S).unwrap();
    let before = people.authenticate(Presented::Bearer(&secret), NOW_S).unwrap();
    assert!(before.may(Role::Operator, Scope::Control));
    people.set_role("ada", Role::Viewer).unwrap();
    let after = people.authenticate(Presented::Bearer(&secret), NOW_S).unwrap();
    assert_eq!(after.role(), Role::Viewer);
    assert!(!people.is_still_valid(&before, NOW_S), "what was begun as operator ends");
    assert!(people.is_still_valid(&after, NOW_S));

    let narrow =
        TokenRequest { scopes: Some(&[Scope::Jobs, Scope::Read, Scope::Jobs]), ..token_for("ada", None) };
    let (token, secret) = people.create_token(&narrow, NOW_S).unwrap();
    assert_eq!(token.scopes, [Scope::Read, Scope::Jobs]);
    let narrow = people.authenticate(Presented::Bearer(&secret), NOW_S).unwrap();
    assert!(narrow.may(Role::Viewer, Scope::Read) && !narrow.may(Role::Viewer, Scope::Control));
}

#[test]
fn the_last_admin_stays() {
    let folder = Folder::new();
    let people = folder.open();
    people.add("root", Role::Admin, PASSWORD, NOW_S).unwrap();
    for refused in [people.remove("root"), people.set_role("root", Role::Operator).map(|_| ())] {
        assert!(refused.unwrap_err().to_string().contains("last admin"));
    }
    people.add("ada", Role::Admin, PASSWORD, NOW_S).unwrap();
    people.set_role("root", Role::Viewer).unwrap();
    assert!(people.remove("ada").is_err());
    people.remove("root").unwrap();
}

#[test]
fn bad_names_passwords_and_tokens_are_refused_in_words() {
    let folder = Folder::new();
    let people = folder.open();
    for name in ["", "Ada", "ada ", "-ada", "a\u{430}da", "station", "somebody", &"a".repeat(33), "a\nb"] {
        let err = people.add(name, Role::Viewer, PASSWORD, NOW_S).unwrap_err().to_string();
        assert!(err.contains("cannot be the name of a person"), "{name:?}: {err}");
    }
    people.add("ada", Role::Viewer, PASSWORD, NOW_S).unwrap();
    let err = people.add("ada", Role::Admin, PASSWORD, NOW_S).unwrap_err().to_string();
    assert!(err.contains("already"), "{err}");
    assert_eq!(people.list()[0].role, Role::Viewer, "and nothing changed");
    for (err, words) in [
        (people.set_role("bob", Role::Admin).unwrap_err(), "no person \"bob\""),
        (people.set_password("bob", PASSWORD).unwrap_err(), "no person \"bob\""),
        (people.set_password("ada", "short").unwrap_err(), "shorter than"),
        (people.create_token(&token_for("bob", None), NOW_S).unwrap_err(), "no person \"bob\""),
        (
            people
                .create_token(&TokenRequest { expires_days: 731, ..token_for("ada", None) }, NOW_S)
                .unwrap_err(),
            "1 to 730 days",
        ),
        (
            people.create_token(&TokenRequest { name: "a\tb", ..token_for("ada", None) }, NOW_S).unwrap_err(),
            "1 to 64",
        ),
        (
            people
                .create_token(&TokenRequest { scopes: Some(&[]), ..token_for("ada", None) }, NOW_S)
                .unwrap_err(),
            "good for nothing",
        ),
        (people.verify("bob", PASSWORD).unwrap_err(), "do not belong together"),
        (people.verify("ada", "wrong password").unwrap_err(), "do not belong together"),
    ] {
        assert!(err.to_string().contains(words), "{err}");
    }
}

#[test]
fn what_another_process_changes_is_noticed_and_uses_are_noted_to_a_minute() {
    let folder = Folder::new();
    let studio = folder.open();
    studio.add("ada", Role::Admin, PASSWORD, NOW_S).unwrap();
    let (token, secret) = studio.create_token(&token_for("ada", None), NOW_S).unwrap();
    let command = folder.open();
    studio.authenticate(Presented::Bearer(&secret), NOW_S).unwrap();
    studio.refresh(NOW_S).unwrap();
    let last_used = |people: &People| people.tokens(None)[0].last_used.clone();
    let first = last_used(&studio);
    assert_eq!(first, Some(rfc3339(NOW_S)));
    studio.authenticate(Presented::Bearer(&secret), NOW_S + 59).unwrap();
    studio.refresh(NOW_S + 59).unwrap();
    assert_eq!(last_used(&studio), first);
    studio.authenticate(Presented::Bearer(&secret), NOW_S + 60).unwrap();
    studio.refresh(NOW_S + 60).unwrap();
    assert_eq!(last_used(&studio), Some(rfc3339(NOW_S + 60)));

    // A token that was made elsewhere is good at once, although somebody guessed just now; what was revoked elsewhere ends
    // with the next look.
    let guess = format!("plp_{}", "0".repeat(64));
    assert_eq!(studio.authenticate(Presented::Bearer(&guess), NOW_S), Err(Denied::Unknown));
    let (_, fresh) = command.create_token(&token_for("ada", None), NOW_S).unwrap();
    assert!(studio.authenticate(Presented::Bearer(&fresh), NOW_S).is_ok());
    command.revoke(token.id, None).unwrap();
    assert!(studio.authenticate(Presented::Bearer(&secret), NOW_S).is_ok(), "not looked yet");
    studio.refresh(NOW_S).unwrap();
    assert_eq!(studio.authenticate(Presented::Bearer(&secret), NOW_S), Err(Denied::Unknown));
}

#[test]
fn a_person_has_so_many_logins_and_the_oldest_go() {
    let folder = Folder::new();
    let people = folder.open();
    people.add("ada", Role::Viewer, PASSWORD, NOW_S).unwrap();
    let logins: Vec<LoggedIn> =
        (0..MAX_LOGINS + 2).map(|number| people.log_in("ada", PASSWORD, NOW_S + number).unwrap()).collect();
    let is_in = |login: &LoggedIn| people.authenticate(Presented::Cookie(&login.secret), NOW_S + 100).is_ok();
    assert_eq!(logins.iter().map(is_in).filter(|&is_in| is_in).count() as i64, MAX_LOGINS);
    assert!(!is_in(&logins[0]) && !is_in(&logins[1]) && is_in(&logins[2]));
}

#[test]
fn tables_of_jobs_stay_as_they_are_and_a_newer_program_is_named() {
    let folder = Folder::new();
    let jobs = Connection::open(folder.path()).unwrap();
    jobs.execute_batch(
        "CREATE TABLE jobs (id TEXT); INSERT INTO jobs VALUES ('run-1'); PRAGMA user_version = 2;",
    )
    .unwrap();
    drop(jobs);
    // A folder from before there were people, and one of each version since.
    for version in 0..=STEPS.len() {
        drop(tables::open(&folder.path(), &STEPS[..version]).unwrap());
    }
    folder.open().add("ada", Role::Admin, PASSWORD, NOW_S).unwrap();
    let other = Connection::open(folder.path()).unwrap();
    let (id, version): (String, i64) = (
        other.query_row("SELECT id FROM jobs", [], |row| row.get(0)).unwrap(),
        other.query_row("PRAGMA user_version", [], |row| row.get(0)).unwrap(),
    );
    assert_eq!((id.as_str(), version), ("run-1", 2));
    other.execute("UPDATE people_version SET version = 9", []).unwrap();
    let err = People::open(&folder.path()).unwrap_err().to_string();
    assert!(err.contains("version 9") && err.contains("newer palpate"), "{err}");
}
