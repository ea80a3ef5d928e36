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

fn table_1() -> String {
    let mut text = String::from("| Nr. | symbol | GBS | VBS |\n|---|---|---|---|\n");
    for (index, row) in experiment::table_1().iter().enumerate() {
        let vertical = match &row.vertical {
            None => "-",
            Some(vertical) if *vertical == row.generalized => "the same",
            Some(vertical) => vertical,
        };
        text.push_str(&format!("| {} | {} | {} | {vertical} |\n", index + 1, row.symbol, row.generalized));
    }
    text
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
