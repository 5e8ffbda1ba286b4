//! Where the operator is, as the part of the address after `#`: `#/hand/session-1?take=take-03&t=12.4`.

use std::fmt;

use percent_encoding::{AsciiSet, CONTROLS, percent_decode_str, utf8_percent_encode};

/// Everything that would change the meaning of a hash if it stood there by itself.
const RESERVED: &AsciiSet = &CONTROLS
    .add(b' ')
    .add(b'"')
    .add(b'#')
    .add(b'%')
    .add(b'&')
    .add(b'+')
    .add(b'/')
    .add(b'<')
    .add(b'=')
    .add(b'>')
    .add(b'?')
    .add(b'`');

/// The screens of the rail, top to bottom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Screen {
    /// What the station does, what runs, what to do next.
    Home,
    /// The hand in 3-D and as a flat map.
    Hand,
    /// Guided recording of a calibration session.
    Record,
    /// Touch events on one time axis.
    Timelines,
    /// Fit the sensor model to a session.
    Calibrate,
    /// Name what the calibrated model lacks, and add it.
    Diagnose,
    /// What has been recorded.
    Sessions,
    /// What is touched and grasped.
    Objects,
    /// Campaigns: policies tried on the hand, trials scored.
    Trials,
    /// Long work: what waits, runs and has ended.
    Jobs,
    /// Sensor models and policies: what was made from what.
    Models,
    /// People, tokens, storage, the audit log.
    Settings,
}

impl Screen {
    /// All screens, in the order of the rail.
    pub const ALL: [Self; 12] = [
        Self::Home,
        Self::Hand,
        Self::Record,
        Self::Sessions,
        Self::Timelines,
        Self::Objects,
        Self::Calibrate,
        Self::Diagnose,
        Self::Models,
        Self::Trials,
        Self::Jobs,
        Self::Settings,
    ];

    /// What the screen is about; screens of one group stand together in the rail. `None` for those that are about all of
    /// it.
    pub fn group(self) -> Option<&'static str> {
        match self {
            Self::Hand | Self::Record => Some("Operate"),
            Self::Sessions | Self::Timelines | Self::Objects => Some("Data"),
            Self::Calibrate | Self::Diagnose | Self::Models => Some("Simulator"),
            Self::Trials => Some("Learn"),
            Self::Home | Self::Jobs | Self::Settings => None,
        }
    }

    /// The word in the rail.
    pub fn label(self) -> &'static str {
        match self {
            Self::Home => "Home",
            Self::Hand => "Hand",
            Self::Record => "Record",
            Self::Timelines => "Timelines",
            Self::Calibrate => "Calibrate",
            Self::Diagnose => "Diagnose",
            Self::Sessions => "Sessions",
            Self::Objects => "Objects",
            Self::Models => "Models",
            Self::Trials => "Trials",
            Self::Jobs => "Jobs",
            Self::Settings => "Settings",
        }
    }

    /// One line on what the screen is for.
    pub fn purpose(self) -> &'static str {
        match self {
            Self::Home => "What the station does, what runs, and what to do next",
            Self::Hand => "Watch the hand replay a take, taxels lit by what they felt",
            Self::Record => "Record a calibration session, take by take, as a checklist says",
            Self::Timelines => "Compare real and simulated touch on one time axis",
            Self::Calibrate => "Fit the sensor model until simulated events line up with real ones",
            Self::Diagnose => {
                "Find where simulation and hand disagree, name the missing effect, add it to the model"
            }
            Self::Sessions => "What has been recorded, and whether it can be used",
            Self::Objects => "What is touched and grasped: shape, mass, poses at rest",
            Self::Models => "Sensor models and policies: what each was made from, and what was made of it",
            Self::Trials => "Try policies on the hand, score each trial, compare success rates",
            Self::Jobs => "Long work: what waits, what runs, how it ended",
            Self::Settings => "People, API tokens, storage, the audit log",
        }
    }

    /// Whether the screen has something to offer: recording needs a live station that takes commands.
    pub fn is_offered(self, commandable: bool) -> bool {
        self != Self::Record || commandable
    }

    fn slug(self) -> &'static str {
        match self {
            Self::Home => "home",
            Self::Hand => "hand",
            Self::Record => "record",
            Self::Timelines => "timelines",
            Self::Calibrate => "calibrate",
            Self::Diagnose => "diagnose",
            Self::Sessions => "sessions",
            Self::Objects => "objects",
            Self::Models => "models",
            Self::Trials => "trials",
            Self::Jobs => "jobs",
            Self::Settings => "settings",
        }
    }

    fn from_slug(slug: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|screen| screen.slug() == slug)
    }
}

