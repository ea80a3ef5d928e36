//! `plumbline effects`: every effect is listed for people, one can be asked for, and an unknown one is refused by name.

use plumbline_model::term::effect::FAMILIES;
use plumbline_testkit::job::plumbline;
use std::process::Output;

fn effects(arguments: &[&str]) -> Output {
    plumbline().arg("effects").args(arguments).output().unwrap()
}

fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap()
}

/// Without the line breaks that wrapping puts in.
fn flat(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn every_effect_is_listed_with_all_its_facts() {
    let done = effects(&[]);
    assert!(done.status.success());
    let listed = text(done.stdout);
    assert!(listed.lines().all(|line| line.chars().count() <= 100 && line.trim_end() == line), "{listed}");
    let headings: Vec<&str> = listed.lines().filter(|line| !line.is_empty() && !line.starts_with(' ')).collect();
    assert_eq!(headings, FAMILIES.iter().map(|family| family.id).collect::<Vec<_>>());
    for family in FAMILIES {
        let done = effects(&[family.id]);
        assert!(done.status.success() && done.stderr.is_empty());
        let one = text(done.stdout);
        assert!(listed.contains(&one), "the same as in the list:\n{one}");
        let one = flat(&one);
        let mut parts = vec![family.physics, family.typical, family.reference];
        parts.extend(family.confounded.iter().flat_map(|alike| [alike.with, alike.decided_by]));
        for form in family.forms {
            parts.extend([form.name, form.equation]);
            for setting in form.settings {
                let range = format!("{}, {} to {}", setting.what, setting.low, setting.high);
                assert!(one.contains(&range), "{range} in {one}");
                assert!(setting.unit == "1" || one.contains(&format!("{} {}", setting.high, setting.unit)), "{one}");
            }
        }
        for part in parts {
            assert!(one.contains(&flat(part)), "`{part}` in {one}");
        }
    }
}

#[test]
fn an_unknown_effect_is_refused_by_name() {
    let done = effects(&["striebeck"]);
    assert_eq!(done.status.code(), Some(2));
    assert!(done.stdout.is_empty());
    let error = text(done.stderr);
    assert!(error.contains("got `striebeck`, expected one of "), "{error}");
    assert!(FAMILIES.iter().all(|family| error.contains(family.id)), "{error}");
}
