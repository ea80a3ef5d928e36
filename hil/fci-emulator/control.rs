//! Lines on standard input: the operator's hand, and faults.

use crate::emulator::{Emulator, Fault, Hand};
use std::io::BufRead;

const HELP: &str = "user-stop | release | guide | let-go | lock | unlock | push | fault FAULT | heal | status | quit";

/// Obeys until `quit`. At the end of input the emulator goes on for as long as the process lives.
pub fn obey(emulator: &Emulator) {
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        let line = line.trim();
        match line.split_once(' ').unwrap_or((line, "")) {
            ("user-stop", "") => emulator.hand(Hand::UserStop),
            ("release", "") => emulator.hand(Hand::Release),
            ("guide", "") => emulator.hand(Hand::Guide),
            ("let-go", "") => emulator.hand(Hand::LetGo),
            ("lock", "") => emulator.hand(Hand::Lock),
            ("unlock", "") => emulator.hand(Hand::Unlock),
            ("push", "") => emulator.hand(Hand::Push),
            ("heal", "") => emulator.heal(),
            ("fault", text) => match text.parse::<Fault>() {
                Ok(fault) => emulator.fault(fault),
                Err(error) => eprintln!("{error}"),
            },
            ("status", "") => {
                let now = emulator.snapshot();
                eprintln!("{}, errors: {}, {:?}", now.state.robot_mode, now.state.errors, now.counts);
            }
            ("quit", "") => return,
            ("", "") => {}
            _ => eprintln!("`{line}`? {HELP}"),
        }
    }
    loop {
        std::thread::park();
    }
}
