//! Direction of gravity from a two-axis inclinometer on the arm's base.
//!
//! The sensor is a CANopen device of CiA 410 (device profile for inclinometers) and CiA 301 (application layer). Only [`socket`] does
//! I/O and reads a clock. In the other modules received frames and times \[ns\] are arguments, and frames to send are results.
//!
//! | module | what |
//! |---|---|
//! | [`frame`], [`canopen`] | CAN frames; CANopen services as values: NMT, SDO, heartbeat, EMCY, TPDO |
//! | [`node`], [`fault`] | configures and monitors one device: SDO, heartbeat, process data; its faults |
//! | [`attitude`] | direction of gravity in the base frame from two slopes, with its covariance |
//! | [`slope_filter`] | low-pass, noise estimate, rest detection, jump detection |
//! | [`sensor`] | node, filter and attitude: frames in, [`Reading`](sensor::Reading) or fault out |
//! | [`follow`] | gravity of the served model: rate limit, fall-back, refusal |
//! | [`socket`] | the sensor over SocketCAN on its own thread |

pub mod attitude;
pub mod canopen;
pub mod fault;
pub mod follow;
pub mod frame;
pub mod node;
pub mod sensor;
pub mod slope_filter;
pub mod socket;
