//! Many simulated runs of one scene: coverage of the confidence intervals, and errors relative to the Cramer-Rao bound.

use super::Scene;
use nalgebra::DMatrix;
use plumbline_identify::solve::Identification;
use std::thread;

struct Found {
    beta: Vec<f64>,
    std: Vec<f64>,
    half_width: Vec<f64>,
}

/// Statistics over all runs, one entry per parameter.
pub struct Campaign {
    pub names: Vec<String>,
    pub runs: usize,
    /// Share of the runs whose 95 % interval contains the true value.
    pub covered: Vec<f64>,
    pub error: Vec<f64>,
    pub bias: Vec<f64>,
    /// Root mean square of the standard deviations that the runs estimated.
    pub claimed: Vec<f64>,
    pub bound: Vec<f64>,
    /// Torque error that the parameters' errors cause on an unseen motion, root mean square over runs and samples, per joint \[Nm\].
    pub torque: Vec<f64>,
}

impl Campaign {
    /// Runs `identify` for seeds `0..runs` on all cores; `bound` is the least covariance that there can be.
    pub fn of(
        scene: &Scene,
        runs: usize,
        bound: &DMatrix<f64>,
        identify: impl Fn(u64) -> Identification + Sync,
    ) -> Campaign {
        let cores = thread::available_parallelism().map_or(1, |cores| cores.get());
        let one = |seed: usize| {
            let found = identify(seed as u64);
            let of = |values: &[Option<f64>]| values.iter().map(|value| value.expect("determined")).collect::<Vec<_>>();
            Found { std: of(&found.std), half_width: of(&found.interval_95()), beta: found.beta }
        };
        let found: Vec<Found> = thread::scope(|scope| {
            let share = |core: usize| (core..runs).step_by(cores).map(one).collect::<Vec<_>>();
            let handles: Vec<_> = (0..cores).map(|core| scope.spawn(move || share(core))).collect();
            handles.into_iter().flat_map(|handle| handle.join().unwrap()).collect()
        });
        let p = scene.beta.len();
        let count = runs as f64;
        let errors = |c: usize| found.iter().map(move |run| run.beta[c] - scene.beta[c]);
        let unseen = scene.structure.regressor(&scene.unseen());
        let samples = unseen.nrows() / scene.joints();
        let mut torque = vec![0.0; scene.joints()];
        for run in &found {
            let error = nalgebra::DVector::from_fn(p, |c, _| run.beta[c] - scene.beta[c]);
            for (j, block) in (&unseen * error).as_slice().chunks(samples).enumerate() {
                torque[j] += block.iter().map(|x| x * x).sum::<f64>() / (samples * runs) as f64;
            }
        }
        Campaign {
            names: scene.structure.columns().iter().map(|column| column.name.clone()).collect(),
            runs,
            covered: (0..p)
                .map(|c| found.iter().filter(|run| (run.beta[c] - scene.beta[c]).abs() < run.half_width[c]).count())
                .map(|inside| inside as f64 / count)
                .collect(),
            error: (0..p).map(|c| (errors(c).map(|e| e * e).sum::<f64>() / count).sqrt()).collect(),
            bias: (0..p).map(|c| errors(c).sum::<f64>() / count).collect(),
            claimed: (0..p).map(|c| (found.iter().map(|run| run.std[c].powi(2)).sum::<f64>() / count).sqrt()).collect(),
            bound: bound.diagonal().iter().map(|variance| variance.sqrt()).collect(),
            torque: torque.into_iter().map(f64::sqrt).collect(),
        }
    }

    /// Share of all intervals that contain the true value.
    pub fn coverage(&self) -> f64 {
        self.covered.iter().sum::<f64>() / self.covered.len() as f64
    }

    /// Errors over the bound, root mean square over the parameters.
    pub fn over_bound(&self) -> f64 {
        pooled(&self.error, &self.bound)
    }

    /// Estimated standard deviations over the errors found, root mean square over the parameters.
    pub fn claimed_over_error(&self) -> f64 {
        pooled(&self.claimed, &self.error)
    }

    /// The parameter with the largest value of something, and that value.
    pub fn worst(&self, of: impl Fn(usize) -> f64) -> (&str, f64) {
        let c = (0..self.names.len()).max_by(|&a, &b| of(a).total_cmp(&of(b))).expect("parameters");
        (&self.names[c], of(c))
    }

    /// One line of a table: errors over the bound, claimed over found, coverage, torque error on an unseen motion.
    pub fn line(&self) -> String {
        let torque = self.torque.iter().sum::<f64>() / self.torque.len() as f64;
        let over = self.worst(|c| self.error[c] / self.bound[c]);
        format!(
            "{:.3} | {:.2} ({}) | {:.3} | {:.2} % | {:.2} mNm",
            self.over_bound(),
            over.1,
            over.0,
            self.claimed_over_error(),
            100.0 * self.coverage(),
            1e3 * torque
        )
    }
}

fn pooled(of: &[f64], over: &[f64]) -> f64 {
    (of.iter().zip(over).map(|(a, b)| (a / b).powi(2)).sum::<f64>() / of.len() as f64).sqrt()
}
