//! Franka's control interface over real sockets: adapter, emulator, and the whole daemon between them. It keeps the clock's time and so waits
//! more than it computes: side by side in one program. `cargo test --test fci MODULE` runs one of them.

#[path = "../../hil/fci-emulator/emulator/mod.rs"]
mod emulator;
#[path = "../fci_fake/mod.rs"]
mod fci_fake;
#[path = "../job_support/mod.rs"]
mod job_support;
#[path = "../peers/mod.rs"]
mod peers;
#[path = "../turns/mod.rs"]
mod turns;

mod fci_adapter;
mod fci_bring_up;
mod fci_clients;
mod fci_emulator;
mod fci_faults;
mod fci_limits;
mod torque_job;
mod torque_starts;
