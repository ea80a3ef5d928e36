//! `plumbline export`: the identified arm as URDF, MJCF or C.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::report::Consistency;
use crate::store::ModelFile;
use crate::store::export::load::{self, Maker};
use crate::store::export::{Arm, Exported, c, effects, mjcf, splice, tree, urdf};
use clap::{Args, ValueEnum};
use plumbline_core::BadInput;
use plumbline_identify::consistency::{Nearest, Prior, Uncertainty, Weights, nearest};
use plumbline_model::{Mounting, Robot, TorqueModel, is_consistent};
use plumbline_model_file::models;
use roxmltree::Document;
use std::path::{Path, PathBuf};

/// Options of `plumbline export`.
#[derive(Args)]
pub struct Options {
    /// Model file
    model: PathBuf,
    /// Format: URDF, MuJoCo model, or a C function that depends on math.h only; or the body on the last link that `compare`, a diagnosis or `payload` found,
    /// as a maker takes it: end effector of Franka Desk (JSON), libfranka's setLoad, UR's set_target_payload, KUKA's load data
    #[arg(long, value_enum)]
    format: Format,
    /// File to write
    #[arg(long, value_name = "FILE")]
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

impl Format {
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

/// Exports a model; projects it to physically consistent bodies if the file has none.
pub fn run(options: Options) -> Result<(), Failure> {
    let name = options.model.display().to_string();
    let (file, robot) = models::load(&options.model)?;
    let model = &file.model;
    check(&options)?;
    if let Some(maker) = options.format.maker() {
        return export_load(&options, model, maker);
    }
    if let Err(refused) = model.valid_in(&Mounting::WALL)
        && !options.vertical
    {
        let expected = "a model that holds in every mounting, or --vertical";
        return Err(BadInput::new(name, "key `kind`", refused, expected).into());
    }

    let exported = if options.format == Format::C {
        c::write(model)
    } else {
        let (bodies, notes) = bodies(&file, &robot, &name, options.prior.as_deref())?;
        say!("{}", Consistency::of_model(model, &bodies).sentence());
        notes.iter().for_each(|note| say!("note: {note}"));
        let bodies = effects::with_payload(model, &bodies).map_err(|link| {
            let expected = "a payload that makes a body of the last link: positive mass and moments";
            BadInput::new(&name, "term `payload`", format!("a last link with {link:?}"), expected)
        })?;
        let arm = Arm { model, bodies: &bodies, limits: &robot.limits };
        match (options.format, &options.into) {
            (Format::Mjcf, _) => {
                let mounting = model.mountings().first().copied().unwrap_or(Mounting::UPRIGHT);
                mjcf::write(&arm, &mounting.gravity())
            }
            (_, Some(path)) => spliced(&arm, path, &robot)?,
            _ => urdf::write(&arm),
        }
    };
    crate::atomic::write_result(&options.out, exported.text.as_bytes())?;
    for note in &exported.notes {
        say!("note: {note}");
    }
    if options.format == Format::C {
        say!("{}: void {}(q, dq, ddq, gravity, tau)", options.out.display(), c::function_name(model.robot()));
    } else {
        say!("{}", options.out.display());
    }
    Ok(())
}

/// The body on the last link, which is valid in every mounting.
fn export_load(options: &Options, model: &TorqueModel, maker: Maker) -> Result<(), Failure> {
    let Some(found) = load::seen_from_flange(model.structure().chain(), &model.on_last_link()) else {
        let expected =
            "a model with a `payload` of positive mass, as `plumbline compare` and `plumbline payload` write it";
        let found = format!("a body of {} kg", model.on_last_link()[9]);
        return Err(BadInput::new(options.model.display().to_string(), "term `payload`", found, expected).into());
    };
    let (body, note) = load::possible(found);
    let exported = load::write(maker, &body);
    crate::atomic::write_result(&options.out, exported.text.as_bytes())?;
    note.iter().chain(&exported.notes).for_each(|note| say!("note: {note}"));
    say!(
        "{}: {:.4} kg at [{:.4}, {:.4}, {:.4}] m in the flange frame",
        options.out.display(),
        body.mass,
        body.com.x,
        body.com.y,
        body.com.z
    );
    Ok(())
}

fn check(options: &Options) -> Result<(), BadInput> {
    let refuse = |option: &str, format: &str, expected: &str| {
        Err(BadInput::new("command line", option, format!("--format {format}"), expected))
    };
    match (options.format, &options.into, &options.prior) {
        (Format::C, Some(_), _) => refuse("--into", "c", "--format urdf"),
        (Format::Mjcf, Some(_), _) => refuse("--into", "mjcf", "--format urdf"),
        (format, Some(_), _) if format.maker().is_some() => refuse("--into", "of a load", "--format urdf"),
        (format, _, Some(_)) if format.maker().is_some() => refuse("--prior", "of a load", "--format urdf or mjcf"),
        (Format::C, _, Some(_)) => refuse(
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
    let tree = tree::Tree::of(&file, &document, &robot.chain)?;
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
    let tree = tree::Tree::of(&file, &document, &robot.chain)?;
    Ok(splice::write(arm, &text, &document, &tree))
}

fn read(path: &Path) -> Result<(String, String), BadInput> {
    let file = path.display().to_string();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok((file, text)),
        Err(error) => Err(BadInput::new(file, "file", error, "a readable URDF")),
    }
}

fn parse<'d>(file: &str, text: &'d str) -> Result<Document<'d>, BadInput> {
    Document::parse(text).map_err(|error| {
        let at = error.pos();
        BadInput::new(file, format!("line {}, column {}", at.row, at.col), error, "XML")
    })
}
