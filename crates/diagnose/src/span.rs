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

#[cfg(test)]
mod tests {
    use super::Span;

    #[test]
    fn what_comes_is_there_at_once_or_by_and_by_until_it_ends() {
        let at_once = Span { to: 5.0, ..Span::since(2.0) };
        assert_eq!([1.9, 2.0, 4.9, 5.0].map(|t| at_once.share_at(t)), [0.0, 1.0, 1.0, 0.0]);
        let slow = Span { rise: 10.0, ..Span::since(2.0) };
        let share = |t: f64| 1.0 - (-(t - 2.0) / 10.0_f64).exp();
        for (t, expected) in [(1.0, 0.0), (2.0, 0.0), (12.0, share(12.0)), (102.0, share(102.0))] {
            assert!((slow.share_at(t) - expected).abs() < 1e-12, "{t}");
        }
        assert!(slow.begins_near(Span { rise: 60.0, ..slow }) && !slow.begins_near(Span::since(2.0)));
        assert!(Span::ALL.is_all() && !slow.is_all() && Span::ALL.share_at(-1e9) == 1.0);
    }
}
