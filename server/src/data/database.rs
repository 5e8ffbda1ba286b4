//! The database of a data folder: jobs, people, and the index of takes.

use std::path::Path;

use palpate_jobs::Database;
use palpate_people::People;

use crate::Error;

/// Its file in the folder.
pub(crate) const DATABASE_FILE: &str = "palpate.sqlite";

/// The people of the data folder `data`, with or without a studio that has it open.
pub fn open_people(data: &Path) -> Result<People, Error> {
    if !data.is_dir() {
        return Err(Error::Argument(format!(
            "{data:?} is no folder; give the data folder of a studio (--data)"
        )));
    }
    let path = data.join(DATABASE_FILE);
    // Checks where it is, and makes it if need be.
    drop(Database::open(&path)?);
    Ok(People::open(&path)?)
}
