//! Franka's control interface over real sockets: adapter, emulator, and the whole daemon between them. It keeps the clock's time and so waits
//! more than it computes: side by side in one program. `cargo test --test fci MODULE` runs one of them.

mod external_servers;
mod fci_adapter;
mod fci_bring_up;
mod fci_clients;
mod fci_emulator;
mod fci_faults;
mod fci_limits;
mod pause;
mod torque_job;
mod torque_starts;

/// The loops of these tests count their allocations.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
