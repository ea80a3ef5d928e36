//! Parts of a recording.

/// Two effects of a kind that begin nearer than this are one \[s\].
const SAME_BEGIN_S: f64 = 5.0;

/// A part of a recording, on the clock that counts through all of its runs \[s\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Begin.
    pub from: f64,
    /// End.
    pub to: f64,
}

impl Span {
    /// The whole recording.
    pub const ALL: Span = Span { from: f64::NEG_INFINITY, to: f64::INFINITY };

    /// From a time on.
    pub fn since(from: f64) -> Span {
        Span { from, ..Span::ALL }
    }

    /// Whether both begin at about the same time: what comes then comes once.
    pub fn begins_near(self, other: Span) -> bool {
        self.from == other.from || (self.from - other.from).abs() < SAME_BEGIN_S
    }

    /// Whether it is the whole recording.
    pub fn is_all(self) -> bool {
        self == Span::ALL
    }
}
