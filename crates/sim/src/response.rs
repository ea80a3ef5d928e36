//! States of an arm along a periodic motion, without a loop: for studies of thousands of runs.
//!
//! The arm is simulated without noise, for one period where nothing changes with time; noise is drawn afterwards for every period.
//! Ten periods then cost as much as one.

use super::commands::{Commands, TICK_S};
use super::effect::Reading;
use super::plant::Plant;
use super::sensors::{Faults, Losses, Sensors};
use super::truth::Truth;
use super::{SimError, check};
use plumbline_core::{JointVec, Reference, State};
use plumbline_model::{Chain, Mounting};

/// Lead before the first period, in which transients decay \[ms\].
pub const LEAD_TICKS: u64 = 1000;

/// Noise-free readings along a motion.
pub struct Response {
    truth: Truth,
    period_ticks: usize,
    periods: usize,
    /// Of one period where the arm repeats, else of all periods.
    readings: Vec<(Reading, JointVec)>,
}

impl Response {
    /// Follows `periods` periods of `reference`, which repeats after `period_ticks` \[ms\].
    ///
    /// The arm's time begins [`LEAD_TICKS`] before the first sample, with the arm already moving; sample k is the state in which the arm
    /// has taken up the reference's sample k.
    ///
    /// # Errors
    /// [`SimError`] when truth and chain do not fit, or a number is not finite.
    pub fn simulate(
        chain: &Chain,
        truth: &Truth,
        mounting: Mounting,
        reference: &dyn Reference,
        period_ticks: u64,
        periods: usize,
    ) -> Result<Response, SimError> {
        assert!(period_ticks > 0 && periods > 0, "{periods} periods of {period_ticks} ms");
        let n = chain.len();
        let at = |tick: u64| reference.at(tick % period_ticks);
        // The first command of the lead, and three before it.
        let first = period_ticks * (LEAD_TICKS.div_ceil(period_ticks) + 4) - LEAD_TICKS;
        let mut commands = Commands::at_rest(n, &at(first - 4).q);
        (1..4).for_each(|back| commands.push(&at(first - 4 + back).q));
        let start = commands.at(1.0);
        let (gravity, effects) = (mounting.gravity(), truth.build_effects());
        check(chain, truth, &gravity, &start.q, &effects)?;
        let mut plant = Plant::new(chain, truth, gravity, &start.q, effects);
        plant.start_moving(&start.dq, &commands);
        let simulated = if truth.repeats(period_ticks as f64 * TICK_S) { 1 } else { periods };
        let samples = simulated * period_ticks as usize;
        let mut readings = Vec::with_capacity(samples);
        for tick in 0..LEAD_TICKS + samples as u64 {
            commands.push(&at(first + tick).q);
            plant.advance(&commands);
            // Effects of the sensors may have a memory, so the lead is read, too.
            let (reading, _) = plant.sense();
            if tick >= LEAD_TICKS {
                readings.push((reading, *commands.newest()));
            }
        }
        Ok(Response { truth: truth.clone(), period_ticks: period_ticks as usize, periods, readings })
    }

    /// Samples of a period.
    pub fn period_ticks(&self) -> usize {
        self.period_ticks
    }

    /// Number of periods.
    pub fn periods(&self) -> usize {
        self.periods
    }

