//! The nearest consistent parameters against those of a general solver for semidefinite programs.

use plumbline_identify::consistency::{Uncertainty, nearest};
use plumbline_testkit::peers::nearest as sdp;

/// Clarabel minimises the distance alone; plumbline's solver keeps a small barrier weight, which costs up to hundredths of a standard
/// deviation.
#[test]
fn clarabel_finds_no_nearer_parameters() {
    let shares = [0.01, 0.03, 0.1, 0.3, 1.0];
    let problems: Vec<_> = shares.iter().enumerate().map(|(k, &share)| sdp::problem(share, k as u64)).collect();
    let Some(answers) = sdp::clarabel(&problems.iter().collect::<Vec<_>>(), 1) else { return };
    let mut moved = 0;
    for (problem, answer) in problems.iter().zip(&answers) {
        let deviations: Vec<_> = problem.covariance.diagonal().iter().map(|variance| Some(variance.sqrt())).collect();
        let uncertainty = Uncertainty::Covariance(&problem.covariance, &deviations);
        let found = nearest(&problem.structure, &problem.beta, uncertainty, &problem.prior).unwrap();
        eprintln!("plumbline {:.5} in {} steps, Clarabel {answer:.5?}", found.distance, found.iterations);
        assert_eq!(found.exact, answer.distance < 1e-3, "{answer:?}");
        assert!(found.distance < answer.distance + 0.03, "{} {answer:?}", found.distance);
        assert!(found.exact || found.distance > answer.distance - 1e-4, "{} {answer:?}", found.distance);
        moved += usize::from(!found.exact);
    }
    assert!(moved >= 3, "{moved}");
}
