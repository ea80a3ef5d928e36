//! The external torque of an identified model on an unseen motion: interval, false alarms, pushes. A part of `cargo bench --bench external`.

use plumbline_identify::external::ObserverSettings;
use plumbline_model::Mounting;
use plumbline_testkit::scene::external::{Bench, found_after};

#[test]
fn intervals_cover_no_alarm_is_false_and_a_push_of_2_newton_is_found_in_50_ms() {
    let bench = Bench::new(0.1);
    let found = bench.identify(&bench.record(&bench.response(false, 4, Mounting::WALL), Mounting::WALL, 3));
    let mut observer = found.observer(Mounting::WALL, ObserverSettings::default());
    let (mut inside, mut count, mut alarms) = (0, 0, 0);
    bench.response(true, 3, Mounting::WALL).measure(77, |_, _, state| {
        let external = observer.next(&state.q, &state.dq, &state.tau);
        alarms += u32::from(external.contact);
        if external.settled {
            count += 7;
            inside += (0..7).filter(|&j| external.tau[j].abs() <= external.half_width[j]).count();
        }
    });
    assert_eq!(alarms, 0);
    let share = inside as f64 / f64::from(count);
    // Coloured noise: 30 s have about 100 independent samples per joint.
    assert!((0.92..0.98).contains(&share), "{share}");

    // Without the coloured noise, which is not that of the shipped arm.
    let bench = Bench::new(0.0);
    let found = bench.identify(&bench.record(&bench.response(false, 4, Mounting::WALL), Mounting::WALL, 4));
    let in_time = |(states, pushed): &(_, usize)| {
        let mut observer = found.observer(Mounting::WALL, ObserverSettings::default());
        found_after(states, *pushed, |[q, dq, tau]| observer.next(q, dq, tau).contact).is_some_and(|ms| ms <= 50)
    };
    let pushes = bench.pushed(2.0, 1, Mounting::WALL);
    let in_time = pushes.iter().filter(|trial| in_time(trial)).count();
    assert!(in_time >= 9, "{in_time} of {}", pushes.len());
}
