//! The live twin: the simulator beside the hardware, on what the joints say and the object that is said to stand there.
//!
//! It runs on a thread of its own and takes what it gets to: frames that find it busy are left out, so that it costs the
//! control loop nothing.

mod judge;

use std::{
    collections::VecDeque,
    io,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel},
    },
    thread::{self, JoinHandle},
};

use nalgebra::Isometry3;
use palpate_messages::bits;
use palpate_robot_model::{ObjectPath, Station};
use palpate_sim::{
    SensorModel,
    effects::{Sensed, TakeScene},
};
use palpate_wire::proto::{TaxelWarning, TwinStatus};

use crate::{pace::Pace, streams::Reading};
use judge::{Expected, Judge};

/// Looks at the station: 15 Hz at most.
const LOOK_NS: u64 = 66_666_667;
/// What an effect can remember: the longest delays and slow releases of the library, with room. The whole of it is
/// simulated at every look, because effects of joints need it too; geometry of so few frames costs little.
const MEMORY_S: f64 = 3.0;
/// Frames that may wait: one that is looked at next, and no more, because older ones are of no use.
const MOST_WAITING: usize = 1;

/// What the twin is shown at one moment.
#[derive(Clone, Debug)]
pub(crate) struct TwinFrame {
    /// Host time, s.
    pub(crate) at_s: f64,
    /// Joints in the station's order; `None` before every joint was seen.
    pub(crate) positions: Option<Vec<f64>>,
    /// By channel of the layout; `None` where a board is silent or has no zero yet.
    pub(crate) readings: Vec<Option<Reading>>,
    /// What the robot touches, and where it stands; `None` while nobody has said so.
    pub(crate) object: Option<(String, Isometry3<f64>)>,
}

/// What the twin makes of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TwinView {
    pub(crate) status: TwinStatus,
    pub(crate) warnings: Vec<TaxelWarning>,
}

/// The sensor model that the twin runs with; clones are the same one.
#[derive(Clone, Debug)]
pub(crate) struct TwinModel {
    model: Arc<Mutex<Arc<SensorModel>>>,
    nominal: Arc<SensorModel>,
}

impl TwinModel {
    /// The station's own; says what is wrong with it where it cannot be used.
    pub(crate) fn nominal(station: &Station) -> Result<Self, String> {
        let file = format!("nominal model of station {}", station.id);
        let nominal = SensorModel::from_toml(&file, &station.nominal_model_toml)
            .and_then(|model| model.check_for(station).map(|()| Arc::new(model)))
            .map_err(|err| err.to_string())?;
        Ok(Self { model: Arc::new(Mutex::new(Arc::clone(&nominal))), nominal })
    }

    /// From the next look on; the station's own without one.
    pub(crate) fn set(&self, station: &Station, model: Option<SensorModel>) -> Result<String, String> {
        let model = match model {
            Some(model) => {
                model.check_for(station).map_err(|err| err.to_string())?;
                Arc::new(model)
            }
            None => Arc::clone(&self.nominal),
        };
        let name = model.name.clone();
        *self.lock() = model;
        Ok(name)
    }

    pub(crate) fn get(&self) -> Arc<SensorModel> {
        Arc::clone(&self.lock())
    }

    fn lock(&self) -> MutexGuard<'_, Arc<SensorModel>> {
        self.model.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The twin's end in the control loop; its thread ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Twin {
    frames: Option<SyncSender<TwinFrame>>,
    views: Receiver<TwinView>,
    newest: TwinView,
    looks: Pace,
    thread: Option<JoinHandle<()>>,
}

impl Twin {
    /// Starts the thread.
    pub(crate) fn start(station: Arc<Station>, model: TwinModel, now_ns: u64) -> io::Result<Self> {
        let (frames, shown) = sync_channel::<TwinFrame>(MOST_WAITING);
        let (tell, views) = sync_channel(MOST_WAITING);
        let newest = TwinView {
            status: TwinStatus { model: model.get().name.clone(), ..TwinStatus::default() },
            warnings: Vec::new(),
        };
        let thread = thread::Builder::new()
            .name("twin".to_owned())
            .spawn(move || watch(Observer::new(station, model), &shown, &tell))?;
        Ok(Self {
            frames: Some(frames),
            views,
            newest,
            looks: Pace::new(now_ns, LOOK_NS),
            thread: Some(thread),
        })
    }

    /// Whether it is time for another look.
    pub(crate) fn due(&mut self, now_ns: u64) -> bool {
        self.looks.due(now_ns)
    }

    /// Shows it a moment; one that finds the twin busy is left out.
    pub(crate) fn show(&self, frame: TwinFrame) {
        if let Some(frames) = &self.frames {
            // Busy, or gone after a panic that was printed.
            let _ = frames.try_send(frame);
        }
    }

    /// What it made of the newest moment that it has got to.
    pub(crate) fn view(&mut self) -> &TwinView {
        loop {
            match self.views.try_recv() {
                Ok(view) => self.newest = view,
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => return &self.newest,
            }
        }
    }
}

impl Drop for Twin {
    fn drop(&mut self) {
        self.frames = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was printed when it happened.
            let _ = thread.join();
        }
    }
}

