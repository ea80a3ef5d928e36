//! The tables of docs/results/paper.md as text.

use super::experiment::{self, Panda};
use plumbline_identify::Settings;

/// Name and content of every block of the page.
pub fn all() -> Vec<(&'static str, String)> {
    let panda = experiment::panda(&Settings::paper());
    vec![
        ("table-1", table_1()),
        ("table-2", table_2()),
        ("table-3", table_3(&panda)),
        ("table-4", errors(&panda.table_4)),
        ("table-5", errors(&panda.table_5)),
    ]
}

/// Table I: one row per rigid-body parameter, one row per kind of friction.
fn table_1() -> String {
    let mut text = String::from("| Nr. | symbol | GBS | VBS |\n|---|---|---|---|\n");
    let rows = experiment::table_1();
    for (index, row) in rows.iter().enumerate().filter(|(_, row)| !is_friction(row)) {
        let vertical = match &row.vertical {
            None => "-",
            Some(vertical) if *vertical == row.generalized => "=",
            Some(vertical) => vertical,
        };
        text.push_str(&format!("| {} | {} | {} | {vertical} |\n", index + 1, row.symbol, row.generalized));
    }
    for kind in ["fv", "fc"] {
        let own: Vec<usize> =
            (0..rows.len()).filter(|&k| is_friction(&rows[k]) && rows[k].symbol.starts_with(kind)).collect();
        if let (Some(first), Some(last)) = (own.first(), own.last()) {
            let symbols = format!("{}..{}", rows[*first].symbol, rows[*last].symbol);
            text.push_str(&format!("| {}-{} | {symbols} | {symbols} | = |\n", first + 1, last + 1));
        }
    }
    text
}

/// Whether a parameter is a friction parameter: not regrouped, the same in both sets.
fn is_friction(row: &experiment::Regrouping) -> bool {
    row.symbol == row.generalized && row.vertical.as_ref() == Some(&row.generalized) && row.symbol.starts_with('f')
}

fn table_2() -> String {
    let two = experiment::two_dof();
    let mut text = String::from("| base parameter | regrouping | H-BAM model | V-BAM model |\n|---|---|---|---|\n");
    for (name, symbol, expression, value) in &two.horizontal {
        let vertical = two.vertical.iter().find(|(other, _)| other == name);
        let vertical = vertical.map_or("-".to_string(), |(_, value)| format!("{value:.3}"));
        text.push_str(&format!("| {symbol} | {expression} | {value:.3} | {vertical} |\n"));
    }
    text.push_str("\n| robot | model | RMS joint 1 \\[Nm\\] | RMS joint 2 \\[Nm\\] |\n|---|---|---|---|\n");
    for figure in &two.figures {
        for (model, rms) in ["H-BAM", "V-BAM"].iter().zip(&figure.rms) {
            text.push_str(&format!("| {} | {model} | {:.1} | {:.1} |\n", figure.mounting, rms[0], rms[1]));
        }
    }
    let (misses, count) = (&two.misses, two.misses.len());
    text.push_str(&format!(
        "\nAlong {count} random trajectories the V-BAM model misses joint 1 of the H-BAM robot by {:.1} to {:.1} Nm RMS, median {:.1} Nm.\n",
        misses[0],
        misses[count - 1],
        misses[count / 2]
    ));
    text
}

fn table_3(panda: &Panda) -> String {
    let mut text =
        String::from("| parameter | Table III | found | standard deviation | error in standard deviations |\n");
    text.push_str("|---|---|---|---|---|\n");
    let rows = panda.found.columns.iter().zip(&panda.truth).zip(panda.found.beta.iter().zip(&panda.found.std));
    for ((column, truth), (beta, std)) in rows {
        let std = std.unwrap_or(f64::NAN);
        let error = (beta - truth) / std;
        text.push_str(&format!("| {} | {truth:.4} | {beta:.4} | {std:.4} | {error:.1} |\n", column.symbol));
    }
    text
}

/// A table like IV and V: joints down, trajectories across, and the mean.
fn errors(trajectories: &[Vec<f64>]) -> String {
    let mut text = String::from("| joint | traj1 | traj2 | traj3 | traj4 | traj5 |\n|---|---|---|---|---|---|\n");
    let joints = trajectories[0].len();
    for j in 0..joints {
        let cells: Vec<String> = trajectories.iter().map(|rms| format!("{:.2}", rms[j])).collect();
        text.push_str(&format!("| {} | {} |\n", j + 1, cells.join(" | ")));
    }
    let means = trajectories.iter().map(|rms| format!("{:.2}", rms.iter().sum::<f64>() / joints as f64));
    text.push_str(&format!("| mean | {} |\n", means.collect::<Vec<_>>().join(" | ")));
    text
}
