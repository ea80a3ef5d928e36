//! A case of the study: an arm and its undeclared effects, drawn by seed and number.

use plumbline_diagnose::Variable;
use plumbline_excite::Plan;
use plumbline_model::Mounting;
use plumbline_model::term::effect::Site;
use plumbline_sim::Truth;
use rand::Rng;
use rand::SeedableRng;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use std::fmt::Write;

/// Families of the catalogue that show within one session, in every period alike.
pub const FAMILIES: [&str; 21] = [
    "torque-offset",
    "torque-gain",
    "asymmetric-coulomb",
    "asymmetric-viscous",
    "stribeck",
    "coulomb-slope",
    "nonlinear-viscous",
    "load-dependent-friction",
    "presliding",
    "rotor-inertia",
    "joint-elasticity",
    "position-ripple",
    "position-dependent-friction",
    "spring",
    "mounting",
    "torque-crosstalk",
    "transmission-coupling",
    "delay",
    "encoder-offset",
    "encoder-eccentricity",
    "backlash",
];

/// Effects that are drawn three at a time: those that the base parameters leave enough of at the joints given (from 1).
const OF_THREE: [(&str, &[usize]); 9] = [
    ("torque-offset", &[1, 3, 5, 6, 7]),
    ("presliding", &[1, 2, 3, 5, 6]),
    ("stribeck", &[1, 2, 3, 5, 6]),
    ("nonlinear-viscous", &[1, 2, 3, 5, 6, 7]),
    ("load-dependent-friction", &[2, 4]),
    ("rotor-inertia", &[3, 4, 5, 6, 7]),
    ("position-ripple", &[1, 2, 3, 4, 5, 6, 7]),
    ("spring", &[1, 3, 5, 6, 7]),
    ("transmission-coupling", &[4, 5, 6, 7]),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// One effect of the catalogue, four trajectories.
    Single,
    /// None at all.
    None,
    Three,
    Foreign,
    /// One effect, and 0.05 Nm of something else that repeats in every joint.
    Background,
    /// One effect, but one trajectory to identify from.
    OneTrajectory,
    /// One effect, on an arm that stands upright.
    Upright,
}

impl What {
    pub const ALL: [What; 7] =
        [What::Single, What::None, What::Three, What::Foreign, What::Background, What::OneTrajectory, What::Upright];

    pub fn id(self) -> &'static str {
        match self {
            What::Single => "single",
            What::None => "none",
            What::Three => "three",
            What::Foreign => "foreign",
            What::Background => "background",
            What::OneTrajectory => "one-trajectory",
            What::Upright => "upright",
        }
    }
}

#[derive(Clone, Debug)]
pub struct Injected {
    /// Its family; `foreign` for what has none.
    pub family: &'static str,
    pub site: Site,
    pub text: String,
    pub variables: Vec<Variable>,
}

#[derive(Clone, Debug)]
pub struct Case {
    pub what: What,
    pub number: usize,
    pub truth: String,
    pub effects: Vec<Injected>,
    /// Seed of the repeatable background, where there is one.
    pub background: Option<u64>,
    pub mounting: Mounting,
    pub trajectories: usize,
    pub noise: u64,
}

impl Case {
    /// Case `number` of a part under a seed; the same whatever else is run.
    pub fn draw(base: &Truth, plans: &[Plan], what: What, seed: u64, number: usize) -> Case {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(((what as u64) << 32) + number as u64);
        let (arm, fc) = arm(&mut rng, base);
        let n = base.joints();
        let effects = match what {
            What::None => Vec::new(),
            What::Three => three(&mut rng, &fc),
            What::Foreign => vec![foreign(&mut rng, plans, n, number)],
            // Every family in turn, so that any number of cases is balanced.
            _ => vec![effect(&mut rng, FAMILIES[number % FAMILIES.len()], None, &fc, what)],
        };
        let truth = effects.iter().fold(arm, |text, one| text + "\n[[effect]]\n" + &one.text);
        Case {
            what,
            number,
            truth,
            effects,
            background: (what == What::Background).then(|| rng.random()),
            mounting: if what == What::Upright { Mounting::UPRIGHT } else { Mounting::WALL },
            trajectories: if what == What::OneTrajectory { 1 } else { 4 },
            noise: rng.random(),
        }
    }
}