    /// Calls `take` for every state that arrives, with period and sample in the period. `seed` decides noise, faults and losses.
    pub fn measure(&self, seed: u64, mut take: impl FnMut(usize, usize, &State)) {
        let mut sensors = Sensors::new(&self.truth, seed);
        let mut faults = Faults::new(&self.truth, seed);
        let mut losses = Losses::new(&self.truth, seed);
        let mut clean = self.readings.iter().cycle();
        for period in 0..self.periods {
            for (tick, (reading, q_d)) in (0..self.period_ticks).zip(&mut clean) {
                let seq = LEAD_TICKS + (period * self.period_ticks + tick) as u64 + 1;
                let (mut reading, mut time) = (*reading, seq as f64 * TICK_S);
                sensors.add_noise(&mut reading);
                faults.apply(&mut reading, &mut time);
                if !losses.next() {
                    let Reading { q, dq, tau } = reading;
                    take(period, tick, &State { seq, time, q, dq, tau, q_d: *q_d });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Gate, Pace, SimArm};
    use super::*;
    use crate::two_joints::{self, chain};
    use plumbline_core::{Backend, Command, Setpoint};
    use plumbline_model::Placement;
    use std::f64::consts::TAU;
    use std::sync::Arc;

    const PERIOD: u64 = 700;

    fn truth(effects: &str, noise: f64) -> Truth {
        two_joints::truth("", &format!("fv = 0.1, fc = 0.3, torque-noise = {noise}"), effects)
    }

    /// A motion that starts at rest.
    struct Wave;
    impl Reference for Wave {
        fn ticks(&self) -> u64 {
            u64::MAX
        }

        fn at(&self, tick: u64) -> Setpoint {
            let angle = TAU * (tick % PERIOD) as f64 / PERIOD as f64;
            let mut point = Setpoint::default();
            (point.q[0], point.q[1]) = (0.1 * (1.0 - angle.cos()).powi(2), 0.3 - 0.05 * (1.0 - angle.cos()).powi(2));
            point
        }
    }

    fn response(truth: &Truth, periods: usize) -> Response {
        Response::simulate(&chain(), truth, Mounting::WALL, &Wave, PERIOD, periods).expect("truth fits the chain")
    }

    /// The same by the long way: a loop that reads and writes, from rest, and looks at a later period.
    #[test]
    fn equals_the_arm_in_a_loop() {
        let truth = truth("{ id = 'presliding', joint = 2, delta = 0.002 }, { id = 'delay', delay = 0.0013 }", 0.0);
        let pace = Pace::Fast(Arc::new(Gate::unlimited()));
        let mut arm =
            SimArm::new(&chain(), &truth, Mounting::WALL, Wave.at(0).q, 0, pace).expect("truth fits the chain");
        let long: Vec<State> = (0..5 * PERIOD)
            .map(|tick| {
                let state = arm.read().expect("the arm goes on");
                let desired = Setpoint { q: Wave.at(tick).q, ..Setpoint::default() };
                arm.write(&Command { seq: state.seq, desired, ..Command::default() }).expect("a smooth motion");
                state
            })
            .collect();
        let short = response(&truth, 3);
        assert_eq!(short.readings.len(), PERIOD as usize, "one period is enough");
        let mut seen = 0;
        short.measure(0, |period, tick, state| {
            // The loop's command of a tick is taken up in the state after.
            let same = &long[3 * PERIOD as usize + tick + 1];
            assert_eq!(state.q_d, same.q_d);
            for j in 0..2 {
                assert!((state.q[j] - same.q[j]).abs() < 1e-9, "period {period}, sample {tick}");
                assert!((state.tau[j] - same.tau[j]).abs() < 1e-6, "{} {}", state.tau[j], same.tau[j]);
            }
            assert_eq!(state.seq, LEAD_TICKS + 1 + seen);
            seen += 1;
        });
        assert_eq!(seen, 3 * PERIOD);
    }

    #[test]
    fn draws_noise_anew_in_every_period() {
        let response = response(&truth("", 0.1), 40);
        let taken = |seed| {
            let mut tau = Vec::new();
            response.measure(seed, |_, tick, state| tau.push(state.tau[1] - response.readings[tick].0.tau[1]));
            tau
        };
        let noise = taken(5);
        assert_eq!(noise, taken(5));
        assert_ne!(noise, taken(6));
        let rms = |values: &[f64]| (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt();
        assert!((rms(&noise) / 0.1 - 1.0).abs() < 0.02, "{}", rms(&noise));
        // The mean of 40 periods: the noise is new in each.
        let mean = |tick: usize| noise.iter().skip(tick).step_by(PERIOD as usize).sum::<f64>() / 40.0;
        let floor = rms(&(0..PERIOD as usize).map(mean).collect::<Vec<_>>());
        assert!((floor / (0.1 / 40f64.sqrt()) - 1.0).abs() < 0.1, "{floor}");
    }

    /// What changes with time is simulated for as long as it takes.
    #[test]
    fn effects_that_do_not_repeat_are_simulated_for_all_periods() {
        let cases = [
            ("{ id = 'offset-drift', joint = 1, drift = 0.5, time = 5 }", false),
            ("{ id = 'friction-drift', share = 0.5, time = 5 }", false),
            ("{ id = 'base-motion', frequency = 3.1, amplitude = 0.5, direction = [1, 0, 0] }", false),
            ("{ id = 'contact', force = [9, 0, 0], from = 1.1, to = 1.4 }", false),
            ("{ id = 'torque-offset', joint = 1, offset = 0.5, from = 2.0 }", false),
            ("{ id = 'base-motion', frequency = 10.0, amplitude = 0.5, direction = [1, 0, 0] }", true),
            ("{ id = 'contact', force = [9, 0, 0], to = 0.3, every = 0.35 }", true),
            ("{ id = 'foreign', form = 'beat', joint = 1, size = 0.3, every = 0.7 }", true),
            ("{ id = 'spring', joint = 1, stiffness = 3 }", true),
        ];
        for (effect, repeats) in cases {
            let truth = truth(effect, 0.0);
            assert_eq!(truth.repeats(PERIOD as f64 * 1e-3), repeats, "{effect}");
            let mut periods = vec![vec![]; 3];
            response(&truth, 3).measure(0, |period, _, state| periods[period].push(state.tau[0]));
            assert_eq!(periods[0] == periods[2], repeats, "{effect}");
            assert_eq!(periods.iter().map(Vec::len).sum::<usize>(), 3 * PERIOD as usize);
            let plain = response(&self::truth("", 0.0), 3);
            let mut apart = 0.0f64;
            plain.measure(0, |period, tick, state| apart = apart.max((state.tau[0] - periods[period][tick]).abs()));
            assert!(apart > 1e-3 && apart < 5.0, "{effect}: {apart} Nm");
        }
    }

    #[test]
    fn arms_that_do_not_fit_are_refused() {
        let short = Chain::modified(chain().joints()[..1].to_vec(), Placement::identity());
        let error = Response::simulate(&short, &truth("", 0.0), Mounting::WALL, &Wave, PERIOD, 1).err();
        assert_eq!(error, Some(SimError::Joints { truth: 2, chain: 1 }));
    }
}
