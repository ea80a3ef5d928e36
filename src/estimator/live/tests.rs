use super::{Live, OfferedModel};
use crate::analysis::{self, pipeline};
use crate::config::job::Job;
use crate::dataset::{Role, Run};
use crate::store::{ModelFile, model_identity};
use plumbline_core::{Phase, Record, State};
use plumbline_model::Robot;
use plumbline_testkit::arms;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const JOB: &str = "robot = \"panda\"\nmounting = \"upright\"\n[backend]\nkind = \"guest\"\n[backend.guest]\nrate = \"500 Hz\"\n\
                   [live]\nwatch = true\nadopt = \"auto\"\n";
const RATE: f64 = 500.0;

/// `seconds` of sines in every joint of a rigid arm that has `offset` \[Nm\] in joint 2 from a time \[s\] on.
fn records(seconds: f64, offset: impl Fn(f64) -> f64) -> Vec<Record> {
    let chain = arms::chain("panda");
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let delta = arms::draw(&mut rng, 10 * chain.len(), 1.0);
    let gravity = plumbline_model::Mounting::UPRIGHT.gravity();
    let record = |k: u64| {
        let t = k as f64 / RATE;
        let mut state = State { seq: k, time: t, ..State::default() };
        let mut ddq = state.q;
        for (j, ddq) in ddq.iter_mut().enumerate().take(chain.len()) {
            for (size, omega) in [(0.5, 1.3 + 0.31 * j as f64), (0.2, 4.1 - 0.23 * j as f64)] {
                state.q[j] += size * (omega * t).sin();
                state.dq[j] += size * omega * (omega * t).cos();
                *ddq -= size * omega * omega * (omega * t).sin();
            }
        }
        let n = chain.len();
        let tau = arms::torque(&chain, &delta, &gravity, &state.q[..n], &state.dq[..n], &ddq[..n]);
        let noise = |tau: &f64| tau + rng.random_range(-0.05..0.05);
        state.tau.iter_mut().zip(tau.iter().map(noise)).for_each(|(measured, tau)| *measured = tau);
        state.tau[1] += offset(t);
        state.q_d = state.q;
        Record { cycle: k, state, phase: Phase::Excite, motion: 1, tick: k, ..Record::default() }
    };
    (0..(seconds * RATE) as u64).map(record).collect()
}

/// What the watch offers along `records` while the loop goes on serving the identified model.
fn offers_while_none_is_served(records: &[Record]) -> Vec<OfferedModel> {
    let out = tempfile::tempdir().unwrap();
    let job = Job::parse("job.toml".as_ref(), JOB, &[]).unwrap();
    let robot = Robot::load("panda", None).unwrap();
    let identify = Run {
        data: plumbline_identify::Run::from_records("identify", &self::records(30.0, |_| 0.0), 7, job.mounting, None),
        role: Role::Identify,
        note: String::new(),
        session: 1,
        start: 0.0,
        extra: Vec::new(),
    };
    let identified =
        pipeline::identify(&robot, &[&identify], &pipeline::plain_terms(&robot), &job.settings(), &job.solver());
    let identified = identified.unwrap();
    let file = ModelFile {
        model: identified.model.clone(),
        noise_floor: identified.identification.rms.noise_floor.clone().unwrap_or_default(),
        validation: Vec::new(),
        uncertainty: None,
        consistent: None,
        provenance: analysis::provenance(&robot, None),
    };
    let text = file.to_toml();
    let mut live = Live::new(&job, &robot, out.path()).unwrap();
    live.wait_for_search = true;
    live.identified(&identified, &text, &identify).unwrap();
    let model = model_identity(&text);
    records.iter().filter_map(|record| live.update(&Record { model, ..*record }).unwrap()).collect()
}

#[test]
fn a_model_that_was_offered_and_is_not_served_yet_is_no_earlier_one() {
    let offered = offers_while_none_is_served(&records(40.0, |t| if t < 15.0 { 0.0 } else { 2.0 }));
    let what: Vec<&str> = offered.iter().map(|offer| offer.proposal.what.as_str()).collect();
    assert!(!what.is_empty() && what.iter().all(|what| what.contains("torque-offset")), "{what:?}");
}
