//! The simulator beside the emulated hardware.

use palpate_sim::{SensorModel, Theta};
use palpate_wire::{
    api::{RecordingAction, StartRecording},
    proto::LiveFrame,
};

use crate::bench::{Bench, Operator};

/// What the twin warns of: channel and kind.
fn warnings(frame: &LiveFrame) -> Vec<(String, String)> {
    let taxels = frame.control.iter().flat_map(|state| &state.taxels);
    taxels.map(|warning| (warning.text.clone(), warning.kind.clone())).collect()
}

fn warns(frame: &LiveFrame, channel: &str, kind: &str) -> bool {
    warnings(frame).iter().any(|(text, known)| text.starts_with(&format!("{channel} ")) && known == kind)
}

fn agreement(frame: &LiveFrame) -> &[f32] {
    let twin = frame.control.as_ref().and_then(|state| state.twin.as_ref());
    twin.map_or(&[], |twin| &twin.agreement)
}

#[test]
fn dead_and_drifting_taxels_are_named_and_the_model_can_be_chosen() {
    let bench = Bench::new();
    let station = bench.handle.station().clone();
    let layout = &station.layout;
    let frame = bench.wait_for_frame("a twin", |frame| {
        frame
            .control
            .as_ref()
            .is_some_and(|state| state.twin.as_ref().is_some_and(|twin| !twin.model.is_empty()))
    });
    assert!(agreement(&frame).is_empty(), "nobody has said what stands there");

    let operator = Operator::in_control(&bench, 1);
    let start = StartRecording {
        plan: "quick_check".to_owned(),
        session: "twin".to_owned(),
        operator: "Ada".to_owned(),
        only_wanted: false,
    };
    bench.handle.start_recording(&operator.claim(), start).unwrap();
    bench.handle.act(&operator.claim(), RecordingAction::ConfirmObject { fixture_trusted: true }).unwrap();
    let frame = bench.wait_for_frame("an expectation", |frame| !agreement(frame).is_empty());
    assert_eq!(agreement(&frame).len(), layout.num_channels());
    // Nothing moves, nothing touches.
    assert!(agreement(&frame).iter().all(|share| *share > 0.9), "{:?}", agreement(&frame));
    assert_eq!(warnings(&frame), []);

    let first_of = |stream: usize| &layout.channels[layout.streams[stream].channels.start].id;
    let (dead, drifting) = (first_of(0), first_of(1));
    let threshold = station.streams[1].on_threshold;
    bench.set_faults(&format!(
        "[[fault]]\nkind = \"dead_taxel\"\nchannel = \"{dead}\"\n\n\
         [[fault]]\nkind = \"drift\"\nchannel = \"{drifting}\"\nraw_per_s = {}\n",
        threshold / 20.0
    ));
    let frame = bench.wait_for_frame("both named", |frame| {
        warns(frame, dead, "dead") && warns(frame, drifting, "drifted")
    });
    assert_eq!(warnings(&frame).len(), 2, "and nobody else: {:?}", warnings(&frame));
    bench.set_faults("");
    bench.wait_for_frame("both mended", |frame| warnings(frame).is_empty());

    let theta = Theta { lambda_con_m: 1e-3, alpha_per_m: 200.0, lambda_pre_pa: 1e3 };
    bench.handle.set_model(Some(SensorModel::plain("of Tuesday", theta))).unwrap();
    let model = |frame: &LiveFrame| {
        frame.control.as_ref().and_then(|state| state.twin.as_ref()).map(|twin| twin.model.clone())
    };
    bench.wait_for_frame("the chosen model", |frame| model(frame).as_deref() == Some("of Tuesday"));
    let mut misfit = SensorModel::plain("misfit", theta);
    misfit.response.off_fractions.insert("no_such_stream".to_owned(), 0.5);
    let refused = bench.handle.set_model(Some(misfit)).unwrap_err().to_string();
    assert!(refused.contains("no_such_stream"), "{refused}");
    let own = bench.handle.set_model(None).unwrap();
    bench.wait_for_frame("the station's own", |frame| model(frame).as_ref() == Some(&own));
}
