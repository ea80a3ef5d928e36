//! `plumbline effects`: prints the effects of the diagnosis.

use crate::failure::Failure;
use clap::Args;
use plumbline_core::BadInput;
use plumbline_model::term::effect::{FAMILIES, Family, Form, InC, Place, Setting, Stratum, family};
use std::io::Write;

/// Options of `plumbline effects`.
#[derive(Args)]
pub struct Options {
    /// Only this one, such as presliding
    id: Option<String>,
}

/// Line width in characters.
const WIDTH: usize = 100;
/// Column of the text after a label.
const LABEL: usize = 14;

pub fn run(options: Options) -> Result<(), Failure> {
    let text = match &options.id {
        None => FAMILIES.iter().map(|family| block(family)).collect::<Vec<_>>().join("\n"),
        Some(id) => block(family(id).ok_or_else(|| {
            let known = FAMILIES.iter().map(|family| family.id).collect::<Vec<_>>().join(", ");
            BadInput::new("command line", "effect", format!("`{id}`"), format!("one of {known}"))
        })?),
    };
    // A closed pipe (`| head`) is not a failure.
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::job(error)),
        _ => Ok(()),
    }
}

fn block(family: &Family) -> String {
    let mut text = format!("{}\n", family.id);
    wrap(&mut text, 2, 2, family.physics);
    for form in family.forms {
        labelled(&mut text, &equation_label(form), form.equation);
        for setting in form.settings {
            wrap(&mut text, LABEL + 2, LABEL + 4, &setting_text(setting));
        }
    }
    labelled(&mut text, "sits", place(family.place));
    labelled(&mut text, "shows", stratum(family.stratum));
    labelled(
        &mut text,
        "served",
        match family.is_served() {
            true => "yes, as part of a model",
            false => "no: it explains a recording and does not come again",
        },
    );
    let mut exported: Vec<String> = family.forms.iter().map(|form| in_c(form.in_c)).collect();
    exported.dedup();
    labelled(&mut text, "export to C", &exported.join("; "));
    labelled(&mut text, "size", family.typical);
    for alike in family.confounded {
        labelled(&mut text, "looks like", &format!("{}; to decide: {}", alike.with, alike.decided_by));
    }
    labelled(&mut text, "described", family.reference);
    text
}

fn equation_label(form: &Form) -> String {
    if form.name.is_empty() { "torque".into() } else { form.name.into() }
}

fn in_c(of: InC) -> String {
    match of {
        InC::Columns(_) | InC::BothRows { .. } | InC::Entries => "yes".into(),
        InC::LastLink => "yes, as part of the last link".into(),
        InC::Part { note, .. } => note.into(),
        InC::Refused(reason) => format!("no: {reason}"),
    }
}

fn setting_text(setting: &Setting) -> String {
    let unit = if setting.unit == "1" { String::new() } else { format!(" {}", setting.unit) };
    format!("{}: {}, {} to {}{unit}", setting.name, setting.what, setting.low, setting.high)
}

fn place(place: Place) -> &'static str {
    match place {
        Place::Arm => "in the arm as a whole",
        Place::Joint => "in one joint",
        Place::Pair => "in one joint (row j), and comes from another (k)",
        Place::Function => "in one joint (row j), and follows the motion of one or two (k, l)",
    }
}

fn stratum(stratum: Stratum) -> &'static str {
    match stratum {
        Stratum::Repeatable => "in what every period of a motion repeats",
        Stratum::Changing => "in what differs from period to period",
        Stratum::Reference => {
            "against a model from before, or between sessions: within one session the base parameters absorb it"
        }
        Stratum::Remainder => {
            "in what all other effects leave; it is fitted last and never searched for in their place"
        }
    }
}

fn labelled(text: &mut String, label: &str, what: &str) {
    wrap(text, 2, LABEL, &format!("{label:<0$} {what}", LABEL - 3));
}

/// Adds `what` in lines of at most [`WIDTH`] columns, the first behind `first` spaces, the others behind `others`. Spaces inside
/// of a line stay as they are.
fn wrap(text: &mut String, first: usize, others: usize, what: &str) {
    let mut line = " ".repeat(first);
    let mut empty = true;
    for word in what.split_inclusive(' ') {
        if !empty && line.len() + word.trim_end().len() > WIDTH {
            text.push_str(line.trim_end());
            text.push('\n');
            line = " ".repeat(others);
        }
        line.push_str(word);
        empty = false;
    }
    text.push_str(line.trim_end());
    text.push('\n');
}
