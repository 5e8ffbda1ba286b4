use super::*;
use crate::emulated::{Driven, Emulated, one_at_a_time};

fn driven(emulated: &Emulated, line: &str, num_channels: usize, lines_per_sample: usize) -> Driven {
    let port = emulated.line(line);
    let setup =
        BoardSetup { port, baud: 115_200, stream: 1, first_channel: 8, num_channels, lines_per_sample };
    Driven::start(line, move |context| run(context, &setup))
}

fn is_sample(event: &DeviceEvent) -> bool {
    matches!(event, DeviceEvent::Tactile { .. })
}

/// Readings of the samples seen so far, after checking that they are dated in order.
fn readings(driven: &Driven) -> Vec<Vec<f32>> {
    let mut last_ns = 0;
    let mut all = Vec::new();
    for event in &driven.seen {
        if let DeviceEvent::Tactile { received_ns, host_ns, device_ns, stream, first_channel, raw, .. } =
            event
        {
            // Two that one read brought are a moment apart.
            assert!(*host_ns > last_ns && device_ns.is_none());
            assert!((*received_ns..received_ns + 1000).contains(host_ns), "{host_ns} {received_ns}");
            assert_eq!((*stream, *first_channel), (1, 8));
            last_ns = *host_ns;
            all.push(raw.clone());
        }
    }
    all
}

fn take(driven: &mut Driven, count: usize) -> Vec<Vec<f32>> {
    driven.forget();
    (0..count).for_each(|_| drop(driven.wait_for("a sample", is_sample)));
    readings(driven)
}

#[test]
fn boards_give_their_samples_and_survive_garbage_unplugging_and_replugging() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut tip = driven(&emulated, "twintac0", 8, 1);
    let mut palm = driven(&emulated, "fsr", 12, 3);
    tip.wait_for_link(Link::Ready);
    palm.wait_for_link(Link::Ready);
    let untouched = take(&mut tip, 100);
    assert!(untouched.iter().all(|raw| raw.len() == 8));
    assert!(untouched.iter().flatten().all(|raw| (7900.0..8100.0).contains(raw)), "{untouched:?}");
    let untouched = take(&mut palm, 40);
    assert!(untouched.iter().all(|raw| raw.len() == 12));
    // Every third line is preceded by bytes that nobody sent, or lost.
    emulated.set_faults(
        "[[fault]]\nkind = \"garbage\"\ndevice = \"twintac0\"\nshare = 0.3\n\
         [[fault]]\nkind = \"lost\"\ndevice = \"fsr\"\nshare = 0.3\n",
    );
    let bad = |driven: &Driven| driven.context.health.snapshot(driven.context.clock.now_ns()).bad_frames;
    let (tip_before, palm_before) = (bad(&tip), bad(&palm));
    while bad(&tip) < tip_before + 20 || bad(&palm) < palm_before + 20 {
        assert!(take(&mut tip, 10).iter().flatten().all(|raw| (7900.0..8100.0).contains(raw)));
        assert!(take(&mut palm, 2).iter().all(|raw| raw.len() == 12));
    }
    emulated.set_faults(
        "[[fault]]\nkind = \"unplug\"\ndevice = \"twintac0\"\n[[fault]]\nkind = \"unplug\"\ndevice = \"fsr\"\n",
    );
    let problem = tip.wait_for_link(Link::Lost);
    assert!(problem.contains("twintac0"), "{problem}");
    palm.wait_for_link(Link::Lost);
    emulated.set_faults("");
    tip.wait_for_link(Link::Ready);
    palm.wait_for_link(Link::Ready);
    assert_eq!(take(&mut tip, 20).len(), 20);
    assert_eq!(take(&mut palm, 20).len(), 20);
    assert_eq!(tip.context.health.snapshot(0).reconnects, 1);
    tip.end();
    palm.end();
}

#[test]
fn a_board_that_goes_silent_is_lost_and_one_of_another_shape_has_a_fault() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut tip = driven(&emulated, "twintac1", 8, 1);
    tip.wait_for_link(Link::Ready);
    let mut wrong = driven(&emulated, "twintac2", 6, 1);
    let problem = wrong.wait_for_link(Link::Fault);
    assert!(problem.contains("than the 6 expected"), "{problem}");
    emulated.set_faults("[[fault]]\nkind = \"lost\"\ndevice = \"twintac1\"\nshare = 1.0\n");
    let problem = tip.wait_for_link(Link::Lost);
    assert!(problem.contains("sent nothing"), "{problem}");
    emulated.set_faults("");
    tip.wait_for_link(Link::Ready);
}

#[test]
fn a_driver_of_a_board_that_panics_is_started_again() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut tip = driven(&emulated, "twintac1", 8, 1);
    tip.wait_for_link(Link::Ready);
    tip.context.panics.store(true, std::sync::atomic::Ordering::Relaxed);
    let problem = tip.wait_for_link(Link::Lost);
    assert!(problem.contains("driver failed") && problem.contains("started again"), "{problem}");
    tip.wait_for_link(Link::Ready);
    assert_eq!(take(&mut tip, 5).len(), 5);
    tip.end();
}

#[test]
fn a_port_that_is_not_there_is_explained() {
    let setup = BoardSetup {
        port: PathBuf::from("/nowhere/ttyACM7"),
        baud: 115_200,
        stream: 0,
        first_channel: 0,
        num_channels: 8,
        lines_per_sample: 1,
    };
    let mut driven = Driven::start("twintac7", move |context| run(context, &setup));
    let problem = driven.wait_for_link(Link::Lost);
    assert!(problem.contains("/nowhere/ttyACM7") && problem.contains("check plug"), "{problem}");
    driven.end();
}
