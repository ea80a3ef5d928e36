//! Declarations of a kind of effect. Search, plots, report and export use only these.

pub(super) use super::Term;
pub(super) use super::load::OperatingPoint;
use super::quantity;
pub(super) use super::quantity::{Quantity, Results};
use crate::chain::Chain;
use serde::{Deserialize, Serialize};
use std::fmt;
pub(super) use std::sync::Arc;

/// A kind of effect.
pub struct Family {
    /// Stable identity in files and commands.
    pub id: &'static str,
    /// Its physics, in one sentence.
    pub physics: &'static str,
    /// Kind of its site.
    pub place: Place,
    /// Alternative laws; a model has one of them.
    pub forms: &'static [Form],
    /// Part of the data that shows it.
    pub stratum: Stratum,
    /// Sizes on real arms.
    pub typical: &'static str,
    /// Effects and parameters with similar columns, and the experiment that decides.
    pub confounded: &'static [Confounded],
    /// Literature.
    pub reference: &'static str,
    /// Properties of few families.
    pub rare: Rare,
}

/// A law of an effect.
pub struct Form {
    /// Name in files; empty where the family has one form.
    pub name: &'static str,
    /// Its equation: `tau_j = k (q_j - q0)`.
    pub equation: &'static str,
    /// Its nonlinear parameters.
    pub settings: &'static [Setting],
    /// Builds its term for a valid site and settings inside their ranges.
    pub build: fn(&OperatingPoint, Site, &[f64]) -> Arc<dyn Term>,
    /// The exported C function's part of it.
    pub in_c: InC,
    /// The horizontal axis of its plot.
    pub plot_over: PlotOver,
}

impl Form {
    /// Whether its law approximates what friction or a gear does: one with nonlinear parameters, of velocity or load.
    pub fn is_approximate(&self) -> bool {
        matches!(self.plot_over, PlotOver::Velocity | PlotOver::Load) && !self.settings.is_empty()
    }

    /// Whether it takes torque of both joints of its pair.
    pub fn is_of_both_joints(&self) -> bool {
        matches!(self.in_c, InC::BothRows { .. })
    }
}

/// Builds a term with a column for every joint of the arm.
pub type WholeArm = fn(&Chain) -> Arc<dyn Term>;

/// Properties of few families.
pub struct Rare {
    /// The term with a column of this effect for every joint. In models and files the effect's columns belong to that term.
    pub whole_arm: Option<WholeArm>,
    /// Whether every arm has it. With unknown noise the search starts from a model with it in every joint.
    pub in_every_arm: bool,
    /// Whether every arm has a little of it, as no friction is quite Coulomb's: where the noise is known it is named only if it matters. A little of
    /// what few arms have is a defect.
    pub slight_in_every_arm: bool,
    /// Whether it is of joints that the robot file declares as coupled: a search tries few others, and they are unlikely. With unknown noise it tries of those
    /// only the forms that take torque of both joints.
    pub between_coupled: bool,
    /// Whether it may change after an identification; a comparison with a stored model then searches for it.
    pub may_change: bool,
    /// Whether it may come at once within a recording: a tool that is picked up, a base that is pushed. The form that a search tries has no settings.
    pub comes_at_once: bool,
    /// Its part in a description of rigid bodies (URDF, MJCF).
    pub in_bodies: InBodies,
    /// Whether a form, by its name, can be at a site of the family's place.
    pub fits: fn(&str, Site) -> bool,
    /// The form, by its name, that a search tries only in joints [with a rotor](OperatingPoint::rotors) in the rigid body.
    pub with_rotor: Option<&'static str>,
    /// The parameter of a stored model that a column of this effect changes, by the column's name.
    pub changed_parameter: fn(&str) -> &str,
    /// Reported quantities.
    pub quantities: fn(&Results) -> Vec<Quantity>,
}

impl Rare {
    /// No such property.
    pub const NONE: Rare = Rare {
        whole_arm: None,
        in_every_arm: false,
        slight_in_every_arm: false,
        between_coupled: false,
        may_change: false,
        comes_at_once: false,
        in_bodies: InBodies::Nothing,
        fits: |_, _| true,
        with_rotor: None,
        changed_parameter: |name| name,
        quantities: quantity::own,
    };
}

/// Location of an effect in the arm. Joints count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Site {
    /// The arm as a whole.
    Arm,
    /// One joint.
    Joint(usize),
    /// An influence of one joint on the torque of another.
    Pair {
        /// The joint whose torque changes.
        row: usize,
        /// The joint that causes it.
        cause: usize,
    },
    /// A function of the motion of two joints, or of one where the two are the same.
    Function {
        /// The joint whose torque it is.
        row: usize,
        /// The joints of the first and of the second variable.
        of: [usize; 2],
    },
}

impl Site {
    /// Its joints: none, one, or row and causes.
    pub fn joints(self) -> Vec<usize> {
        match self {
            Site::Arm => Vec::new(),
            Site::Joint(joint) => vec![joint],
            Site::Pair { row, cause } => vec![row, cause],
            Site::Function { row, of: [first, second] } if first == second => vec![row, first],
            Site::Function { row, of: [first, second] } => vec![row, first, second],
        }
    }