/// A screen and what it shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Which screen.
    pub screen: Screen,
    /// Session shown, by id; `None` lets the screen choose.
    pub session: Option<String>,
    /// Take shown, by id.
    pub take: Option<String>,
    /// Time in the take, s, to the millisecond.
    pub time_s: Option<f64>,
    /// Simulation compared with the recording (see [`crate::playback::ModelRef::key`]).
    pub model: Option<String>,
    /// Simulation with effects (as `model`).
    pub diagnosed: Option<String>,
    /// Calibration run or diagnosis shown, by id.
    pub run: Option<String>,
    /// Whether the live station is shown instead of a take.
    pub live: bool,
    /// Object shown, by id.
    pub object: Option<String>,
    /// Model, policy or other artifact shown ([`palpate_wire::api::ArtifactKey`] as text).
    pub artifact: Option<String>,
    /// Campaign shown, by id.
    pub campaign: Option<String>,
    /// Which part is shown: of a campaign `run`, `score` or `results`; of Settings `people`, `tokens`, `storage` or
    /// `audit`.
    pub part: Option<String>,
    /// Job shown, by id.
    pub job: Option<String>,
    /// What stands where a screen is named, and is none. Nothing else of such a link is read.
    pub lost: Option<String>,
}

impl Default for Route {
    fn default() -> Self {
        Self::to(Screen::Home)
    }
}

impl Route {
    /// `screen`, with nothing chosen.
    pub fn to(screen: Screen) -> Self {
        Self {
            screen,
            session: None,
            take: None,
            time_s: None,
            model: None,
            diagnosed: None,
            run: None,
            live: false,
            object: None,
            artifact: None,
            campaign: None,
            part: None,
            job: None,
            lost: None,
        }
    }

    /// The same, with `session` chosen.
    pub fn with_session(mut self, session: impl Into<String>) -> Self {
        self.session = Some(session.into());
        self
    }

    /// The same, with `take` chosen.
    pub fn with_take(mut self, take: impl Into<String>) -> Self {
        self.take = Some(take.into());
        self
    }

    /// Reads a hash, with or without `#`. Unknown screens are kept as [`Self::lost`]; unknown keys are left out, so
    /// that a link from another version still opens.
    pub fn from_hash(hash: &str) -> Self {
        let hash = hash.trim_start_matches('#').trim_start_matches('/');
        let (path, query) = hash.split_once('?').unwrap_or((hash, ""));
        let mut segments = path.split('/').map(decode);
        let slug = segments.next().unwrap_or_default();
        let Some(screen) = Screen::from_slug(&slug) else {
            return Self { lost: Some(slug).filter(|slug| !slug.is_empty()), ..Self::default() };
        };
        let mut route = Self::to(screen);
        route.session = segments.next().filter(|session| !session.is_empty());
        for pair in query.split('&') {
            let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
            let value = Some(decode(value)).filter(|value| !value.is_empty());
            match key {
                "take" => route.take = value,
                "t" => {
                    route.time_s = value
                        .and_then(|text| text.parse().ok())
                        .filter(|time_s: &f64| time_s.is_finite() && *time_s >= 0.0);
                }
                "model" => route.model = value,
                "diagnosed" => route.diagnosed = value,
                "run" => route.run = value,
                "source" => route.live = value.as_deref() == Some("live"),
                "object" => route.object = value,
                "artifact" => route.artifact = value,
                "campaign" => route.campaign = value,
                "part" => route.part = value,
                "job" => route.job = value,
                _ => {}
            }
        }
        route
    }

    /// Whether going from `self` to `other` is a step that "back" should undo, as opposed to scrubbing in place.
    pub fn is_same_place(&self, other: &Self) -> bool {
        let ids = |route: &Self| {
            let Self { session, take, run, object, artifact, campaign, part, job, .. } = route.clone();
            [session, take, run, object, artifact, campaign, part, job]
        };
        (self.screen, self.live, &self.lost, ids(self)) == (other.screen, other.live, &other.lost, ids(other))
    }
}

impl fmt::Display for Route {
    /// The hash, with `#`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(slug) = &self.lost {
            return write!(f, "#/{}", encode(slug));
        }
        write!(f, "#/{}", self.screen.slug())?;
        if let Some(session) = &self.session {
            write!(f, "/{}", encode(session))?;
        }
        let time = self.time_s.map(|time_s| {
            let text = format!("{time_s:.3}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        });
        let source = self.live.then(|| "live".to_owned());
        let pairs = [
            ("source", &source),
            ("take", &self.take),
            ("t", &time),
            ("model", &self.model),
            ("diagnosed", &self.diagnosed),
            ("run", &self.run),
            ("object", &self.object),
            ("artifact", &self.artifact),
            ("campaign", &self.campaign),
            ("part", &self.part),
            ("job", &self.job),
        ];
        let mut separator = '?';
        for (key, value) in pairs {
            if let Some(value) = value {
                write!(f, "{separator}{key}={}", encode(value))?;
                separator = '&';
            }
        }
        Ok(())
    }
}

/// What Help shows, over whatever screen: `#/help/learning?section=memory`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HelpPlace {
    /// Document, by name; `None` for what words mean.
    pub doc: Option<String>,
    /// Its heading, by address ([`palpate_wire::markdown::slug`]).
    pub section: Option<String>,
    /// Words to look for.
    pub words: Option<String>,
}

impl HelpPlace {
    /// The beginning of the document called `name`.
    pub fn doc(name: impl Into<String>) -> Self {
        Self { doc: Some(name.into()), ..Self::default() }
    }

