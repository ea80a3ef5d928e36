//! Base parameters: how many, which, and what they are made of.

use nalgebra::{DMatrix, DVector};
use plumbline_model::{
    BaseKind, Chain, Joint, JointKind, LINK_COLUMNS, Mounting, Placement, Reduction, Structure, regressor,
};

use plumbline_testkit::arms;
use plumbline_testkit::arms::{all, any_mounting, chain, draw, random_chain, torque};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rstest::rstest;

#[rstest]
#[case("panda", 45, 43)]
#[case("fr3", 45, 43)]
#[case("kuka-lwr4p", 45, 43)]
#[case("ur10", 38, 36)]
#[case("ur10e", 38, 36)]
#[case("tx40", 38, 36)]
#[case("paper-2dof", 10, 8)]
fn an_arm_has_this_many(#[case] robot: &str, #[case] generalized: usize, #[case] vertical: usize) {
    let chain = chain(robot);
    let n = chain.len();
    for mounting in [Mounting::WALL, Mounting { rho: 2.5, phi: -1.0 }] {
        let reduction = Reduction::in_mounting(&chain, &mounting);
        assert_eq!((reduction.len(), reduction.kind()), (generalized, BaseKind::Gbs));
    }
    for mounting in [Mounting::UPRIGHT, Mounting::CEILING, Mounting { rho: 3.135, phi: 0.3 }] {
        let reduction = Reduction::in_mounting(&chain, &mounting);
        assert_eq!((reduction.len(), reduction.kind()), (vertical, BaseKind::Vbs));
    }
    for (kind, count) in [(BaseKind::Gbs, generalized), (BaseKind::Vbs, vertical)] {
        let structure = Structure::of(chain.clone(), Reduction::of_kind(&chain, kind), &["friction"]).unwrap();
        assert_eq!(structure.columns().len(), count + 2 * n);
    }
}

/// Names of the Panda's base parameters as in the paper's Table III.
#[test]
fn the_panda_keeps_the_usual_parameters() {
    let chain = chain("panda");
    let mut expected: Vec<String> = ["Lzz1", "lx1", "ly1"].map(String::from).to_vec();
    for link in 2..=7 {
        expected.extend(["Lxx", "Lxy", "Lxz", "Lyz", "Lzz", "lx", "ly"].map(|stem| format!("{stem}{link}")));
    }
    let names = |reduction: &Reduction| {
        reduction.independent().iter().map(|&slot| plumbline_model::parameter_name(slot)).collect::<Vec<_>>()
    };
    assert_eq!(names(&Reduction::any_mounting(&chain)), expected);
    expected.retain(|name| name != "lx1" && name != "ly1");
    assert_eq!(names(&Reduction::in_mounting(&chain, &Mounting::UPRIGHT)), expected);
}

#[test]
fn expressions_read_like_the_papers_tables() {
    let two = Reduction::any_mounting(&chain("paper-2dof"));
    let table: Vec<(String, String)> =
        plumbline_model::base_columns(&two).into_iter().map(|column| (column.symbol, column.expression)).collect();
    let expected = [
        ("LzzR1", "Lzz1 + Lyy2"),
        ("lxR1", "lx1"),
        ("lyR1", "ly1 + lz2"),
        ("LxxR2", "Lxx2 - Lyy2"),
        ("LxyR2", "Lxy2"),
        ("LxzR2", "Lxz2"),
        ("LyzR2", "Lyz2"),
        ("LzzR2", "Lzz2"),
        ("lxR2", "lx2"),
        ("lyR2", "ly2"),
    ];
    assert_eq!(table, expected.map(|(symbol, text)| (symbol.to_string(), text.to_string())));

    let panda = plumbline_model::base_columns(&Reduction::any_mounting(&chain("panda")));
    let of = |name: &str| panda.iter().find(|column| column.name == name).unwrap().expression.clone();
    assert_eq!(of("Lzz1"), "Lzz1 + Lyy2");
    assert_eq!(of("ly1"), "ly1 + lz2");
    // 0.316^2 = 0.099856, 0.316^2 + 0.0825^2 = 0.10666225
    assert_eq!(of("Lxx2"), "Lxx2 - Lyy2 + Lyy3 + 0.632 lz3 + 0.099856 m3 + 0.106662 (m4 + m5 + m6 + m7)");
    assert_eq!(of("ly2"), "ly2 - lz3 - 0.316 (m3 + m4 + m5 + m6 + m7)");
    assert_eq!(of("ly7"), "ly7");
}

