//! What came while a model was served: earlier models that hold again, searches among the known effects, and proposals.

use super::log::{Event, Stretch};
use super::{CHANGE_MARGIN_S, Known, Live, OfferedModel, REFINED_S, Verdict, hex, list};
use crate::config::job::Adopt;
use crate::failure::Failure;
use crate::report::diagnosis::Effect;
use crate::store::{ModelFile, Provenance, model_identity};
use plumbline_core::threads;
use plumbline_diagnose::live::{self, Floor, Found, Remedy, Watch};
use plumbline_diagnose::reference;
use plumbline_identify::Experiment;
use plumbline_ipc::Proposal;
use plumbline_model::TorqueModel;
use std::thread::JoinHandle;

/// Time after a change after which an earlier model is tried again \[s\].
const RETURN_S: f64 = 2.0;
/// Time of a motion on which an earlier model holds again, where nothing explains what came \[s\].
const HELD_S: f64 = 4.0;
/// Samples of a search, as a ratio to those of the one before.
const GROWTH: f64 = 1.5;
/// Models that an arm may come back to.
const MAX_MODELS: usize = 32;

/// A change that the model before it does not have.
#[derive(Clone, Copy)]
pub(super) struct Change {
    /// When it came \[s\].
    pub(super) since: f64,
    /// Identity of the model that held before.
    pub(super) before: u64,
    /// Time of samples after it that the next search waits for \[s\].
    pub(super) wanted: f64,
    /// Whether earlier models were tried.
    pub(super) returned: bool,
    /// Since when the model that was found for it does not hold, where that was found from few samples \[s\].
    pub(super) doubted: Option<f64>,
}

impl Change {
    pub(super) fn new(since: f64, before: u64, wanted: f64) -> Change {
        Change { since, before, wanted, returned: false, doubted: None }
    }
}

/// A search for a change, in its own thread.
pub(super) struct Search {
    /// Start of the search \[s\].
    t: f64,
    change: Change,
    /// Model that was served at the start.
    model: u64,
    found: JoinHandle<Found>,
}

impl Live {
    /// Looks for the change: first whether an earlier model holds again, then among the known effects, again whenever there are half as many samples more
    /// since it came. What was found is refined like that.
    pub(super) fn search(&mut self) -> Result<Option<OfferedModel>, Failure> {
        if let Some(offer) = self.came_back()? {
            return Ok(Some(offer));
        }
        let Some(mut change) = self.change.filter(|_| self.searching.is_none() && !self.silent) else {
            return Ok(None);
        };
        let found = self.serving != change.before || self.proposed.is_some_and(|_| self.adopt == Adopt::Ask);
        if !change.returned && !found && self.buffer.len() - self.after(change.since) >= self.samples(RETURN_S) {
            // There is more to see of the change now than at the alarm; but its torque may have passed through zero meanwhile.
            let near = |since: &f64| *since < change.since + CHANGE_MARGIN_S;
            let since = self.onset(change.since).filter(near).unwrap_or(change.since);
            change = Change { since, returned: true, ..change };
            let first = self.after(change.since);
            self.change = Some(change);
            if let Some(offer) = self.earlier(change.since, first, Watch::floor)? {
                return Ok(Some(offer));
            }
        }
        let after = self.after(change.since);
        let count = self.buffer.len() - after;
        if count < self.samples(change.wanted) && change.doubted.is_none() {
            return Ok(None);
        }
        // Once more, with more samples.
        if let Some(offer) = if found { None } else { self.earlier(change.since, after, Watch::floor)? } {
            return Ok(Some(offer));
        }
        if self.begin_search(change, after) {
            let wanted = if change.doubted.is_some() { change.wanted } else { GROWTH * change.wanted };
            self.change = (change.wanted < REFINED_S).then_some(Change { wanted, doubted: None, ..change });
        } else {
            // Where the arm rested too long for a search, the next samples will do.
            self.is_another(change);
        }
        self.collect(self.wait_for_search)
    }

