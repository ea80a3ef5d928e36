//! Faults on demand: of the network between robot and client, and of the robot.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::str::FromStr;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Of {
    /// Both, each by itself.
    #[default]
    Both,
    States,
    Commands,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Datagrams are lost, by this chance.
    Loss(f64),
    /// Datagrams arrive so much later \[s\]. Commands are used once a millisecond, so their delay ends with one.
    Delay(f64),
    /// Datagrams arrive up to so much later, evenly spread, and out of order where that reaches beyond the next \[s\].
    Jitter(f64),
    /// Datagrams arrive twice, by this chance.
    Duplicate(f64),
    /// Datagrams arrive behind their successor, by this chance.
    Reorder(f64),
    /// Datagrams are cut off somewhere, by this chance.
    Truncate(f64),
    /// Datagrams are random bytes of random length instead, by this chance.
    Garbage(f64),
    /// The TCP connection is reset, once.
    TcpReset,
    /// The robot sends no states and takes no commands; the TCP connection stays open.
    Silence,
    /// Connect is answered as by a robot of this version.
    WrongVersion(u16),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// So long after the emulator's own start, or after the control line that brought it \[s\].
    After(f64),
    /// So long into the next motion \[s\].
    IntoMotion(f64),
}

/// A fault, when it begins and how long it lasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    pub kind: Kind,
    pub start: Start,
    /// How long it lasts \[s\]; for good without it.
    pub lasts: Option<f64>,
    pub of: Of,
}

impl Fault {
    /// A fault that is there from now on and strikes everything.
    pub fn now(kind: Kind) -> Fault {
        Fault { kind, start: Start::After(0.0), lasts: None, of: Of::Both }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is not a fault ({why}); expected KIND[=VALUE][,at=SECONDS|motion[+SECONDS]][,for=SECONDS][,of=states|commands], KIND one of \
     loss, delay, jitter, duplicate, reorder, truncate, garbage, tcp-reset, silence, wrong-version"
)]
pub struct NotAFault {
    text: String,
    why: &'static str,
}

impl FromStr for Fault {
    type Err = NotAFault;

    /// `loss=0.2,at=motion,for=2`; parts may be separated by spaces, seconds may end in `s`.
    fn from_str(text: &str) -> Result<Fault, NotAFault> {
        let wrong = |why| NotAFault { text: text.into(), why };
        let seconds = |value: &str| {
            let number = value.strip_suffix('s').unwrap_or(value).parse::<f64>().ok();
            number.filter(|number| number.is_finite() && *number >= 0.0).ok_or(wrong("a time that is none"))
        };
        let mut parts = text.split([',', ' ']).filter(|part| !part.is_empty());
        let first = parts.next().ok_or(wrong("it is empty"))?;
        let (name, value) = first.split_once('=').map_or((first, None), |(name, value)| (name, Some(value)));
        let chance = || {
            let number = value.ok_or(wrong("the chance is missing"))?.parse::<f64>().ok();
            number.filter(|number| (0.0..=1.0).contains(number)).ok_or(wrong("a chance is 0 to 1"))
        };
        let length = || seconds(value.ok_or(wrong("the time is missing"))?);
        let kind = match name {
            "loss" => Kind::Loss(chance()?),
            "delay" => Kind::Delay(length()?),
            "jitter" => Kind::Jitter(length()?),
            "duplicate" => Kind::Duplicate(chance()?),
            "reorder" => Kind::Reorder(chance()?),
            "truncate" => Kind::Truncate(chance()?),
            "garbage" => Kind::Garbage(chance()?),
            "tcp-reset" => Kind::TcpReset,
            "silence" => Kind::Silence,
            "wrong-version" => {
                let number = value.and_then(|value| value.parse().ok());
                Kind::WrongVersion(number.ok_or(wrong("the version is missing"))?)
            }
            _ => return Err(wrong("an unknown kind")),
        };
        let mut fault = Fault::now(kind);
        for part in parts {
            match part.split_once('=') {
                Some(("at", "motion")) => fault.start = Start::IntoMotion(0.0),
                Some(("at", value)) => {
                    fault.start = match value.strip_prefix("motion+") {
                        Some(value) => Start::IntoMotion(seconds(value)?),
                        None => Start::After(seconds(value)?),
                    }
                }
                Some(("for", value)) => fault.lasts = Some(seconds(value)?),
                Some(("of", "states")) => fault.of = Of::States,
                Some(("of", "commands")) => fault.of = Of::Commands,
                _ => return Err(wrong("an unknown part")),
            }
        }
        Ok(fault)
    }
}

/// A fault that has been given to the injector, in the robot's time \[ms\].
#[derive(Clone, Copy, Debug)]
struct Given {
    fault: Fault,
    since: u64,
    from: Option<u64>,
    struck: bool,
}

