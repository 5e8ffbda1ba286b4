//! Secrets of cookies and tokens, and what is kept of them.

use std::fmt::Write as _;

use sha2::{Digest as _, Sha256};

use crate::PeopleError;

/// What is kept of a secret.
pub(crate) type Hash = [u8; 32];

/// Before the random part of a token, so that scanners for leaked secrets know it.
pub(crate) const TOKEN_PREFIX: &str = "plp_";

/// Longest secret that is looked at, bytes.
const MAX_SECRET_BYTES: usize = 128;

/// A new secret of 256 random bits, and its hash.
pub(crate) fn new(prefix: &str) -> Result<(String, Hash), PeopleError> {
    let mut bytes = [0_u8; 32];
    getrandom::fill(&mut bytes).map_err(|err| PeopleError::Random(err.to_string()))?;
    let secret = bytes.iter().fold(prefix.to_owned(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    });
    let hash = hash(&secret);
    Ok((secret, hash))
}

/// Random bits are not guessed, so a plain hash keeps them.
fn hash(secret: &str) -> Hash {
    Sha256::digest(secret.as_bytes()).into()
}

/// The hash of a secret that a client sent; `None` for what cannot be one.
pub(crate) fn hash_of_client(secret: &str) -> Option<Hash> {
    (!secret.is_empty() && secret.len() <= MAX_SECRET_BYTES).then(|| hash(secret))
}
