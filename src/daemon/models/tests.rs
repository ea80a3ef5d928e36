use super::super::fixture::*;
use super::*;
use plumbline_ipc::{Response, Served};
use plumbline_rt::Event;

#[test]
fn a_model_that_a_loop_distrusted_is_handed_to_no_other() {
    let (mut state, _place) = new_state();
    assert!(state.models.for_loop(&Mounting::UPRIGHT).is_none(), "there is none");
    let Response::ModelAccepted { model } = ask(&mut state, offer()) else { panic!() };
    assert!(state.models.for_loop(&Mounting::UPRIGHT).is_some());
    state.take_event(&Event::Distrusted { model: model ^ 1, instead: 0 });
    assert!(state.models.for_loop(&Mounting::UPRIGHT).is_some(), "another one was");
    state.take_event(&Event::Distrusted { model, instead: 0 });
    assert!(state.models.for_loop(&Mounting::UPRIGHT).is_none());
    assert_eq!(state.status(&Served::default(), None).model, 0);
    // An operator or the estimator who offers it again takes it upon himself.
    assert_eq!(ask(&mut state, offer()), Response::ModelAccepted { model });
    assert!(state.models.for_loop(&Mounting::UPRIGHT).is_some());
}

#[test]
fn every_sixteenth_cycle_of_the_last_second_is_kept() {
    let mut recent = Recent::default();
    let records: Vec<Record> = (0..3000).map(|cycle| Record { cycle, ..Record::default() }).collect();
    records.chunks(100).for_each(|some| recent.take(some));
    let kept: Vec<u64> = recent.0.iter().map(|record| record.cycle).collect();
    assert_eq!(kept, (0..64).map(|k| 2992 - 16 * (63 - k)).collect::<Vec<u64>>());
    recent.clear();
    assert!(recent.0.is_empty());
}

#[test]
fn the_model_served_before_is_in_reserve_unless_a_loop_has_distrusted_it() {
    let of = |accepted: &Option<Accepted>| accepted.as_ref().map(|accepted| accepted.id);
    let (mut state, _place) = new_state();
    let [first, second, third] = [1, 2, 3].map(|number| offered(&mut state, another(number)));
    assert_eq!((of(&state.models.served), of(&state.models.reserve)), (Some(third), Some(second)));
    // The same model again is no change.
    offered(&mut state, another(3));
    assert_eq!((of(&state.models.served), of(&state.models.reserve)), (Some(third), Some(second)));
    // Falls back to the reserve.
    state.take_event(&Event::Distrusted { model: third, instead: second });
    assert_eq!((of(&state.models.served), of(&state.models.reserve)), (Some(second), None));
    assert!(state.models.for_loop(&Mounting::UPRIGHT).is_some(), "another one was distrusted");
    // The one that follows a distrusted one has none behind it.
    state.take_event(&Event::Distrusted { model: second, instead: 0 });
    offered(&mut state, another(1));
    assert_eq!((of(&state.models.served), of(&state.models.reserve), state.models.rejected), (Some(first), None, None));

    // The reserve itself is distrusted, or both: neither is fallen back to.
    offered(&mut state, another(2));
    assert_eq!(of(&state.models.reserve), Some(first));
    state.take_event(&Event::Distrusted { model: first, instead: 0 });
    assert_eq!((of(&state.models.served), of(&state.models.reserve)), (Some(second), None));
    offered(&mut state, another(1));
    assert_eq!(of(&state.models.reserve), Some(second));
    // A loop that has fallen back to a model of an older daemon's keeps what this one serves.
    state.take_event(&Event::Distrusted { model: first, instead: 99 });
    assert_eq!((of(&state.models.served), of(&state.models.reserve)), (Some(first), Some(second)));
    // A loop that still asked an older model fell back to the reserve: the served one stays, the reserve is in use.
    state.take_event(&Event::Distrusted { model: 98, instead: second });
    assert_eq!((of(&state.models.served), of(&state.models.reserve)), (Some(first), None));
}
