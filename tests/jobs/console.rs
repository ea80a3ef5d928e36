//! What a person sees who starts a job: a table that fits a terminal, the same numbers from the same seed, and results that are not lost.

use plumbline_testkit::job::*;
use serde_json::Value;
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;

/// Two motions to identify from: the model of the first is waited for, the second is driven beside its identification.
const JOB: [&str; 3] = ["excitation.trajectories=2", "output.dataset=true", "validation.mountings=[\"wall\"]"];

/// `plumbline run` as people start it; the testkit's prints all words.
fn run(place: &Place, job: &str, more: &[&str]) -> Done {
    let mut command = plumbline();
    command.args(["run", job, "--out"]).arg(place.out()).args(more);
    for set in PLAIN.iter().chain(&SHORT).chain(&JOB) {
        command.args(["--set", set]);
    }
    Done::of(command.args(["--set", &format!("serve.id={}", place.id)]))
}

fn model(place: &Place) -> String {
    std::fs::read_to_string(place.out().join("model.toml")).unwrap()
}

#[test]
fn a_seeded_job_has_a_table_and_gives_the_same_numbers_twice() {
    let place = Place::new("console");
    let first = run(&place, WALL, &[]).expect_code(0);
    let lines: Vec<&str> = first.out.lines().collect();
    assert!(lines.len() <= 15 && lines.iter().all(|line| line.chars().count() <= 80), "{}", first.output());
    assert_eq!(lines[0], "panda, wall: 59 base parameters (GBS)", "{}", first.output());
    assert!(lines[1].ends_with("1     2     3     4     5     6     7    mean"), "{}", first.output());
    for row in ["noise floor ", "fit ", "wall, 1 unseen run "] {
        let row = lines.iter().find(|line| line.starts_with(row)).unwrap_or_else(|| panic!("{}", first.output()));
        let numbers = row.split_whitespace().rev().map_while(|word| word.parse::<f64>().ok());
        assert_eq!(numbers.filter(|number| (0.01..2.0).contains(number)).count(), 8, "{row}");
    }
    assert_eq!(lines.last().unwrap(), &format!("report: {}", place.out().join("report.html").display()));
    // One line per motion, and nothing that looks like trouble.
    let motions: Vec<&str> = first.err.lines().collect();
    assert_eq!(motions.len(), 3, "{}", first.output());
    assert!(motions[2].ends_with("motion  3 of 3: validate-wall-1, 4 s"), "{}", first.output());

    // Once more in the same place: the same job may replace its results, and its seed gives the same samples.
    let (before, report) = (model(&place), place.report());
    let json = run(&place, WALL, &["--json"]).expect_code(0);
    let again: Value = serde_json::from_str(&json.out).unwrap();
    assert_eq!(model(&place), before);
    assert_eq!(serde_json::to_value(&report.validate[0].rms_raw).unwrap(), again["validate"][0]["rms_raw"]);
    assert!(again["provenance"]["command"].as_str().unwrap().starts_with("plumbline run "), "{again}");
    assert!(again["provenance"]["source"].as_str().unwrap().ends_with(WALL), "{again}");

    // Another job may not.
    let other = place.path().join("other.toml");
    let shipped = std::fs::read_to_string(plumbline_testkit::path(WALL)).unwrap();
    std::fs::write(&other, shipped).unwrap();
    let refused = run(&place, other.to_str().unwrap(), &[]).expect_code(2);
    let words = ["report.json", "provenance.source", WALL, "other.toml", "--force"];
    assert!(words.iter().all(|word| refused.err.contains(word)), "{}", refused.output());
    assert_eq!(model(&place), before);

    // Nor may an identification of other data; it may with --force, and says nothing when asked to.
    let identify = |more: &[&str]| {
        Done::of(plumbline().arg("identify").arg(place.out().join("dataset")).arg("--out").arg(place.out()).args(more))
    };
    assert!(identify(&[]).expect_code(2).err.contains("--force"));
    let forced = identify(&["--force", "--quiet"]).expect_code(0);
    assert!(forced.out.is_empty() && forced.err.is_empty(), "{}", forced.output());
    assert_ne!(model(&place), before);

    // `--open` gives the page to the desktop's opener, here one that writes down what it got.
    let (opener, opened) = (place.path().join("xdg-open"), place.path().join("opened"));
    let open = |code: i32| {
        std::fs::write(&opener, format!("#!/bin/sh\nprintf %s \"$1\" >{}\nexit {code}\n", opened.display())).unwrap();
        std::fs::set_permissions(&opener, Permissions::from_mode(0o755)).unwrap();
        let mut command = plumbline();
        command.arg("identify").arg(place.out().join("dataset")).arg("--out").arg(place.out()).args(["-q", "--open"]);
        Done::of(command.env("PATH", format!("{}:/usr/bin:/bin", place.path().display())))
    };
    open(0).expect_code(0);
    let page = place.out().join("report.html").display().to_string();
    assert_eq!(std::fs::read_to_string(&opened).unwrap(), page);
    let failed = open(3).expect_code(1);
    assert!(failed.err.contains(&page) && failed.err.contains("xdg-open"), "{}", failed.output());
}