    /// A place that has `words` looked for.
    pub fn words(words: impl Into<String>) -> Self {
        Self { words: Some(words.into()), ..Self::default() }
    }

    /// The same, at the heading with the address `section`.
    #[must_use]
    pub fn at(mut self, section: Option<impl Into<String>>) -> Self {
        self.section = section.map(Into::into);
        self
    }

    /// Reads a hash, with or without `#`; `None` if it is no place of Help.
    pub fn from_hash(hash: &str) -> Option<Self> {
        let hash = hash.trim_start_matches('#').trim_start_matches('/');
        let (path, query) = hash.split_once('?').unwrap_or((hash, ""));
        let mut segments = path.split('/').map(decode);
        if segments.next()? != HELP {
            return None;
        }
        let some = |text: String| Some(text).filter(|text| !text.is_empty());
        let mut place = Self { doc: segments.next().and_then(some), ..Self::default() };
        for (key, value) in query.split('&').filter_map(|pair| pair.split_once('=')) {
            match key {
                "section" => place.section = some(decode(value)),
                "words" => place.words = some(decode(value)),
                _ => {}
            }
        }
        Some(place)
    }
}

impl fmt::Display for HelpPlace {
    /// The hash, with `#`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "#/{HELP}")?;
        if let Some(doc) = &self.doc {
            write!(f, "/{}", encode(doc))?;
        }
        let pairs = [("section", &self.section), ("words", &self.words)];
        let given = pairs.into_iter().filter_map(|(key, value)| Some((key, value.as_ref()?)));
        for (idx, (key, value)) in given.enumerate() {
            write!(f, "{}{key}={}", if idx == 0 { '?' } else { '&' }, encode(value))?;
        }
        Ok(())
    }
}

/// What stands where other addresses name a screen.
const HELP: &str = "help";

fn encode(text: &str) -> String {
    utf8_percent_encode(text, RESERVED).to_string()
}

fn decode(text: &str) -> String {
    percent_decode_str(text).decode_utf8_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn link_of_a_colleague_opens_the_same_view() {
        let route = Route::from_hash("#/hand/session-1?take=take-03&t=12.4");
        assert_eq!(route.screen, Screen::Hand);
        assert_eq!(route.session.as_deref(), Some("session-1"));
        assert_eq!(route.take.as_deref(), Some("take-03"));
        assert_eq!(route.time_s, Some(12.4));
        assert_eq!(route.to_string(), "#/hand/session-1?take=take-03&t=12.4");
    }

    #[test]
    fn unknown_screen_is_not_taken_for_another() {
        let route = Route::from_hash("#/bananas/demo?take=take-01");
        assert_eq!(route.lost.as_deref(), Some("bananas"));
        assert_eq!((route.session.as_deref(), route.take.as_deref()), (None, None));
        assert_eq!(route.to_string(), "#/bananas");
    }

    #[test]
    fn nonsense_leads_to_the_first_screen() {
        for hash in ["", "#", "#/", "#/home?t=NaN", "#/home?t=-3", "#/home?&&=&x"] {
            let route = Route::from_hash(hash);
            assert_eq!(route.screen, Screen::Home, "{hash}");
            assert_eq!(route.time_s, None, "{hash}");
        }
    }

    #[test]
    fn help_is_no_screen_and_screens_are_not_help() {
        let place = HelpPlace::from_hash("#/help/learning?section=memory&x=1");
        assert_eq!(place, Some(HelpPlace::doc("learning").at(Some("memory"))));
        assert_eq!(HelpPlace::from_hash("#/help/"), Some(HelpPlace::default()));
        for hash in ["", "#/home", "#/helper", "#/home/help"] {
            assert_eq!(HelpPlace::from_hash(hash), None, "{hash}");
        }
    }

    fn id() -> impl Strategy<Value = Option<String>> {
        // `.+` and not a list of friendly characters: ids are folder names that people chose.
        proptest::option::of(".{1,12}")
    }

    proptest! {
        #[test]
        fn every_route_survives_its_hash(
            screen_idx in 0..Screen::ALL.len(), session in id(), take in id(), model in id(),
            diagnosed in id(), run in id(), (object, artifact) in (id(), id()), campaign in id(), part in id(), job in id(),
            time_ms in proptest::option::of(0_u32..10_000_000), live in any::<bool>(),
        ) {
            let screen = Screen::ALL[screen_idx];
            let time_s = time_ms.map(|ms| f64::from(ms) / 1000.0);
            let route = Route {
                screen, session, take, time_s, model, diagnosed, run, live, object, artifact, campaign, part, job,
                lost: None,
            };
            prop_assert_eq!(Route::from_hash(&route.to_string()), route);
        }

        #[test]
        fn every_place_of_help_survives_its_hash(doc in id(), section in id(), words in id()) {
            let place = HelpPlace { doc, section, words };
            prop_assert_eq!(HelpPlace::from_hash(&place.to_string()), Some(place));
        }

        #[test]
        fn any_text_is_some_route(hash in ".*") {
            let route = Route::from_hash(&hash);
            prop_assert_eq!(Route::from_hash(&route.to_string()).to_string(), route.to_string());
        }
    }
}
