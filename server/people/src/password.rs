//! Passwords: what they must be like, and what is kept of them.

use argon2::{
    Argon2,
    password_hash::{PasswordHash, PasswordHasher as _, PasswordVerifier as _, SaltString},
};

use crate::PeopleError;

/// Shortest password, characters.
const MIN_CHARACTERS: usize = 10;
/// Longest password, bytes.
const MAX_BYTES: usize = 256;

/// Refuses passwords that are soon guessed. Rules beyond length make people write passwords down (NIST SP 800-63B).
pub(crate) fn check(name: &str, password: &str) -> Result<(), PeopleError> {
    let refused = |problem: String| Err(PeopleError::Argument(problem));
    if password.chars().count() < MIN_CHARACTERS {
        return refused(format!(
            "the password is shorter than {MIN_CHARACTERS} characters; take a longer one"
        ));
    }
    if password.len() > MAX_BYTES {
        return refused(format!("the password is longer than {MAX_BYTES} bytes; take a shorter one"));
    }
    if password.to_lowercase().contains(name) && password.len() < name.len() + MIN_CHARACTERS {
        return refused("the password is little more than the name; take another one".to_owned());
    }
    let mut characters = password.chars();
    let first = characters.next();
    if characters.all(|character| Some(character) == first) {
        return refused("the password is one character repeated; take another one".to_owned());
    }
    Ok(())
}

/// What is kept of a password: argon2id with a salt of its own (19 MiB, 2 passes, as OWASP has it), as a PHC string.
pub(crate) fn hash(password: &str) -> Result<String, PeopleError> {
    let mut salt = [0_u8; 16];
    getrandom::fill(&mut salt).map_err(|err| PeopleError::Random(err.to_string()))?;
    let failed = |err: argon2::password_hash::Error| {
        PeopleError::Argument(format!("the password cannot be kept: {err}"))
    };
    let salt = SaltString::encode_b64(&salt).map_err(failed)?;
    let hash = Argon2::default().hash_password(password.as_bytes(), &salt).map_err(failed)?;
    Ok(hash.to_string())
}

/// Whether `password` is the one that `hash` was kept of. It takes some tens of milliseconds, on purpose.
pub(crate) fn fits(hash: &str, password: &str) -> bool {
    password.len() <= MAX_BYTES
        && PasswordHash::new(hash)
            .is_ok_and(|hash| Argon2::default().verify_password(password.as_bytes(), &hash).is_ok())
}

/// What the password of somebody who does not exist is compared with, so that it takes as long.
pub(crate) const NOBODY: &str = "$argon2id$v=19$m=19456,t=2,p=1$bm9ib2R5bm9ib2R5MA$\
    AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA";

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    #[test]
    fn only_the_password_itself_fits_and_its_hash_says_how_it_was_made() {
        let kept = hash("correct horse battery").unwrap();
        assert!(kept.starts_with("$argon2id$v=19$m=19456,t=2,p=1$"), "{kept}");
        assert!(!kept.contains("horse"));
        assert!(fits(&kept, "correct horse battery"));
        for other in ["correct horse batterz", "", "correct horse battery ", "Correct horse battery"] {
            assert!(!fits(&kept, other), "{other}");
        }
        assert!(!fits("no hash", "no hash"));
        assert_ne!(kept, hash("correct horse battery").unwrap(), "each has its own salt");
    }

    #[test]
    fn somebody_unknown_is_compared_in_earnest() {
        let parsed = PasswordHash::new(NOBODY).unwrap();
        assert_eq!(parsed.params.to_string(), "m=19456,t=2,p=1");
        let begun = Instant::now();
        assert!(!fits(NOBODY, "correct horse battery"));
        assert!(begun.elapsed().as_micros() > 500, "{:?}", begun.elapsed());
    }

    #[test]
    fn weak_passwords_are_refused_with_the_reason() {
        for (password, reason) in [
            ("short", "shorter than 10"),
            ("", "shorter than 10"),
            ("aaaaaaaaaaaaaaaa", "repeated"),
            ("adalovelace1", "little more than the name"),
            (&"x1".repeat(200), "longer than 256"),
        ] {
            let err = check("adalovelace", password).unwrap_err().to_string();
            assert!(err.contains(reason), "{err}");
        }
        check("ada", "a sentence of five words").unwrap();
    }
}
