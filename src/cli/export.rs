//! `plumbline export`: the identified arm as URDF, MJCF or C, or its load in a maker's format.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::report::Consistency;
use crate::store::ModelFile;
use crate::store::export::load::{self, Maker};
use crate::store::export::{Arm, Exported, c, effects, mjcf, splice, tree, urdf};
use crate::urdf::{parse, read};
use clap::{Args, ValueEnum};
use plumbline_core::BadInput;
use plumbline_identify::consistency::{Nearest, Prior, Uncertainty, Weights, nearest};
use plumbline_model::{Mounting, Robot, TorqueModel, is_consistent};
use plumbline_model_file::models;
use std::path::{Path, PathBuf};

/// Options of `plumbline export`.
#[derive(Args)]
pub struct Options {
    /// Model file, or the folder of a job's results
    model: PathBuf,
    /// Format: URDF, MuJoCo model, or a C function that depends on math.h only; all three where absent. Or the body on the last link that `compare`, a
    /// diagnosis or `payload` found, as a maker takes it: end effector of Franka Desk (JSON), libfranka's setLoad, UR's set_target_payload, KUKA's load data
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// File to write; without --format the folder for ROBOT.urdf, ROBOT.xml and ROBOT.c
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    /// URDF of the same arm (from its maker, from CAD) whose bodies are the prior where the torques determine none
    #[arg(long, value_name = "FILE.urdf")]
    prior: Option<PathBuf>,
    /// URDF of the same arm to insert the identified inertials into; the rest is unchanged
    #[arg(long, value_name = "FILE.urdf")]
    into: Option<PathBuf>,
    /// Export a model that is valid only with gravity along axis 1; the file states this
    #[arg(long)]
    vertical: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Urdf,
    Mjcf,
    C,
    FrankaDesk,
    Libfranka,
    Ur,
    Kuka,
}

/// The formats of the whole arm: those that are written without `--format`.
const OF_ARM: [Format; 3] = [Format::Urdf, Format::Mjcf, Format::C];

/// Exports a model; projects it to physically consistent bodies if the file has none.
pub fn run(options: Options) -> Result<(), Failure> {
    let path = match options.model.is_dir() {
        true => options.model.join("model.toml"),
        false => options.model.clone(),
    };
    let name = path.display().to_string();
    let (file, robot) = models::load(&path)?;
    let model = &file.model;
    check(&options)?;
    if let Some(maker) = options.format.and_then(Format::maker) {
        return export_load(&options.out, &name, model, maker);
    }
    if let Err(refused) = model.valid_in(&Mounting::WALL)
        && !options.vertical
    {
        let expected = "a model that holds in every mounting, or --vertical";
        return Err(BadInput::new(name, "key `kind`", refused, expected).into());
    }
    let wanted: Vec<(Format, PathBuf)> = match options.format {
        Some(format) => vec![(format, options.out.clone())],
        None if options.out.is_file() => {
            let expected = "a folder for all formats, or --format";
            return Err(BadInput::new(
                "command line",
                "--out",
                format!("the file {}", options.out.display()),
                expected,
            )
            .into());
        }
        None => OF_ARM.iter().map(|format| (*format, options.out.join(format.file(model.robot())))).collect(),
    };

    let mut exported: Vec<(Format, PathBuf, Exported)> = Vec::new();
    if wanted.iter().any(|(format, _)| *format != Format::C) {
        let (bodies, notes) = bodies(&file, &robot, &name, options.prior.as_deref())?;
        say!("{}", Consistency::of_model(model, &bodies).sentence());
        notes.iter().for_each(|note| say!("note: {note}"));
        let (bodies, left_out) = match effects::with_payload(model, &bodies) {
            Ok(with) => (with, None),
            Err(link) => {
                let [.., mass] = link;
                let note = format!(
                    "the payload is left out: with it the last link is no body ({mass:.3} kg with impossible moments)"
                );
                (bodies, Some(note))
            }
        };
        let arm = Arm { model, bodies: &bodies, limits: &robot.limits, left_out: left_out.as_deref() };
        for (format, out) in wanted.iter().filter(|(format, _)| *format != Format::C) {
            let text = match (format, &options.into) {
                (Format::Mjcf, _) => {
                    let mounting = model.mountings().first().copied().unwrap_or(Mounting::UPRIGHT);
                    mjcf::write(&arm, &mounting.gravity())
                }
                (_, Some(path)) => spliced(&arm, path, &robot)?,
                _ => urdf::write(&arm),
            };
            exported.push((*format, out.clone(), text));
        }
    }
    exported.extend(
        wanted
            .iter()
            .filter(|(format, _)| *format == Format::C)
            .map(|(_, out)| (Format::C, out.clone(), c::write(model))),
    );
    for (format, out, exported) in exported {
        crate::atomic::write_result(&out, exported.text.as_bytes())?;
        for note in &exported.notes {
            say!("note: {note}");
        }
        match format {
            Format::C => say!("{}: void {}(q, dq, ddq, gravity, tau)", out.display(), c::function_name(model.robot())),
            _ => say!("{}", out.display()),
        }
    }
    Ok(())
}

impl Format {
    /// Name of a robot's file.
    fn file(self, robot: &str) -> String {
        let extension = match self {
            Format::Urdf => "urdf",
            Format::Mjcf => "xml",
            Format::C => "c",
            Format::FrankaDesk => "json",
            Format::Libfranka | Format::Ur | Format::Kuka => "txt",
        };
        format!("{robot}.{extension}")
    }

