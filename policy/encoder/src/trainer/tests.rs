use super::*;
use crate::NetworkConfig;

/// Samples of numbers that mean nothing; every third without contact.
struct Waves;

impl Dataset for Waves {
    fn len(&self) -> usize {
        20
    }

    fn num_channels(&self) -> usize {
        3
    }

    fn num_joints(&self) -> usize {
        2
    }

    fn sample(&self, idx: usize) -> Sample {
        let wave = |len: usize, pace: f32, size: f32| -> Vec<f32> {
            (0..len).map(|i| size * (idx as f32 + i as f32 * pace).sin()).collect()
        };
        let contact = f32::from(u8::from(!idx.is_multiple_of(3)));
        Sample {
            input: wave(2 * 3 * 4, 0.7, 1.0),
            hand_points: wave(4 * 3, 1.3, 0.1),
            object_points: wave(6 * 3, 0.9, 0.1),
            pose: [0.05, 0.01, -0.03, 0.5, 0.5, -0.5, 0.5].map(|value| value * (1.0 + 0.1 * idx as f32)),
            joints: wave(2, 0.4, 0.5),
            contacts: vec![contact, 0.0, contact],
        }
    }
}

#[test]
fn gradients_of_every_parameter_are_differences_of_the_objective() {
    let config = EncoderConfig {
        batch_size: 20,
        history: 2,
        hand_points: 4,
        object_points: 6,
        network: NetworkConfig {
            width: 6,
            layers: 1,
            decoder_layers: 2,
            heads: 2,
            feed_forward: 5,
            points_per_query: 2,
        },
        ..EncoderConfig::default()
    };
    let mut trainer = Trainer::new(config, &Waves, BTreeMap::new()).expect("a trainer");
    // Away from the means, where many predictions are alike.
    for (idx, array) in trainer.networks.arrays.iter_mut().enumerate() {
        array.values.iter_mut().enumerate().for_each(|(at, value)| *value += 0.1 * ((idx + at) as f32).sin());
    }
    let samples: Vec<Sample> = (0..Waves.len()).map(|idx| Waves.sample(idx)).collect();
    let (slopes, terms) = trainer.gradients(&samples, samples.len()).expect("gradients");
    let predicted = trainer.predict(&Waves, &mut |_, _| ()).expect("losses");
    assert!((predicted.total() - terms.total()).abs() < 1e-6);
    let mut felt = 0;
    for (array, slopes) in slopes.iter().enumerate() {
        for at in [0, slopes.len() / 2] {
            let moved = |by: f32| {
                let mut moved = trainer.clone();
                moved.networks.arrays[array].values[at] += by;
                moved.predict(&Waves, &mut |_, _| ()).expect("losses").total()
            };
            let slope = (moved(2e-3) - moved(-2e-3)) / 4e-3;
            let found = f64::from(slopes[at]);
            let name = &trainer.networks.arrays[array].name;
            assert!((found - slope).abs() < 2e-3 + 0.02 * slope.abs(), "{name}[{at}]: {found} {slope}");
            felt += usize::from(slope.abs() > 5e-3);
        }
    }
    assert!(felt > slopes.len() / 2, "only {felt} slopes are felt");
}
