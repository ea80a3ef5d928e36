//! Values of a monitored daemon in the text exposition format of Prometheus, version 0.0.4.

use super::watched::Watched;
use plumbline_core::{Distribution, Validity};
use plumbline_ipc::{Progress, Status};
use serde_json::Value;
use std::fmt::{Display, Write};

/// The page of a daemon with this identity in shared memory, at `now` (`CLOCK_BOOTTIME`) \[ns\]; `None` before its first status.
pub fn exposition(of: &Watched, id: &str, now: u64) -> Option<String> {
    let status = of.status.as_ref()?;
    let mut page = Page { id, text: String::new() };
    let states = [
        Progress::Idle,
        Progress::Driving,
        Progress::AwaitingModel,
        Progress::Paused,
        Progress::Done,
        Progress::Stopped,
    ];
    let state = |one: Progress| (vec![("state", name(one))], f64::from(u8::from(one == status.progress)));
    page.family("state", "gauge", "Progress of the job: 1 for the present one.", states.map(state));
    let phase = vec![("phase", format!("{:?}", status.phase).to_lowercase())];
    page.family("phase", "gauge", "Motion phase of the loop.", [(phase, 1.0)]);
    page.value("cycles_total", "counter", "Cycles of the loop.", status.cycles as f64);
    let missed = missed(status).into_iter().map(|(kind, count)| (vec![("kind", kind)], count as f64));
    page.family("samples_missed_total", "counter", "Samples that were lost, late or not used, by kind.", missed);
    let refused = status.degraded.len() as f64;
    page.value("rights_refused", "gauge", "Real-time rights that the machine does not grant.", refused);
    page.durations(
        "wake_up_seconds",
        "Wake-up latency of the loop since the daemon's start.",
        &of.wake_up.distribution(),
    );
    page.durations(
        "execution_seconds",
        "Execution time of a cycle since the daemon's start.",
        &of.execution.distribution(),
    );
    let since = |stamp: u64| now.saturating_sub(stamp) as f64 / 1e9;
    let model = of.served();
    let info = model.map(|(header, _)| {
        let validity = header.validity().unwrap_or(Validity::None);
        (vec![("model", format!("{:016x}", header.model)), ("validity", format!("{validity:?}").to_lowercase())], 1.0)
    });
    page.family("model_info", "gauge", "Identity of the served model, and whether it is trusted.", info);
    let age = model.map(|(_, stamp)| (Vec::new(), since(stamp)));
    page.family("model_age_seconds", "gauge", "Time since the model is served under its present gravity.", age);
    let per_joint = |of: &dyn Fn(usize) -> Option<f64>| {
        (0..status.joints).filter_map(|j| Some((vec![("joint", (j + 1).to_string())], of(j)?))).collect::<Vec<_>>()
    };
    let residual = per_joint(&|j| model.map(|_| of.residual(j)));
    let text = "RMS of measured minus served torque over half a second.";
    page.family("residual_newton_metres", "gauge", text, residual);
    let floor = per_joint(&|j| of.floor.get(j).copied());
    page.family("noise_floor_newton_metres", "gauge", "Noise floor of the served model.", floor);
    let external = of.external.filter(|external| external.settled);
    let torque = per_joint(&|j| external.map(|external| external.tau[j]));
    page.family("external_torque_newton_metres", "gauge", "External torque by the served model.", torque);
    let threshold = per_joint(&|j| external.map(|external| external.threshold[j]));
    page.family("contact_threshold_newton_metres", "gauge", "External torque that flags contact.", threshold);
    Some(page.text)
}

/// The word of a value that serialises as one.
fn name(value: Progress) -> String {
    serde_json::to_value(value).ok().and_then(|value| value.as_str().map(str::to_string)).unwrap_or_default()
}

/// Counters of samples that were lost, late or not used. Those of an arm that another program controls have their own names.
fn missed(status: &Status) -> Vec<(String, u64)> {
    let mut counters = vec![
        ("lost".to_string(), status.lost),
        ("late".to_string(), status.late),
        ("dropped".to_string(), status.dropped_records),
    ];
    let of_guest = status.guest.as_ref().and_then(|guest| serde_json::to_value(guest.counts).ok());
    if let Some(Value::Object(of_guest)) = of_guest {
        let known = |name: &str| ["received", "publishers", "lost", "late"].contains(&name);
        let own = of_guest.iter().filter(|(name, _)| !known(name));
        counters.extend(own.filter_map(|(name, count)| Some((name.replace('_', "-"), count.as_u64()?))));
    }
    counters
}

