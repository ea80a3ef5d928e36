//! `plumbline robot`: an arm's own files from a URDF, and a robot file on one page.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::report::robot as page;
use crate::setup::backend;
use crate::urdf::{Arm, Choice, Packages, Urdf, declared, parse, read, robot_file, volumes};
use clap::{Args, Subcommand};
use plumbline_core::{BadInput, JointVec, MAX_JOINTS};
use plumbline_model::{Body, JointKind, Robot};
use std::path::{Path, PathBuf};

/// Options of `plumbline robot`.
#[derive(Args)]
pub struct Options {
    #[command(subcommand)]
    subcommand: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Write robot file, simulated arm and job of the arm in a URDF
    Import(Import),
    /// Print kinematics, limits and base parameters of a robot, and draw it
    Show(Show),
}

/// Options of `plumbline robot import`.
#[derive(Args)]
struct Import {
    /// The URDF; of a xacro file `xacro FILE.xacro` makes one
    urdf: PathBuf,
    /// Folder for NAME.toml (robot), sim-NAME-arm.toml (simulated arm) and sim-NAME.toml (job); made where it is missing
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    /// Name of the robot instead of the URDF's
    #[arg(long)]
    name: Option<String>,
    /// Link that the arm stands on, instead of the URDF's root
    #[arg(long, value_name = "LINK")]
    base: Option<String>,
    /// Link whose frame is the flange; joints beside the way to it are held at zero
    #[arg(long, value_name = "LINK")]
    tool: Option<String>,
    /// Folder that holds the packages of package:// meshes (repeatable); the folders above the URDF are searched anyway
    #[arg(long, value_name = "DIR")]
    meshes: Vec<PathBuf>,
    /// Replace files of these names
    #[arg(long)]
    force: bool,
}

/// Options of `plumbline robot show`.
#[derive(Args)]
struct Show {
    /// Robot: a shipped name such as panda, or the path of a robot file
    robot: String,
    /// Page with a picture to write as well (HTML)
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
}

pub fn run(options: Options) -> Result<(), Failure> {
    match options.subcommand {
        Command::Import(options) => import(&options),
        Command::Show(options) => show(&options),
    }
}

fn show(options: &Show) -> Result<(), Failure> {
    let robot = Robot::load(&options.robot, None)?;
    say!("{}", page::text(&robot).trim_end());
    if let Some(out) = &options.out {
        crate::atomic::write_result(out, page::html(&robot).as_bytes())?;
        say!("{}", out.display());
    }
    Ok(())
}

fn import(options: &Import) -> Result<(), Failure> {
    let (file, text) = read(&options.urdf)?;
    let text = declared(text);
    let document = parse(&file, &text)?;
    let urdf = Urdf::of(&file, &document)?;
    let choice = Choice { base: options.base.as_deref(), tool: options.tool.as_deref() };
    let arm = Arm::of(&urdf, &choice)?;
    let name = name(options, urdf.robot.attribute("name"))?;
    let paths = [format!("{name}.toml"), format!("sim-{name}-arm.toml"), format!("sim-{name}.toml")];
    let [robot_path, arm_path, job_path] = paths.map(|file| options.out.join(file));
    for path in [&robot_path, &arm_path, &job_path] {
        if path.exists() && !options.force {
            let expected = "another --out or --name, or --force to replace it";
            return Err(BadInput::new("command line", "--out", format!("{} exists", path.display()), expected).into());
        }
    }

    let folder = options.urdf.parent().map(Path::to_path_buf).unwrap_or_default();
    // Parent folders of a relative path are those of the whole path.
    let packages = Packages { urdf: std::path::absolute(&folder).unwrap_or(folder), more: options.meshes.clone() };
    let shape = volumes(&urdf, &arm, &packages)?;
    let mut notes = arm.notes.clone();
    notes.extend(shape.notes);
    let source =
        format!("plumbline robot import {}: limits of the URDF; ddq, jerk and dtau are chosen", options.urdf.display());
    let described = |exempt: &[[usize; 2]]| {
        let text = robot_file(&name, &source, &arm, &shape.capsules, exempt);
        let shown = robot_path.display().to_string();
        Robot::parse(&shown, &text).map(|robot| (robot, text))
    };
    let (robot, _) = described(&[])?;
    let exempt = robot.overlapping();
    let (robot, robot_text) = described(&exempt)?;
    let start = robot.pose();
    let (bodies, wrong) = arm.bodies(&urdf)?;
    notes.extend(wrong);
    let bodies = filled(&robot, &arm, bodies, &mut notes);
    let friction: Vec<[Option<f64>; 2]> = arm.limits.iter().map(|limit| limit.friction).collect();
    let mut rest: JointVec = [0.0; MAX_JOINTS];
    rest[..start.len()].copy_from_slice(&start);
    let (arm_text, lowered) = backend::simulated_arm(&format!("{name}.toml"), &robot, &bodies, &friction, &rest);
    notes.extend(lowered);

    crate::atomic::write_result(&robot_path, robot_text.as_bytes())?;
    crate::atomic::write_result(&arm_path, arm_text.as_bytes())?;
    crate::atomic::write_result(&job_path, job(&name, &robot, &start).as_bytes())?;

    say!("{}: {} joints from `{}` to `{}`", robot_path.display(), robot.chain.len(), arm.base_link, arm.tool_link);
    say!("  largest distance from the URDF's kinematics {:.1e} m", arm.deviation);
    match robot.shape.is_empty() {
        true => say!("  no volumes: self-collision is not checked"),
        false => say!("  {} capsules around the collision geometry", robot.shape.capsules().len()),
    }
    if !exempt.is_empty() {
        let pairs: Vec<String> = exempt.iter().map(|[a, b]| format!("{a}-{b}")).collect();
        say!("  not compared, because they overlap in nearly every pose: links {}", pairs.join(", "));
    }
    say!("  no workspace: neither floor nor walls are checked");
    say!(
        "  chosen, because a URDF has none: ddq, jerk, dtau, torque-sensing. Set them from the data sheet before an arm is driven"
    );
    notes.iter().for_each(|note| say!("  note: {note}"));
    say!("{}: simulated arm", arm_path.display());
    say!("{}: job; next: plumbline run {}", job_path.display(), job_path.display());
    Ok(())
}

