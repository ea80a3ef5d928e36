//! The 1 kHz loop: it reads the arm's state, evaluates motion and model, checks the command against every limit and writes it. Begin reading
//! at [`cycle`].
//!
//! Nothing that runs inside a cycle allocates, locks, logs, panics, or makes a system call beyond its clock and its backend.
//!
//! | what | items |
//! |---|---|
//! | the loop | [`cycle::new`], [`cycle::Cycle::run`], [`CycleSettings`] |
//! | orders and events over lock-free rings | [`Order`], [`Event`], [`Handles`] |
//! | stop, resume, quit, state | [`Controls`] |
//! | limits of commands and states | [`Guard`], [`GuardSettings`], [`Violation`] |
//! | feed-forward torque and the hand-over from model to model | [`Torques`], [`Succession`] |
//! | records for the rest of the program | [`recorder`] |
//! | clock, deadlines, real-time rights | [`os`], [`become_realtime`] |
//!
//! ```
//! use plumbline_core::{Backend, Command, Fault, Limits, Phase, State};
//! use plumbline_rt::{CycleSettings, Event, GuardSettings, Order, OrderKind, Rights, cycle, recorder};
//!
//! /// An ideal arm: it reaches every commanded position at once.
//! struct Ideal(State);
//!
//! impl Backend for Ideal {
//!     fn joints(&self) -> usize {
//!         1
//!     }
//!     fn read(&mut self) -> Result<State, Fault> {
//!         self.0.seq += 1;
//!         Ok(self.0)
//!     }
//!     fn write(&mut self, command: &Command) -> Result<(), Fault> {
//!         (self.0.q, self.0.q_d, self.0.dq) = (command.desired.q, command.desired.q, command.desired.dq);
//!         Ok(())
//!     }
//!     fn stop(&mut self) {}
//! }
//!
//! let all = |value: f64| [value; 8];
//! let limits = Limits {
//!     q_min: all(-1.0), q_max: all(1.0), dq: all(1.0), ddq: all(10.0), jerk: all(1e3), tau: all(10.0), dtau: all(1e3),
//! };
//! let guard = GuardSettings { limits, envelope: None, workspace: None, tracking: all(0.1) };
//! let settings = CycleSettings { rights: Rights::NONE, ..CycleSettings::new(guard) };
//! let (sink, _records) = recorder::ring(100_000);
//! let (mut cycle, mut handles) = cycle::new(Ideal(State::default()), sink, None, settings)?;
//!
//! let target = [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
//! assert!(handles.orders.give(Order { motion: 1, kind: OrderKind::MoveTo { target, phase: Phase::Approach } }).is_ok());
//! let outcome = std::thread::scope(|scope| {
//!     let running = scope.spawn(|| cycle.run());
//!     while !matches!(handles.events.pop().map(|timed| timed.event), Ok(Event::Ended { motion: 1 })) {
//!         std::thread::yield_now();
//!     }
//!     handles.controls.quit();
//!     running.join().unwrap()
//! });
//! assert_eq!(outcome.stops, 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
// The wall around the loop: clippy.toml lists what must not be called here.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

mod checkpoint;
mod controls;
pub mod cycle;
mod guard;
mod motion;
mod moves;
mod order;
pub mod os;
pub mod recorder;
mod retired;
mod rights;
mod settings;
mod stats;
mod sync;
mod torque;

pub use checkpoint::{Checkpoint, Doing};
pub use controls::Controls;
pub use guard::{Guard, GuardSettings, Limit, Violation};
pub use motion::braked_from;
pub use moves::{MoveFactors, Planner};
pub use order::{Event, Handles, Order, OrderKind, StopReason, TimedEvent};
pub use retired::Retired;
pub use rights::{Grant, Granted, Rights, become_realtime, preempt_rt};
pub use settings::{CycleSettings, SetupError};
pub use torque::{ModelTorques, Succession, Torques};
