//! The text of `model.toml`: one line per parameter.

use super::file::{FORMAT, ModelFile, Validated, sealed};
use super::quoted;
use plumbline_model::term::effect::Spec;
use std::fmt::Write;

impl ModelFile {
    /// The file's text; [`ModelFile::parse`] restores the model bitwise.
    pub fn to_toml(&self) -> String {
        write(self)
    }
}

/// Numbers are the shortest text that parses to the same `f64`.
fn write(file: &ModelFile) -> String {
    let model = &file.model;
    let mut text = String::new();
    let mut line = |args: std::fmt::Arguments| {
        // Writing to a String can't fail.
        let _ = text.write_fmt(args);
        text.push('\n');
    };
    line(format_args!("# Parameters of the joint torques, tau = Y beta. Angles in rad, torques in Nm."));
    line(format_args!("format = {FORMAT}"));
    line(format_args!("robot = {}", quoted(model.robot())));
    line(format_args!("kind = \"{}\"", model.kind()));
    if !file.noise_floor.is_empty() {
        line(format_args!("noise-floor = {:?}", file.noise_floor));
    }
    for mounting in model.mountings() {
        line(format_args!("\n[[mounting]] # {mounting}"));
        line(format_args!("rho = {:?}\nphi = {:?}", mounting.rho, mounting.phi));
    }
    for (term, parameters) in model.terms() {
        line(format_args!("\n[[term]]\nid = {}", quoted(term.id())));
        if let Some(spec) = term.spec() {
            effect(&mut line, &spec);
        }
        line(format_args!("parameters = ["));
        for parameter in parameters {
            let column = &parameter.column;
            let std = parameter.std.map_or(String::new(), |std| format!(", std = {std:?}"));
            // A zero without a standard deviation was restricted, not estimated.
            let zero = parameter.value == 0.0 && parameter.std.is_none();
            let note = if zero { " # restricted to zero: not significant" } else { "" };
            line(format_args!(
                "  {{ name = {}, value = {:?}{std}, unit = {}, symbol = {}, expression = {} }},{note}",
                quoted(&column.name),
                parameter.value,
                quoted(column.unit),
                quoted(&column.symbol),
                quoted(&column.expression),
            ));
        }
        line(format_args!("]"));
    }
    for Validated { run, rho, phi, rms } in &file.validation {
        line(format_args!("\n[[validation]]\nrun = {}\nrho = {rho:?}\nphi = {phi:?}\nrms = {rms:?}", quoted(run)));
    }
    if let Some(found) = &file.uncertainty {
        super::uncertainty::write(&mut line, model, found);
    }
    if let Some(found) = &file.consistent {
        super::consistent::write(&mut line, model, found);
    }
    line(format_args!("\n[provenance]"));
    let origin = &file.provenance;
    let keys = ["dataset", "plumbline", "date", "source", "robot-description"];
    let values = [&origin.dataset, &origin.plumbline, &origin.date, &origin.source, &origin.robot_description];
    for (key, value) in keys.into_iter().zip(values) {
        if let Some(value) = value {
            line(format_args!("{key} = {}", quoted(value)));
        }
    }
    sealed(&text)
}

/// Settings that identify an effect among others of its kind.
fn effect(line: &mut dyn FnMut(std::fmt::Arguments), spec: &Spec) {
    if !spec.form.is_empty() {
        line(format_args!("form = {}", quoted(spec.form)));
    }
    for (key, joint) in ["joint", "cause", "other"].into_iter().zip(spec.site.joints()) {
        line(format_args!("{key} = {}", joint + 1));
    }
    let form = spec.form();
    let names = form.map_or(&[][..], |form| form.settings);
    let settings = names.iter().zip(&spec.settings).map(|(one, value)| format!("{} = {value:?}", one.name));
    let settings: Vec<String> = settings.collect();
    if !settings.is_empty() {
        line(format_args!("settings = {{ {} }}", settings.join(", ")));
    }
}
