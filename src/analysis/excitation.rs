//! What a motion that was not planned tells of the parameters.

use nalgebra::{DMatrix, Vector3};
use plumbline_core::Limits;
use plumbline_identify::solve::Identification;
use plumbline_model::Structure;
use plumbline_model::term::Motion;

/// Samples of the general motion.
const SAMPLES: usize = 256;
/// Shares of the limits that its positions, speeds and accelerations fill.
const SHARES: [f64; 3] = [0.8, 0.5, 0.25];
/// Condition number (column-equilibrated) above which a planned motion is recommended. A planned one has 10 to 30.
const POOR_CONDITION: f64 = 200.0;

/// What a motion determines of a model's parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Excitation {
    /// Number of parameters.
    pub parameters: usize,
    /// Condition number of the regressor, column-equilibrated.
    pub condition: f64,
    /// Parameters that the motion contains nothing of.
    pub undetermined: Vec<String>,
    /// Determined parameters whose standard deviation alone is more torque in a general motion than the torque's own scatter.
    pub weak: Vec<String>,
    /// Joint (from 0) and standard deviation of the model's torque in a general motion, where it is largest against the scatter \[Nm\].
    pub general: (usize, f64),
}

impl Excitation {
    /// Of an identification under `gravity` \[m/s2\]. A general motion has states spread over the `limits` of the arm: with `Y` its regressor, S
    /// the covariance of the parameters and `k` its samples, joint `j` has the torque variance `mean_k (Y S Y')`.
    pub fn of(of: &Identification, structure: &Structure, limits: &Limits, gravity: Vector3<f64>) -> Excitation {
        let n = structure.chain().len();
        let y = structure.regressor(&general(n, limits, gravity));
        let scatter: Vec<f64> = (0..n).map(|j| of.rms.raw.get(j).copied().unwrap_or(0.0).max(1e-9)).collect();
        let rms = |rows: DMatrix<f64>| (rows.norm_squared() / SAMPLES as f64).sqrt();
        let weak = |&c: &usize| {
            let std = of.std[c].unwrap_or(0.0);
            (0..n).any(|j| std * rms(y.view((j * SAMPLES, c), (SAMPLES, 1)).into_owned()) > scatter[j])
        };
        let of_joint = |j: usize| {
            let rows = y.rows(j * SAMPLES, SAMPLES);
            let variance = (rows * &of.covariance).component_mul(&rows).sum() / SAMPLES as f64;
            (j, variance.max(0.0).sqrt())
        };
        let ratio = |&(j, std): &(usize, f64)| std / scatter[j];
        let general = (0..n).map(of_joint).max_by(|one, other| ratio(one).total_cmp(&ratio(other)));
        Excitation {
            parameters: of.columns.len(),
            condition: of.conditions.equilibrated,
            undetermined: of.undetermined.iter().map(|one| one.name.clone()).collect(),
            weak: (0..of.columns.len()).filter(weak).map(|c| of.columns[c].name.clone()).collect(),
            general: general.unwrap_or((0, 0.0)),
        }
    }

    /// Whether a planned motion would tell clearly more.
    pub fn is_poor(&self) -> bool {
        !self.undetermined.is_empty() || !self.weak.is_empty() || self.condition > POOR_CONDITION
    }

    /// The same in words; `plan` is the command that plans a motion for what is missing.
    pub fn words(&self, plan: &str) -> String {
        let Excitation { parameters: all, condition, undetermined, weak, general: (joint, std) } = self;
        let list = |count: usize, what: &str, names: &[String]| match count {
            0 => String::new(),
            count => format!("; {count} are {what} ({})", names.join(", ")),
        };
        let poor = match self.is_poor() {
            true => format!(". The model holds along motions like this one; for others: {plan}"),
            false => String::new(),
        };
        format!(
            "the motion was not planned; it determines {} of {all} parameters, with a condition number of {condition:.1} (column-equilibrated){}{}; \
             in a general motion the model's torque has a standard deviation of {std:.3} Nm by them (joint {}){poor}",
            all - undetermined.len(),
            list(undetermined.len(), "not determined", undetermined),
            list(weak.len(), "determined weakly", weak),
            joint + 1
        )
    }
}

