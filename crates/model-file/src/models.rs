//! Model files and the robots that they are of. A file names its robot; one that was identified with a description of the user's own holds
//! that description.

use crate::ModelFile;
use plumbline_core::BadInput;
use plumbline_model::Robot;
use std::path::Path;

/// A model file with its robot: the description that the file holds, else the shipped robot of that name.
/// Errors: as [`ModelFile::parse`]; a robot that is neither in the file nor shipped.
pub fn load(path: &Path) -> Result<(ModelFile, Robot), BadInput> {
    let file = path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|error| BadInput::new(&file, "file", error, "a readable model file"))?;
    parse(&file, &text, path.parent())
}

/// As [`load`], from a text; `file` is the name in errors, and a robot of one's own is looked up in `folder`.
pub fn parse(file: &str, text: &str, folder: Option<&Path>) -> Result<(ModelFile, Robot), BadInput> {
    let mut found = None;
    let model = ModelFile::parse_described(file, text, |name, description| {
        let robot = described(file, name, description, folder)?;
        Ok(found.insert(robot).chain.clone())
    })?;
    // The closure was called: there is no model without an arm.
    let robot = found.ok_or_else(|| BadInput::new(file, "key `robot`", "no robot", "a robot"))?;
    Ok((model, robot))
}

/// The model in a file's text, which must be of `robot`; `whose` describes it in errors: `which this daemon drives`.
/// Errors: as [`ModelFile::parse`]; a model of a robot of another name, or of other kinematics under the same name.
pub fn of_robot(file: &str, text: &str, robot: &Robot, whose: &str) -> Result<ModelFile, BadInput> {
    ModelFile::parse_described(file, text, |name, description| {
        let expected = format!("`{}`, {whose}", robot.name);
        if name != robot.name {
            return Err(BadInput::new(file, "key `robot`", format!("`{name}`"), expected));
        }
        // A model without a description is of a shipped robot, or from before files held descriptions.
        let known = match description {
            None => Robot::names().any(|shipped| shipped == name).then(|| Robot::load(name, None)).transpose()?,
            Some(_) => Some(described(file, name, description, None)?),
        };
        if known.is_some_and(|known| known.chain != robot.chain) {
            let found = format!("another `{name}`: its joints or its flange lie elsewhere");
            return Err(BadInput::new(file, "key `robot`", found, expected));
        }
        Ok(robot.chain.clone())
    })
}

fn described(file: &str, name: &str, description: Option<&str>, folder: Option<&Path>) -> Result<Robot, BadInput> {
    let Some(text) = description else {
        return Robot::load(name, folder).map_err(|bad| {
            let expected = format!(
                "{}; a model of a robot of one's own holds its description if it was identified with this version",
                bad.expected
            );
            BadInput::new(file, "key `robot`", format!("`{name}`"), expected)
        });
    };
    let place = "key `provenance.robot-description`";
    let robot = Robot::parse(&format!("{file}, {place}"), text)?;
    if robot.name != name {
        return Err(BadInput::new(
            file,
            place,
            format!("robot `{}`", robot.name),
            format!("robot `{name}`, as in key `robot`"),
        ));
    }
    Ok(robot)
}
