//! How fast the simulated arm is: `cargo bench --bench simulated_arm`.
//!
//! Time per millisecond of the arm's life along a lively motion of all joints, the shortest of several repeats; and a whole response: six
//! trajectories of ten periods of ten seconds with noise, as a study of a diagnosis needs for one case.

use plumbline_core::{Backend, Command, JointVec, Reference, Setpoint};
use plumbline_excite::{Fourier, PeriodicMotion};
use plumbline_model::{Mounting, Robot};
use plumbline_sim::{Gate, Pace, Response, SimArm};
use plumbline_testkit::sim::arm;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

const READY: [f64; 7] = [0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5];

fn motion(seed: usize, periods: u32) -> PeriodicMotion {
    let mut fourier = Fourier::still(10.0, READY.to_vec(), 5).expect("a pose");
    for j in 0..7 {
        for k in 0..5 {
            let angle = (1 + seed) as f64 * (1.7 * j as f64 + 2.3 * k as f64 + 0.4);
            fourier.a[(j, k)] = 0.12 * angle.sin();
            fourier.b[(j, k)] = 0.12 * angle.cos();
        }
    }
    fourier.project();
    PeriodicMotion::new(&fourier, periods).expect("a motion from rest to rest")
}

fn main() {
    let quick = std::env::args().any(|arg| arg == "--quick");
    let chain = Robot::load("panda", None).expect("a shipped robot").chain;
    let mut start: JointVec = [0.0; 8];
    start[..7].copy_from_slice(&READY);
    for file in ["sim-panda", "sim-panda-effect"] {
        let truth = arm(file);
        let (ticks, repeats) = if quick { (1000, 1) } else { (5000, 9) };
        let reference = motion(0, 1);
        let per_tick = (0..repeats).map(|_| {
            let pace = Pace::Fast(Arc::new(Gate::unlimited()));
            start[..7].copy_from_slice(&reference.at(0).q[..7]);
            let mut simulated =
                SimArm::new(&chain, &truth, Mounting::WALL, start, 0, pace).expect("truth fits the robot");
            let began = Instant::now();
            for tick in 0..ticks {
                let state = simulated.read().expect("the arm goes on");
                let desired = Setpoint { q: reference.at(tick).q, ..Setpoint::default() };
                simulated.write(&Command { seq: state.seq, desired, ..Command::default() }).expect("a smooth motion");
                black_box(&state);
            }
            began.elapsed().as_secs_f64() / ticks as f64
        });
        println!("{file}: {:.2} us per ms of the arm's life", per_tick.fold(f64::INFINITY, f64::min) * 1e6);
    }
    let truth = arm("sim-panda");
    let trajectories = if quick { 1 } else { 6 };
    let whole = (0..if quick { 1 } else { 5 }).map(|_| {
        let began = Instant::now();
        for trajectory in 0..trajectories {
            let reference = motion(trajectory, 10);
            let response = Response::simulate(&chain, &truth, Mounting::WALL, &reference, reference.period_ticks(), 10);
            let mut sum = 0.0;
            response.expect("truth fits the robot").measure(trajectory as u64, |_, _, state| sum += state.tau[0]);
            black_box(sum);
        }
        began.elapsed().as_secs_f64()
    });
    println!("{trajectories} trajectories, 10 periods of 10 s: {:.2} s", whole.fold(f64::INFINITY, f64::min));
}