/// The arm of the file with masses, centres of mass, inertias and friction of its own: nothing can be tuned to one arm. Also its `fc`.
pub fn arm(rng: &mut ChaCha8Rng, base: &Truth) -> (String, Vec<f64>) {
    let mut text = format!("robot = \"{}\"\nsubsteps = {}\n", base.robot, base.substeps);
    for link in &base.links {
        // All of a link heavier alike stays a body; its centre of mass moves inside it.
        let (heavier, longer) = (rng.random_range(0.8..1.2), rng.random_range(0.8..1.2));
        let com = link.com.map(|c| c * longer * rng.random_range(0.9..1.1));
        let inertia = link.inertia.map(|i| i * heavier);
        let _ = writeln!(text, "[[link]]\nmass = {}\ncom = {com:?}\ninertia = {inertia:?}", link.mass * heavier);
    }
    let mut all = Vec::new();
    for joint in &base.joints {
        let fc = joint.fc * rng.random_range(0.7..1.4);
        let fv = joint.fv * rng.random_range(0.7..2.0);
        all.push(fc);
        let _ = write!(text, "[[joint]]\nfv = {fv}\nfc = {fc}\n");
        let _ = write!(text, "stiffness = {}\ndamping = {}\n", joint.stiffness, joint.damping);
        let _ = write!(text, "torque-noise = {}\ntorque-quantum = {}\n", joint.torque_noise, joint.torque_quantum);
        let _ = writeln!(text, "position-noise = {:e}", joint.position_noise);
        let _ = writeln!(text, "position-quantum = {:e}", joint.position_quantum);
    }
    (text, all)
}

fn sign(rng: &mut ChaCha8Rng) -> f64 {
    if rng.random() { 1.0 } else { -1.0 }
}

fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low * (high / low).powf(rng.random::<f64>())
}

/// An effect of nominal size; `joint` from 1, or any.
fn effect(rng: &mut ChaCha8Rng, family: &'static str, joint: Option<usize>, fc: &[f64], what: What) -> Injected {
    let n = fc.len();
    let joint = joint.unwrap_or_else(|| rng.random_range(1..=n));
    let own = fc[joint - 1];
    let mut site = Site::Joint(joint - 1);
    let body = match family {
        "torque-offset" => format!("offset = {}", 0.3 * sign(rng)),
        "torque-gain" => format!("gain = {}", 1.0 + 0.03 * sign(rng)),
        "asymmetric-coulomb" => format!("asymmetry = {}", 0.25 * own * sign(rng)),
        "asymmetric-viscous" => {
            // No more than the friction that is there holds.
            format!("asymmetry = {}", f64::min(0.1, 0.5 * own) * sign(rng))
        }
        "stribeck" => format!("excess = {}\nvelocity = {}", 0.5 * own, between(rng, 0.03, 0.2)),
        "coulomb-slope" => {
            let form = if rng.random() { "tanh" } else { "arctan" };
            format!("form = \"{form}\"\nsize = {own}\nvelocity = {}", between(rng, 0.02, 0.06))
        }
        "nonlinear-viscous" => match rng.random_range(0..3) {
            0 => format!("form = \"sigmoid\"\nsize = 0.6\nvelocity = {}", between(rng, 0.1, 0.2)),
            1 => "form = \"cubic\"\nsize = 0.065".to_string(),
            _ => "form = \"quadratic\"\nsize = 0.15".to_string(),
        },
        "load-dependent-friction" => "coulomb = 0.03".to_string(),
        "presliding" if rng.random() => {
            format!("delta = {}\ndamping = 0.1\nbreakaway = 1.2", between(rng, 0.002, 0.02))
        }
        "presliding" => {
            let delta = between(rng, 0.002, 0.01);
            let element = |share: f64, times: f64| format!("{{ share = {share}, delta = {} }}", times * delta);
            format!("elements = [{}, {}, {}]", element(0.5, 0.5), element(0.3, 1.5), element(0.2, 4.0))
        }
        "rotor-inertia" => "inertia = 0.1".to_string(),
        "joint-elasticity" => "stiffness = 10000".to_string(),
        "position-ripple" => {
            let (order, phase) = (between(rng, 2.0, 200.0).round(), rng.random_range(0.0..TAU));
            format!("order = {order:?}\nsine = {}\ncosine = {}", 0.15 * phase.sin(), 0.15 * phase.cos())
        }
        "position-dependent-friction" => {
            let (order, phase) = (rng.random_range(1..=4), rng.random_range(0.0..TAU));
            let size = 0.4 * own;
            format!("order = {order}.0\nsine = {}\ncosine = {}", size * phase.sin(), size * phase.cos())
        }
        "spring" => {
            let side = ["both", "above", "below"].choose(rng).expect("three");
            format!("stiffness = 0.5\nrest = {}\nside = \"{side}\"", rng.random_range(-0.5..0.5))
        }
        "mounting" => {
            site = Site::Arm;
            let turn: f64 = rng.random_range(0.0..TAU);
            let (a, b) = (0.0087 * turn.sin(), 0.0087 * turn.cos());
            // Two axes across gravity: gravity runs along the base's x on the wall, along its z upright.
            let tilt = if what == What::Upright { [a, b, 0.0] } else { [0.0, a, b] };
            format!("tilt = {tilt:?}")
        }
        "torque-crosstalk" => {
            let other = (joint + rng.random_range(1..n) - 1) % n + 1;
            site = Site::Pair { row: joint - 1, cause: other - 1 };
            format!("other = {other}\nshare = {}", 0.03 * sign(rng))
        }
        "transmission-coupling" => {
            let other = if joint == 1 || (joint < n && rng.random()) { joint + 1 } else { joint - 1 };
            site = Site::Pair { row: joint - 1, cause: other - 1 };
            let ratio = if rng.random() { format!("ratio = {}\n", sign(rng)) } else { String::new() };
            format!("other = {other}\n{ratio}fc = 0.15")
        }
        "delay" => {
            site = Site::Arm;
            "delay = 0.004".to_string()
        }
        "encoder-offset" => format!("offset = {}", 0.005 * sign(rng)),
        "encoder-eccentricity" => format!("amplitude = 0.002\nphase = {}", rng.random_range(0.0..TAU)),
        "backlash" => "gap = 0.0015".to_string(),
        _ => unreachable!("{family} is not drawn"),
    };
    let joint = if site == Site::Arm { String::new() } else { format!("joint = {joint}\n") };
    Injected { family, site, text: format!("id = \"{family}\"\n{joint}{body}\n"), variables: Vec::new() }
}

