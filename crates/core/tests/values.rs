//! The values and interfaces of the crate, against their definitions.

use plumbline_core::{
    Backend, Command, Distribution, Fault, Histogram, LoopStatistics, MAX_JOINTS, Phase, SpeedEnvelope, State,
    Validity, expectation, from_toml, singular_values, symmetric_eigen,
};
use serde::Deserialize;

#[test]
fn codes_of_phase_and_validity_read_back_and_others_are_none() {
    let phases = [Phase::Hold, Phase::Approach, Phase::Excite, Phase::Return, Phase::Stop, Phase::Stopped];
    for phase in phases {
        assert_eq!(Phase::from_u32(phase as u32), Some(phase));
    }
    use Validity::{Doubtful, HandOver, None as NoModel, Valid, Withdrawn};
    for validity in [NoModel, Valid, HandOver, Withdrawn, Doubtful] {
        assert_eq!(Validity::from_u32(validity as u32), Some(validity));
        assert_eq!(validity.is_served(), matches!(validity, Valid | HandOver | Doubtful));
    }
    assert_eq!((Phase::from_u32(6), Validity::from_u32(5)), (None, None));
}

/// `dq <= min(dq_max, max(0, sqrt(2 dec room) - offset))`, and its slope against a difference quotient.
#[test]
fn a_speed_envelope_is_its_formula_and_its_slope_the_derivative() {
    let mut envelope = SpeedEnvelope { offset: [0.3; MAX_JOINTS], deceleration: [6.0; MAX_JOINTS] };
    envelope.deceleration[1] = 0.0;
    assert_eq!(envelope.at(1, 1e-3, 2.0), (2.0, 0.0), "no dependence on the position");
    assert_eq!(envelope.at(0, 10.0, 2.0), (2.0, 0.0), "far from the end of the range");
    assert_eq!(envelope.at(0, 1e-3, 2.0), (0.0, 0.0), "the offset is larger than the root");
    assert_eq!(envelope.at(0, -1.0, 2.0), (0.0, 0.0), "past the end of the range");
    for room in [0.01, 0.1, 0.2, 0.4] {
        let (speed, slope) = envelope.at(0, room, 2.0);
        assert!((speed - ((12.0 * room).sqrt() - 0.3)).abs() < 1e-12, "{room}: {speed}");
        let step = 1e-6;
        let quotient = (envelope.at(0, room + step, 2.0).0 - envelope.at(0, room - step, 2.0).0) / (2.0 * step);
        assert!((slope - quotient).abs() < 1e-6 * slope, "{room}: {slope} {quotient}");
    }
    let slower = envelope.braked_with(&[4.0; MAX_JOINTS]);
    assert_eq!((slower.deceleration[0], slower.deceleration[1], slower.offset[0]), (4.0, 0.0, 0.3));
}

#[test]
fn cycles_are_accounted_for_where_the_arms_count_is_the_loops_and_the_lost() {
    let counts = LoopStatistics { elapsed: 12, cycles: 5, lost: 7, ..LoopStatistics::default() };
    assert!(counts.accounted());
    assert!(!LoopStatistics { elapsed: 13, ..counts }.accounted());
}

#[test]
fn a_distribution_in_microseconds_is_its_nanoseconds_and_none_when_empty() {
    assert_eq!(Distribution::default().in_us(), None);
    let histogram = Histogram::default();
    histogram.add(1_500);
    assert_eq!(histogram.distribution().in_us(), Some([1.5; 4]));
}

/// A boxed arm is the arm.
#[test]
fn a_boxed_backend_forwards_every_call() {
    struct Counting([u32; 3]);
    impl Backend for Counting {
        fn joints(&self) -> usize {
            3
        }
        fn read(&mut self) -> Result<State, Fault> {
            self.0[0] += 1;
            Ok(State { seq: 7, ..State::default() })
        }
        fn write(&mut self, _: &Command) -> Result<(), Fault> {
            self.0[1] += 1;
            Err(Fault::Disconnected)
        }
        fn stop(&mut self) {
            self.0[2] += 1;
        }
        fn deadline_ns(&self) -> Option<u64> {
            Some(5)
        }
    }
    fn drive(arm: &mut impl Backend) {
        assert_eq!((arm.joints(), arm.deadline_ns()), (3, Some(5)));
        assert_eq!(arm.read().map(|state| state.seq), Ok(7));
        assert_eq!(arm.write(&Command::default()), Err(Fault::Disconnected));
        arm.stop();
    }
    let mut arm = Box::new(Counting([0; 3]));
    drive(&mut arm);
    assert_eq!(arm.0, [1; 3]);
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[allow(dead_code)]
    arm: Arm,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Arm {
    #[allow(dead_code)]
    limit: f64,
}

#[test]
fn bad_toml_is_named_by_file_line_key_value_and_expectation() {
    let bad = |text: &str| from_toml::<File>("a.toml", text).unwrap_err();
    let error = bad("\n\n[arm]\nlimit = \"fast\"\n");
    assert_eq!((error.file.as_str(), error.place.as_str()), ("a.toml", "line 4, key `arm.limit`"));
    assert_eq!((error.value.as_str(), error.expected.as_str()), ("`\"fast\"`", "f64"));
    let error = bad("[arm]\nlimit = 1.0\nspeed = 2\n");
    assert!(error.place.starts_with("line 3") && error.expected.starts_with("a known key"), "{error}");
    let error = bad("[arm]\n");
    assert!(error.value == "`[arm]`" && error.expected.starts_with("all required keys"), "{error}");
    let error = bad("arm = [\n");
    assert!(error.place.starts_with("line "), "{error}");
    assert!(from_toml::<File>("a.toml", "[arm]\nlimit = 1.0").is_ok());
}

#[test]
fn serdes_message_becomes_an_expectation() {
    assert_eq!(expectation("invalid type: string \"a\", expected f64"), "f64");
    assert_eq!(expectation("odd"), "odd");
    assert_eq!(expectation("unknown field `a`"), "a known key (unknown field `a`)");
    assert_eq!(expectation("missing field `a`"), "all required keys (missing field `a`)");
}

#[test]
fn a_matrix_of_one_entry_is_its_own_decomposition() {
    assert_eq!(symmetric_eigen(nalgebra::Matrix1::new(-2.0)).unwrap().eigenvalues[0], -2.0);
    assert_eq!(singular_values(nalgebra::DMatrix::from_element(1, 1, -2.0)).unwrap()[0], 2.0);
}