impl Given {
    fn is_on(&self, now: u64) -> bool {
        let ends = |from: u64| self.fault.lasts.map_or(u64::MAX, |lasts| from + milliseconds(lasts));
        self.from.is_some_and(|from| from <= now && now < ends(from))
    }
}

fn milliseconds(seconds: f64) -> u64 {
    (seconds * 1e3).round() as u64
}

/// Datagrams on their way, each with the time at which it arrives \[ns\].
#[derive(Debug, Default)]
pub struct Line {
    under_way: Vec<(u64, Vec<u8>)>,
}

impl Line {
    /// The datagrams that have arrived at `now`, in the order in which they did.
    pub fn arrived(&mut self, now: u64) -> Vec<Vec<u8>> {
        let (mut arrived, rest): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.under_way).into_iter().partition(|(due, _)| *due <= now);
        self.under_way = rest;
        arrived.sort_by_key(|(due, _)| *due);
        arrived.into_iter().map(|(_, datagram)| datagram).collect()
    }

    /// When the next datagram arrives \[ns\].
    pub fn next(&self) -> Option<u64> {
        self.under_way.iter().map(|(due, _)| *due).min()
    }

    pub fn clear(&mut self) {
        self.under_way.clear();
    }
}

/// Strikes datagrams and the robot with the faults that are on.
pub struct Injector {
    given: Vec<Given>,
    now: u64,
    rng: ChaCha8Rng,
}

impl Injector {
    /// Starts at time 0; `seed` decides what chance decides.
    pub fn new(faults: &[Fault], seed: u64) -> Injector {
        let mut injector = Injector { given: Vec::new(), now: 0, rng: ChaCha8Rng::seed_from_u64(seed ^ 0xfa17) };
        faults.iter().for_each(|fault| injector.give(*fault));
        injector
    }

    pub fn give(&mut self, fault: Fault) {
        let from = match fault.start {
            Start::After(seconds) => Some(self.now + milliseconds(seconds)),
            Start::IntoMotion(_) => None,
        };
        self.given.push(Given { fault, since: self.now, from, struck: false });
    }

    pub fn heal(&mut self) {
        self.given.clear();
    }

    /// One millisecond of the robot's time; `motion` is the duration of the present motion \[ms\].
    pub fn tick(&mut self, now: u64, motion: Option<u64>) {
        self.now = now;
        for given in &mut self.given {
            if let (None, Start::IntoMotion(seconds), Some(run)) = (given.from, given.fault.start, motion)
                && run >= milliseconds(seconds)
                && now >= given.since
            {
                given.from = Some(now);
            }
        }
    }

    fn on(&self) -> impl Iterator<Item = &Fault> {
        self.given.iter().filter(|given| given.is_on(self.now)).map(|given| &given.fault)
    }

    /// Whether the robot sends and receives nothing.
    pub fn is_silent(&self) -> bool {
        self.on().any(|fault| fault.kind == Kind::Silence)
    }

    /// Whether commands may arrive later than they come.
    pub fn delays_commands(&self) -> bool {
        let delays = |kind| matches!(kind, Kind::Delay(_) | Kind::Jitter(_) | Kind::Reorder(_));
        self.on().any(|fault| fault.of != Of::States && delays(fault.kind))
    }

    /// The version that Connect is answered with instead of the true one.
    pub fn version(&self) -> Option<u16> {
        self.on().find_map(|fault| match fault.kind {
            Kind::WrongVersion(version) => Some(version),
            _ => None,
        })
    }

    /// Whether the TCP connection is to be reset now; once per fault.
    pub fn resets(&mut self) -> bool {
        let now = self.now;
        let due = |given: &&mut Given| given.fault.kind == Kind::TcpReset && !given.struck && given.is_on(now);
        self.given.iter_mut().find(due).map(|given| given.struck = true).is_some()
    }