type Labels = Vec<(&'static str, String)>;

/// A page under construction. Every name begins with `plumbline_`, every row has the label `robot`.
struct Page<'a> {
    id: &'a str,
    text: String,
}

impl Page<'_> {
    /// Rows of one name; nothing without rows.
    fn family(&mut self, name: &str, kind: &str, help: &str, rows: impl IntoIterator<Item = (Labels, f64)>) {
        let mut rows = rows.into_iter().peekable();
        if rows.peek().is_some() {
            let _ = write!(self.text, "# HELP plumbline_{name} {help}\n# TYPE plumbline_{name} {kind}\n");
        }
        for (labels, value) in rows {
            let own =
                labels.iter().map(|(label, value)| format!(",{label}=\"{}\"", escaped(value))).collect::<String>();
            let _ = writeln!(self.text, "plumbline_{name}{{robot=\"{}\"{own}}} {value}", escaped(self.id));
        }
    }

    fn value(&mut self, name: &str, kind: &str, help: &str, value: f64) {
        self.family(name, kind, help, [(Vec::new(), value)]);
    }

    /// Percentiles of a duration; nothing where nothing was measured.
    fn durations(&mut self, name: &str, help: &str, of: &Distribution) {
        let quantiles = [("0.5", of.p50_ns), ("0.99", of.p99_ns), ("0.999", of.p999_ns), ("1", of.max_ns)];
        let row = |(quantile, ns): (&str, u64)| (vec![("quantile", quantile.to_string())], ns as f64 / 1e9);
        self.family(name, "gauge", help, quantiles.map(row).into_iter().filter(|_| of.count > 0));
    }
}

/// A label's value.
fn escaped(text: &(impl Display + ?Sized)) -> String {
    text.to_string().replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::Record;
    use plumbline_ipc::{GuestCounts, GuestStatus};

    #[test]
    fn every_row_has_a_type_and_a_number() {
        let mut watched = Watched::default();
        assert_eq!(exposition(&watched, "panda", 0), None);
        let guest = GuestStatus { counts: GuestCounts { doubled: 5, ..GuestCounts::default() }, problem: None };
        let mut status = Status { joints: 7, cycles: 1234, lost: 3, guest: Some(guest), ..Status::default() };
        status.progress = Progress::AwaitingModel;
        watched.status(status);
        watched.record(&Record { wake_ns: 28_000, work_ns: 5_000, ..Record::default() });
        watched.floor = vec![0.15; 7];
        let text = exposition(&watched, "a\"b", 0).unwrap();
        for row in [
            "# TYPE plumbline_cycles_total counter\nplumbline_cycles_total{robot=\"a\\\"b\"} 1234\n",
            "plumbline_state{robot=\"a\\\"b\",state=\"awaiting-model\"} 1\n",
            "plumbline_state{robot=\"a\\\"b\",state=\"driving\"} 0\n",
            "plumbline_samples_missed_total{robot=\"a\\\"b\",kind=\"lost\"} 3\n",
            "plumbline_samples_missed_total{robot=\"a\\\"b\",kind=\"doubled\"} 5\n",
            "plumbline_wake_up_seconds{robot=\"a\\\"b\",quantile=\"0.99\"} 0.000028",
            "plumbline_noise_floor_newton_metres{robot=\"a\\\"b\",joint=\"7\"} 0.15\n",
        ] {
            assert!(text.contains(row), "{row}\n{text}");
        }
        // No model is served.
        assert!(!text.contains("plumbline_model") && !text.contains("plumbline_residual"), "{text}");
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let (name, rest) = line.split_once('{').unwrap();
            assert!(text.contains(&format!("# TYPE {name} ")) && text.contains(&format!("# HELP {name} ")), "{line}");
            assert!(rest.rsplit_once("} ").unwrap().1.parse::<f64>().is_ok(), "{line}");
        }
    }
}