    /// Proposes an earlier model where what came has not been explained, and is gone.
    fn came_back(&mut self) -> Result<Option<OfferedModel>, Failure> {
        let named = self.change.is_some_and(|change| change.before != self.serving);
        let first = self.buffer.len().saturating_sub(self.samples(HELD_S) + 2 * self.edge());
        if self.unexplained.is_none()
            || named
            || first == 0
            || self.searching.is_some()
            || self.silent
            || self.proposed.is_some()
        {
            return Ok(None);
        }
        let offer = self.earlier(self.buffer[first].state.time, first, Watch::usual)?;
        self.unexplained = self.unexplained.filter(|_| offer.is_none());
        Ok(offer)
    }

    /// Starts a search among the known effects with the samples from `first` on; false where they are too few.
    fn begin_search(&mut self, change: Change, first: usize) -> bool {
        let end = self.buffer.len();
        let middle = first + live::divide(end - first);
        // Of a model that is doubted the last samples tell most.
        let (find, judge) = if change.doubted.is_some() { (end, first) } else { (middle, middle) };
        let parts = self.prepared(first, find).zip(self.prepared(judge, end));
        let served = self.proposed.filter(|_| self.adopt == Adopt::Ask).map_or(self.serving, |(id, _)| id);
        let models = self.model(change.before).cloned().zip(self.model(served).cloned());
        let floor = self.watch.as_ref().map(|watch| watch.floor().clone());
        let Some((((find, judge), (lost, served)), floor)) = parts.zip(models).zip(floor) else { return false };
        let settings = plumbline_diagnose::Settings { threads: threads(), ..plumbline_diagnose::Settings::default() };
        // The search has its own thread: samples have to be acknowledged meanwhile.
        let found = std::thread::spawn(move || live::search(&lost, &served, &find, &judge, &floor, &settings));
        self.searching = Some(Search { t: self.now(), change, model: self.serving, found });
        true
    }

    /// Where a model is doubted and none with one change since then holds, something else has come.
    fn is_another(&mut self, change: Change) {
        if let Some(since) = change.doubted {
            self.change = Some(Change::new(since, self.serving, self.window));
        }
    }

    /// Proposes an earlier model that predicts the samples from `first` on, the latest first.
    fn earlier(
        &mut self,
        since: f64,
        first: usize,
        floor: impl Fn(&Watch) -> &Floor,
    ) -> Result<Option<OfferedModel>, Failure> {
        let (Some(experiment), Some(watch)) = (self.prepared(first, self.buffer.len()), &self.watch) else {
            return Ok(None);
        };
        // One that was offered is not served at once.
        let is_new = |id: u64| id == self.serving || self.proposed.is_some_and(|(proposed, _)| id == proposed);
        let holds = |known: &&Known| !is_new(known.id) && live::holds(&known.model, &experiment, floor(watch), 0.0);
        let Some(known) = self.models.iter().rev().find(holds) else { return Ok(None) };
        let errors = |model: &TorqueModel| {
            let residual = live::residual(model, &experiment);
            live::rms(&residual, 0..residual.nrows())
        };
        let (toml, id) = (known.toml.clone(), known.id);
        let after = errors(&known.model);
        let Some(before) = self.model(self.serving).map(errors) else { return Ok(None) };
        let what = format!("as it was: model {} holds again", hex(id));
        self.change = None;
        self.offer(self.now(), since, id, what, Vec::new(), [before, after], toml).map(Some)
    }

    /// Returns the result of an ended search; with `wait`, blocks until its end.
    pub fn collect(&mut self, wait: bool) -> Result<Option<OfferedModel>, Failure> {
        let done = self.searching.take_if(|one| wait || one.found.is_finished());
        let Some(Search { t, change, model, found }) = done else { return Ok(None) };
        let Change { since, before, .. } = change;
        let found = found.join().map_err(|_| Failure::job("the search for a change panicked"))?;
        if model != self.serving {
            return Ok(None);
        }
        let refines = |found: &Found| matches!(found, Found::Remedy(remedy) if self.refines(change, remedy));
        if change.doubted.is_some() && !refines(&found) {
            self.is_another(change);
            return Ok(None);
        }
        let offer = match found {
            Found::Remedy(remedy) => Some(self.propose(t, since, before, *remedy)?),
            // What is served is as good as what more samples tell.
            Found::Nothing { .. } if before != self.serving || self.proposed.is_some() => None,
            Found::Nothing { tried, before: rms } => {
                tracing::warn!("no known change explains the error of {}", list(&rms));
                let doubt = Some(format!("since {since:.1} s no known change explains the error of {} Nm", list(&rms)));
                self.verdict = Some(Verdict { model, doubt });
                self.log.events.push(Event::Unexplained { t, tried, rms });
                self.watch_beside(since);
                None
            }
        };
        self.write()?;
        Ok(offer)
    }

