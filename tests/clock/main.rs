//! What keeps the clock's time, and so waits more than it computes: side by side in one program. `cargo test --test clock MODULE` runs one
//! of them.

mod blocked_log;
mod every_millisecond;
mod guest;
mod inclinometer_daemon;
mod kill_campaign;
mod orders;
mod relay;
mod rt_rights;
mod service;
mod signals;
mod stop_path;
mod torque_clients;
