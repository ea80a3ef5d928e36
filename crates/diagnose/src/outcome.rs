//! What a diagnosis ends with.

use super::curves::Curves;
use super::fallback::Unexplained;
use super::gates::{Folds, Relevance};
use super::select::{Rival, Step};
use plumbline_identify::solve::Identification;
use plumbline_model::Structure;
use plumbline_model::term::effect::Spec;

/// The answer in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The model lacks nothing that this data could show.
    NothingSignificant,
    /// Effects were found that explain what the model lacked.
    Diagnosed,
    /// The same, but another effect would explain it as well.
    Ambiguous,
    /// Effects were found, and some of what the model lacks is left.
    Partly,
    /// The model lacks something, and no effect of the catalogue explains it.
    Unexplained,
}

impl Verdict {
    /// Its name in files.
    pub fn id(self) -> &'static str {
        match self {
            Verdict::NothingSignificant => "nothing-significant",
            Verdict::Diagnosed => "diagnosed",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Partly => "partly",
            Verdict::Unexplained => "unexplained",
        }
    }
}

/// How far a finding can be trusted, by what there was to test it on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Confirmation {
    /// Several trajectories, and repeats that tell the noise.
    Full {
        /// Trajectories.
        trajectories: usize,
    },
    /// Repeats, but one trajectory: no finding could be tested on another.
    OneTrajectory,
    /// No repeats: the noise is not known, and blocks of the runs stood in for trajectories.
    NoRepeats {
        /// Blocks.
        blocks: usize,
    },
}

/// An effect that was found.
#[derive(Clone, Debug)]
pub struct Effect {
    /// What it is, with its nonlinear parameters.
    pub spec: Spec,
    /// First session that has it; all where absent.
    pub since: Option<u32>,
    /// Linear parameters, by name of their columns: value, standard deviation, unit.
    pub parameters: Vec<Estimate>,
    /// Nonlinear parameters with the standard deviations that the likelihood's curvature gives.
    pub settings: Vec<Estimate>,
    /// Twice the gain in log likelihood.
    pub evidence: f64,
    /// Part of the score that pays for parameters and choice.
    pub penalty: f64,
    /// Score, their difference.
    pub score: f64,
    /// How the folds judge it.
    pub folds: Folds,
    /// What it explains, joint by joint.
    pub relevance: Relevance,
    /// Share of its fitted part that the other columns can't take over.
    pub independence: f64,
    /// Share of what was unmodelled in its main joint that all effects together explain on data that was not fitted; `None` where the
    /// noise is not known.
    pub adequacy: Option<f64>,
    /// What might be there instead.
    pub rivals: Vec<Rival>,
    /// Whether the delivered model has it.
    pub in_model: bool,
    /// Why it has not.
    pub withheld: Option<String>,
}

/// A number with its standard deviation.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard deviation, where known.
    pub std: Option<f64>,
    /// Unit.
    pub unit: &'static str,
}

/// One joint before and after, on the data of the identification.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointFacts {
    /// Noise of the mean period in the band \[Nm\]; `None` without repeats.
    pub floor: Option<f64>,
    /// RMS of the residual in the band, before and after \[Nm\].
    pub rms: [f64; 2],
    /// RMS of what repeats and the model lacks, before and after \[Nm\].
    pub unmodelled: [f64; 2],
    /// Mean square of the residual over that of the noise, before and after; `None` without repeats.
    pub lack_of_fit: Option<[f64; 2]>,
    /// What counts as unmodelled \[Nm\].
    pub threshold: f64,
    /// Share of what was unmodelled that the effects explain, on data that was not fitted where there is any; `None` where nothing was
    /// unmodelled or the noise is not known.
    pub adequacy: Option<f64>,
    /// RMS of the residual in the band on trajectories or blocks left out in turn, before and after \[Nm\]; `None` where there is one.
    pub left_out: Option<[f64; 2]>,
}

impl JointFacts {
    /// Whether the model lacks something there, before (0) or after (1). Unknown noise says nothing.
    pub fn lacking(&self, when: usize) -> bool {
        self.lack_of_fit.is_some_and(|ratio| ratio[when] > 1.3) && self.unmodelled[when] > self.threshold
    }
}

/// Least effect of a family that would have been found.
#[derive(Clone, Debug, PartialEq)]
pub struct Detectable {
    /// Identity of the family.
    pub family: &'static str,
    /// Per site: the site's joint (from 0), torque \[Nm\] and parameter in its unit.
    pub sites: Vec<(usize, f64, f64)>,
    /// Unit of the parameter.
    pub unit: &'static str,
}

/// A candidate that the base parameters take over.
#[derive(Clone, Debug, PartialEq)]
pub struct Hidden {
    /// What it would be.
    pub spec: Spec,
    /// Share of it that the base parameters leave.
    pub independence: f64,
}

/// A model and how it came about.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Its structure.
    pub structure: Structure,
    /// Its parameters.
    pub identification: Identification,
}

/// What a diagnosis ends with.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The answer.
    pub verdict: Verdict,
    /// What it rests on.
    pub confirmation: Confirmation,
    /// The effects, the strongest first.
    pub effects: Vec<Effect>,
    /// Joint by joint.
    pub joints: Vec<JointFacts>,
    /// The model without effects.
    pub before: Fitted,
    /// The model with those that hold; as before where there is none.
    pub after: Fitted,
    /// What could have been found.
    pub detectable: Vec<Detectable>,
    /// What could not, whatever the data holds.
    pub hidden: Vec<Hidden>,
    /// Joints in which something is left that no effect explains.
    pub unexplained: Vec<Unexplained>,
    /// Curves for people to look at.
    pub curves: Curves,
    /// How the selection went.
    pub path: Vec<Step>,
    /// The best candidates for the plain model: label and score.
    pub ranking: Vec<(Spec, f64)>,
}
