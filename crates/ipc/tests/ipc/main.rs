//! Processes and threads that exchange samples, torques and requests.

mod exchange;
mod kill;
mod python;
mod squatters;
