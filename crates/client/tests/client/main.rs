//! Tests of the library from the caller's view.

mod evaluation;
mod follower;
mod guest;
mod layout;
mod models;

#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