    /// Lets the watch look for another change beside the one that nothing explains.
    fn watch_beside(&mut self, since: f64) {
        self.unexplained = Some(since);
        let model = hex(self.serving);
        let of_it = |stretch: &&Stretch| stretch.start >= since && stretch.model == model;
        let stretches: Vec<Vec<f64>> =
            self.log.stretches.iter().filter(of_it).map(|stretch| stretch.rms.clone()).collect();
        let rms = Floor::from_stretches(&stretches).usual;
        self.watch.iter_mut().for_each(|watch| watch.set_unexplained(&rms));
    }

    /// Whether a model that was fitted to all samples since a change holds ever since it came, and since the one that is served is doubted.
    fn refines(&self, change: Change, remedy: &Remedy) -> bool {
        let first = self.after(change.since);
        let last = self.now() - change.doubted.unwrap_or(change.since);
        let holds =
            |(experiment, watch): (Experiment, &Watch)| live::holds(&remedy.model, &experiment, watch.floor(), last);
        self.prepared(first, self.buffer.len()).zip(self.watch.as_ref()).is_some_and(holds)
    }

    fn propose(&mut self, t: f64, since: f64, lost: u64, remedy: Remedy) -> Result<OfferedModel, Failure> {
        let Remedy { changes, model, before, after, deviations } = remedy;
        let what = changes.iter().map(reference::Change::line).collect::<Vec<_>>().join("; ");
        let source = format!("live, since {since:.1} s: {what}");
        let file = ModelFile {
            model,
            noise_floor: self.noise_floor.clone(),
            validation: Vec::new(),
            uncertainty: None,
            consistent: None,
            provenance: Provenance { source: Some(source), ..crate::analysis::provenance(&self.robot, None) },
        };
        let toml = file.to_toml();
        crate::atomic::write_result(&self.out.join("model-live.toml"), toml.as_bytes())?;
        let effects = self.effects(lost, &changes);
        let id = model_identity(&toml);
        self.models.push(Known { id, model: file.model, toml: toml.clone(), deviations });
        // The identified model, the one that is served and the one before the change stay.
        let old = |known: &Known| known.id != self.serving && known.id != lost;
        if let Some(oldest) = self.models[1..].iter().position(old).filter(|_| self.models.len() > MAX_MODELS) {
            self.models.remove(1 + oldest);
        }
        self.offer(t, since, id, what, effects, [before, after], toml)
    }

    #[allow(clippy::too_many_arguments, reason = "one proposal, told to the log, the report and the daemon")]
    fn offer(
        &mut self,
        t: f64,
        since: f64,
        id: u64,
        what: String,
        effects: Vec<Effect>,
        [before, after]: [Vec<f64>; 2],
        toml: String,
    ) -> Result<OfferedModel, Failure> {
        let usual = self.watch.as_ref().map_or(vec![1.0; self.joints], |watch| watch.usual().usual.clone());
        let worst = live::worst(&before, &usual).unwrap_or(0);
        let asks = if self.adopt == Adopt::Ask { ", if adopted" } else { "" };
        self.notes.push(format!(
            "live: since {since:.1} s: {what}; error in joint {} {:.3} -> {:.3} Nm with model {id:016x}{asks}",
            worst + 1,
            before[worst],
            after[worst]
        ));
        let (of_worst, left) = (before[worst], after[worst]);
        let model = hex(id);
        self.log.events.push(Event::Proposed { t, since, model, what: what.clone(), effects, before, after });
        self.proposed = Some((id, since));
        let proposal = Proposal { what, since, joint: worst + 1, before: of_worst, after: left };
        Ok(OfferedModel { toml, proposal })
    }

    fn effects(&self, lost: u64, changes: &[reference::Change]) -> Vec<Effect> {
        let Some(model) = self.model(lost) else { return Vec::new() };
        changes.iter().map(|change| change.effect(model, Some(&self.mounting), true)).collect()
    }
}
