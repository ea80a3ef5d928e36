//! The simulated arm's file, which `backend.arm` names.

pub use plumbline_sim::TruthFile;
