//! The pages of docs/reference are current: what they show is compared with the program's output and with the types that read and write it.
//!
//! `PLUMBLINE_WRITE_DOCS=1 cargo test --test jobs reference_pages` writes the blocks of output anew. The other pages are written by hand.

use plumbline::config::job::Job;
use plumbline_ipc::{FeedForwardMessage, GuestMessage, ModelHeader, SampleMessage};
use plumbline_model::Robot;
use plumbline_model::term::effect::{self, FAMILIES, Stratum};
use plumbline_sim::Truth;
use plumbline_testkit::job::{Done, plumbline};
use plumbline_testkit::page;
use std::mem::{offset_of, size_of};
use std::path::Path;

const COMMAND_LINE: &str = "docs/reference/command-line.md";
const EFFECTS: &str = "docs/reference/effects.md";
const MESSAGES: &str = "docs/reference/messages-and-export.md";

/// What the program prints, without blanks at the ends of lines.
fn printed(arguments: &str) -> String {
    let out = Done::of(plumbline().args(arguments.split(' '))).expect_code(0).out;
    out.trim_matches('\n').lines().map(|line| line.trim_end().to_string()).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_command_line_page_matches_help() {
    let text = page::read(COMMAND_LINE);
    let shown: Vec<&str> =
        text.lines().filter_map(|line| line.strip_prefix("<!-- output: plumbline ")?.strip_suffix(" -->")).collect();
    let help = printed("--help");
    let subcommands = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    for name in subcommands.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help") {
        assert!(shown.contains(&format!("{name} --help").as_str()), "{COMMAND_LINE} lacks `plumbline {name} --help`");
    }
    for arguments in shown {
        let block = format!("output: plumbline {arguments}");
        check(COMMAND_LINE, &block, &format!("```text\n{}\n```\n", printed(arguments)));
    }
}

/// Asserts that a block of a page has this content, or writes it.
fn check(name: &str, block: &str, content: &str) {
    if std::env::var_os("PLUMBLINE_WRITE_DOCS").is_some() {
        page::write_block(name, block, content);
    } else {
        assert_eq!(page::block(&page::read(name), block), Some(content), "{name}, block `{block}`");
    }
}

#[test]
fn the_table_of_effects_is_the_catalogue() {
    let mut table =
        "| effect | what | in | found in | served | typical size |\n|---|---|---|---|---|---|\n".to_string();
    for family in FAMILIES {
        let place = match family.place {
            effect::Place::Arm => "arm",
            effect::Place::Joint => "joint",
            effect::Place::Pair => "two joints",
            effect::Place::Function => "up to three joints",
        };
        let stratum = match family.stratum {
            Stratum::Repeatable => "mean period",
            Stratum::Changing => "period to period",
            Stratum::Reference => "earlier model",
            Stratum::Remainder => "what the others leave",
        };
        let served = if family.is_served() { "yes" } else { "no" };
        let (id, physics, typical) = (family.id, family.physics.trim_end_matches('.'), family.typical);
        table.push_str(&format!("| `{id}` | {physics} | {place} | {stratum} | {served} | {typical} |\n"));
    }
    check(EFFECTS, "effects", &table);
}

/// Bytes of the field that `field` borrows.
fn bytes<T, F>(_: impl Fn(&T) -> &F) -> usize {
    size_of::<F>()
}

/// Name, offset and size of fields.
macro_rules! layout {
    ($message:ident: $($field:ident),+) => {
        vec![$((stringify!($field), offset_of!($message, $field), bytes(|message: &$message| &message.$field))),+]
    };
}

