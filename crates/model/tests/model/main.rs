//! Tests of the crate against independent computations and simulated arms.

mod base;
mod catalogue;
mod dynamics;
mod effects;
mod empirical;
mod fast;
mod golden;
mod models;
mod physics;
mod torque;

#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
