//! How a step ended.

use std::fmt;

/// How a step ended, and why.
pub enum Verdict {
    Pass(String),
    /// Do not go on; each line is a reason and what to do.
    Fail(Vec<String>),
}

impl Verdict {
    /// A pass where nothing speaks against it.
    pub fn of(reasons: Vec<String>, passed: String) -> Verdict {
        if reasons.is_empty() { Verdict::Pass(passed) } else { Verdict::Fail(reasons) }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Verdict::Pass(why) => write!(f, "PASS: {why}"),
            Verdict::Fail(reasons) => {
                write!(f, "FAIL:")?;
                reasons.iter().try_for_each(|reason| write!(f, "\n  - {reason}"))
            }
        }
    }
}