fn three(rng: &mut ChaCha8Rng, fc: &[f64]) -> Vec<Injected> {
    let mut all: Vec<Injected> = Vec::new();
    while all.len() < 3 {
        let (family, joints) = OF_THREE.choose(rng).expect("some");
        let joint = *joints.choose(rng).expect("some");
        let taken =
            |one: &Injected| one.family == *family || one.site.joints().contains(&(joint - 1)) || all.len() == 3;
        if !all.iter().any(taken) {
            let new = effect(rng, family, Some(joint), fc, What::Three);
            // What couples two joints takes both.
            if !all.iter().any(|one| one.site.joints().iter().any(|joint| new.site.joints().contains(joint))) {
                all.push(new);
            }
        }
    }
    all
}

/// What no catalogue holds, in each form in turn, about a place that the motions pass.
fn foreign(rng: &mut ChaCha8Rng, plans: &[Plan], n: usize, number: usize) -> Injected {
    let joint = rng.random_range(1..=n);
    let mut others: Vec<usize> = (1..=n).filter(|&other| other != joint).collect();
    let first = others.swap_remove(rng.random_range(0..others.len()));
    let second = *others.choose(rng).expect("more joints");
    let plan = plans.choose(rng).expect("plans").fourier().expect("a plan's motion");
    let t = rng.random_range(0.0..10.0);
    let passed = |joint: usize| plan.at(joint - 1, t);
    let size = rng.random_range(0.3..0.6) * sign(rng);
    let (q, dq) = (Variable::Position, Variable::Velocity);
    let (form, body, variables) = match number % 5 {
        0 => {
            let order = rng.random_range(2.0..6.0);
            let body = format!("order = {order}\nsecond = {second}\nmiddle = {}\nwidth = 0.6", passed(second).q);
            ("windowed-sine", format!("first = {first}\n{body}"), vec![q(first - 1), q(second - 1)])
        }
        1 => {
            let place =
                format!("middle = {}\nwidth = 0.5\nspeed = {}\nspread = 0.6", passed(first).q, passed(second).dq);
            ("bump", format!("first = {first}\nsecond = {second}\n{place}"), vec![q(first - 1), dq(second - 1)])
        }
        2 => {
            let body = format!("first = {first}\nmiddle = {}\nwidth = 0.1", passed(first).q);
            ("region", body, vec![q(first - 1)])
        }
        3 => {
            let body = format!("first = {first}\nwidth = 0.3\nsecond = {second}");
            ("product", body, vec![q(first - 1), dq(second - 1)])
        }
        _ => ("beat", "every = 2.5".to_string(), vec![Variable::Time]),
    };
    let text = format!("id = \"foreign\"\nform = \"{form}\"\njoint = {joint}\nsize = {size}\n{body}\n");
    Injected { family: "foreign", site: Site::Joint(joint - 1), text, variables }
}
