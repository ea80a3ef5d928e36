//! The live watch on a motion that another program recorded, as it would have seen it sample by sample: `hil/study/serving.sh`.

use super::{Live, OfferedModel};
use crate::analysis::{self, pipeline};
use crate::config::job::Job;
use crate::dataset::{Dataset, Run};
use crate::store::{ModelFile, model_identity};
use plumbline_core::{JointVec, Phase, Record, State};
use plumbline_model::Robot;
use std::path::{Path, PathBuf};

/// Names the folder of a dataset to identify from, and in it the folder `live` of the dataset to watch; `live.json` is written there.
const CASE: &str = "PLUMBLINE_SERVED_CASE";
/// Samples until the loop serves a model that was offered.
const ADOPTED_AFTER: u64 = 5;

/// The states of a recorded run. What is missing of it is missing in their numbers.
fn records(run: &Run, rate: f64, joints: usize) -> impl Iterator<Item = Record> + '_ {
    let data = &run.data;
    let dq = data.dq.as_ref().expect("columns dq1..dqn");
    (0..data.samples()).map(move |k| {
        let mut state = State { seq: (data.t[k] * rate).round() as u64, time: data.t[k], ..State::default() };
        let of = |values: &nalgebra::DMatrix<f64>| {
            let mut row = JointVec::default();
            (0..joints).for_each(|j| row[j] = values[(k, j)]);
            row
        };
        (state.q, state.dq, state.tau, state.q_d) = (of(&data.q), of(dq), of(&data.tau), of(&data.q));
        Record { cycle: k as u64, state, phase: Phase::Excite, motion: 1, tick: k as u64, ..Record::default() }
    })
}

/// Identifies from a dataset as a job does, and watches a run.
fn watch(folder: &Path, out: &Path) {
    let (dataset, served) = (Dataset::read(folder).unwrap(), Dataset::read(&folder.join("live")).unwrap());
    let robot = Robot::load(&dataset.robot, Some(folder)).unwrap();
    let run = &served.runs[0];
    let truth = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
    let rate = truth["conditions"]["rate"].as_f64().unwrap();
    let text = format!(
        "robot = \"panda\"\nmounting = \"upright\"\n[backend]\nkind = \"guest\"\n[backend.guest]\nrate = \"{rate} Hz\"\n[live]\nwatch = true\nadopt = \"auto\"\n"
    );
    let job = Job { mounting: dataset.mounting, ..Job::parse("job.toml".as_ref(), &text, &[]).unwrap() };
    let runs: Vec<&Run> = dataset.runs.iter().filter(|run| run.role == crate::dataset::Role::Identify).collect();
    let (terms, settings) = (pipeline::plain_terms(&robot), job.settings());
    let identified = pipeline::identify(&robot, &runs, &terms, &settings, &job.solver()).unwrap();
    let noise_floor = identified.identification.rms.noise_floor.clone().unwrap_or_default();
    let file = ModelFile {
        model: identified.model.clone(),
        noise_floor,
        validation: Vec::new(),
        uncertainty: None,
        consistent: None,
        provenance: analysis::provenance(&robot, None),
    };
    let text = file.to_toml();
    let mut live = Live::new(&job, &robot, out).unwrap();
    // Recorded time runs ahead of the searches.
    live.wait_for_search = true;
    live.identified(&identified, &text, runs[0]).unwrap();
    let (mut model, mut next) = (model_identity(&text), None);
    for record in records(run, rate, robot.chain.len()) {
        if let Some((offered, _)) = next.take_if(|(_, at)| record.cycle >= *at) {
            model = offered;
        }
        if let Some(OfferedModel { toml, .. }) = live.update(&Record { model, ..record }).unwrap() {
            next = Some((model_identity(&toml), record.cycle + ADOPTED_AFTER));
        }
    }
    live.finish().unwrap();
}

#[test]
#[ignore = "hil/study/serving.sh"]
fn a_recorded_motion_is_watched() {
    let folder = PathBuf::from(std::env::var_os(CASE).unwrap_or_else(|| panic!("{CASE} names no folder")));
    watch(&folder, &folder.join("live"));
}