    /// Puts a datagram on its line at time `now` \[ns\].
    pub fn send(&mut self, of: Of, now: u64, mut datagram: Vec<u8>, line: &mut Line) {
        let (mut due, mut copies) = (now, 1);
        let on: Vec<Fault> = self.on().copied().filter(|fault| fault.of == Of::Both || fault.of == of).collect();
        for fault in on {
            let rng = &mut self.rng;
            let mut strikes = |chance: f64| rng.random::<f64>() < chance;
            match fault.kind {
                Kind::Loss(chance) if strikes(chance) => copies = 0,
                Kind::Duplicate(chance) if strikes(chance) => copies *= 2,
                // A millisecond and a half later, the next one has just gone.
                Kind::Reorder(chance) if strikes(chance) => due += 1_500_000,
                Kind::Truncate(chance) if strikes(chance) => {
                    let length = self.rng.random_range(0..datagram.len().max(1));
                    datagram.truncate(length);
                }
                Kind::Garbage(chance) if strikes(chance) => {
                    let length = self.rng.random_range(0..=datagram.len());
                    datagram.truncate(length);
                    self.rng.fill(datagram.as_mut_slice());
                }
                Kind::Delay(seconds) => due += (seconds * 1e9) as u64,
                Kind::Jitter(seconds) => due += (self.rng.random::<f64>() * seconds * 1e9) as u64,
                _ => {}
            }
        }
        (0..copies).for_each(|_| line.under_way.push((due, datagram.clone())));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> Fault {
        text.parse().unwrap_or_else(|error| panic!("{error}"))
    }

    #[test]
    fn reads_what_people_write() {
        assert_eq!(fault("loss=0.2"), Fault::now(Kind::Loss(0.2)));
        let rich = fault("jitter=0.003s at=motion+0.5 for=2s of=states");
        let expected =
            Fault { kind: Kind::Jitter(0.003), start: Start::IntoMotion(0.5), lasts: Some(2.0), of: Of::States };
        assert_eq!(rich, expected);
        assert_eq!(fault("tcp-reset,at=motion").start, Start::IntoMotion(0.0));
        assert_eq!(fault("wrong-version=4").kind, Kind::WrongVersion(4));
        for wrong in ["", "loss", "loss=2", "loss=NaN", "delay=-1", "noise=1", "loss=0.1,at=x", "loss=0.1,when=2"] {
            assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
        }
    }

    /// Sends `count` numbered datagrams a millisecond apart and returns what arrives, with its time \[ms\].
    fn sent(faults: &[Fault], count: u64) -> Vec<(f64, Vec<u8>)> {
        let mut injector = Injector::new(faults, 1);
        let mut line = Line::default();
        let mut arrived = Vec::new();
        for tick in 0..count * 20 {
            let now = tick * 50_000;
            if tick % 20 == 0 && tick / 20 < count {
                injector.tick(tick / 20, None);
                injector.send(Of::States, now, (tick / 20).to_le_bytes().to_vec(), &mut line);
            }
            arrived.extend(line.arrived(now).into_iter().map(|datagram| (now as f64 * 1e-6, datagram)));
        }
        arrived
    }

    fn numbers(arrived: &[(f64, Vec<u8>)]) -> Vec<u64> {
        arrived.iter().map(|(_, bytes)| u64::from_le_bytes(bytes.as_slice().try_into().expect("whole"))).collect()
    }

    #[test]
    fn each_kind_does_what_it_says() {
        let plain = sent(&[], 100);
        assert_eq!(numbers(&plain), (0..100).collect::<Vec<_>>());
        let lost = sent(&[fault("loss=0.3,at=0.1,for=0.7")], 1000);
        assert!((700 + 60..=1000 - 140).contains(&lost.len()), "{}", lost.len());
        let lost = numbers(&lost);
        assert!((0..100).chain(800..1000).all(|k| lost.contains(&k)), "outside its time nothing is lost");
        let late = sent(&[fault("delay=0.005")], 100);
        assert!(late.iter().zip(numbers(&late)).all(|((at, _), sent)| (at - sent as f64 - 5.0).abs() < 0.1));
        let jitter = sent(&[fault("jitter=0.004")], 1000);
        let delays: Vec<f64> = jitter.iter().zip(numbers(&jitter)).map(|((at, _), sent)| at - sent as f64).collect();
        assert!(delays.iter().all(|delay| (-0.01..=4.06).contains(delay)));
        assert!(delays.iter().any(|delay| *delay > 3.5) && !numbers(&jitter).is_sorted());
        let twice = numbers(&sent(&[fault("duplicate=1")], 10));
        assert_eq!(twice, (0..10).flat_map(|k| [k, k]).collect::<Vec<_>>());
        let swapped = numbers(&sent(&[fault("reorder=0.2")], 500));
        assert!(swapped.len() == 500 && !swapped.is_sorted());
        let cut = sent(&[fault("truncate=1")], 100);
        assert!(cut.iter().all(|(_, bytes)| bytes.len() < 8));
        let garbage = sent(&[fault("garbage=1")], 100);
        assert!(garbage.iter().zip(&plain).filter(|(a, b)| a.1 == b.1).count() < 2);
        let commands_only = sent(&[fault("loss=1,of=commands")], 10);
        assert_eq!(commands_only.len(), 10);
    }

    #[test]
    fn a_fault_waits_for_the_motion_and_a_reset_strikes_once() {
        let mut injector = Injector::new(&[fault("tcp-reset,at=motion+0.01"), fault("silence,at=motion,for=0.005")], 1);
        let mut resets = Vec::new();
        let mut silent = Vec::new();
        for now in 0..100 {
            injector.tick(now, (now >= 50).then(|| now - 50));
            if injector.resets() {
                resets.push(now);
            }
            if injector.is_silent() {
                silent.push(now);
            }
        }
        assert_eq!(resets, [60]);
        assert_eq!(silent, [50, 51, 52, 53, 54]);
    }
}
