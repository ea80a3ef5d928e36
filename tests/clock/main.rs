//! What keeps the clock's time, and so waits more than it computes: side by side in one program. `cargo test --test clock MODULE` runs one
//! of them.

#[path = "../../hil/fci-emulator/emulator/mod.rs"]
mod emulator;
#[path = "../ipc_support/mod.rs"]
mod ipc_support;
#[path = "../job_support/mod.rs"]
mod job_support;
#[path = "../kill_support/mod.rs"]
mod kill_support;
#[path = "../peers/mod.rs"]
mod peers;
#[path = "../turns/mod.rs"]
mod turns;

mod blocked_log;
mod every_millisecond;
mod inclinometer_daemon;
mod ipc_exchange;
mod ipc_kill;
mod ipc_python;
mod kill_campaign;
mod orders;
mod rt_rights;
mod service;
mod signals;
mod squatters;
mod stop_path;
mod torque_clients;
