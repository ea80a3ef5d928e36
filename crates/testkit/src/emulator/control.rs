//! Lines on standard input: actions of the operator, and faults.

use crate::emulator::{Emulator, OperatorAction};
use std::io::BufRead;

const HELP: &str = "user-stop | release | guide | let-go | lock | unlock | push | fault FAULT | heal | status | quit";

#[derive(Debug, PartialEq, Eq)]
pub enum Outcome {
    Done,
    /// Help was requested, or the line is no order.
    Say(String),
    Quit,
}

/// Carries out orders until `quit`. After the end of input the emulator runs until the process ends.
pub fn obey(emulator: &Emulator) {
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        match carry_out(emulator, line.trim()) {
            Outcome::Done => {}
            Outcome::Say(text) => eprintln!("{text}"),
            Outcome::Quit => return,
        }
    }
    loop {
        std::thread::park();
    }
}

pub fn carry_out(emulator: &Emulator, line: &str) -> Outcome {
    let act = |action| {
        emulator.operate(action);
        Outcome::Done
    };
    match line.split_once(' ').unwrap_or((line, "")) {
        ("user-stop", "") => act(OperatorAction::UserStop),
        ("release", "") => act(OperatorAction::Release),
        ("guide", "") => act(OperatorAction::Guide),
        ("let-go", "") => act(OperatorAction::LetGo),
        ("lock", "") => act(OperatorAction::Lock),
        ("unlock", "") => act(OperatorAction::Unlock),
        ("push", "") => act(OperatorAction::Push),
        ("heal", "") => {
            emulator.heal();
            Outcome::Done
        }
        ("fault", text) => match text.parse() {
            Ok(fault) => {
                emulator.fault(fault);
                Outcome::Done
            }
            Err(error) => Outcome::Say(format!("{error}")),
        },
        ("status", "") => {
            let now = emulator.snapshot();
            Outcome::Say(format!("{}, errors: {}, {:?}", now.state.robot_mode, now.state.errors, now.counts))
        }
        ("quit", "") => Outcome::Quit,
        ("", "") => Outcome::Done,
        ("help", "") => Outcome::Say(HELP.into()),
        _ => Outcome::Say(format!("`{line}` is none of {HELP}")),
    }
}