fn watch(mut observer: Observer, shown: &Receiver<TwinFrame>, views: &SyncSender<TwinView>) {
    for frame in shown {
        // A loop that has not taken the view before misses this one, and one that has ended all of them.
        if let Err(TrySendError::Disconnected(_)) = views.try_send(observer.look(&frame)) {
            return;
        }
    }
}

/// What the thread does, moment by moment, without a clock of its own.
struct Observer {
    station: Arc<Station>,
    model: TwinModel,
    /// Model that the judge's account is of.
    used: Arc<SensorModel>,
    judge: Judge,
    object: Option<(String, Isometry3<f64>)>,
    /// Moments that effects can still remember, oldest first: host time, s, and joints.
    path: VecDeque<(f64, Vec<f64>)>,
    /// When the boards took their zero last, s.
    zeroed_s: f64,
    references: Vec<Option<f64>>,
    problem: String,
}

impl Observer {
    fn new(station: Arc<Station>, model: TwinModel) -> Self {
        Self {
            used: model.get(),
            model,
            judge: Judge::new(&station),
            object: None,
            path: VecDeque::new(),
            zeroed_s: 0.0,
            references: vec![None; station.layout.num_channels()],
            problem: String::new(),
            station,
        }
    }

    fn look(&mut self, frame: &TwinFrame) -> TwinView {
        let model = self.model.get();
        if !Arc::ptr_eq(&model, &self.used) {
            self.judge.forget_loads();
        }
        if self.object != frame.object {
            self.judge.forget_expectations();
            self.object.clone_from(&frame.object);
            self.path.clear();
            self.problem.clear();
        }
        self.used = model;
        self.notice_zero(frame);
        let felt = self.feel(frame);
        let expected = felt
            .as_ref()
            .map(|(active, loads)| Expected { active: active.as_slice(), loads: loads.as_slice() });
        self.judge.take_in(frame.at_s, &frame.readings, expected);
        let status = TwinStatus {
            model: self.used.name.clone(),
            active: felt.map_or_else(Vec::new, |(active, _)| bits::pack(active)),
            agreement: self.judge.agreement(),
            time_s: frame.at_s,
            problem: self.problem.clone(),
        };
        TwinView { status, warnings: self.judge.warnings(frame.at_s) }
    }

    /// Drift counts from the last zero, as takes count it from theirs.
    fn notice_zero(&mut self, frame: &TwinFrame) {
        for (known, reading) in self.references.iter_mut().zip(&frame.readings) {
            let reference = reading.map(|reading| reading.reference);
            if reference.is_some() && reference != *known {
                *known = reference;
                self.zeroed_s = frame.at_s;
            }
        }
    }

    /// Whether every channel should be on now, and its load over the one that switches it on; `None` without an object or
    /// with joints unknown.
    fn feel(&mut self, frame: &TwinFrame) -> Option<(Vec<bool>, Vec<f64>)> {
        let (object, base_from_object) = self.object.as_ref()?;
        let object = self.station.objects.get(object)?;
        let positions = frame.positions.as_ref()?;
        if self.path.back().is_none_or(|(at_s, _)| frame.at_s > *at_s) {
            self.path.push_back((frame.at_s, positions.clone()));
        }
        while self.path.front().is_some_and(|(at_s, _)| at_s + MEMORY_S < frame.at_s) {
            self.path.pop_front();
        }
        let (first_s, first) = self.path.front()?;
        // What is older is not known in detail, but that it began with the zero is.
        let before = (self.zeroed_s < *first_s).then_some((&self.zeroed_s, first));
        let moments = before.into_iter().chain(self.path.iter().map(|(at_s, positions)| (at_s, positions)));
        let (mut frame_times_s, mut path) = (Vec::new(), Vec::new());
        for (at_s, positions) in moments {
            frame_times_s.push(at_s - self.zeroed_s);
            path.extend_from_slice(positions);
        }
        let scene = TakeScene {
            station: &self.station,
            object,
            base_from_object: &ObjectPath::Still(*base_from_object),
            surroundings: &[],
            frame_times_s: &frame_times_s,
            positions: &path,
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        };
        match self.used.sense(&scene) {
            Ok(sensed) => {
                self.problem.clear();
                Some(self.newest(&sensed))
            }
            Err(err) => {
                let problem = err.to_string();
                if problem != self.problem {
                    tracing::warn!(problem, "the live twin cannot follow");
                    self.problem = problem;
                }
                None
            }
        }
    }

    fn newest(&self, sensed: &Sensed) -> (Vec<bool>, Vec<f64>) {
        let from = sensed.activation.len().saturating_sub(sensed.num_channels);
        let active: Vec<bool> =
            sensed.activation[from..].iter().map(|&activation| activation > 0.5).collect();
        let layout = &self.station.layout;
        let thetas = self.used.thetas().by_stream(layout);
        let on_loads = layout.channels.iter().map(|channel| {
            self.used.response.on_load(layout.streams[channel.stream].kind, &thetas[channel.stream])
        });
        let loads = sensed.load[from..].iter().zip(on_loads);
        // A model may have channels on without any load.
        let loads = loads
            .map(|(&load, on_load)| if load > 0.0 { load / on_load.max(f64::MIN_POSITIVE) } else { 0.0 });
        let loads = loads.collect();
        (active, loads)
    }
}

#[cfg(test)]
mod tests;
