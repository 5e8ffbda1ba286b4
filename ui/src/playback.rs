//! Where in which take everybody looks: shared by the hand, the timelines and the address bar.

use std::{collections::BTreeSet, fmt};

use crate::take_data::TakeData;

/// A simulation to compare the recording with.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum ModelRef {
    /// The station's nominal sensor model.
    #[default]
    Nominal,
    /// A saved model, by id.
    Saved(String),
    /// What a finished calibration run found, by the run's id.
    Run(String),
    /// The calibrated model that a finished diagnosis started from, by the diagnosis' id.
    Calibrated(String),
    /// That model with the effects that the diagnosis named.
    Diagnosis(String),
}

impl ModelRef {
    /// The text in addresses, the page's and the server's: `nominal`, a model's id, `run:ID`, `calibrated:ID`,
    /// `diagnosis:ID`.
    pub fn key(&self) -> String {
        self.to_string()
    }

    /// Reads [`ModelRef::key`].
    pub fn from_key(key: &str) -> Option<Self> {
        match key.split_once(':') {
            None if key.is_empty() => None,
            None if key == "nominal" => Some(Self::Nominal),
            None => Some(Self::Saved(key.to_owned())),
            Some(("run" | "calibrated" | "diagnosis", "")) => None,
            Some(("run", id)) => Some(Self::Run(id.to_owned())),
            Some(("calibrated", id)) => Some(Self::Calibrated(id.to_owned())),
            Some(("diagnosis", id)) => Some(Self::Diagnosis(id.to_owned())),
            Some(_) => Some(Self::Saved(key.to_owned())),
        }
    }
}

impl fmt::Display for ModelRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nominal => write!(f, "nominal"),
            Self::Saved(id) => write!(f, "{id}"),
            Self::Run(id) => write!(f, "run:{id}"),
            Self::Calibrated(id) => write!(f, "calibrated:{id}"),
            Self::Diagnosis(id) => write!(f, "diagnosis:{id}"),
        }
    }
}

/// What Hand and Timelines show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum HandSource {
    /// The chosen take at the cursor.
    #[default]
    Recorded,
    /// The live station.
    Live,
}

/// Which channels have a lane in the timelines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum ShownChannels {
    /// Those touched in the take, in reality or in a simulation.
    #[default]
    Touched,
    /// All.
    All,
    /// Those picked by hand.
    Picked,
}

/// The shared cursor and selection.
#[derive(Clone, Debug)]
pub struct Playback {
    /// Session looked at, by id.
    pub session: Option<String>,
    /// Take looked at, by id.
    pub take: Option<String>,
    /// Cursor, seconds since the take's start.
    pub time_s: f64,
    /// Duration of the take, s; 0 until it is known.
    pub duration_s: f64,
    /// Whether the cursor moves by itself.
    pub playing: bool,
    /// Seconds of take per second of wall clock.
    pub speed: f64,
    /// The second simulation (blue), beside the nominal one (orange); `None` until there is one to compare.
    pub compared: Option<ModelRef>,
    /// The third simulation (green), with effects beyond the three parameters; `None` until there is one.
    pub diagnosed: Option<ModelRef>,
    /// Diagnosis whose residual map colours the hand, by id, once the operator asked for it.
    pub residual_of: Option<String>,
    /// Recorded or live.
    pub hand_source: HandSource,
    /// Channels picked by the operator, shown in the timelines and marked on the hand.
    pub selected: BTreeSet<usize>,
    /// Which channels have a lane in the timelines.
    pub shown: ShownChannels,
    /// Channel under the pointer, in whichever view; cleared at the start of each frame.
    pub hovered: Option<usize>,
    /// Channel whose details stay in the side panel.
    pub pinned: Option<usize>,
    /// `hovered` of the frame before, so that a view drawn earlier can show what a later one hovers.
    pub hovered_before: Option<usize>,
}

impl Default for Playback {
    fn default() -> Self {
        Self {
            session: None,
            take: None,
            time_s: 0.0,
            duration_s: 0.0,
            playing: false,
            speed: 1.0,
            compared: None,
            diagnosed: None,
            residual_of: None,
            hand_source: HandSource::default(),
            selected: BTreeSet::new(),
            shown: ShownChannels::default(),
            hovered: None,
            pinned: None,
            hovered_before: None,
        }
    }
}