/// States spread evenly over the limits of `n` joints, by multiples of irrational numbers: the same every time.
fn general(n: usize, limits: &Limits, gravity: Vector3<f64>) -> Motion {
    // The root of x^(d + 1) = x + 1 spreads points in d dimensions best (R-sequence).
    let dimensions = 3 * n;
    let root = (0..64).fold(2.0f64, |x, _| (1.0 + x).powf(1.0 / (dimensions as f64 + 1.0)));
    let spread = |k: usize, d: usize| 2.0 * (0.5 + (k + 1) as f64 * root.powi(-(d as i32 + 1))).fract() - 1.0;
    let rows = |of: &dyn Fn(usize, usize) -> f64| DMatrix::from_fn(SAMPLES, n, of);
    let [position, speed, acceleration] = SHARES;
    let middle = |j: usize| 0.5 * (limits.q_max[j] + limits.q_min[j]);
    let half = |j: usize| 0.5 * (limits.q_max[j] - limits.q_min[j]);
    Motion {
        dt: 1e-3,
        q: rows(&|k, j| middle(j) + position * half(j) * spread(k, j)),
        dq: rows(&|k, j| speed * limits.dq[j] * spread(k, n + j)),
        ddq: rows(&|k, j| acceleration * limits.ddq[j] * spread(k, 2 * n + j)),
        gravity,
        periodic: false,
        start: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_identify::{Experiment, Run, Settings, solve};
    use plumbline_model::{Mounting, Robot};

    /// An identification from a motion of the Panda's joints from `first` on, with exact torques of a model plus a little noise.
    fn identified(first: usize) -> (Identification, Structure, Robot) {
        let robot = Robot::load("panda", None).unwrap();
        let structure = crate::setup::friction_structure(&robot, &Mounting::WALL);
        let (samples, n) = (20_000, robot.chain.len());
        // Position, velocity or acceleration.
        let moved = |k: usize, j: usize, derivative: i32| {
            let (t, own) = (k as f64 * 1e-3, j as f64);
            let (middle, rest) = (0.5 * (robot.limits.q_min[j] + robot.limits.q_max[j]), f64::from(derivative == 0));
            let quarter = f64::from(derivative) * std::f64::consts::FRAC_PI_2;
            let tone = |size: f64, w: f64, phase: f64| size * w.powi(derivative) * (w * t + phase + quarter).sin();
            let both = tone(0.5, 1.1 + 0.17 * own, own) + tone(0.3, 2.9 + 0.23 * own, 0.0);
            rest * middle + if j < first { 0.0 } else { both }
        };
        let noise = |k: usize, c: usize| 0.1 * (((k * 7919 + c * 104_729) % 10_007) as f64 / 5003.5 - 1.0);
        let rows = |derivative: i32| DMatrix::from_fn(samples, n, |k, j| moved(k, j, derivative));
        let gravity = Mounting::WALL.gravity();
        let motion = Motion { dt: 1e-3, q: rows(0), dq: rows(1), ddq: rows(2), gravity, periodic: false, start: 0.0 };
        let beta = nalgebra::DVector::from_fn(structure.columns().len(), |c, _| 0.3 + 0.01 * c as f64);
        let exact = structure.regressor(&motion) * beta;
        // A joint that holds has the noise of its encoder.
        let q = DMatrix::from_fn(samples, n, |k, j| motion.q[(k, j)] + 1e-4 * noise(k, j + 50));
        let tau = DMatrix::from_fn(samples, n, |k, j| exact[j * samples + k] + noise(k, j));
        let t = (0..samples).map(|k| k as f64 * 1e-3).collect();
        let run = Run { name: "run".into(), t, q, dq: None, tau, mounting: Mounting::WALL, period: None };
        let experiment = Experiment::prepare(&run, &Settings::default()).unwrap();
        (solve::identify(&structure, &[experiment]).unwrap(), structure, robot)
    }

    #[test]
    fn what_stands_still_is_named_and_what_moves_is_not() {
        let excitation = |first: usize| {
            let (identification, structure, robot) = identified(first);
            Excitation::of(&identification, &structure, &robot.limits, Mounting::WALL.gravity())
        };
        let (all, wrist) = (excitation(0), excitation(4));
        assert!(all.undetermined.is_empty() && all.weak.is_empty() && !all.is_poor(), "{}", all.words("plan"));
        assert!(!all.words("plan").contains("plan.") && all.general.1 < 0.5, "{all:?}");
        let missing: Vec<&String> = wrist.undetermined.iter().chain(&wrist.weak).collect();
        for name in ["fv1", "fv4", "Lzz1"] {
            assert!(missing.iter().any(|missing| *missing == name), "{name}: {}", wrist.words("plan"));
        }
        for name in ["fv5", "fc7"] {
            assert!(!missing.iter().any(|missing| *missing == name), "{name}: {}", wrist.words("plan"));
        }
        assert!(wrist.is_poor() && wrist.words("`plan`").ends_with("for others: `plan`"));
    }
}
