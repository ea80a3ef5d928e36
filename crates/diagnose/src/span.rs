//! Parts of a recording.

/// Two effects of a kind that begin nearer than this are one \[s\].
const SAME_BEGIN_S: f64 = 5.0;

/// A part of a recording, on the clock that counts through all of its runs \[s\], and how an effect comes in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Begin.
    pub from: f64,
    /// End.
    pub to: f64,
    /// Time constant with which an effect comes, `1 - exp(-(t - from) / rise)`; 0: it comes at once.
    pub rise: f64,
}

impl Span {
    /// The whole recording.
    pub const ALL: Span = Span { from: f64::NEG_INFINITY, to: f64::INFINITY, rise: 0.0 };

    /// From a time on.
    pub fn since(from: f64) -> Span {
        Span { from, ..Span::ALL }
    }

    /// Share of an effect that is there at a time.
    pub fn share_at(self, t: f64) -> f64 {
        match (self.from..self.to).contains(&t) {
            true if self.rise > 0.0 => -(-(t - self.from) / self.rise).exp_m1(),
            inside => f64::from(inside),
        }
    }

    /// Whether it comes by and by.
    pub fn is_slow(self) -> bool {
        self.rise > 0.0
    }

    /// Whether both begin at about the same time: what comes then comes once.
    pub fn begins_near(self, other: Span) -> bool {
        self.is_slow() == other.is_slow() && (self.from == other.from || (self.from - other.from).abs() < SAME_BEGIN_S)
    }

    /// Whether it is the whole recording.
    pub fn is_all(self) -> bool {
        self == Span::ALL
    }
}
