//! Identity of a dataset's content, for provenance.

use super::{Dataset, Role, columns};
use sha2::{Digest, Sha256};

/// Hash over numbers, not over text: independent of the number format.
pub(super) fn content_hash(dataset: &Dataset) -> String {
    let mut hasher = Sha256::new();
    let mut number = |value: f64| hasher.update((value + 0.0).to_le_bytes());
    number(dataset.runs.len() as f64);
    for (index, run) in dataset.runs.iter().enumerate() {
        number(match run.role {
            Role::Identify => 0.0,
            Role::Validate => 1.0,
        });
        number(run.data.period.unwrap_or(0.0));
        number(f64::from(run.session));
        if dataset.pause_before(index) {
            number(run.start);
        }
        number(run.data.mounting.rho);
        number(run.data.mounting.phi);
        number(run.samples() as f64);
        number(run.joints() as f64);
        run.data.t.iter().copied().for_each(&mut number);
        run.data.q.iter().copied().for_each(&mut number);
        number(if run.data.dq.is_some() { 1.0 } else { 0.0 });
        run.data.dq.iter().flat_map(|dq| dq.iter()).copied().for_each(&mut number);
        run.data.tau.iter().copied().for_each(&mut number);
        let further = columns::ALL.iter().filter(|known| known.identifies).filter_map(|known| known.of(run));
        further.for_each(|matrix| matrix.iter().copied().for_each(&mut number));
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}
