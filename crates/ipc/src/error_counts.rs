//! Rate limit for logged errors: one line per cause at counts of 1, 10, 100, ...

/// Maximum distinct causes; further ones are counted with the last.
const MAX_CAUSES: usize = 16;

#[derive(Debug, Default)]
pub(super) struct ErrorCounts {
    causes: Vec<(String, u64)>,
}

impl ErrorCounts {
    /// Counts `cause`; returns the log line at counts of 1, 10, 100, ...
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
        let mut counts = ErrorCounts::default();
        let lines: Vec<_> = (0..1000).filter_map(|_| counts.count("no file descriptor is left")).collect();
        let text = |count| format!("no file descriptor is left ({count} times)");
        assert_eq!(lines, ["no file descriptor is left".to_string(), text(10), text(100), text(1000)]);
        assert_eq!(counts.count("another").as_deref(), Some("another"));
        let lines: usize = (0..1000).filter_map(|k| counts.count(&format!("cause {k}"))).count();
        assert!(lines < MAX_CAUSES + 4, "{lines}: distinct causes do not fill the log");
        assert_eq!(counts.causes.len(), MAX_CAUSES);
    }
}