/// The closed-form regrouping of a revolute joint (Khalil and Dombre, Modeling, Identification and Control of Robots, ch. 9;
/// Gautier and Khalil 1990), from the last link to the base: the second route to every coefficient.
#[rstest]
#[case("panda")]
#[case("kuka-lwr4p")]
#[case("ur10")]
#[case("tx40")]
#[case("paper-2dof")]
fn regrouping_is_khalils(#[case] robot: &str) {
    let chain = chain(robot);
    let n = chain.len();
    let reduction = Reduction::any_mounting(&chain);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..20 {
        let delta = draw(&mut rng, n * LINK_COLUMNS, 1.0);
        let mut links = arms::links(&delta);
        for j in (1..n).rev() {
            let Joint { a, alpha, d, .. } = chain.joints()[j];
            let (s, c) = alpha.sin_cos();
            let [_, _, _, yy, _, _, _, _, mz, m] = links[j];
            let up = &mut links[j - 1];
            up[0] += yy + 2.0 * d * mz + d * d * m;
            up[1] += a * s * mz + a * d * s * m;
            up[2] -= a * c * mz + a * d * c * m;
            up[3] += c * c * yy + 2.0 * d * c * c * mz + (a * a + d * d * c * c) * m;
            up[4] += c * s * yy + 2.0 * d * c * s * mz + d * d * c * s * m;
            up[5] += s * s * yy + 2.0 * d * s * s * mz + (a * a + d * d * s * s) * m;
            up[6] += a * m;
            up[7] -= s * mz + d * s * m;
            up[8] += c * mz + d * c * m;
            up[9] += m;
            links[j][0] -= yy;
        }
        let regrouped: Vec<f64> = links.concat();
        let beta = reduction.base_of(&DVector::from_vec(delta));
        for (&slot, value) in reduction.independent().iter().zip(beta.iter()) {
            assert!(
                (value - regrouped[slot]).abs() < 1e-10,
                "{robot} {}: {value} {}",
                plumbline_model::parameter_name(slot),
                regrouped[slot]
            );
        }
    }
}

/// Base parameters put into the slots of their names give the torque of all the standard parameters they are made of.
#[test]
fn base_parameters_go_straight_into_newton_euler() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut chains: Vec<Chain> = all().into_iter().map(|(_, chain)| chain).collect();
    chains.extend((0..40).map(|_| random_chain(&mut rng)));
    for chain in chains {
        let n = chain.len();
        for kind in [BaseKind::Gbs, BaseKind::Vbs] {
            let reduction = Reduction::of_kind(&chain, kind);
            let delta = draw(&mut rng, n * LINK_COLUMNS, 1.0);
            let beta = reduction.base_of(&DVector::from_row_slice(&delta));
            let mut slots = vec![0.0; n * LINK_COLUMNS];
            for (&slot, value) in reduction.independent().iter().zip(beta.iter()) {
                slots[slot] = *value;
            }
            for _ in 0..10 {
                let mounting = match reduction.kind() {
                    BaseKind::Gbs => any_mounting(&mut rng),
                    BaseKind::Vbs if rng.random_bool(0.5) => Mounting::CEILING,
                    BaseKind::Vbs => Mounting::UPRIGHT,
                };
                let (q, dq, ddq) = (draw(&mut rng, n, 3.0), draw(&mut rng, n, 2.0), draw(&mut rng, n, 5.0));
                let full = torque(&chain, &delta, &mounting.gravity(), &q, &dq, &ddq);
                let short = torque(&chain, &slots, &mounting.gravity(), &q, &dq, &ddq);
                let difference = (&full - &short).amax();
                assert!(difference < 1e-9 * full.amax().max(1.0), "{difference:e} for {chain:?}");
            }
        }
    }
}