#[test]
fn message_layouts_match_their_tables() {
    let text = page::read(MESSAGES);
    let feed_forward = layout!(FeedForwardMessage: sequence, stamp_ns, epoch, model, n, phase, q_d, dq_d, tau_ff, gravity, tau_vendor,
        gravity_vendor, validity, clock);
    let sample = layout!(SampleMessage: epoch, seq, cycle, state_seq, time, q, dq, tau, q_d, command_seq, desired_q, desired_dq,
        desired_ddq, tau_ff, phase, motion, tick, model, stamp_ns, wake_ns, work_ns, tau_vendor, validity, reserved);
    let model = layout!(ModelHeader: layout, validity, epoch, sequence, stamp_ns, model, gravity, gravity_vendor);
    let guest = layout!(GuestMessage: layout, n, epoch, seq, stamp_ns, q, dq, tau, q_d);
    let messages = [
        ("### ModelHeader", size_of::<ModelHeader>(), model),
        ("### GuestMessage", size_of::<GuestMessage>(), guest),
        ("### FeedForwardMessage", size_of::<FeedForwardMessage>(), feed_forward),
        ("### SampleMessage", size_of::<SampleMessage>(), sample),
    ];
    for (heading, size, fields) in messages {
        // No field is missing here: together they fill the message.
        assert_eq!(fields.iter().map(|(_, _, bytes)| bytes).sum::<usize>(), size, "{heading}");
        let section = text.split(&format!("{heading}\n")).nth(1).unwrap().split("\n#").next().unwrap();
        assert!(section.contains(&format!("{size} bytes.")), "{heading}: {size} bytes");
        let rows = section.lines().filter(|line| line.starts_with("| `"));
        let shown: Vec<String> =
            rows.map(|row| row.split('|').skip(1).take(3).map(str::trim).collect::<Vec<_>>().join(" ")).collect();
        let real: Vec<String> =
            fields.iter().map(|(name, offset, bytes)| format!("`{name}` {offset} {bytes}")).collect();
        assert_eq!(shown, real, "{MESSAGES}, {heading}");
    }
}

fn toml_blocks(page: &str) -> Vec<String> {
    let blocks = page.split("```toml\n").skip(1);
    blocks.map(|rest| rest.split("```").next().unwrap().to_string()).collect()
}

/// Whether a comment is a key with its value, or a table.
fn is_option(comment: &str) -> bool {
    comment.starts_with('[') || comment.split_once(" = ").is_some_and(|(key, _)| !key.contains(' '))
}

/// A block with its commented keys and tables in force.
fn with_options(block: &str) -> String {
    let lines = block.lines().map(|line| match line.strip_prefix("# ") {
        Some(option) if is_option(option) => option,
        _ => line,
    });
    lines.map(|line| format!("{line}\n")).collect()
}

/// The table that a line opens, without its brackets.
fn header(line: &str) -> Option<&str> {
    let inner = line.split('#').next()?.trim().strip_prefix('[')?.strip_suffix(']')?;
    Some(inner.trim_start_matches('[').trim_end_matches(']'))
}

/// Asserts that a block, or a table of the page's other blocks, names every key that its reader knows. `refusal` reads a text with an unknown key `zzz` and gives the error, which
/// lists the known ones; nothing where the table takes any key.
fn assert_names_every_key(what: &str, block: &str, mut refusal: impl FnMut(&str) -> Option<String>) {
    let tables_of_page = with_options(&toml_blocks(&page::read(what)).concat());
    let full = with_options(block);
    let lines: Vec<&str> = full.lines().collect();
    let tables = (0..lines.len()).filter(|&index| header(lines[index]).is_some()).map(|index| index + 1);
    for start in [0].into_iter().chain(tables) {
        let table = if start == 0 { "" } else { header(lines[start - 1]).unwrap() };
        let with_unknown = [&lines[..start], &["zzz = 1"], &lines[start..]].concat().join("\n");
        let Some(error) = refusal(&with_unknown) else { continue };
        let known = error.split("unknown field `zzz`, ").nth(1).unwrap_or_else(|| panic!("{what}, [{table}]: {error}"));
        let own = lines[start..].iter().take_while(|line| header(line).is_none());
        let own: Vec<&str> = own.filter_map(|line| Some(line.split_once(" = ")?.0)).collect();
        for key in known.split('`').skip(1).step_by(2) {
            let inner = if table.is_empty() { key.to_string() } else { format!("{table}.{key}") };
            let named = own.contains(&key) || tables_of_page.lines().any(|line| header(line) == Some(inner.as_str()));
            assert!(named, "{what} lacks the key `{key}` of [{table}]");
        }
    }
}