    /// Suffix of a column's name, joints from 1: `4`, `5_6`, empty for the whole arm.
    pub fn suffix(self) -> String {
        self.joints().iter().map(|joint| (joint + 1).to_string()).collect::<Vec<_>>().join("_")
    }
}

impl fmt::Display for Site {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Site::Arm => f.write_str("the arm"),
            Site::Joint(joint) => write!(f, "joint {}", joint + 1),
            Site::Function { row, of: [first, second] } if first == second => {
                write!(f, "joint {} from joint {}", row + 1, first + 1)
            }
            Site::Pair { row, cause } => write!(f, "joint {} from joint {}", row + 1, cause + 1),
            Site::Function { row, of: [first, second] } => {
                write!(f, "joint {} from joints {} and {}", row + 1, first + 1, second + 1)
            }
        }
    }
}

/// Kind of [`Site`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// [`Site::Arm`].
    Arm,
    /// [`Site::Joint`].
    Joint,
    /// [`Site::Pair`], two different joints.
    Pair,
    /// [`Site::Function`], any joints.
    Function,
}

impl Place {
    /// Every such site of an arm with `n` joints.
    pub fn sites(self, n: usize) -> Vec<Site> {
        let pair = |row| (0..n).filter(move |&cause| cause != row).map(move |cause| Site::Pair { row, cause });
        match self {
            Place::Arm => vec![Site::Arm],
            Place::Joint => (0..n).map(Site::Joint).collect(),
            Place::Pair => (0..n).flat_map(pair).collect(),
            Place::Function => {
                let site = |k: usize| Site::Function { row: k / (n * n), of: [k / n % n, k % n] };
                (0..n * n * n).map(site).collect()
            }
        }
    }
}

/// Spacing of the values of a nonlinear parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Even.
    Linear,
    /// Even in the logarithm.
    Logarithmic,
}

/// A nonlinear parameter of an effect: the columns depend on it, and a search finds it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Name in files: `delta`.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Meaning.
    pub what: &'static str,
    /// Least value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Number of start values of a search; 0 where none tries the form.
    pub steps: usize,
    /// Spacing of the start values.
    pub scale: Scale,
}

impl Setting {
    /// Whether it is a displacement, which may be as small as you like, and not a position of the joint.
    pub fn is_displacement(&self) -> bool {
        self.unit == "rad" && matches!(self.scale, Scale::Logarithmic)
    }

    /// Whether it is a speed of the joint.
    pub fn is_speed(&self) -> bool {
        self.unit == "rad/s"
    }

    /// Position between `low` (0) and `high` (1) as a value.
    pub fn at(&self, share: f64) -> f64 {
        match self.scale {
            Scale::Linear => self.low + share * (self.high - self.low),
            Scale::Logarithmic => self.low * (self.high / self.low).powf(share),
        }
    }

    /// Inverse of [`Setting::at`].
    pub fn share(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Logarithmic => (value / self.low).ln() / (self.high / self.low).ln(),
        }
    }

    /// Start values of a search.
    pub fn grid(&self) -> Vec<f64> {
        (0..self.steps).map(|step| self.at(step as f64 * self.spacing())).collect()
    }

    /// Distance between two start values as a ratio of the range: a search covers as much on either side.
    pub fn spacing(&self) -> f64 {
        1.0 / (self.steps.max(2) - 1) as f64
    }
}

/// Part of the data that shows an effect.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stratum {
    /// The mean period.
    #[default]
    Repeatable,
    /// Differences between periods.
    Changing,
    /// Differences between sessions, or from an earlier model: within one session the base parameters absorb it.
    Reference,
    /// What all named effects leave: fitted last, never searched for in their place.
    Remainder,
}

/// An effect or parameter with similar columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Confounded {
    /// Identity of the other family, or a base parameter.
    pub with: &'static str,
    /// The experiment that distinguishes the two.
    pub decided_by: &'static str,
}

pub(super) const fn confounded(with: &'static str, decided_by: &'static str) -> Confounded {
    Confounded { with, decided_by }
}

// Experiments that decide between several pairs of effects.
pub(super) const FULL_TURN: &str = "move the joint through a full turn, or as far as it goes";
pub(super) const MOST_OF_RANGE: &str = "move the joint through more than 60 % of its range";
pub(super) const SLOW_CONSTANT_SPEEDS: &str = "move the joint at constant speeds of 0.02 to 0.3 rad/s, both ways";
pub(super) const CONSTANT_SPEEDS: &str = "move the joint at constant speeds up to its rated one";
pub(super) const HIGHER_HARMONICS: &str = "add harmonics of a higher frequency: a delay grows with it";
pub(super) const BOTH_DIRECTIONS_EQUALLY: &str =
    "a motion that is as long in either direction; a drift of friction turns with it";
