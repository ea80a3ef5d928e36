//! The whole program as people start it, in simulated time, as fast as the machine is. One program of tests, so that it is linked once and
//! both cores have work until the end; `cargo test --test jobs MODULE` runs one of them.

#[path = "../export_support/mod.rs"]
mod export_support;
#[path = "../job_support/mod.rs"]
mod job_support;
#[path = "../logs/mod.rs"]
mod logs;
#[path = "../peers/mod.rs"]
mod peers;
#[path = "../scene/mod.rs"]
mod scene;
#[path = "../turns/mod.rs"]
mod turns;

mod bad_input;
mod changing_command;
mod compare_command;
mod config_job;
mod dead_channels;
mod doctor;
mod effects_command;
mod estimate_cli;
mod export_cli;
mod flight_recorder;
mod killed;
mod live_watch;
mod main_job;
mod plan_command;
mod plan_robots;
mod power_cut;
mod predict_command;
mod undeclared_effect;
mod vertical_model;