    /// The maker whose format of a load it is.
    fn maker(self) -> Option<Maker> {
        match self {
            Format::Urdf | Format::Mjcf | Format::C => None,
            Format::FrankaDesk => Some(Maker::FrankaDesk),
            Format::Libfranka => Some(Maker::Libfranka),
            Format::Ur => Some(Maker::Ur),
            Format::Kuka => Some(Maker::Kuka),
        }
    }
}

/// Writes the body on the last link, which is valid in every mounting.
fn export_load(out: &Path, name: &str, model: &TorqueModel, maker: Maker) -> Result<(), Failure> {
    let Some(found) = load::seen_from_flange(model.structure().chain(), &model.on_last_link()) else {
        let expected =
            "a model with a `payload` of positive mass, as `plumbline compare` and `plumbline payload` write it";
        let found = format!("a body of {} kg", model.on_last_link()[9]);
        return Err(BadInput::new(name, "term `payload`", found, expected).into());
    };
    let (body, note) = load::possible(found);
    let exported = load::write(maker, &body);
    crate::atomic::write_result(out, exported.text.as_bytes())?;
    note.iter().chain(&exported.notes).for_each(|note| say!("note: {note}"));
    let [x, y, z] = body.com.into();
    say!("{}: {:.4} kg at [{x:.4}, {y:.4}, {z:.4}] m in the flange frame", out.display(), body.mass);
    Ok(())
}

fn check(options: &Options) -> Result<(), BadInput> {
    let refuse = |option: &str, format: &str, expected: &str| {
        Err(BadInput::new("command line", option, format!("--format {format}"), expected))
    };
    match (options.format, &options.into, &options.prior) {
        (Some(Format::C), Some(_), _) => refuse("--into", "c", "--format urdf"),
        (Some(Format::Mjcf), Some(_), _) => refuse("--into", "mjcf", "--format urdf"),
        (Some(format), Some(_), _) if format.maker().is_some() => refuse("--into", "of a load", "--format urdf"),
        (Some(format), _, Some(_)) if format.maker().is_some() => {
            refuse("--prior", "of a load", "--format urdf or mjcf")
        }
        (Some(Format::C), _, Some(_)) => refuse(
            "--prior",
            "c",
            "--format urdf or mjcf: the C function takes the base parameters, which need no bodies",
        ),
        _ => Ok(()),
    }
}

/// Bodies of a model file: its own; nearest to a prior where one is given; found now where the file has none.
fn bodies(
    file: &ModelFile,
    robot: &Robot,
    name: &str,
    prior: Option<&Path>,
) -> Result<(Nearest, Vec<String>), Failure> {
    let model = &file.model;
    let usual = Prior::of_geometry(model.structure(), &model.beta());
    let (prior, mut notes) = match prior {
        Some(path) => prior_of(path, robot, usual)?,
        None => match &file.consistent {
            Some(found) => return Ok((found.clone(), Vec::new())),
            None => (usual, Vec::new()),
        },
    };
    let deviations: Vec<Option<f64>> = model.parameters().iter().map(|parameter| parameter.std).collect();
    let project = |beta: &[f64]| {
        nearest(model.structure(), beta, Uncertainty::Deviations(&deviations), &prior).map_err(Failure::job)
    };
    if let Some(found) = &file.consistent {
        // Keeps the file's base parameters if they are consistent: only unidentifiable parameters come from the prior.
        let again = project(&found.beta)?;
        if again.exact {
            return Ok((Nearest { links: again.links, rotors: again.rotors, ..found.clone() }, notes));
        }
    }
    let found = project(&model.beta())?;
    if !found.exact && found.weights == Weights::Relative {
        notes.push(format!("{name} has no standard deviations: distances are measured {}", found.weights.text()));
    }
    Ok((found, notes))
}

/// The bodies of a URDF as a prior; links without inertial keep the geometric prior.
fn prior_of(path: &Path, robot: &Robot, usual: Prior) -> Result<(Prior, Vec<String>), Failure> {
    let (file, text) = read(path)?;
    let document = parse(&file, &text)?;
    let tree = tree::Tree::of(&file, &document, robot)?;
    let mut prior = usual;
    let mut notes = Vec::new();
    for (i, body) in tree::bodies(&file, &document, &tree)?.into_iter().enumerate() {
        let link = &tree.segments[i].link;
        let Some(body) = body else {
            notes.push(format!("link `{link}` of {file} has no mass: a uniform rod is used instead"));
            continue;
        };
        let parameters = body.link_parameters();
        if !is_consistent(&parameters) {
            let found = format!("mass {} kg, inertia {:?}", body.mass, body.inertia.as_slice());
            let expected = "a body: positive mass and moments, none larger than the sum of the other two";
            return Err(BadInput::new(file, format!("link `{link}`, <inertial>"), found, expected).into());
        }
        prior.links[i] = parameters;
    }
    Ok((prior, notes))
}

fn spliced(arm: &Arm, path: &Path, robot: &Robot) -> Result<Exported, Failure> {
    let (file, text) = read(path)?;
    let document = parse(&file, &text)?;
    let tree = tree::Tree::of(&file, &document, robot)?;
    Ok(splice::write(arm, &text, &document, &tree))
}