pub(super) const SECOND_MOUNTING: &str = "identify in a second mounting: the load turns, the zero stays";
pub(super) const OTHER_LOAD: &str = "pass the same poses under another load, or in another mounting";
pub(super) const SLOW_BOTH_DIRECTIONS: &str = "pass the same poses slowly in both directions";
pub(super) const STANDSTILL: &str = "hold the joint still for some seconds in several poses";
pub(super) const LONGER_RECORDING: &str = "a longer recording: a vibration goes on, a touch ends";
pub(super) const ONE_REVERSES: &str = "reverse one joint while the other holds still";

/// Horizontal axis of an effect's plot: a variable of the joint that causes the effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlotOver {
    /// Position.
    Position,
    /// Velocity.
    Velocity,
    /// Acceleration.
    Acceleration,
    /// Rigid-body torque.
    Load,
    /// Time since the start of the recording, or of the period.
    Time,
    /// No plot: an effect in all joints' rows has no single residual.
    Nothing,
}

/// An effect's part of the exported C function.
#[derive(Clone, Copy)]
pub enum InC {
    /// An expression per column, for the torque in the row of its site.
    Columns(Expressions),
    /// As `Columns`, and a share of each column for the torque in the row of the joint that causes it.
    BothRows {
        /// The expressions.
        columns: Expressions,
        /// The share, by the settings.
        share: fn(&[f64]) -> f64,
    },
    /// As `Columns`, for a part of the effect.
    Part {
        /// The expressions.
        columns: Expressions,
        /// The exported and the missing part of the effect.
        note: &'static str,
    },
    /// The [`Entry`](super::Entry) of every column of its whole-arm term.
    Entries,
    /// Standard parameters of a body on the last link, which the Newton-Euler recursion computes.
    LastLink,
    /// No C: the file names the effect and this reason.
    Refused(&'static str),
}

/// C expressions of an effect's columns, by the names of its inputs and its settings.
pub type Expressions = fn(&Inputs, &[f64]) -> Vec<String>;

/// C expressions that an effect may use; `cause` is the joint that causes it, the row's own unless the site is a pair.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// Position of the row's joint.
    pub q: String,
    /// Velocity of the row's joint.
    pub dq: String,
    /// `tanh(100 dq)` of the row's joint.
    pub sign: String,
    /// Position of the cause.
    pub cause_q: String,
    /// Velocity of the cause.
    pub cause_dq: String,
    /// Acceleration of the cause.
    pub cause_ddq: String,
    /// `tanh(100 dq)` of the cause.
    pub cause_sign: String,
    /// Position of the second joint of a function.
    pub other_q: String,
    /// Velocity of the second joint of a function.
    pub other_dq: String,
    /// `tanh(100 dq)` of the second joint of a function.
    pub other_sign: String,
    /// Rigid-body torque of the cause.
    pub load: String,
    /// `fv dq + fc tanh(100 dq) + ia ddq` of the cause.
    pub cause_drive: String,
}

/// The law needs earlier samples.
pub(super) const REFUSED_MEMORY: InC = InC::Refused("its law needs earlier samples");
/// The law needs the rigid-body torque at another position or under another gravity.
pub(super) const REFUSED_OTHER_STATE: InC = InC::Refused("its law needs the rigid-body torque in another state");
/// The law needs the time since the start of a recording.
pub(super) const REFUSED_TIME: InC = InC::Refused("its law needs the time of a recording");

/// The part of an effect in a description of rigid bodies with joint friction (URDF, MJCF).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InBodies {
    /// All of it: its columns are standard parameters of a body on the last link.
    LastLink,
    /// The sum of its parameters as Coulomb friction of its joint.
    CoulombFriction {
        /// The exported and the missing part of the effect.
        note: &'static str,
    },
    /// Nothing: the file names the effect.
    Nothing,
}

/// One effect without its linear parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Spec {
    /// Identity of the family.
    pub family: &'static str,
    /// Name of the form.
    pub form: &'static str,
    /// Location.
    pub site: Site,
    /// Nonlinear parameters, in the form's order.
    pub settings: Vec<f64>,
}

impl fmt::Display for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.site {
            Site::Arm => f.write_str(self.family),
            site => write!(f, "{} in {site}", self.family),
        }
    }
}

impl Family {
    /// Whether the loop serves it. An effect of the time of an event explains a recording; its [`FixedTerm`](super::FixedTerm) adds nothing.
    pub fn is_served(&self) -> bool {
        self.stratum != Stratum::Changing
    }

    /// Every site of an arm with `n` joints that a form can be at.
    pub fn sites(&self, form: &Form, n: usize) -> Vec<Site> {
        self.place.sites(n).into_iter().filter(|site| (self.rare.fits)(form.name, *site)).collect()
    }

    /// Its form of that name.
    pub fn form(&self, name: &str) -> Option<&'static Form> {
        self.forms.iter().find(|form| form.name == name)
    }
}

/// The joint of a site, the row of a pair.
pub(super) fn joint(site: Site) -> usize {
    match site {
        Site::Joint(joint) => joint,
        Site::Pair { row, .. } | Site::Function { row, .. } => row,
        Site::Arm => 0,
    }
}
