//! From recordings to a model in a file: the library's parts on data, by the processor alone. One program, so that it is linked once
//! and both cores have work until the end; `cargo test --test identification MODULE` runs one of them.

mod consistency;
mod dataset_form;
mod dataset_mcap;
mod dataset_table3;
mod diagnose_real_logs;
mod estimate_direction;
mod excite_optimiser;
mod export_c;
mod export_load;
mod export_peers;
mod external_torque;
mod mounting_check;
mod paper;
mod plausibility;
mod prediction_intervals;
mod real_data;
mod report_diagnosis;
mod report_files;
mod store_files;
