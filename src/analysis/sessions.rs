//! What changed between the sessions of a dataset: the first is the reference, every later one is compared with its model.

use crate::analysis::pipeline::Identified;
use crate::analysis::{pipeline, split};
use crate::dataset::{Dataset, Run};
use crate::failure::Failure;
use crate::report::Band;
use crate::report::diagnosis::{Changes, Diagnosis, Verdict};
use crate::store::{ModelFile, Provenance};
use plumbline_diagnose::Trial;
use plumbline_diagnose::reference::{self, Comparison, Stored};
use plumbline_identify::{Experiment, Settings};
use plumbline_model::Robot;
use std::path::Path;

/// Runs of the sessions after the first, taken out of the dataset, session by session.
pub fn take_later(dataset: &mut Dataset) -> Vec<(u32, Vec<Run>)> {
    let mut numbers: Vec<u32> = dataset.runs.iter().map(|run| run.session).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let later = numbers.split_off(1.min(numbers.len()));
    let of = |session: u32| dataset.runs.iter().filter(|run| run.session == session).cloned().collect();
    let runs = later.iter().map(|&session| (session, of(session))).collect();
    dataset.runs.retain(|run| !later.contains(&run.session));
    runs
}

/// What a later session is compared with, and how.
pub struct Reference<'a> {
    pub robot: &'a Robot,
    /// The first session's model.
    pub identified: &'a Identified,
    pub session: u32,
    pub settings: &'a Settings,
    pub diagnosis: &'a plumbline_diagnose::Settings,
}

impl Reference<'_> {
    /// Compares each later session with the first, adds what changed to the block, writes `model-session-K.toml` where something did, and
    /// gives the runs that the model is not valid for.
    pub fn compare(
        &self,
        later: &[(u32, Vec<Run>)],
        block: &mut Diagnosis,
        out: &Path,
    ) -> Result<Vec<String>, Failure> {
        let mut untrusted = Vec::new();
        for (session, runs) in later {
            let (held, refused): (Vec<&Run>, Vec<&Run>) =
                runs.iter().partition(|run| self.identified.model.valid_in(&run.data.mounting).is_ok());
            untrusted.extend(refused.iter().map(|run| run.data.name.clone()));
            if !held.is_empty() {
                self.one(*session, &held, block, out)?;
            }
        }
        Ok(untrusted)
    }

    fn one(&self, session: u32, runs: &[&Run], block: &mut Diagnosis, out: &Path) -> Result<(), Failure> {
        let Identified { model, identification, .. } = self.identified;
        let (find, judge) = split::find_and_judge(runs, &mut block.notes);
        let prepare = |runs: &[Run]| pipeline::experiments_of(model, &runs.iter().collect::<Vec<_>>(), self.settings);
        let (find, unseen) = (prepare(&find)?, prepare(&judge)?);
        // Within one session, an effect is there or it is not.
        let trials = Trial::in_turn(&find);
        let changes = reference::changes(model, Some(&identification.covariance), &trials, self.diagnosis, &|_| {});
        let stored = Stored { model, changes: &changes.effects };
        let unseen: Vec<(&Experiment, u32)> = unseen.iter().map(|experiment| (experiment, session)).collect();
        let kept = stored.held(&unseen).map_err(Failure::job)?;
        let comparison = Comparison {
            changes: &changes,
            stored: model,
            kept: &kept,
            declared: runs.first().map(|run| run.data.mounting),
            band: Band::Filtered { cutoff: self.settings.torque_cutoff },
            since: format!("session {}", self.session),
            runs: judge.iter().map(|run| run.data.name.clone()).collect(),
        };
        let compared = stored.compared(&kept, &unseen).map_err(Failure::job)?;
        let mut own = comparison.diagnosis(&compared);
        block.take_what_goes_on(&mut own.effects, &format!("since session {session}"));
        own.effects.iter_mut().for_each(|effect| effect.since_session = Some(session));
        for Changes { session: of, effects, .. } in &mut own.changes {
            *of = format!("session {session}");
            effects.clone_from(&own.effects);
        }
        if !own.effects.is_empty() && matches!(block.verdict, Verdict::NothingSignificant | Verdict::NotDetermined) {
            block.verdict = own.verdict;
        }
        block.effects.append(&mut own.effects);
        block.notes.append(&mut own.notes);
        block.changes.append(&mut own.changes);
        if kept.is_empty() {
            return Ok(());
        }
        let name = format!("model-session-{session}.toml");
        let source = format!("the model of session {} with what changed by session {session}", self.session);
        let file = ModelFile {
            model: stored.with(&kept, session).map_err(Failure::job)?,
            noise_floor: identification.rms.noise_floor.clone().unwrap_or_default(),
            validation: Vec::new(),
            uncertainty: None,
            consistent: None,
            provenance: Provenance { source: Some(source), ..crate::analysis::provenance(self.robot, None) },
        };
        block.notes.push(format!("the arm as it is in session {session}: {name}"));
        std::fs::create_dir_all(out).map_err(|error| Failure::job(format!("{}: {error}", out.display())))?;
        crate::atomic::write_result(&out.join(name), file.to_toml().as_bytes())
    }
}