#[test]
fn the_job_file_shows_every_key_and_its_default() {
    let text = page::read("docs/reference/job-file.md");
    let [all, franka, guest, inclinometer, _]: [String; 5] = toml_blocks(&text).try_into().unwrap();
    let upright = "robot = \"panda\"\nmounting = \"upright\"\nvalidation = { mountings = [\"upright\"] }\n";
    let of_franka = format!("{upright}backend.kind = \"franka\"\n");
    let of_guest = "robot = \"panda\"\nmounting = \"upright\"\nbackend.kind = \"guest\"\n".to_string();
    let of_sensor = format!("{upright}backend = {{ kind = \"sim\", arm = \"sim-panda\", pace = \"wall-clock\" }}\n");
    let cases = [
        ("", all, "robot = \"panda\"\nmounting = \"wall\"\nbackend = { kind = \"sim\", arm = \"sim-panda\" }\n"),
        (of_franka.as_str(), franka, "backend.franka.address = \"172.16.0.2\"\n"),
        (of_guest.as_str(), guest, "backend.guest = {}\n"),
        (
            of_sensor.as_str(),
            inclinometer,
            "inclinometer = { interface = \"can0\", node = 10, x = \"x\", z = \"z\" }\n",
        ),
    ];
    let parse = |text: &str| Job::parse(Path::new("job.toml"), text, &[]);
    for (head, block, least) in cases {
        // Keys of the head stand above the first table; those of `[backend]` are dotted, so that the block may open its tables.
        let shown = parse(&format!("{head}{block}")).unwrap();
        assert_eq!(shown, parse(&format!("{head}{least}")).unwrap(), "docs/reference/job-file.md: shown and default");
        parse(&format!("{head}{}", with_options(&block))).unwrap();
        assert_names_every_key("docs/reference/job-file.md", &block, |text| {
            // The top level of the others is that of the first block.
            if !head.is_empty() && text.starts_with("zzz") {
                return None;
            }
            Some(parse(&format!("{head}{text}")).expect_err("an unknown key is refused").to_string())
        });
    }
}

#[test]
fn the_arm_file_shows_every_key_and_its_default() {
    let block = toml_blocks(&page::read("docs/reference/job-file.md")).swap_remove(4);
    // A base is found beside the file.
    let file = plumbline_testkit::path("config/arms/own.toml").display().to_string();
    let parse = |text: &str| Truth::parse(&file, text);
    let least = "robot = 'panda'
        link = [{ mass = 3.0, com = [0.0, 0.0, 0.1], inertia = [0.03, 0.0, 0.0, 0.03, 0.0, 0.02] }]
        joint = [{ stiffness = 3000.0, damping = 100.0 }]
        effect = [{ id = 'spring', joint = 1 }]";
    assert_eq!(parse(&block).unwrap(), parse(least).unwrap(), "docs/reference/job-file.md: shown and default");
    parse(&with_options(&block)).unwrap();
    assert_names_every_key("docs/reference/job-file.md", &block, |text| {
        Some(parse(text).expect_err("an unknown key is refused").to_string())
    });
}

#[test]
fn the_robot_file_shows_every_key() {
    let [block]: [String; 1] = toml_blocks(&page::read("docs/reference/robot-file.md")).try_into().unwrap();
    Robot::parse("robot.toml", &block).unwrap();
    assert_names_every_key("docs/reference/robot-file.md", &block, |text| {
        Some(Robot::parse("robot.toml", text).expect_err("an unknown key is refused").to_string())
    });
}

#[test]
fn the_dataset_page_has_every_column_that_is_read_by_joint() {
    let text = page::read("docs/reference/dataset.md");
    for known in plumbline::dataset::columns::ALL {
        let (stem, unit, purpose) = (known.stem, known.unit, known.purpose);
        let row = format!("| `{stem}1` .. `{stem}n` | {unit} | optional: {purpose} |");
        assert!(text.contains(&row), "docs/reference/dataset.md lacks\n{row}");
    }
}

#[test]
fn dataset_and_model_file_show_every_key() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |command: &[&str], file: &Path, text: &str| {
        std::fs::write(file, text).unwrap();
        let mut program = plumbline();
        program.args(command).arg("--out").arg(folder.path().join("out"));
        String::from_utf8(program.output().unwrap().stderr).unwrap()
    };
    let place = folder.path().display().to_string();

    let [dataset]: [String; 1] = toml_blocks(&page::read("docs/reference/dataset.md")).try_into().unwrap();
    let file = folder.path().join("dataset.toml");
    let identify = |text: &str| refused(&["identify", &place], &file, text);
    let missing = identify(&dataset);
    assert!(missing.contains("run_1.csv"), "what the page shows is taken, but for its run: {missing}");
    assert_names_every_key("docs/reference/dataset.md", &dataset, |text| {
        let source = text.find("[source]").is_some_and(|at| text[at..].lines().nth(1) == Some("zzz = 1"));
        (!source).then(|| identify(text))
    });

    let text = page::read("docs/reference/model-and-report.md");
    let model = toml_blocks(&text).swap_remove(0);
    let file = folder.path().join("model.toml");
    let model_path = file.display().to_string();
    assert_names_every_key("docs/reference/model-and-report.md", &model, |text| {
        Some(refused(&["export", &model_path, "--format", "c"], &file, text))
    });
}
