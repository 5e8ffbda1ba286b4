//! The null bars of stations: the evidence that chance gives where nothing is missing. Slow to find, so kept.

use std::{
    fs,
    hash::{DefaultHasher, Hash as _, Hasher as _},
    io::ErrorKind,
    path::{Path, PathBuf},
};

use palpate_diagnosis::NullBar;
use palpate_robot_model::StationFiles;

use super::files;
use crate::Error;

/// Bars in a folder, one file each.
#[derive(Clone, Debug)]
pub struct Bars {
    dir: PathBuf,
}

impl Bars {
    /// The bars in data folder `data`, which need not exist.
    pub fn of(data: &Path) -> Self {
        Self { dir: data.join("bars") }
    }

    /// The bar of the station with these files, if it was found by this version of the software. One that cannot be read
    /// is as good as none: it is found again.
    pub fn get(&self, station: &StationFiles) -> Result<Option<NullBar>, Error> {
        let path = self.path(station);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(err) if err.kind() == ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(Error::Io { action: "read", path, source }),
        };
        match serde_json::from_str(&text) {
            Ok(bar) => Ok(Some(bar)),
            Err(err) => {
                tracing::warn!(path = %path.display(), %err, "left out the bar of a station; set it again");
                Ok(None)
            }
        }
    }

    /// Keeps `bar` for the station with these files.
    pub fn put(&self, station: &StationFiles, bar: &NullBar) -> Result<(), Error> {
        fs::create_dir_all(&self.dir).map_err(Error::io("make", &self.dir))?;
        let json = serde_json::to_vec_pretty(bar).map_err(|err| Error::Internal(err.to_string()))?;
        files::write(&self.path(station), &json)
    }

    /// Another station or another version of the software has another bar.
    fn path(&self, station: &StationFiles) -> PathBuf {
        let mut hasher = DefaultHasher::new();
        env!("CARGO_PKG_VERSION").hash(&mut hasher);
        station.station_toml.hash(&mut hasher);
        station.files.hash(&mut hasher);
        self.dir.join(format!("{:016x}.json", hasher.finish()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assets;

    #[test]
    fn bar_belongs_to_one_station_and_survives_its_file() {
        let dir = tempfile::tempdir().unwrap();
        let bars = Bars::of(dir.path());
        let station = assets::station("probe-bench").unwrap().files;
        assert_eq!(bars.get(&station).unwrap(), None);
        let bar: NullBar = serde_json::from_str(r#"{"evidence":11.5,"maxima":[2.0,11.0]}"#).unwrap();
        bars.put(&station, &bar).unwrap();
        assert_eq!(bars.get(&station).unwrap(), Some(bar));

        let mut other = station.clone();
        other.station_toml.push('\n');
        assert_eq!(bars.get(&other).unwrap(), None, "another station");
        fs::write(bars.path(&station), "{").unwrap();
        assert_eq!(bars.get(&station).unwrap(), None, "what cannot be read is found again");
    }
}
