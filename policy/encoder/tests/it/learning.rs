//! What is felt is learned.

use palpate_encoder::{EncoderConfig, InputsConfig, MeanPrediction, Score, Trainer};

use crate::world::{Row, config, sources};

/// Objective of held-out samples before and after, and the score afterwards.
fn learned(inputs: InputsConfig) -> (f64, f64, Score) {
    let (data, held_out) = (Row::new(0, 480), Row::new(100_000, 160));
    let config = EncoderConfig { epochs: 30, inputs, ..config() };
    let mut trainer = Trainer::new(config, &data, sources("a")).expect("a trainer");
    let total = |trainer: &Trainer| trainer.predict(&held_out, &mut |_, _| ()).expect("losses").total();
    let before = total(&trainer);
    while trainer.updates() < trainer.num_updates() {
        trainer.update(&data).expect("an update");
    }
    let score = Score::of(|add| trainer.predict(&held_out, add).map(|_| ())).expect("a score");
    (before, total(&trainer), score)
}

#[test]
fn touch_tells_where_the_object_is_and_without_touch_nothing_does() {
    let (before, after, feeling) = learned(InputsConfig::default());
    assert!(after < 0.5 * before, "held-out loss {before} became {after}");
    let (_, _, blind) = learned(InputsConfig { touch: false, ..InputsConfig::default() });
    let mean = MeanPrediction::of(&Row::new(0, 480), &config()).expect("a mean");
    let held_out = Row::new(100_000, 160);
    let mean = Score::of(|add| -> Result<(), ()> {
        use palpate_encoder::Dataset as _;
        (0..held_out.len()).for_each(|idx| add(mean.prediction(), &held_out.sample(idx)));
        Ok(())
    })
    .expect("a score");
    let cm = |score: &Score| score.position_cm.expect("contacts");
    assert!(cm(&feeling) < 0.5 * cm(&blind), "{feeling:?} {blind:?}");
    assert!(cm(&feeling) < 0.5 * cm(&mean), "{feeling:?} {mean:?}");
    assert!(feeling.contact_auc > Some(0.98) && blind.contact_auc < Some(0.8), "{feeling:?} {blind:?}");
    // Joints are read off the taxels' places.
    assert!(feeling.joint_rms < 0.75 * mean.joint_rms, "{feeling:?} {mean:?}");
}

#[test]
fn the_same_seed_has_the_same_bits_for_any_number_of_threads() {
    let bytes = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let data = Row::new(0, 100);
            let mut trainer =
                Trainer::new(EncoderConfig { seed, ..config() }, &data, sources("a")).expect("a trainer");
            (0..4).for_each(|_| {
                trainer.update(&data).expect("an update");
            });
            trainer.to_checkpoint()
        })
    };
    let one = bytes(1, 0);
    assert!(one == bytes(3, 0), "other bits with three threads");
    assert!(one != bytes(1, 1), "another seed makes no difference");
}

#[test]
fn samples_that_do_not_fit_are_refused_by_name() {
    let refused = |data: &Row| Trainer::new(config(), data, sources("a")).expect_err("refused").to_string();
    let broken = Row { broken: Some(7), ..Row::new(0, 100) };
    let refusals = [refused(&broken), refused(&Row::new(0, 47)), refused(&Row::new(0, 0))];
    assert_eq!(refusals.join("\n"), include_str!("../refusals/samples.txt").trim_end());
}