/// The option's, or the URDF's in the letters that names of robots have.
fn name(options: &Import, urdf: Option<&str>) -> Result<String, BadInput> {
    let given = options.name.as_deref();
    let wanted = given.or(urdf).unwrap_or_default();
    let fits = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if given.is_some_and(|name| name.is_empty() || !name.chars().all(fits)) {
        return Err(BadInput::new("command line", "--name", format!("`{wanted}`"), "letters, digits, - and _"));
    }
    let name: String = wanted.chars().map(|c| if fits(c) { c.to_ascii_lowercase() } else { '-' }).collect();
    let name = if name.is_empty() { "arm".to_string() } else { name };
    let shipped = Robot::names().any(|known| known == name);
    // Models and datasets of the shipped robot would fit its name.
    Ok(if shipped && given.is_none() { format!("{name}-urdf") } else { name })
}

/// A body for every link: where the URDF has none, a ball of 1 kg and 5 cm in the middle of its capsules.
fn filled(robot: &Robot, arm: &Arm, bodies: Vec<Option<Body>>, notes: &mut Vec<String>) -> Vec<Body> {
    let mut without = Vec::new();
    let all = bodies.into_iter().enumerate().map(|(j, body)| {
        body.unwrap_or_else(|| {
            without.push(arm.segments[j + 1].first().map_or("", |(link, _)| link));
            let own = robot.shape.capsules().iter().filter(|capsule| capsule.link == j + 1);
            let ends: Vec<nalgebra::Vector3<f64>> =
                own.flat_map(|capsule| [capsule.from.into(), capsule.to.into()]).collect();
            let com = ends.iter().sum::<nalgebra::Vector3<f64>>() / ends.len().max(1) as f64;
            Body { mass: 1.0, com, inertia: nalgebra::Matrix3::identity() * (0.4 * 0.05 * 0.05) }
        })
    });
    let all = all.collect();
    if !without.is_empty() {
        notes.push(format!("links without mass, simulated as balls of 1 kg: {}", without.join(", ")));
    }
    all
}

/// A short job of the simulated arm.
fn job(name: &str, robot: &Robot, start: &[f64]) -> String {
    let positions = start.iter().zip(robot.chain.joints()).map(|(q, joint)| match joint.kind {
        JointKind::Revolute => format!("\"{} deg\"", (q.to_degrees() * 1e6).round() / 1e6),
        JointKind::Prismatic => format!("{q:?}"),
    });
    format!(
        "# {name} in simulation, on a wall, where all base parameters are found: upright two of them have no influence. Then unseen motions are \
         predicted, on the wall and upright.\n# `plumbline run FILE --set \
         key.path=value` overrides a value for one run.\n\nrobot = \"{name}.toml\"\nmounting = \"wall\"                    # upright, wall, ceiling or {{ \
         rho = \"90 deg\", phi = \"0 deg\" }}\n\n[backend]\nkind = \"sim\"\narm = \"sim-{name}-arm.toml\"\npace = \"fast\"                        # or \
         \"wall-clock\"\nstart = [{}]\n\n[excitation]\nperiod = \"10 s\"\ntrajectories = 2\nperiods = 5\n\n[validation]\ntrajectories = \
         2\nmountings = [\"wall\", \"upright\"]\n\n[output]\ndir = \"results/sim-{name}\"\n",
        positions.collect::<Vec<_>>().join(", ")
    )
}
