//! The whole model as one C function that depends on nothing but `math.h`.
//!
//! The Newton-Euler recursion with the regrouped base parameters in the slots of their names, unrolled, every product with a zero left
//! out: it computes what [`TorqueModel::evaluator`] does, friction, offsets, rotors and effects of one sample included, for any
//! direction of gravity.

use super::emit::{Program, Value, ZERO, expression};
use super::{Exported, effects, validity};
use plumbline_model::{Joint, JointKind, LINK_COLUMNS, TorqueModel};

type Vector = [Value; 3];

/// Name of the function for a robot: its own in lower case where C allows, `_torque` behind.
pub fn function_name(robot: &str) -> String {
    let mut name: String =
        robot.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' }).collect();
    if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name.insert_str(0, "arm_");
    }
    name + "_torque"
}

/// The source file, C99.
pub fn write(model: &TorqueModel) -> Exported {
    let structure = model.structure();
    let chain = structure.chain();
    let n = chain.len();
    let beta = model.beta();
    let mut links = vec![[0.0; LINK_COLUMNS]; n];
    for (&slot, &value) in structure.reduction().independent().iter().zip(&beta) {
        links[slot / LINK_COLUMNS][slot % LINK_COLUMNS] = value;
    }

    let mut program = Program::default();
    // A load that effects refer to is the rigid body's own, without a payload.
    let load = recursion(&mut program, chain.joints(), &links);
    let payload = model.on_last_link();
    let mut tau = load.clone();
    if payload != [0.0; LINK_COLUMNS] {
        if let Some(last) = links.last_mut() {
            last.iter_mut().zip(payload).for_each(|(own, more)| *own += more);
        }
        tau = recursion(&mut program, chain.joints(), &links);
    }
    let operating_point = structure.operating_point(&beta);
    for (term, range) in structure.terms().iter().zip(structure.ranges()) {
        let (spec, entries) = (term.spec(), term.entries());
        for (c, value) in beta[range].iter().enumerate() {
            let column = match (&spec, &entries) {
                (Some(spec), _) => effects::column(&mut program, spec, term.original(c), &load, &operating_point),
                (None, Some(entries)) => effects::entry(&mut program, entries[c]).into_iter().collect(),
                (None, None) => Vec::new(),
            };
            for (row, factor) in column {
                tau[row] = program.sum(&[(tau[row].clone(), Value::Known(1.0)), (Value::Known(*value), factor)]);
            }
        }
    }

    let notes: Vec<String> = validity(model).into_iter().chain(effects::notes_of_c(model)).collect();
    let name = function_name(model.robot());
    let mountings: Vec<String> = model.mountings().iter().map(|mounting| mounting.to_string()).collect();
    let about = notes.iter().map(|note| format!(" * {}\n", note.replace("*/", "* /"))).collect::<String>();
    let outputs: String =
        tau.iter().enumerate().map(|(j, tau)| format!("    tau[{j}] = {};\n", expression(tau))).collect();
    let text = format!(
        "/* Joint torques of {}, written by plumbline: {} of {} parameters, identified in mounting {}.\n *\n * q, dq, ddq: joint positions, \
         velocities, accelerations [rad, rad/s, rad/s2; m for a sliding joint], {n} each.\n * gravity: gravitational acceleration in the \
         base frame, pointing down [m/s2], e.g. {{0, 0, -9.81}} upright.\n * tau: the torques that the arm needs, {n} [Nm; N for a sliding \
         joint].\n{about} */\n#include <math.h>\n\nvoid {name}(const double q[{n}], const double dq[{n}], const double ddq[{n}], const \
         double gravity[3], double tau[{n}]);\n\nvoid {name}(const double q[{n}], const double dq[{n}], const double ddq[{n}], const \
         double gravity[3], double tau[{n}])\n{{\n    (void)q, (void)dq, (void)ddq, (void)gravity;\n{}{outputs}}}\n",
        model.robot().replace("*/", "* /"),
        model.kind(),
        beta.len(),
        if mountings.is_empty() { "unknown".to_string() } else { mountings.join(", ") },
        program.lines(&tau),
    );
    Exported { text, notes }
}

