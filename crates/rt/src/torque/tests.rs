use super::*;

/// The torque-rate limit \[Nm/s\]: 0.4 Nm per command, of which a hand-over uses half.
const DTAU: JointVec = [400.0; MAX_JOINTS];

/// The torque of both kinds, in every joint, is the acceleration that is asked for, and `more`.
struct Follows(u64, f64);

impl FeedForward for Follows {
    fn id(&self) -> u64 {
        self.0
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        Torque(desired.ddq.map(|ddq| ddq + self.1))
    }

    fn vendor_torque(&mut self, _: &JointVec) -> Torque {
        Torque([self.1; MAX_JOINTS])
    }
}

/// A source, and the ring of retired models with room for `room`.
fn source(room: usize) -> (TorqueSource, Producer<Retired>, rtrb::Consumer<Retired>) {
    let (retired, done) = rtrb::RingBuffer::new(room);
    (TorqueSource::new(2, &DTAU), retired, done)
}

/// The torque that is sent in joint 1 where the model needs `ddq` more than itself.
fn send(source: &mut TorqueSource, ddq: f64, braking: bool) -> (f64, Validity) {
    let answer = source.answer(&Setpoint { ddq: [ddq; MAX_JOINTS], ..Setpoint::default() }, braking);
    source.sent(&answer);
    (answer.served.tau_ff.0[0], answer.validity)
}

#[test]
fn the_model_before_replaces_a_rejected_one() {
    let mut models = Succession::default();
    assert_eq!((models.id(), models.fall_back()), (0, None::<&str>));
    assert_eq!(models.serve(1, "1"), [None; 3]);
    assert_eq!(models.serve(2, "2"), [None; 3]);
    // Another gravity of the same model: the one before stays in reserve.
    assert_eq!(models.serve(2, "2 again"), [Some("2"), None, None]);
    assert_eq!((models.fall_back(), models.id(), models.serving()), (Some("2 again"), 1, Some(&"1")));
    assert_eq!((models.fall_back(), models.id()), (Some("1"), 0));
    models.serve(3, "3");
    models.serve(4, "4");
    assert_eq!(models.serve(5, "5"), [Some("3"), None, None]);
    // None serves, and none is in reserve.
    assert_eq!(models.serve(0, "none"), [Some("5"), Some("4"), Some("none")]);
    assert_eq!((models.id(), models.fall_back()), (0, None));
}

#[test]
fn a_hand_over_uses_half_of_the_rate_limit_and_the_model_all_of_it() {
    let (mut source, mut retired, _done) = source(8);
    source.serve(Box::new(Follows(1, 0.0)), &mut retired);
    assert_eq!(send(&mut source, 5.0, false), (5.0, Validity::Valid), "nothing was sent before");
    source.serve(Box::new(Follows(2, 0.5)), &mut retired);
    let sent: Vec<(f64, Validity)> = (0..4).map(|_| send(&mut source, 5.0, false)).collect();
    let expected = [5.2, 5.4, 5.5, 5.5];
    assert!(sent.iter().zip(expected).all(|(sent, expected)| (sent.0 - expected).abs() < 1e-12), "{sent:?}");
    let validities: Vec<Validity> = sent.into_iter().map(|(_, validity)| validity).collect();
    assert_eq!(validities, [Validity::HandOver, Validity::HandOver, Validity::Valid, Validity::Valid]);
    // More than a hand-over may use; the guard checks the limit.
    assert_eq!(send(&mut source, 5.3, false), (5.8, Validity::Valid));
    assert_eq!(send(&mut source, 4.0, false), (4.5, Validity::Valid));
    // While the arm brakes the limit holds in any case.
    let (tau, validity) = send(&mut source, 9.0, true);
    assert!((tau - 4.9).abs() < 1e-12 && validity == Validity::HandOver, "{tau}");
}

#[test]
fn a_model_is_taken_over_when_the_retired_ring_has_room() {
    for (room, enough) in [(3, false), (4, true)] {
        let (mut source, mut retired, mut done) = source(8);
        (0..8 - room).for_each(|_| assert!(retired.push(Retired::Model(Box::new(Follows(9, 0.0)))).is_ok()));
        assert_eq!(source.has_room(&retired), enough, "room for {room}");
        // Models that broke a limit have to leave first, one or both.
        (0..8 - room).for_each(|_| assert!(done.pop().is_ok()));
        source.serve(Box::new(Follows(1, 0.0)), &mut retired);
        source.serve(Box::new(Follows(2, 0.0)), &mut retired);
        for left in [1, 0] {
            assert_eq!(source.fall_back(), Some((left + 1, left)));
            assert!(!source.has_room(&retired));
        }
        let (mut full, _kept) = rtrb::RingBuffer::new(1);
        source.hand_out(&mut full);
        assert!(!source.has_room(&retired), "one has left, the other is kept");
        source.hand_out(&mut full);
        assert!(!source.has_room(&retired), "it is kept as long as there is no room");
        source.hand_out(&mut retired);
        assert!(source.has_room(&retired));
        assert!(matches!(done.pop(), Ok(Retired::Model(model)) if model.id() == 1));
    }
}

#[test]
fn a_torque_source_restored_from_a_record_continues_as_the_original() {
    let (mut before, mut retired, _done) = source(8);
    let of = || Box::new(Follows(1, 0.5)) as Box<dyn FeedForward>;
    before.serve(Box::new(Follows(7, 0.0)), &mut retired);
    send(&mut before, 1.0, false);
    before.serve(of(), &mut retired);
    // During the hand-over, and after it.
    for (cycles, under_way) in [(1, true), (4, false)] {
        let sent = (0..cycles).map(|_| send(&mut before, 1.0, false)).last().unwrap();
        assert_eq!(sent.1 == Validity::HandOver, under_way);
        let desired = Setpoint { ddq: [1.0; MAX_JOINTS], ..Setpoint::default() };
        let torques = before.sent.unwrap();
        let (mut after, ..) = source(1);
        let mut models = Succession::default();
        models.serve(1, of());
        after.restore(models, &desired, torques, sent.1);
        let next = Setpoint { ddq: [1.3; MAX_JOINTS], ..Setpoint::default() };
        let [expected, found] = [&mut before, &mut after].map(|source| source.answer(&next, false));
        assert_eq!(found, expected);
        assert_eq!(found.asked.before.map(|before| before.tau_ff.0[0]), Some(1.5));
    }
    // A model was withdrawn and its torque returns to zero, or there was never one.
    for validity in [Validity::Withdrawn, Validity::None] {
        let (mut after, ..) = source(1);
        let torques = Torques { tau_ff: Torque([1.0; MAX_JOINTS]), ..Torques::default() };
        after.restore(Succession::default(), &Setpoint::default(), torques, validity);
        let answer = after.answer(&Setpoint::default(), false);
        assert_eq!((answer.validity, answer.asked), (validity, ModelTorques::default()));
        assert_eq!(answer.served.tau_ff.0[..2], [0.8; 2]);
    }
}
