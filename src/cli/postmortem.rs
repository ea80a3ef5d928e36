//! `plumbline postmortem`: analysis of the recording of a fault.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::postmortem::facts::Facts;
use crate::postmortem::replay::{ReplayInputs, ReplayResult, replay};
use crate::postmortem::{page, text};
use crate::recording::about::RecordedModel;
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
    /// Recording of the daemon
    file: PathBuf,
    /// HTML page to write instead of the one beside the recording
    #[arg(long, value_name = "HTML")]
    out: Option<PathBuf>,
    /// Print the facts as JSON instead
    #[arg(long)]
    json: bool,
    /// Replay the recording through the loop and compare every command
    #[arg(long)]
    replay: bool,
}

/// Reads a recording, prints its facts and writes the page.
pub fn run(options: Options) -> Result<(), Failure> {
    let recording = Recording::read(&options.file)?;
    let file = options.file.display().to_string();
    let replayed = if options.replay { Some(replayed_recording(&file, &recording)?) } else { None };
    let identical = replayed.as_ref().is_none_or(ReplayResult::is_identical);
    let facts = Facts::of(&file, &recording, replayed);
    if options.json {
        say!("{}", serde_json::to_string_pretty(&facts).map_err(Failure::job)?);
    } else {
        say!("{}", text(&facts).trim_end());
    }
    let path = options.out.unwrap_or_else(|| options.file.with_extension("html"));
    crate::atomic::write_result(&path, page(&facts, &recording).map_err(Failure::job)?.as_bytes())?;
    if !options.json {
        say!("page: {}", path.display());
    }
    if identical { Ok(()) } else { Err(Failure::job("the commands of the replay differ from the recording")) }
}

fn replayed_recording(file: &str, recording: &Recording) -> Result<ReplayResult, Failure> {
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
    let mut model = |handed: &RecordedModel| -> Result<Box<dyn FeedForward>, String> {
        // Identity 0 is the withdrawal of a model.
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
    replay(recording, ReplayInputs { kinematics: Some(kinematics), model: &mut model })
        .map_err(|error| BadInput::new(file, "replay", error, "a recording with all inputs of the loop").into())
}
