//! The arm's reference between two commands: position, velocity and acceleration by its own differences, once per millisecond.

/// The arm's cycle \[s\].
pub(super) const TICK: f64 = plumbline_core::PERIOD_S;

/// A commanded point with the derivatives that the arm makes of it: `dq = (q - q_last) / T`, `ddq = (dq - dq_last) / T`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Point {
    /// \[rad\]
    pub q: [f64; 7],
    /// \[rad/s\]
    pub dq: [f64; 7],
    /// \[rad/s2\]
    pub ddq: [f64; 7],
}

impl Point {
    /// At rest at `q`.
    pub fn at_rest(q: [f64; 7]) -> Point {
        Point { q, ..Point::default() }
    }

    /// The point one cycle on, where `q` is commanded.
    pub fn step_to(&self, q: &[f64; 7]) -> Point {
        let mut next = Point::at_rest(*q);
        for (j, q) in q.iter().enumerate() {
            next.dq[j] = (q - self.q[j]) / TICK;
            next.ddq[j] = (next.dq[j] - self.dq[j]) / TICK;
        }
        next
    }

    /// The point `ticks` cycles on, where the arm got no command: it extrapolates at constant acceleration.
    pub fn after(&self, ticks: u64) -> Point {
        let mut next = *self;
        // The sum of the same steps that the arm makes: q += n T dq + n (n + 1) / 2 T^2 ddq.
        let n = ticks as f64;
        for j in 0..7 {
            next.dq[j] += n * TICK * self.ddq[j];
            next.q[j] += n * TICK * self.dq[j] + 0.5 * n * (n + 1.0) * TICK * TICK * self.ddq[j];
        }
        next
    }

    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        self.q.iter().chain(&self.dq).chain(&self.ddq).all(|value| value.is_finite())
    }

    /// Whether nothing moves.
    pub fn rests(&self) -> bool {
        self.dq.iter().chain(&self.ddq).all(|value| *value == 0.0)
    }
}

/// Commands kept: more than the arm may miss.
const MAX_KEPT: usize = 32;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sent {
    /// Number of the state that it answered.
    id: u64,
    /// When it left, `CLOCK_MONOTONIC` \[ns\].
    at_ns: u64,
    point: Point,
    /// Whether the arm has shown it.
    seen: bool,
}

/// The arm's reference in a state, by the commands before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Followed {
    /// The arm's reference.
    pub point: Point,
    /// Cycles extrapolated since the command that the arm followed last.
    pub missed: u64,
    /// Whether `point` is our own in double precision; otherwise it is the state's.
    pub own: bool,
    /// When the command left that this state is the first to show \[ns\]; only where it differs from the one before.
    pub shown_ns: Option<u64>,
    /// Whether the newest command was sent in answer to the state before, and the arm did not use it.
    pub late: bool,
}

/// The commands sent last, and where the motion began.
#[derive(Clone, Copy, Debug)]
pub(super) struct Commands {
    ring: [Sent; MAX_KEPT],
    count: usize,
    start: Point,
    /// How far a state's `q_d` may be off what was sent \[rad\].
    tolerance: f64,
}

impl Commands {
    /// A motion that begins at rest at `q_d`. `tolerance` is the rounding of states \[rad\].
    pub fn new(q_d: [f64; 7], tolerance: f64) -> Commands {
        Commands { ring: [Sent::default(); MAX_KEPT], count: 0, start: Point::at_rest(q_d), tolerance }
    }

    /// The command sent last.
    pub fn newest(&self) -> Option<&Point> {
        self.back(0).map(|sent| &sent.point)
    }

    /// Number of the state that was answered last.
    pub fn answered(&self) -> Option<u64> {
        self.back(0).map(|sent| sent.id)
    }

