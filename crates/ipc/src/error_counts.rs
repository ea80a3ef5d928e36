//! What shared memory refused to do: a line in the log once per cause, then only as the count grows tenfold.

/// Causes that are told apart; what comes on top is one more.
const MAX_CAUSES: usize = 16;

/// Causes of trouble and how often each has come.
#[derive(Debug, Default)]
pub(super) struct ErrorCounts {
    causes: Vec<(String, u64)>,
}

impl ErrorCounts {
    /// Counts `cause`; the line for the log, where it is due.
    pub(super) fn count(&mut self, cause: &str) -> Option<String> {
        let known = self.causes.iter().position(|(known, _)| known == cause);
        let index = known.unwrap_or_else(|| {
            let full = self.causes.len() >= MAX_CAUSES;
            if !full {
                self.causes.push((cause.to_string(), 0));
            }
            self.causes.len() - 1
        });
        let (_, count) = self.causes.get_mut(index)?;
        *count += 1;
        let due = (0..20).any(|power| 10_u64.pow(power) == *count);
        due.then(|| match count {
            1 => cause.to_string(),
            count => format!("{cause} ({count} times)"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_is_logged_once_and_then_with_its_count() {
        let mut troubles = ErrorCounts::default();
        let lines: Vec<_> = (0..1000).filter_map(|_| troubles.count("no file descriptor is left")).collect();
        let text = |count| format!("no file descriptor is left ({count} times)");
        assert_eq!(lines, ["no file descriptor is left".to_string(), text(10), text(100), text(1000)]);
        assert_eq!(troubles.count("another").as_deref(), Some("another"));
        let lines: usize = (0..1000).filter_map(|k| troubles.count(&format!("cause {k}"))).count();
        assert!(lines < MAX_CAUSES + 4, "{lines}: causes without end do not fill the log");
        assert_eq!(troubles.causes.len(), MAX_CAUSES);
    }
}
