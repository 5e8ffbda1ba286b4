//! Where the operator is, as the part of the address after `#`: `#/hand/session-1?take=take-03&t=12.4`.

use std::fmt;

use percent_encoding::{AsciiSet, CONTROLS, percent_decode_str, utf8_percent_encode};

use crate::screens::{self, About};

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

/// Makes [`Screen`] from names of screens and of their modules, in the order of the rail.
macro_rules! screens {
    ($($name:ident: $module:ident,)*) => {
        /// The screens of the rail.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Screen {
            $(#[doc = concat!("[`screens::", stringify!($module), "`].")] $name,)*
        }

        impl Screen {
            /// All screens, in the order of the rail.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// What is said of the screen.
            pub fn about(self) -> &'static About {
                match self {
                    $(Self::$name => &screens::$module::ABOUT,)*
                }
            }
        }
    };
}

screens! {
    Home: home,
    Hand: hand,
    Record: record,
    Sessions: sessions,
    Timelines: timelines,
    Objects: objects,
    Plans: plans,
    Calibrate: calibrate,
    Diagnose: diagnose,
    Models: models,
    Trials: trials,
    Jobs: jobs,
    Settings: settings,
}

impl Screen {
    /// The word in the rail.
    pub fn label(self) -> &'static str {
        self.about().label
    }

    /// Whether the screen has something to offer: recording needs a live station that takes commands.
    pub fn is_offered(self, commandable: bool) -> bool {
        commandable || !self.about().needs_station
    }

    fn from_slug(slug: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|screen| screen.about().slug == slug)
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
    /// Plan shown, or to be recorded, by id.
    pub plan: Option<String>,
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
            plan: None,
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
                "plan" => route.plan = value,
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
            let Self { session, take, run, object, plan, artifact, campaign, part, job, .. } = route.clone();
            [session, take, run, object, plan, artifact, campaign, part, job]
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
        write!(f, "#/{}", self.screen.about().slug)?;
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
            ("plan", &self.plan),
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
            diagnosed in id(), run in id(), (object, plan, artifact) in (id(), id(), id()), campaign in id(), part in id(), job in id(),
            time_ms in proptest::option::of(0_u32..10_000_000), live in any::<bool>(),
        ) {
            let screen = Screen::ALL[screen_idx];
            let time_s = time_ms.map(|ms| f64::from(ms) / 1000.0);
            let route = Route {
                screen, session, take, time_s, model, diagnosed, run, live, object, plan, artifact, campaign, part, job,
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