    /// Takes in a command that left.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn push(&mut self, id: u64, at_ns: u64, point: Point) {
        if let Some(slot) = self.ring.get_mut(self.count % MAX_KEPT) {
            *slot = Sent { id, at_ns, point, seen: false };
        }
        self.count = self.count.wrapping_add(1);
    }

    fn back(&self, age: usize) -> Option<&Sent> {
        if age >= self.count.min(MAX_KEPT) { None } else { self.ring.get((self.count - 1 - age) % MAX_KEPT) }
    }

    /// Which of the commands the arm is following in state `id`, newest first: each of them predicts where the arm is now, if it was
    /// the last one to arrive. `state` is the arm's own reference, used where no command explains it.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn follow(&mut self, id: u64, state: &Point) -> Followed {
        let Some(newest) = self.back(0).copied() else {
            let own = self.agrees(&self.start, state);
            let point = if own || !state.is_finite() { self.start } else { *state };
            return Followed { point, missed: 0, own, shown_ns: None, late: false };
        };
        let answered_last = newest.id + 1 == id;
        for age in 0..self.count.min(MAX_KEPT) {
            let Some(sent) = self.back(age).copied() else { break };
            let Some(missed) = id.checked_sub(sent.id + 1) else { continue };
            if missed as usize > MAX_KEPT {
                break;
            }
            let point = sent.point.after(missed);
            if self.agrees(&point, state) {
                let shown_ns = if missed == 0 { self.first_shown(age) } else { None };
                return Followed { point, missed, own: true, shown_ns, late: answered_last && age > 0 };
            }
            // An arm that shows commands a cycle later: the newest one is still to be used, and the next continues from it.
            if missed == 1 && age == 1 && answered_last && self.agrees(&sent.point, state) {
                let shown_ns = self.first_shown(age);
                return Followed { point: newest.point, missed: 0, own: true, shown_ns, late: false };
            }
        }
        let missed = id.saturating_sub(newest.id + 1);
        // An arm that takes a late command when it comes, instead of dropping it.
        if missed > 0 && self.agrees(&newest.point, state) {
            return Followed { point: newest.point, missed, own: true, shown_ns: self.first_shown(0), late: true };
        }
        // A state with a NaN shows nothing.
        let point = if state.is_finite() { *state } else { newest.point.after(missed) };
        Followed { point, missed, own: false, shown_ns: None, late: answered_last }
    }

    /// When the command left, if no state has shown it yet and it differs from the one before.
    fn first_shown(&mut self, age: usize) -> Option<u64> {
        let before = self.back(age + 1).map_or(self.start.q, |sent| sent.point.q);
        let index = (self.count - 1 - age) % MAX_KEPT;
        let sent = self.ring.get_mut(index)?;
        let first = !sent.seen;
        sent.seen = true;
        let differs = sent.point.q.iter().zip(&before).any(|(a, b)| (a - b).abs() > 2.0 * self.tolerance);
        (first && differs).then_some(sent.at_ns)
    }

    fn agrees(&self, point: &Point, state: &Point) -> bool {
        point.q.iter().zip(&state.q).all(|(own, reported)| (own - reported).abs() <= self.tolerance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const Q: [f64; 7] = [0.1, -0.4, 0.2, -2.0, 0.3, 1.8, 0.5];
    const F64: f64 = 1e-9;
    const F32: f64 = 3e-7;

    /// A smooth motion, command by command.
    fn motion(tick: u64) -> [f64; 7] {
        let t = tick as f64 * TICK;
        Q.map(|q| q + 0.2 * (1.0 - (3.0 * t).cos()) + 0.05 * t.powi(3))
    }

    fn rounded(point: &Point) -> Point {
        let round = |values: &[f64; 7]| values.map(|value| f64::from(value as f32));
        Point { q: round(&point.q), dq: round(&point.dq), ddq: round(&point.ddq) }
    }

    #[test]
    fn going_on_alone_is_the_same_as_stepping_at_constant_acceleration() {
        let mut point = Point::at_rest(Q).step_to(&Q.map(|q| q + 1e-5)).step_to(&Q.map(|q| q + 3e-5));
        let far = point.after(7);
        for _ in 0..7 {
            let q = std::array::from_fn(|j| point.q[j] + TICK * (point.dq[j] + TICK * point.ddq[j]));
            point = point.step_to(&q);
        }
        for j in 0..7 {
            assert!((far.q[j] - point.q[j]).abs() < 1e-12 && (far.dq[j] - point.dq[j]).abs() < 1e-9);
        }
    }

    /// An arm that gets every command but those that `lost` names, and a program that sees every state but those that `unseen` names.
    fn drive(tolerance: f64, lost: &[u64], unseen: &[u64], lag: bool) -> Vec<(u64, Followed, Point)> {
        let mut commands = Commands::new(Q, tolerance);
        let mut arm = Point::at_rest(Q);
        let mut shown = arm;
        let mut last = Point::at_rest(Q);
        let mut out = Vec::new();
        let mut pending = None;
        for id in 100..400u64 {
            if id > 100 {
                shown = arm;
                arm = match pending.take() {
                    Some(q) => arm.step_to(&q),
                    None => arm.after(1),
                };
            }
            if unseen.contains(&id) {
                continue;
            }
            let truth = if lag { shown } else { arm };
            let state = if tolerance > 1e-8 { rounded(&truth) } else { truth };
            let followed = commands.follow(id, &state);
            out.push((id, followed, truth));
            let q = motion(id - 100);
            last = if id == 100 { last } else { followed.point.step_to(&q) };
            commands.push(id, id * 1_000_000 + 200_000, last);
            if !lost.contains(&id) {
                pending = Some(last.q);
            }
        }
        out
    }

    #[test]
    fn a_healthy_arm_is_known_in_double_precision_though_it_answers_in_single() {
        for tolerance in [F64, F32] {
            for (id, followed, truth) in drive(tolerance, &[], &[], false) {
                assert!(followed.own && !followed.late && followed.missed == 0, "{id} {followed:?}");
                assert!(followed.point.q.iter().zip(&truth.q).all(|(a, b)| (a - b).abs() < 1e-12), "{id}");
                if id > 200 {
                    assert_eq!(followed.shown_ns, Some((id - 1) * 1_000_000 + 200_000));
                }
            }
        }
    }

    #[test]
    fn lost_commands_are_distinguished_from_lost_states() {
        for tolerance in [F64, F32] {
            // Commands 200, 201 and 202 never arrive; states 300 to 304 don't either.
            for (id, followed, truth) in drive(tolerance, &[200, 201, 202], &[300, 301, 302, 303, 304], false) {
                assert!(followed.own, "{id} {followed:?}");
                assert!(followed.point.q.iter().zip(&truth.q).all(|(a, b)| (a - b).abs() <= tolerance), "{id}");
                let missed = match id {
                    201..=203 => id - 200,
                    305 => 5,
                    _ => 0,
                };
                // In single precision going on missed can look like having been told so.
                if tolerance < 1e-8 {
                    assert_eq!((followed.missed, followed.late), (missed, (201..=203).contains(&id)), "{id}");
                }
            }
        }
    }

    #[test]
    fn an_arm_that_shows_commands_a_cycle_later_is_no_arm_that_loses_them() {
        let seen = drive(F64, &[], &[], true);
        let good = seen.iter().filter(|(_, followed, _)| followed.own && !followed.late).count();
        // Where the motion begins, one command can not be told from standing still.
        assert!(good + 1 >= seen.len(), "{good} of {}", seen.len());
    }

    #[test]
    fn a_late_command_that_is_taken_after_all_is_where_the_arm_goes_on_from() {
        let mut commands = Commands::new(Q, F64);
        let moving = Point { q: Q, dq: [0.3; 7], ddq: [2.0; 7] };
        commands.push(5, 1, moving);
        let followed = commands.follow(9, &moving);
        assert_eq!((followed.point, followed.own, followed.missed, followed.late), (moving, true, 3, true));
        assert_eq!(commands.follow(9, &moving.after(3)).point, moving.after(3), "unless it went on by itself");
    }

    #[test]
    fn an_arm_that_goes_its_own_way_is_believed() {
        let mut commands = Commands::new(Q, F64);
        commands.push(5, 1, Point::at_rest(Q));
        let elsewhere = Point { q: Q.map(|q| q + 0.01), dq: [0.2; 7], ddq: [1.0; 7] };
        let followed = commands.follow(8, &elsewhere);
        assert_eq!((followed.point, followed.own, followed.missed), (elsewhere, false, 2));
        let nowhere = Point { q: [f64::NAN; 7], ..elsewhere };
        assert!(commands.follow(8, &nowhere).point.is_finite());
        assert!(Commands::new(Q, F64).follow(1, &nowhere).point.is_finite());
    }
}
