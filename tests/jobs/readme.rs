//! docs/guide/simulation.md shows what the program prints: the whole main job, as it ships.

use plumbline_testkit::job::*;

/// Figures that a faster or busier machine changes: of these lines, what follows the word.
const OF_THE_MACHINE: [(&str, &str); 1] = [("loop (simulated time", "execution")];

/// The first indented block after a heading, without its indentation.
fn block(text: &str, heading: &str) -> Vec<String> {
    let lines = text.lines().skip_while(|line| *line != heading).skip_while(|line| !line.starts_with("    "));
    lines.take_while(|line| line.starts_with("    ")).map(|line| line[4..].to_string()).collect()
}

/// A word as what stands before its number, the number, its decimals, and what stands after it.
fn parts(word: &str) -> Option<(&str, f64, usize, &str)> {
    let of_number = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
    let begin = word.find(of_number)?;
    let end = word[begin..].find(|c| !of_number(c)).map_or(word.len(), |length| begin + length);
    let number = &word[begin..end];
    let decimals = number.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    Some((&word[..begin], number.parse().ok()?, decimals, &word[end..]))
}

/// Whether two numbers, of which the first is shown with so many decimals, are the same figure of two runs of one job. Simulated time runs on
/// between motions for as long as the processes take, so the noise of two runs differs. Small counts must be equal.
fn near(one: f64, other: f64, decimals: usize) -> bool {
    let (apart, size) = ((one - other).abs(), one.abs().max(other.abs()));
    match decimals {
        0 if size < 100.0 => apart == 0.0,
        0 => apart <= 0.1 * size,
        _ => apart <= (0.1 * size).max(2.01 * 10f64.powi(-(decimals as i32))),
    }
}

/// The same words, and numbers that are [`near`]. Figures of the machine are numbers in both.
fn says_the_same(shown: &str, printed: &str) -> bool {
    let (one, other): (Vec<&str>, Vec<&str>) = (shown.split(' ').collect(), printed.split(' ').collect());
    let machine = OF_THE_MACHINE.iter().find(|(begin, _)| shown.starts_with(begin)).map(|(_, word)| *word);
    let from = machine.and_then(|word| one.iter().position(|other| *other == word)).unwrap_or(one.len());
    one.len() == other.len()
        && one.iter().zip(&other).enumerate().all(|(index, (one, other))| {
            one == other
                || parts(one).zip(parts(other)).is_some_and(|(one, other)| {
                    let near = index > from || near(one.1, other.1, one.2.min(other.2));
                    (one.0, one.3) == (other.0, other.3) && near
                })
        })
}

#[test]
fn the_guide_shows_what_the_main_job_prints() {
    let page = plumbline_testkit::page::read("docs/guide/simulation.md");
    let shown = block(&page, "## What you see");
    assert!(shown.len() > 10, "{shown:?}");
    let place = Place::new("readme");
    let done = Done::of(
        plumbline().args(["run", WALL, "--out"]).arg(place.out()).args(["--set", &format!("serve.id={}", place.id)]),
    )
    .expect_code(0);
    let out = place.out().display().to_string();
    let printed: Vec<String> = done.out.lines().map(|line| line.replace(&out, "results/sim-panda-wall")).collect();
    let same = shown.len() == printed.len() && shown.iter().zip(&printed).all(|(one, other)| says_the_same(one, other));
    let block: String = printed.iter().map(|line| format!("    {line}\n")).collect();
    assert!(same, "docs/guide/simulation.md, `What you see`, shows other lines than the program prints:\n{block}");
}

#[test]
fn different_words_and_numbers_are_detected() {
    let shown = "RMS wall [Nm], 5 unseen runs: 0.152 [0.151 0.152]";
    assert!(says_the_same(shown, shown) && says_the_same(shown, "RMS wall [Nm], 5 unseen runs: 0.153 [0.151 0.151]"));
    assert!(!says_the_same(shown, "RMS wall [Nm], 5 unseen runs: 0.184 [0.151 0.152]"));
    assert!(!says_the_same(shown, "RMS wall [Nm], 6 unseen runs: 0.152 [0.151 0.152]"));
    assert!(!says_the_same(shown, "RMS roof [Nm], 5 unseen runs: 0.152 [0.151 0.152]"));
    assert!(!says_the_same(shown, "RMS wall [Nm], 5 unseen runs: 0.152 [0.151 0.152"));
    let cycles =
        "loop (simulated time, as fast as possible): 799820 cycles, 0 lost, execution p50 0.736 p99 3.78 max 5212 us";
    assert!(says_the_same(cycles, &cycles.replace("5212", "1.2").replace("0.736", "20").replace("799820", "790000")));
    assert!(!says_the_same(cycles, &cycles.replace("0 lost", "1 lost")));
}
