//! Which way gravity points, by a two-axis inclinometer on the arm's base.
//!
//! A CANopen device after CiA 410 (device profile for inclinometers) and CiA 301 (application layer). Everything but [`socket`] is
//! without input, output and clock: frames and times \[ns\] come in as arguments, frames to send come out.
//!
//! | module | what |
//! |---|---|
//! | [`frame`], [`canopen`] | CAN frames; CANopen services as values: NMT, SDO, heartbeat, EMCY, TPDO |
//! | [`node`] | brings one device up and watches it: SDO set-up, heartbeat, process data |
//! | [`attitude`] | two slopes as a direction of gravity in the base frame, with its covariance |
//! | [`smooth`] | low-pass, noise, rest, jumps |
//! | [`sensor`] | the three together: frames in, [`Reading`](sensor::Reading) or fault out |
//! | [`follow`] | which gravity the model gets: rate bound, fall-back, refusal |
//! | [`socket`] | the same over SocketCAN on a thread of its own |

pub mod attitude;
pub mod canopen;
pub mod follow;
pub mod frame;
pub mod node;
pub mod sensor;
pub mod smooth;
pub mod socket;