/// The count is the numerical rank, for arms of any geometry: parallel first axes, prismatic first joints, skew angles.
#[test]
fn the_count_is_the_rank() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut chains: Vec<Chain> = all().into_iter().map(|(_, chain)| chain).collect();
    chains.extend((0..60).map(|_| random_chain(&mut rng)));
    for chain in chains {
        let upright = Mounting::UPRIGHT;
        let tilted = Mounting { rho: rng.random_range(0.1..3.0), phi: rng.random_range(-3.0..3.0) };
        for mounting in [None, Some(upright), Some(tilted)] {
            let reduction = match &mounting {
                None => Reduction::any_mounting(&chain),
                Some(mounting) => Reduction::in_mounting(&chain, mounting),
            };
            assert_eq!(reduction.len(), rank(&chain, mounting, &mut rng), "{mounting:?} {chain:?}");
        }
        // What one mounting away from axis 1 shows is all there is.
        assert_eq!(Reduction::in_mounting(&chain, &tilted).kind(), BaseKind::Gbs);
    }
}

/// The paper assumes that axis 2 is not parallel to axis 1. A SCARA's is: gravity along the axes still hides what moves about them.
#[test]
fn parallel_first_axes_are_counted_too() {
    let scara = chain("scara");
    let generalized = Reduction::any_mounting(&scara);
    let vertical = Reduction::in_mounting(&scara, &Mounting::UPRIGHT);
    assert_eq!(vertical.kind(), BaseKind::Vbs);
    assert!(vertical.len() < generalized.len(), "{} {}", vertical.len(), generalized.len());
    assert!(vertical.independent().iter().all(|slot| generalized.independent().contains(slot)));

    // Three sliding joints see only masses, and see them in every mounting.
    let slide = |alpha| Joint { kind: JointKind::Prismatic, a: 0.0, alpha, d: 0.0, theta: 0.0 };
    let right = std::f64::consts::FRAC_PI_2;
    let gantry = Chain::modified(vec![slide(0.0), slide(right), slide(right)], Placement::identity());
    let upright = Reduction::in_mounting(&gantry, &Mounting::UPRIGHT);
    assert_eq!((upright.len(), upright.kind()), (3, BaseKind::Gbs));
}

/// Rank of a stacked regressor of random states by its singular values, which have to leave no doubt.
fn rank(chain: &Chain, mounting: Option<Mounting>, rng: &mut ChaCha8Rng) -> usize {
    let n = chain.len();
    let states = 80;
    let mut stacked = DMatrix::zeros(states * n, n * LINK_COLUMNS);
    let mut y = DMatrix::zeros(n, n * LINK_COLUMNS);
    for k in 0..states {
        let gravity = mounting.unwrap_or_else(|| any_mounting(rng)).gravity();
        let (q, dq, ddq) = (draw(rng, n, 3.0), draw(rng, n, 2.0), draw(rng, n, 3.0));
        regressor(chain, &gravity, &q, &dq, &ddq, &mut y);
        stacked.rows_mut(k * n, n).copy_from(&y);
    }
    let values = stacked.singular_values();
    let relative: Vec<f64> = values.iter().map(|value| value / values[0]).collect();
    let rank = relative.iter().filter(|value| **value > 1e-9).count();
    assert!(relative.iter().all(|value| *value > 1e-7 || *value < 1e-12), "no clear gap: {relative:?}");
    rank
}
