//! Franka arms (Panda, FER, FR3) over the Franka Control Interface, the 1 kHz network interface that libfranka speaks too.
//!
//! [`wire`] is the protocol as bytes.

pub mod wire;
