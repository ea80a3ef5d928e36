//! What a candidate has to show before it is taken in.

use super::synthetic::{At, FLOOR, ROWS, Recorded, once, recorded, scaled, with_effect, with_effect_in_noise};
use plumbline_diagnose::{Candidate, FoldTest, Relevance, Scored, Search, Selected, Settings, Span, State};
use plumbline_model::term::effect::{FAMILIES, Family, OperatingPoint, Site, Spec, family};
use plumbline_model::term::{encoder_offset, joint_elasticity, position_ripple, spring, torque_offset};
use std::collections::BTreeSet;
use std::f64::consts::TAU;

pub const OFFSET: [&Family; 1] = [&torque_offset::FAMILY];

/// The offset of joint 2 among the candidates of a search.
pub fn offset_2(search: &Search, state: &State) -> Scored {
    let item = search.library.iter().find(|item| item.joints() == [1]).unwrap();
    search.score(state, item).unwrap()
}

pub fn select(recorded: &Recorded, families: &[&'static Family], settings: &Settings) -> Selected {
    recorded.search(families, settings, |search, base| search.select(base.clone(), &[], &|_| {}))
}

/// Labels of what was taken: family and joint from 1.
pub fn taken(selected: &Selected) -> Vec<(&'static str, usize)> {
    selected.state.items.iter().map(|item| (item.spec.family, item.spec.site.joints()[0] + 1)).collect()
}

/// An offset of joint 2.
pub fn constant(size: f64) -> impl Fn(&At) -> [f64; 2] {
    move |_| [0.0, size]
}

#[test]
fn the_noise_of_the_synthetic_evidence_is_what_the_tests_take_it_for() {
    recorded(4, 1, |_| [0.0; 2]).search(&OFFSET, &Settings::default(), |search, base| {
        let evidence = search.problem.evidence;
        assert_eq!(evidence.per_joint(), 4 * ROWS);
        for joint in 0..2 {
            let floor = evidence.floor(joint).unwrap();
            assert!((floor / FLOOR - 1.0).abs() < 0.05, "{floor} {FLOOR}");
            // The plain model lacks nothing: a mean square of about one.
            let left = base.residual(joint).norm_squared() / evidence.per_joint() as f64;
            assert!((left - 1.0).abs() < 0.25, "{left}");
        }
    });
}

#[test]
fn a_score_is_the_evidence_less_what_parameters_and_choice_cost() {
    let families: [&'static Family; 2] = [&torque_offset::FAMILY, &position_ripple::FAMILY];
    recorded(4, 2, constant(0.1)).search(&families, &Settings::default(), |search, base| {
        let columns: usize = search.library.iter().map(|item| item.rows.width).sum();
        assert!(columns > 50, "{columns}");
        let choice = 2.0 * (columns as f64).ln();
        for (family, parameters) in [("torque-offset", 1.0), ("position-ripple", 3.0)] {
            let mut of_family = search.library.iter().filter(|item| item.spec.family == family);
            let scored = of_family.find_map(|item| search.score(base, item)).unwrap();
            let penalty = parameters * ((4 * ROWS) as f64).ln() + choice;
            assert!((scored.penalty - penalty).abs() < 1e-9, "{family}: {} {penalty}", scored.penalty);
            assert!((scored.score - (scored.tried.evidence - penalty)).abs() < 1e-9, "{family}");
            // What the deviations of the periods show has been chosen there.
            let came = [(scored.item.spec.clone(), scored.item.span)];
            let known = Search { came: &came, ..search.at(search.operating_point) }.score(base, &scored.item).unwrap();
            assert!((known.penalty - (penalty - choice)).abs() < 1e-9, "{family}: {} {penalty}", known.penalty);
        }
    });
}

#[test]
fn the_size_of_the_library_is_paid_for() {
    let settings = Settings { threshold: Some(1e-3), ..Settings::default() };
    let recorded = recorded(4, 3, constant(0.5 * FLOOR));
    recorded.search(&OFFSET, &settings, |search, base| {
        let scored = offset_2(search, base);
        let alone = scored.tried.evidence - ((4 * ROWS) as f64).ln();
        // The same candidates so often that the choice among them costs a little more than the effect brings.
        let copies = (0.5 * (scored.score + 2.0)).exp() as usize;
        assert!(scored.score > 3.0 && copies < 200_000, "{alone}, score {}, {copies} copies", scored.score);
        let few = search.forward(base.clone(), &[], &|_| {});
        assert_eq!(few.state.items.len(), 1);
        let library: Vec<_> = (0..copies).flat_map(|_| search.library.iter().cloned()).collect();
        let many = Search { library: &library, ..search.at(search.operating_point) };
        let dear = offset_2(&many, base);
        assert!((scored.score - dear.score - 2.0 * (copies as f64).ln()).abs() < 1e-6);
        assert!((-3.0..-1.0).contains(&dear.score), "{}", dear.score);
        // Not even for a moment.
        assert!(many.select(base.clone(), &[], &|_| {}).path.is_empty());
    });
}

#[test]
fn three_of_four_folds_have_to_agree() {
    let folds = |positive, informative| FoldTest { positive, informative, ..FoldTest::default() };
    assert_eq!(folds(3, 4).confirm(), Some(true));
    assert_eq!(folds(6, 8).confirm(), Some(true));
    assert_eq!(folds(5, 8).confirm(), Some(false));
    assert_eq!(folds(2, 4).confirm(), Some(false));
    assert_eq!(folds(0, 0).confirm(), None);
    // By what they gain and lose, and more than half of them.
    let by_weight = |positive, agreement| {
        FoldTest { positive, informative: 6, agreement, ..FoldTest::default() }.confirm_by_weight()
    };
    assert_eq!([by_weight(4, 0.75), by_weight(4, 0.74), by_weight(3, 0.75)], [true, false, false]);
}

#[test]
fn without_repeats_blocks_agree_by_weight_on_what_another_joint_has() {
    // For a third of the time joint 2 has no offset: by count too many blocks are against it.
    let offset = |at: &At| [4.0 * FLOOR, if at.t < 13.0 { 4.0 * FLOOR } else { 0.0 }];
    for alone in [false, true] {
        once(20.0, 15, offset).search(&OFFSET, &Settings::default(), |search, base| {
            let of = |joint: usize| search.library.iter().find(|item| item.joints() == [joint]).unwrap();
            let only = [of(1).clone()];
            let search = Search { library: if alone { &only } else { search.library }, ..*search };
            let state = if alone { base.clone() } else { base.with(&search.problem, of(0).clone()) };
            let scored = search.score(&state, of(1)).unwrap();
            let folds = plumbline_diagnose::folds(&search.problem, &state, &scored.tried);
            assert!(folds.confirm() == Some(false) && folds.confirm_by_weight(), "{folds:?}");
            assert!(folds.hold(search.problem.evidence.folds().len(), scored.penalty, 0.2), "{folds:?}");
            let taken = search.forward(state, &[], &|_| {}).state.items;
            assert_eq!(taken.iter().any(|item| item.joints() == [1]), !alone, "{folds:?}");
        });
    }
}

#[test]
fn without_repeats_every_condition_on_left_out_blocks_counts() {
    let good =
        FoldTest { positive: 3, informative: 3, agreement: 1.0, showing: 3, evidence: 20.1, share: 0.21, worst: -0.29 };
    let holds = |folds: FoldTest, blocks: usize| folds.hold(blocks, 20.0, Settings::default().least_share_left_out);
    assert!(holds(good, 20));
    assert!(!holds(FoldTest { showing: 2, ..good }, 20), "in three blocks");
    assert!(holds(FoldTest { showing: 2, ..good }, 5), "of few blocks in half");
    assert!(!holds(FoldTest { showing: 1, ..good }, 5));
    assert!(!holds(FoldTest { evidence: 19.9, ..good }, 20), "as much as it costs");
    assert!(!holds(FoldTest { share: 0.19, ..good }, 20), "a fifth of a joint's error");
    assert!(!holds(FoldTest { worst: -0.31, ..good }, 20), "no joint loses more than 30 %");
}

#[test]
fn an_effect_of_half_of_the_trajectories_is_not_taken() {
    let size = 6.0 * FLOOR;
    let families = OFFSET;
    let settings = Settings::default();
    let half = recorded(8, 4, |at| [0.0, if at.trajectory % 2 == 0 { size } else { 0.0 }]);
    half.search(&families, &settings, |search, base| {
        // It passes everything but the folds.
        let scored = offset_2(search, base);
        let relevance = plumbline_diagnose::relevance(search.problem.evidence, base, &scored.tried, &scored.item);
        assert!(scored.score > 5.0, "{}", scored.score);
        assert!(plumbline_diagnose::matters(search.problem.evidence, &relevance, &settings), "{relevance:?}");
        let folds = plumbline_diagnose::folds(&search.problem, base, &scored.tried);
        assert_eq!((folds.informative, folds.confirm()), (8, Some(false)), "{folds:?}");
        assert!(search.forward(base.clone(), &[], &|_| {}).state.items.is_empty());
    });
    let all = select(&recorded(8, 4, constant(size)), &families, &settings);
    assert_eq!(taken(&all), [("torque-offset", 2)]);
    assert_eq!(all.found[0].folds.confirm(), Some(true));
}

#[test]
fn one_of_two_trajectories_is_asked_about_the_other_and_a_single_one_is_not() {
    for (count, informative, confirmed) in [(1, 0, None), (2, 2, Some(true))] {
        recorded(count, 7, constant(6.0 * FLOOR)).search(&OFFSET, &Settings::default(), |search, base| {
            let folds = plumbline_diagnose::folds(&search.problem, base, &offset_2(search, base).tried);
            assert_eq!((folds.informative, folds.confirm()), (informative, confirmed), "{folds:?}");
        });
    }
}

#[test]
fn trajectories_that_hardly_show_an_effect_are_not_asked() {
    // A spring that only the first trajectory reaches: no other can confirm or refute it, and neither can the first.
    let spring: [&'static Family; 1] = [&spring::FAMILY];
    let tight = |at: &At| [0.0, 2.0 * (at.q[1] - 0.7).max(0.0)];
    let recorded = scaled(&[2.0, 0.5, 0.5, 0.5], 5, tight);
    let selected = select(&recorded, &spring, &Settings::default());
    assert_eq!(taken(&selected), [("spring", 2)]);
    let folds = selected.found[0].folds;
    assert_eq!((folds.informative, folds.confirm()), (0, None), "{folds:?}");
}

/// A spring of joint 2 that gets tight at a share of the largest position of a run of 40 s that does not repeat.
fn tight_from(share: f64) -> Recorded {
    let largest = once(40.0, 10, |_| [0.0; 2]).experiments[0].motion.q.column(1).max();
    once(40.0, 10, move |at| [0.0, 30.0 * (at.q[1] - share * largest).max(0.0)])
}

#[test]
fn without_repeats_undeclared_coupled_gears_are_searched_only_by_what_acts_on_both_joints() {
    let coupling: [&'static Family; 1] = [family("transmission-coupling").unwrap()];
    let settings = Settings::default();
    let forms_of = |library: &[Candidate]| library.iter().map(|one| one.spec.form).collect::<BTreeSet<_>>();
    let forms = |recorded: &Recorded| recorded.search(&coupling, &settings, |search, _| forms_of(search.library));
    let (all, shaft) = (BTreeSet::from(["friction", "inertia", "sum"]), BTreeSet::from(["sum"]));
    assert_eq!(forms(&recorded(4, 1, constant(0.0))), all);
    let free = once(20.0, 1, constant(0.0));
    assert_eq!(forms(&free), shaft);
    free.search(&coupling, &settings, |search, base| {
        let free = search.operating_point.clone();
        let coupled = OperatingPoint { chain: free.chain.clone().with_coupled(vec![[1, 0]]), ..free };
        let evidence = search.problem.evidence;
        let library = plumbline_diagnose::library(evidence, &coupled, &coupling, Span::ALL, 1);
        assert_eq!(forms_of(&library), all, "{}", base.base);
    });
}

/// A shaft that turns with both joints, seen from either of the two.
#[test]
fn a_shaft_of_two_joints_is_found_without_repeats_and_undeclared() {
    let shaft = |at: &At| {
        let f = 0.4 * (100.0 * (at.dq[1] - 0.6 * at.dq[0])).tanh();
        [-0.6 * f, f]
    };
    let one_sided = |at: &At| [0.0, 0.4 * (100.0 * (at.dq[1] - 0.6 * at.dq[0])).tanh()];
    let families: Vec<&'static Family> =
        ["transmission-coupling", "torque-crosstalk", "stribeck", "presliding"].map(|id| family(id).unwrap()).to_vec();
    let found = |recorded: &Recorded| select(recorded, &families, &Settings::default()).state.items;
    let of_both = found(&once(40.0, 10, shaft));
    let specs = of_both.iter().map(|item| item.spec.clone()).collect::<Vec<_>>();
    let [coupling] = &specs[..] else { panic!("{specs:?}") };
    assert_eq!((coupling.family, coupling.form), ("transmission-coupling", "sum"));
    assert_eq!(coupling.site, Site::Pair { row: 1, cause: 0 });
    assert!((coupling.settings[0] + 0.6).abs() < 0.02, "{coupling:?}");
    // Where joint 1 takes no share of the torque it is no shaft.
    let of_one = found(&once(40.0, 10, one_sided));
    assert!(of_one.iter().all(|item| item.spec.family != "transmission-coupling"), "{of_one:?}");
}

#[test]
fn an_undeclared_coupling_has_to_be_a_thousand_times_as_likely_as_a_declared_one() {
    let coupling: [&'static Family; 1] = [family("transmission-coupling").unwrap()];
    recorded(4, 1, constant(0.0)).search(&coupling, &Settings::default(), |search, base| {
        let free = search.operating_point.clone();
        let coupled = OperatingPoint { chain: free.chain.clone().with_coupled(vec![[1, 0]]), ..free };
        let cost = |search: &Search| search.score(base, &search.library[0]).unwrap().penalty;
        let (undeclared, declared) = (cost(search), cost(&search.at(&coupled)));
        assert!((undeclared - declared - 2.0 * 1000f64.ln()).abs() < 1e-9, "{undeclared} {declared}");
    });
}

#[test]
fn a_rotor_is_searched_where_the_rigid_body_has_absorbed_one() {
    let elastic: [&'static Family; 1] = [&joint_elasticity::FAMILY];
    recorded(4, 1, constant(0.0)).search(&elastic, &Settings::default(), |search, base| {
        assert_eq!(search.operating_point.rotors, [false; 2], "{}", base.base);
        let with = |rotors: Vec<bool>| {
            let operating_point = OperatingPoint { rotors, ..search.operating_point.clone() };
            let library =
                plumbline_diagnose::library(search.problem.evidence, &operating_point, &elastic, Span::ALL, 1);
            let tried = library.iter().filter(|item| item.spec.form == "swinging-rotor");
            tried.map(|item| item.spec.site).collect::<BTreeSet<_>>()
        };
        assert!(with(vec![false; 2]).is_empty());
        assert_eq!(with(vec![false, true]).into_iter().collect::<Vec<_>>(), [Site::Joint(1)]);
    });
}

#[test]
fn the_zero_of_joint_1_is_left_to_the_tilt_of_the_base() {
    let zero: [&'static Family; 1] = [&encoder_offset::FAMILY];
    recorded(4, 1, constant(0.0)).search(&zero, &Settings::default(), |search, _| {
        let sites: BTreeSet<Site> = search.library.iter().map(|item| item.spec.site).collect();
        assert_eq!(sites, BTreeSet::from([Site::Joint(1)]));
    });
}

#[test]
fn a_constant_is_exact_where_the_noise_is_known() {
    let families: [&'static Family; 2] = [OFFSET[0], &spring::FAMILY];
    let exact = |recorded: &Recorded| {
        recorded.search(&families, &Settings::default(), |search, _| {
            let exact = search.library.iter().filter(|item| item.rows.exact);
            exact.map(|item| (item.spec.family, item.span.is_all())).collect::<Vec<_>>()
        })
    };
    assert_eq!(exact(&recorded(4, 1, constant(0.0))), [("torque-offset", true); 2]);
    assert!(exact(&once(20.0, 1, constant(0.0))).is_empty());
}

#[test]
fn without_repeats_an_effect_has_to_show_in_three_blocks() {
    let families: [&'static Family; 1] = [&spring::FAMILY];
    let mut seen = Vec::new();
    for share in [0.96, 0.95, 0.94, 0.93, 0.92, 0.9, 0.6] {
        tight_from(share).search(&families, &Settings::default(), |search, base| {
            let scored = search.propose(base, |_| true).into_iter().next().unwrap();
            let folds = plumbline_diagnose::folds(&search.problem, base, &scored.tried);
            let taken = !search.forward(base.clone(), &[], &|_| {}).state.items.is_empty();
            println!("tight from {share}: score {}, {folds:?}, taken {taken}", scored.score);
            // Everything else speaks for it.
            let held = folds.confirm() == Some(true) && folds.evidence > scored.penalty && folds.share >= 0.2;
            if held && folds.worst > -0.3 {
                assert_eq!(taken, folds.showing >= 3, "{folds:?}");
                seen.push(taken);
            }
        });
    }
    assert!(seen.contains(&true) && seen.contains(&false), "{seen:?}");
}

#[test]
fn without_repeats_an_effect_has_to_take_a_fifth_of_a_joints_error_away() {
    let mut seen = Vec::new();
    for size in [0.018, 0.019, 0.021, 0.023, 0.026] {
        once(20.0, 11, constant(size)).search(&OFFSET, &Settings::default(), |search, base| {
            let scored = offset_2(search, base);
            let folds = plumbline_diagnose::folds(&search.problem, base, &scored.tried);
            let taken = !search.forward(base.clone(), &[], &|_| {}).state.items.is_empty();
            println!("offset {size}: score {}, {folds:?}, taken {taken}", scored.score);
            // Everything else speaks for it.
            assert!(scored.score > 0.0 && folds.evidence > scored.penalty && folds.confirm() == Some(true));
            assert_eq!(taken, folds.share >= 0.2, "{folds:?}");
            seen.push(folds.share);
        });
    }
    assert!(seen.iter().any(|share| (0.1..0.2).contains(share)) && seen.iter().any(|share| (0.2..0.3).contains(share)));
}

#[test]
fn without_repeats_a_change_of_friction_within_a_run_has_to_take_half_of_its_joints_error() {
    let spec = Spec { family: "friction-change", form: "", site: Site::Joint(1), settings: vec![] };
    let settings = Settings::default();
    let mut seen = Vec::new();
    for size in [0.03, 0.04, 0.05, 0.06, 0.08, 0.1] {
        let more = |at: &At| [0.0, if at.t < 10.0 { 0.0 } else { size * (100.0 * at.dq[1]).tanh() }];
        once(20.0, 12, more).search(&[], &settings, |search, base| {
            let evidence = search.problem.evidence;
            let item = Candidate::of(evidence, search.operating_point, spec.clone(), Span::since(10.0)).unwrap();
            let library = [item];
            let search = Search { library: &library, ..*search };
            let scored = search.propose(base, |_| true).into_iter().next().unwrap();
            let folds = plumbline_diagnose::folds(&search.problem, base, &scored.tried);
            let taken = !search.forward(base.clone(), &[], &|_| {}).state.items.is_empty();
            println!("change of {size} Nm: score {}, {folds:?}, taken {taken}", scored.score);
            // Everything else speaks for it, and it would do for an effect of the whole run.
            if folds.hold(evidence.folds().len(), scored.penalty, settings.least_share_left_out) {
                assert_eq!(taken, folds.share >= 0.5, "{folds:?}");
                seen.push(taken);
            }
        });
    }
    assert!(seen.contains(&true) && seen.contains(&false), "{seen:?}");
}

#[test]
fn what_an_effect_can_not_be_is_no_candidate() {
    let family: [&'static Family; 1] = [&joint_elasticity::FAMILY];
    let form = &joint_elasticity::FAMILY.forms[0];
    let settings = form.settings.iter().map(|setting| setting.at(0.5)).collect();
    let spec = Spec { family: joint_elasticity::ID, form: form.name, site: Site::Joint(1), settings };
    for (size, allowed) in [(6.0 * FLOOR, true), (-6.0 * FLOOR, false)] {
        let recorded = with_effect(4, 15, &spec, size, |_| [0.0; 2]);
        recorded.search(&family, &Settings::default(), |search, base| {
            let evidence = search.problem.evidence;
            let item = Candidate::of(evidence, search.operating_point, spec.clone(), Span::ALL).unwrap();
            let tried = base.try_in(&search.problem, &item).unwrap();
            assert_eq!(*tried.fit.theta.as_slice().last().unwrap() > 0.0, allowed);
            assert!(tried.evidence > 50.0, "{}", tried.evidence);
            assert_eq!(search.score(base, &item).is_some(), allowed);
            let taken = search.forward(base.clone(), &[], &|_| {}).state.items;
            assert_eq!(!taken.is_empty(), allowed);
        });
    }
}

#[test]
fn an_effect_of_several_joints_belongs_to_the_one_whose_noise_it_exceeds_most() {
    let form = &joint_elasticity::FAMILY.forms[0];
    assert!(form.settings.is_empty());
    let spec = Spec { family: joint_elasticity::ID, form: form.name, site: Site::Joint(1), settings: Vec::new() };
    // In one joint a tone stands beside it: a smaller share there, and still the larger torque.
    for tone_in in [0, 1] {
        let tone = |at: &At| {
            let tone = 25.0 * FLOOR * (TAU * 7.0 * at.t).sin();
            [0, 1].map(|j| if j == tone_in { tone } else { 0.0 })
        };
        with_effect(4, 16, &spec, 30.0 * FLOOR, tone).search(
            &[&joint_elasticity::FAMILY],
            &Settings::default(),
            |search, base| {
                let item =
                    Candidate::of(search.problem.evidence, search.operating_point, spec.clone(), Span::ALL).unwrap();
                let tried = base.try_in(&search.problem, &item).unwrap();
                let found = plumbline_diagnose::relevance(search.problem.evidence, base, &tried, &item);
                println!("tone in joint {}: {found:?}", tone_in + 1);
                assert!(found.share[tone_in] < found.share[1 - tone_in] - 0.1);
                let larger = usize::from(found.rms[1] > found.rms[0]);
                assert!(found.rms[larger] > 1.2 * found.rms[1 - larger]);
                assert_eq!(found.joint, larger, "{found:?}");
                // It matters where it matters in one of its joints.
                let in_one = Relevance {
                    rms: vec![0.0, 1.0],
                    share: vec![0.0, 1.0],
                    joint: 1,
                    low: vec![(0.0, 0.0); 2],
                    ..Relevance::default()
                };
                assert!(plumbline_diagnose::matters(search.problem.evidence, &in_one, &Settings::default()));
            },
        );
    }
    // Where the larger torque meets four times the noise, the other one exceeds its own more.
    for noisy in [0, 1] {
        let noise = [0, 1].map(|j| if j == noisy { 4.0 } else { 1.0 });
        let recorded = with_effect_in_noise(17, &spec, 60.0 * FLOOR, noise);
        recorded.search(&[&joint_elasticity::FAMILY], &Settings::default(), |search, base| {
            let evidence = search.problem.evidence;
            let item = Candidate::of(evidence, search.operating_point, spec.clone(), Span::ALL).unwrap();
            let found =
                plumbline_diagnose::relevance(evidence, base, &base.try_in(&search.problem, &item).unwrap(), &item);
            let in_noise = |j: usize| found.rms[j] / evidence.floor(j).unwrap();
            println!("{noise:?}: {found:?}, in noise {} {}", in_noise(0), in_noise(1));
            assert_eq!(found.joint, usize::from(in_noise(1) > in_noise(0)));
            assert_eq!(found.joint, 1 - noisy);
        });
    }
}

#[test]
fn a_gain_is_found_in_the_torque_of_another_joint() {
    let of = |joint| Spec { family: "torque-gain", form: "", site: Site::Joint(joint), settings: Vec::new() };
    // Joint 2 has little noise, and the masses follow its gain: the torque of joint 1 is wrong.
    let recorded = with_effect_in_noise(18, &of(1), 20.0 * FLOOR, [1.0, 0.4]);
    recorded.search(FAMILIES, &Settings::default(), |search, base| {
        let evidence = search.problem.evidence;
        let proposed = search.propose(base, |_| true);
        let gain = proposed.iter().find(|one| one.item.spec == of(1)).unwrap();
        let found = plumbline_diagnose::relevance(evidence, base, &gain.tried, &gain.item);
        println!("score {} {found:?}", gain.score);
        assert_eq!(found.joint, 0, "{found:?}");
        assert!(gain.score > 100.0 && found.share[0] > 0.9, "{} {found:?}", gain.score);
    });
    // An arm of two joints has no other scale: a gain of the other joint explains as much.
    let selected = select(&recorded, &[family("torque-gain").unwrap()], &Settings::default());
    let [found] = &selected.found[..] else { panic!("{:?}", taken(&selected)) };
    let own = selected.state.items[0].spec.site;
    let rivals: Vec<_> = found.rivals.iter().map(|rival| (rival.item.spec.site, rival.gap)).collect();
    println!("{own:?} {rivals:?}");
    assert_eq!(rivals.len(), 1, "{rivals:?}");
    assert!(rivals[0].0 != own && rivals[0].1.abs() < 3.0, "{own:?} {rivals:?}");
}

#[test]
fn an_effect_of_its_family_in_another_joint_is_no_rival_where_it_is_worth_as_much_beside() {
    // One step takes the stronger one of two.
    let settings = Settings { steps: 1, ..Settings::default() };
    let rippled = recorded(4, 19, |at| at.q.map(|q| 0.05 * (20.0 * q).sin()));
    let selected = select(&rippled, &[&position_ripple::FAMILY], &settings);
    let [one, other] =
        [0, 1].map(|joint| selected.first.iter().find(|one| one.item.joints() == [joint]).unwrap().score);
    println!("scores {one} {other}, {:?}", taken(&selected));
    assert!(one > 0.0 && other > 0.0 && (one - other).abs() < 12.0, "{one} {other}");
    assert!(selected.found.len() == 1 && selected.found[0].rivals.is_empty());
}

#[test]
fn the_energy_of_an_effect_is_divided_among_the_folds_that_show_it() {
    // The shares decide which folds are asked: an offset shows alike in all.
    recorded(4, 12, constant(4.0 * FLOOR)).search(&OFFSET, &Settings::default(), |search, base| {
        let scored = offset_2(search, base);
        let folds = plumbline_diagnose::folds(&search.problem, base, &scored.tried);
        assert_eq!((folds.positive, folds.informative), (4, 4));
    });
}