/// The recursion of [`plumbline_model::rnea`] as a program.
fn recursion(p: &mut Program, joints: &[Joint], links: &[[f64; LINK_COLUMNS]]) -> Vec<Value> {
    let zero = || [ZERO, ZERO, ZERO];
    let mut w = zero();
    let mut dw = zero();
    let mut a: Vector = std::array::from_fn(|k| Value::input(format!("gravity[{k}]")).negated());
    let mut frames = Vec::new();
    let mut force = Vec::new();
    let mut moment = Vec::new();
    for (i, (joint, link)) in joints.iter().zip(links).enumerate() {
        let (rotation, origin) = placement(p, i, joint);
        let to_child: [Vector; 3] = std::array::from_fn(|r| std::array::from_fn(|c| rotation[c][r].clone()));
        let swing = cross(p, &w, &origin);
        let (turn, swing) = (cross(p, &dw, &origin), cross(p, &w, &swing));
        let at_joint = add(p, &a, &turn);
        let at_joint = add(p, &at_joint, &swing);
        a = times(p, &to_child, &at_joint);
        w = times(p, &to_child, &w);
        dw = times(p, &to_child, &dw);
        let (dq, ddq) = (Value::input(format!("dq[{i}]")), Value::input(format!("ddq[{i}]")));
        match joint.kind {
            JointKind::Revolute => {
                let coriolis = cross(p, &w, &[ZERO, ZERO, dq.clone()]);
                dw = add(p, &dw, &coriolis);
                dw[2] = p.add(&dw[2], &ddq);
                w[2] = p.add(&w[2], &dq);
            }
            JointKind::Prismatic => {
                let twice = p.product(&Value::Known(2.0), &dq);
                let coriolis = cross(p, &w, &[ZERO, ZERO, twice]);
                a = add(p, &a, &coriolis);
                a[2] = p.add(&a[2], &ddq);
            }
        }
        let [xx, xy, xz, yy, yz, zz, lx, ly, lz, m] = link.map(Value::Known);
        let inertia = [[xx, xy.clone(), xz.clone()], [xy, yy, yz.clone()], [xz, yz, zz]];
        let first = [lx, ly, lz];
        let (spun, turned) = (cross(p, &w, &first), cross(p, &dw, &first));
        let spun = cross(p, &w, &spun);
        let inertial: Vector = std::array::from_fn(|k| p.product(&m, &a[k]));
        let sum = add(p, &turned, &spun);
        force.push(add(p, &inertial, &sum));
        let (accelerated, momentum, pull) = (times(p, &inertia, &dw), times(p, &inertia, &w), cross(p, &first, &a));
        let gyroscopic = cross(p, &w, &momentum);
        let sum = add(p, &accelerated, &gyroscopic);
        moment.push(add(p, &sum, &pull));
        frames.push((rotation, origin));
    }
    let mut tau = vec![ZERO; joints.len()];
    for i in (0..joints.len()).rev() {
        tau[i] = match joints[i].kind {
            JointKind::Revolute => moment[i][2].clone(),
            JointKind::Prismatic => force[i][2].clone(),
        };
        if i > 0 {
            let (rotation, origin) = &frames[i];
            let (f, m) = (times(p, rotation, &force[i]), times(p, rotation, &moment[i]));
            let lever = cross(p, origin, &f);
            force[i - 1] = add(p, &force[i - 1], &f);
            let sum = add(p, &m, &lever);
            moment[i - 1] = add(p, &moment[i - 1], &sum);
        }
    }
    tau
}

/// Rotation and origin of joint `i`'s frame in the one before, [`Joint::placement`] as a program.
fn placement(p: &mut Program, i: usize, joint: &Joint) -> ([Vector; 3], Vector) {
    // At a joint angle of zero the second and third rows hold the twist's cosine and sine, exact at right angles.
    let straight = Joint { kind: JointKind::Revolute, theta: 0.0, ..*joint }.placement(0.0).rotation;
    let (ca, sa) = (Value::Known(straight[(1, 1)]), Value::Known(straight[(2, 1)]));
    let (st, ct, d) = match joint.kind {
        JointKind::Revolute => {
            let angle = match joint.theta {
                0.0 => format!("q[{i}]"),
                theta => format!("q[{i}] + {theta:?}"),
            };
            let st = p.named(format!("sin{i}"), format!("sin({angle})"));
            (st, p.named(format!("cos{i}"), format!("cos({angle})")), Value::Known(joint.d))
        }
        JointKind::Prismatic => {
            let (sin, cos) = joint.theta.sin_cos();
            let d = p.add(&Value::input(format!("q[{i}]")), &Value::Known(joint.d));
            (Value::Known(sin), Value::Known(cos), d)
        }
    };
    let rotation = [
        [ct.clone(), st.negated(), ZERO],
        [p.product(&st, &ca), p.product(&ct, &ca), sa.negated()],
        [p.product(&st, &sa), p.product(&ct, &sa), ca.clone()],
    ];
    let origin = [Value::Known(joint.a), p.product(&sa.negated(), &d), p.product(&ca, &d)];
    (rotation, origin)
}

fn add(p: &mut Program, a: &Vector, b: &Vector) -> Vector {
    std::array::from_fn(|k| p.add(&a[k], &b[k]))
}

fn times(p: &mut Program, matrix: &[Vector; 3], v: &Vector) -> Vector {
    std::array::from_fn(|r| {
        let pairs: Vec<_> = matrix[r].iter().cloned().zip(v.iter().cloned()).collect();
        p.sum(&pairs)
    })
}

fn cross(p: &mut Program, a: &Vector, b: &Vector) -> Vector {
    std::array::from_fn(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        p.sum(&[(a[i].clone(), b[j].clone()), (a[j].negated(), b[i].clone())])
    })
}
