//! Gears between motors and links: what lies between an encoder and the link that it speaks for.

/// The links' side of every gear.
#[derive(Clone, Debug)]
pub(crate) struct Linkage {
    /// Play, per degree of freedom, rad or m; not positive where the gear has none.
    play: Vec<f64>,
    /// Where the links are; empty before the first step.
    links: Vec<f64>,
    speeds: Vec<f64>,
}

impl Linkage {
    pub(crate) fn new(play: Vec<f64>) -> Self {
        Self { speeds: vec![0.0; play.len()], links: Vec::new(), play }
    }

    /// Turns the motors to `motors` within `dt_s`.
    pub(crate) fn turn(&mut self, motors: &[f64], dt_s: f64) {
        if self.links.is_empty() {
            self.links.extend_from_slice(motors);
            return;
        }
        for (dof, &motor) in motors.iter().enumerate() {
            let before = self.links[dof];
            let half = 0.5 * self.play[dof].max(0.0);
            // Friction holds the link until a tooth's flank takes it along.
            self.links[dof] = if half > 0.0 { before.clamp(motor - half, motor + half) } else { motor };
            self.speeds[dof] = (self.links[dof] - before) / dt_s;
        }
    }

    /// Where the links are, rad or m.
    pub(crate) fn links(&self) -> &[f64] {
        &self.links
    }

    /// How fast they are, per s.
    pub(crate) fn speeds(&self) -> &[f64] {
        &self.speeds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_link_follows_after_the_play_and_comes_back_after_it() {
        let mut linkage = Linkage::new(vec![0.2, 0.0]);
        let mut at = |motor: f64| {
            linkage.turn(&[motor, motor], 0.005);
            let links = linkage.links().to_vec();
            assert!((links[1] - motor).abs() < 1e-15, "a gear without play follows at once");
            links[0]
        };
        assert_eq!([at(0.0), at(0.05), at(0.1)], [0.0, 0.0, 0.0]);
        assert!((at(0.5) - 0.4).abs() < 1e-12);
        assert!((at(0.4) - 0.4).abs() < 1e-12 && (at(0.3) - 0.4).abs() < 1e-12);
        assert!((at(0.0) - 0.1).abs() < 1e-12);
    }
}
