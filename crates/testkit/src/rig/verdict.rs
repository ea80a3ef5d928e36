//! How a step ended.

use std::fmt;

/// How a step ended, and why.
pub enum Verdict {
    Pass(String),
    /// Stop here; each line is a reason and its remedy.
    Fail(Vec<String>),
}

impl Verdict {
    /// A pass where there is no reason to stop.
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
