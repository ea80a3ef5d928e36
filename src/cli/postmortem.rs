//! `plumbline postmortem`: what happened before a fault, from its recording.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::postmortem::replay::{Parts, Replayed, replay};
use crate::postmortem::story::Story;
use crate::postmortem::{page, text};
use crate::recording::about::Handed;
use crate::recording::{Recording, model_name};
use crate::store::{ModelFile, model_identity};
use clap::Args;
use nalgebra::Vector3;
use plumbline_core::{BadInput, FeedForward};
use plumbline_model::{NoModel, Reach, Robot, ServedModel};
use std::path::PathBuf;

/// Options of `plumbline postmortem`.
#[derive(Args)]
pub struct Options {
    /// The recording, as the daemon wrote it
    file: PathBuf,
    /// Page with the plots instead of the one beside the recording
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
    /// Print the facts as JSON instead
    #[arg(long)]
    json: bool,
    /// Run the recording through the loop again, and compare every command
    #[arg(long)]
    replay: bool,
}

/// Reads, tells, draws.
pub fn run(options: Options) -> Result<(), Failure> {
    let recording = Recording::read(&options.file)?;
    let file = options.file.display().to_string();
    let replayed = if options.replay { Some(again(&file, &recording)?) } else { None };
    let identical = replayed.as_ref().is_none_or(Replayed::is_identical);
    let story = Story::of(&file, &recording, replayed);
    if options.json {
        say!("{}", serde_json::to_string_pretty(&story).map_err(Failure::job)?);
    } else {
        say!("{}", text(&story).trim_end());
    }
    let path = options.out.unwrap_or_else(|| options.file.with_extension("html"));
    crate::atomic::write_result(&path, page(&story, &recording).map_err(Failure::job)?.as_bytes())?;
    if !options.json {
        say!("page: {}", path.display());
    }
    if identical { Ok(()) } else { Err(Failure::job("the replay gave other commands than the recording")) }
}

/// The recording through the loop again.
fn again(file: &str, recording: &Recording) -> Result<Replayed, Failure> {
    let place = |name: &str| format!("{file}, attachment `{name}`");
    let needed = |name: &str| {
        let expected = format!("the attachment `{name}`, for a replay");
        recording.text(name).ok_or_else(|| BadInput::new(file, "attachments", "none of that name", expected))
    };
    let robot = Robot::parse(&place("robot.toml"), needed("robot.toml")?)?;
    if robot.chain.len() != recording.about.joints {
        let expected = format!("{}, as in `about.json`", recording.about.joints);
        return Err(BadInput::new(place("robot.toml"), "joint", robot.chain.len(), expected).into());
    }
    let mut model = |handed: &Handed| -> Result<Box<dyn FeedForward>, String> {
        // Served in the place of a model that was withdrawn.
        if handed.id == 0 {
            return Ok(Box::new(NoModel));
        }
        let name = model_name(handed.id);
        let text = recording.text(&name).ok_or_else(|| format!("there is no attachment `{name}`"))?;
        if model_identity(text) != handed.id {
            return Err(format!("the attachment `{name}` is another model"));
        }
        let chain = |_: &str| Ok(robot.chain.clone());
        let file = ModelFile::parse(&place(&name), text, chain).map_err(|bad| bad.to_string())?;
        let [gravity, vendor] = [handed.gravity, handed.vendor.unwrap_or(handed.gravity)].map(Vector3::from);
        Ok(Box::new(ServedModel::new(handed.id, &file.model, &gravity, &vendor)))
    };
    let kinematics = Box::new(Reach(robot.chain.clone()));
    replay(recording, Parts { kinematics: Some(kinematics), model: &mut model }).map_err(|error| {
        BadInput::new(file, "replay", error, "a recording that holds all that the loop was given").into()
    })
}
