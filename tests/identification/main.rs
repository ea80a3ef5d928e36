//! From recordings to a model in a file: the library's parts on data, by the processor alone. One program, so that it is linked once
//! and both cores have work until the end; `cargo test --test identification MODULE` runs one of them.

mod compare_changes;
mod consistency;
mod consistency_peers;
mod dataset_form;
mod dataset_table3;
mod diagnose_changing;
mod diagnose_delivery;
mod diagnose_fallback;
mod diagnose_gates;
mod diagnose_real_logs;
mod diagnose_selection;
mod diagnose_sketch;
mod estimate_direction;
mod estimate_estimators;
mod estimate_real_logs;
mod estimate_simulated;
mod estimate_statistics;
mod excite_optimiser;
mod excite_search;
mod export_c;
mod export_peers;
mod model_base;
mod model_dynamics;
mod model_fast;
mod model_golden;
mod mounting_check;
mod paper;
mod plausibility;
mod real_data;
mod report_diagnosis;
mod report_files;
mod store_files;