impl Playback {
    /// Speeds on offer.
    pub const SPEEDS: [f64; 6] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0];

    /// Starts a frame: moves the cursor by `dt_secs` if playing and turns the page of `hovered`.
    pub fn begin_frame(&mut self, dt_secs: f64) {
        self.hovered_before = self.hovered.take();
        if !self.playing {
            return;
        }
        // A tab that slept must not leap: at most a tenth of a second a frame.
        self.time_s += dt_secs.clamp(0.0, 0.1) * self.speed;
        if self.duration_s > 0.0 && self.time_s >= self.duration_s {
            self.time_s = self.duration_s;
            self.playing = false;
        }
    }

    /// Looks at another session (or the same one). Picked channels and the compared simulation stay behind: they may mean
    /// nothing on another station.
    pub fn open_session(&mut self, session: &str) {
        if self.session.as_deref() == Some(session) {
            return;
        }
        *self = Self {
            session: Some(session.to_owned()),
            speed: self.speed,
            hand_source: self.hand_source,
            ..Self::default()
        };
    }

    /// Looks at another take (or the same one), from its start.
    pub fn open(&mut self, session: &str, take: &str) {
        self.open_session(session);
        if self.take.as_deref() == Some(take) {
            return;
        }
        self.take = Some(take.to_owned());
        self.time_s = 0.0;
        self.duration_s = 0.0;
        self.playing = false;
    }

    /// Pauses, and moves the cursor by so many joint frames of the take it is in.
    pub fn step_frames(&mut self, take: &TakeData, by: isize) {
        self.playing = false;
        if let Some(frame) = take.frame_at(self.time_s) {
            let frame = frame.saturating_add_signed(by).min(take.num_frames().saturating_sub(1));
            self.seek(take.trace.frame_times_s[frame]);
        }
    }

    /// Moves the cursor, within the take.
    pub fn seek(&mut self, time_s: f64) {
        if time_s.is_finite() {
            let end_s = if self.duration_s > 0.0 { self.duration_s } else { f64::INFINITY };
            self.time_s = time_s.clamp(0.0, end_s);
        }
    }

    /// Plays, or pauses; from the start again when the end was reached.
    pub fn toggle_playing(&mut self) {
        if !self.playing && self.duration_s > 0.0 && self.time_s >= self.duration_s {
            self.time_s = 0.0;
        }
        self.playing = !self.playing;
    }

    /// The channel that views should highlight.
    pub fn highlighted(&self) -> Option<usize> {
        self.hovered.or(self.hovered_before)
    }
}

#[cfg(test)]
mod tests {
    use palpate_wire::proto::TakeTrace;

    use super::*;

    #[test]
    fn steps_go_from_frame_to_frame_and_stop_at_the_ends() {
        let trace = TakeTrace {
            frame_times_s: vec![0.0, 0.1, 0.25],
            joint_positions: vec![0.0; 3],
            ..Default::default()
        };
        let take = TakeData::new(trace).expect("a take");
        let mut playback = Playback { duration_s: 0.25, time_s: 0.12, playing: true, ..Default::default() };
        playback.step_frames(&take, 1);
        assert_eq!((playback.time_s, playback.playing), (0.25, false));
        playback.step_frames(&take, 1);
        assert_eq!(playback.time_s, 0.25);
        playback.step_frames(&take, -5);
        assert_eq!(playback.time_s, 0.0);
    }

    #[test]
    fn another_session_leaves_picks_and_models_behind() {
        let mut playback = Playback { speed: 0.5, ..Default::default() };
        playback.open("a", "take-01");
        playback.selected.insert(3);
        playback.compared = Some(ModelRef::Run("run-1".into()));
        playback.open("a", "take-02");
        assert!(playback.compared.is_some() && playback.selected.contains(&3));
        playback.open("b", "take-01");
        assert!(playback.compared.is_none() && playback.selected.is_empty());
        assert_eq!((playback.session.as_deref(), playback.speed), (Some("b"), 0.5));
    }

    #[test]
    fn playing_stops_at_the_end_and_starts_over() {
        let mut playback = Playback { duration_s: 1.0, playing: true, time_s: 0.95, ..Default::default() };
        playback.begin_frame(0.1);
        assert_eq!((playback.time_s, playback.playing), (1.0, false));
        playback.toggle_playing();
        assert_eq!((playback.time_s, playback.playing), (0.0, true));
    }

    #[test]
    fn sleeping_tab_does_not_leap() {
        let mut playback = Playback { duration_s: 100.0, playing: true, ..Default::default() };
        playback.begin_frame(30.0);
        assert!((playback.time_s - 0.1).abs() < 1e-12);
    }

    #[test]
    fn model_keys_round_trip() {
        for model in [
            ModelRef::Nominal,
            ModelRef::Saved("a:b".into()),
            ModelRef::Run("7".into()),
            ModelRef::Calibrated("diagnosis-2".into()),
            ModelRef::Diagnosis("diagnosis-2".into()),
        ] {
            assert_eq!(ModelRef::from_key(&model.key()), Some(model));
        }
        for key in ["", "run:"] {
            assert_eq!(ModelRef::from_key(key), None, "{key}");
        }
    }

    #[test]
    fn cursor_ignores_nonsense() {
        let mut playback = Playback { duration_s: 2.0, ..Default::default() };
        playback.seek(f64::NAN);
        assert_eq!(playback.time_s, 0.0);
        playback.seek(1e9);
        assert_eq!(playback.time_s, 2.0);
    }
}
