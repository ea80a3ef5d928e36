//! The bytes of the Franka Control Interface: against the numbers of the C++ headers, there and back, and against bad packets.

mod allocation;
mod identity;
mod numbers;
mod offsets;
mod refusals;
