//! The whole program as people start it, in simulated time, as fast as the machine is. One program of tests, so that it is linked once and
//! both cores have work until the end; `cargo test --test jobs MODULE` runs one of them.

mod bad_input;
mod changing_command;
mod check_command;
mod compare_command;
mod config_job;
mod console;
mod dead_channels;
mod demonstrations;
mod doctor;
mod effects_command;
mod estimate_cli;
mod export_cli;
mod flight_recorder;
mod guide;
mod held_out_errors;
mod killed;
mod live_steps;
mod live_watch;
mod main_job;
mod metrics;
mod own_robot;
mod pause;
mod plan_command;
mod plan_robots;
mod power_cut;
mod predict_command;
mod reference_pages;
mod robot_command;
mod rounds;
mod run_identity;
mod schemas;
mod steps;
mod undeclared_effect;
mod vertical_model;
