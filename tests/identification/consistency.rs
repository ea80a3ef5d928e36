//! Physical consistency: what real bodies can have is reproduced, what they can't is moved to the nearest, and how far is said.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use plumbline::store::ModelFile;
use plumbline_identify::consistency::{ConsistencyError, FLOOR, Nearest, Prior, Uncertainty, Weights, nearest};
use plumbline_model::{Body, Chain, LinkParameters, Reduction, Robot, Structure, is_consistent, pseudo_inertia};
use plumbline_testkit::arms::random_body;
use plumbline_testkit::arms::{all, chain, random_chain};
use plumbline_testkit::sim::arm;
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

fn structure(chain: &Chain, terms: &[&str]) -> Structure {
    Structure::of(chain.clone(), Reduction::any_mounting(chain), terms).unwrap()
}

fn stacked(links: &[LinkParameters]) -> DVector<f64> {
    DVector::from_iterator(10 * links.len(), links.iter().flatten().copied())
}

/// A covariance with correlations: 1 % of each size, mixed.
fn covariance(rng: &mut ChaCha8Rng, size: &[f64], share: f64) -> DMatrix<f64> {
    let p = size.len();
    let mix = DMatrix::from_fn(p, p, |i, k| {
        let own = if i == k { 1.0 } else { 0.0 };
        own + 0.3 / (p as f64).sqrt() * rng.sample::<f64, _>(StandardNormal)
    });
    let scale = DMatrix::from_diagonal(&DVector::from_iterator(p, size.iter().map(|size| share * size.max(1e-3))));
    &scale * &mix * mix.transpose() * &scale
}

fn deviations(covariance: &DMatrix<f64>) -> Vec<Option<f64>> {
    (0..covariance.nrows()).map(|c| Some(covariance[(c, c)].sqrt())).collect()
}

fn assert_exact(structure: &Structure, beta: &[f64], found: &Nearest) {
    assert!(found.exact, "{} away after {} systems", found.distance, found.iterations);
    assert_eq!(found.distance, 0.0);
    assert!(found.links.iter().all(is_consistent));
    let again = structure.reduction().base_of(&stacked(&found.links));
    let largest = beta.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    for (again, value) in again.iter().zip(beta) {
        assert!((again - value).abs() <= 1e-12 * largest, "{again} {value}");
    }
}

fn unknown(beta: &[f64]) -> Vec<Option<f64>> {
    vec![None; beta.len()]
}

#[test]
fn what_a_real_arm_has_is_reproduced() {
    let truth = arm("sim-panda").link_parameters();
    let panda = structure(&chain("panda"), &[]);
    let beta: Vec<f64> = panda.reduction().base_of(&stacked(&truth)).iter().copied().collect();
    let found =
        nearest(&panda, &beta, Uncertainty::Deviations(&unknown(&beta)), &Prior::of_geometry(&panda, &beta)).unwrap();
    assert_exact(&panda, &beta, &found);
    assert_eq!(found.weights, Weights::Relative);
    // What the data leaves open is of the size of a real arm's.
    let (own, real) = (mass(&found.links), mass(&truth));
    assert!((0.3..3.0).contains(&(own / real)), "{own} kg for {real} kg");

    // With the truth as its prior, the truth itself comes back, also in what the torques don't tell.
    let prior = Prior { links: truth.clone(), rotors: vec![0.1; 7] };
    let same = nearest(&panda, &beta, Uncertainty::Deviations(&unknown(&beta)), &prior).unwrap();
    assert_exact(&panda, &beta, &same);
    assert!((stacked(&same.links) - stacked(&truth)).amax() < 1e-9);
    // And a heavier prior gives a heavier arm with the same torques.
    let heavy = Prior { links: truth.iter().map(|link| link.map(|value| 3.0 * value)).collect(), ..prior };
    let heavier = nearest(&panda, &beta, Uncertainty::Deviations(&unknown(&beta)), &heavy).unwrap();
    assert_exact(&panda, &beta, &heavier);
    assert!(mass(&heavier.links) > 1.2 * real, "{}", mass(&heavier.links));
}

fn mass(links: &[LinkParameters]) -> f64 {
    links.iter().map(|link| link[9]).sum()
}

#[test]
fn random_arms_are_reproduced() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (name, chain) in all() {
        check_random(&mut rng, name, &chain);
    }
    for k in 0..60 {
        let chain = random_chain(&mut rng);
        check_random(&mut rng, &format!("random {k}"), &chain);
    }
}

fn check_random(rng: &mut ChaCha8Rng, name: &str, chain: &Chain) {
    let structure = structure(chain, &[]);
    if structure.reduction().is_empty() {
        return;
    }
    let bodies: Vec<LinkParameters> = (0..chain.len()).map(|_| random_body(rng)).collect();
    let beta: Vec<f64> = structure.reduction().base_of(&stacked(&bodies)).iter().copied().collect();
    let prior = Prior::of_geometry(&structure, &beta);
    let found = nearest(&structure, &beta, Uncertainty::Deviations(&unknown(&beta)), &prior)
        .unwrap_or_else(|error| panic!("{name}: {error}"));
    assert_exact(&structure, &beta, &found);
}

/// Noise carries most estimates out of what bodies can have. The result is then the nearest: no body anywhere in any link, added to or
/// taken from it, comes nearer.
#[test]
fn what_no_arm_has_is_moved_to_the_nearest() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let truth = arm("sim-panda").link_parameters();
    let panda = structure(&chain("panda"), &["friction", "torque-offset"]);
    let rigid = panda.reduction().len();
    let beta: Vec<f64> = panda.reduction().base_of(&stacked(&truth)).iter().copied().chain([0.3; 21]).collect();
    let mut moved = 0;
    for share in [0.003, 0.03, 0.1, 0.3] {
        let c = covariance(&mut rng, &beta, share);
        let noise = c.clone().cholesky().unwrap().l() * DVector::from_fn(beta.len(), |_, _| rng.sample(StandardNormal));
        let noisy: Vec<f64> = beta.iter().zip(&noise).map(|(beta, noise)| beta + noise).collect();
        let prior = Prior::of_geometry(&panda, &noisy);
        let found = nearest(&panda, &noisy, Uncertainty::Covariance(&c, &deviations(&c)), &prior).unwrap();
        if found.exact {
            continue;
        }
        moved += 1;
        assert!(found.links.iter().all(is_consistent));
        let now = panda.reduction().base_of(&stacked(&found.links));
        assert!(now.iter().zip(&found.beta).all(|(a, b)| (a - b).abs() < 1e-12));

        // Its distance is what it says, and shorter than that of the truth, which noise left behind.
        let inverse = c.view((0, 0), (rigid, rigid)).into_owned().cholesky().unwrap();
        let off = DVector::from_iterator(rigid, noisy.iter().zip(&now).map(|(beta, now)| beta - now));
        let y = inverse.solve(&off);
        assert!((off.dot(&y).sqrt() - found.distance).abs() < 1e-5 * found.distance, "{share}");
        let noise = noise.rows(0, rigid).into_owned();
        assert!(found.distance < noise.dot(&inverse.solve(&noise)).sqrt());
        for (c, moved) in deviations(&c)
            .iter()
            .zip(&found.moved)
            .zip(found.beta.iter().zip(&noisy))
            .map(|((deviation, moved), (to, from))| ((to - from) / deviation.unwrap(), *moved))
        {
            assert!((c - moved).abs() < 1e-9 * (1.0 + c.abs()));
        }

        // Point masses generate all bodies: none of them points nearer, up to the barrier that the method leaves (GAP in its source), and
        // going along the result itself gains nothing.
        let pull = panda.reduction().regroup().tr_mul(&y);
        let barrier = 1e-4 * (1.0 + 0.5 * found.distance * found.distance) / 28.0;
        let measure = |link: usize, body: &LinkParameters| {
            let inverse = pseudo_inertia(&prior.links[link]).try_inverse().unwrap();
            (inverse * pseudo_inertia(body)).trace()
        };
        let gain = |link: usize, body: &LinkParameters| -> f64 {
            body.iter().zip(pull.rows(10 * link, 10).iter()).map(|(a, b)| a * b).sum()
        };
        let along: f64 = (0..7).map(|i| gain(i, &found.links[i]) - FLOOR * gain(i, &prior.links[i])).sum();
        let size: f64 = (0..7).map(|i| 4.0 + measure(i, &found.links[i])).sum();
        assert!(along.abs() < 2.0 * barrier * size, "{along} {barrier} {size}");
        for link in 0..7 {
            for _ in 0..200 {
                let reach = rng.random_range(0.0..2.0f64).powi(3);
                let com = Vector3::from_fn(|_, _| rng.random_range(-reach..=reach));
                let point = Body { mass: 1.0, com, inertia: Matrix3::zeros() }.link_parameters();
                // The multiplier is known to the equations left open, some 1e-4 of a standard deviation each.
                let mut alone = DVector::zeros(70);
                alone.rows_mut(10 * link, 10).copy_from_slice(&point);
                let rows = panda.reduction().base_of(&alone);
                let known: f64 = rows.iter().zip(deviations(&c)).map(|(row, std)| (row / std.unwrap()).abs()).sum();
                let gain = gain(link, &point);
                assert!(gain < 2.0 * barrier * measure(link, &point) + 1e-4 * known, "link {link}: {gain}, {known}");
            }
        }

        // Friction and offsets follow: beta_o - C_or C_rr^-1 (beta_r - K delta).
        let expected = DVector::from_column_slice(&noisy[rigid..]) - c.view((rigid, 0), (21, rigid)) * &y;
        assert!((expected - DVector::from_column_slice(&found.beta[rigid..])).amax() < 1e-5 * share);
    }
    assert!(moved >= 2, "{moved} of 4");
}

/// The paper's Table III: no arm has its Lzz7 = -0.005, which nothing is regrouped with.
#[test]
fn table_3_is_projected_and_labelled() {
    let text = include_str!("../../config/models/panda-paper-table3.toml");
    let file = ModelFile::parse("Table III", text, |name| Ok(Robot::load(name, None)?.chain)).unwrap();
    let (beta, structure) = (file.model.beta(), file.model.structure());
    let prior = Prior::of_geometry(structure, &beta);
    let found = nearest(structure, &beta, Uncertainty::Deviations(&unknown(&beta)), &prior).unwrap();
    assert!(!found.exact && found.distance > 1.0 && found.links.iter().all(is_consistent));
    let lzz7 = structure.columns().iter().position(|column| column.name == "Lzz7").unwrap();
    assert!(beta[lzz7] < 0.0 && found.beta[lzz7] > 0.0 && found.moved[lzz7] > 0.0);
    // Without a covariance friction has no reason to move.
    assert_eq!(found.beta[45..], beta[45..]);
}

/// Motor-side torques hold rotor inertias; those of joints 1 and 2 are part of Lzz1 and Lzz2, and no inertia of a link has to stand
/// for them.
#[test]
fn rotor_inertias_are_separated_from_links() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let chain = chain("ur10");
    let structure = structure(&chain, &["friction", "torque-offset", "rotor-inertia"]);
    assert!(!structure.absorbed().is_empty());
    let bodies: Vec<LinkParameters> = (0..6).map(|_| random_body(&mut rng)).collect();
    let rotors: Vec<f64> = (0..6).map(|_| rng.random_range(0.5..5.0)).collect();
    let rigid = structure.reduction().len();
    let mut beta: Vec<f64> = structure.columns().iter().map(|_| 0.1).collect();
    beta[..rigid].copy_from_slice(structure.reduction().base_of(&stacked(&bodies)).as_slice());
    let position = |name: &str| structure.columns().iter().position(|column| column.name == name);
    for (joint, rotor) in rotors.iter().enumerate() {
        if let Some(own) = position(&format!("ia{}", joint + 1)) {
            beta[own] = *rotor;
        }
    }
    for absorbed in structure.absorbed() {
        for (name, coefficient) in &absorbed.into {
            beta[position(name).unwrap()] += coefficient * rotors[absorbed.column.joint - 1];
        }
    }
    let prior = Prior::of_geometry(&structure, &beta);
    let found = nearest(&structure, &beta, Uncertainty::Deviations(&unknown(&beta)), &prior).unwrap();
    assert!(found.exact && found.rotors.iter().all(|rotor| *rotor > 0.0), "{:?}", found.rotors);
    let mut again = structure.reduction().base_of(&stacked(&found.links));
    for absorbed in structure.absorbed() {
        for (name, coefficient) in &absorbed.into {
            again[position(name).unwrap()] += coefficient * found.rotors[absorbed.column.joint - 1];
        }
    }
    assert!(again.iter().zip(&beta).all(|(a, b)| (a - b).abs() < 1e-11));
    for (found, real) in found.rotors.iter().zip(&rotors).skip(2) {
        assert!((found - real).abs() < 1e-12);
    }

    // A rotor with negative inertia is none.
    let ia6 = position("ia6").unwrap();
    beta[ia6] = -0.2;
    let found = nearest(&structure, &beta, Uncertainty::Deviations(&unknown(&beta)), &prior).unwrap();
    assert!(!found.exact && found.beta[ia6] > 0.0 && found.rotors[5] == found.beta[ia6]);
}

#[test]
fn an_inconsistent_prior_is_refused() {
    let panda = structure(&chain("panda"), &[]);
    let beta = vec![0.1; 45];
    let good = Prior::of_geometry(&panda, &beta);
    let mut prior = good.clone();
    prior.links[3][9] = -1.0;
    let run = |prior: &Prior, beta: &[f64]| nearest(&panda, beta, Uncertainty::Deviations(&unknown(beta)), prior);
    assert!(matches!(run(&prior, &beta), Err(ConsistencyError::Prior { link: 4, .. })));
    let mut prior = good.clone();
    prior.rotors[2] = 0.0;
    assert!(matches!(run(&prior, &beta), Err(ConsistencyError::Rotor { joint: 3, .. })));
    let mut wild = beta.clone();
    wild[7] = f64::NAN;
    assert_eq!(run(&good, &wild), Err(ConsistencyError::Failed));
}

/// Whatever the numbers, there is an answer that bodies can have: any arm, noise up to thirty times the parameters, covariances that know
/// only some directions, parameters that the data does not determine.
#[test]
fn noise_does_not_defeat_it() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let (mut moved, mut reproduced) = (0, 0);
    for k in 0..120 {
        let chain = random_chain(&mut rng);
        let structure = structure(&chain, &["friction", "rotor-inertia"]);
        let rigid = structure.reduction().len();
        if rigid == 0 {
            continue;
        }
        let bodies: Vec<LinkParameters> = (0..chain.len()).map(|_| random_body(&mut rng)).collect();
        let mut beta = vec![0.5; structure.columns().len()];
        beta[..rigid].copy_from_slice(structure.reduction().base_of(&stacked(&bodies)).as_slice());
        let share = *[0.001, 0.1, 1.0, 30.0].choose(&mut rng).unwrap();
        let mut c = covariance(&mut rng, &beta, share);
        let mut known = deviations(&c);
        for (column, known) in known.iter_mut().enumerate() {
            // Not determined: as the estimator leaves them, without variance in that direction.
            if rng.random_bool(0.1) {
                *known = None;
                c.row_mut(column).fill(0.0);
                c.column_mut(column).fill(0.0);
            }
        }
        let noisy: Vec<f64> = (0..beta.len())
            .map(|c| beta[c] + known[c].unwrap_or(beta[c]) * rng.sample::<f64, _>(StandardNormal))
            .collect();
        let prior = Prior::of_geometry(&structure, &noisy);
        let found = nearest(&structure, &noisy, Uncertainty::Covariance(&c, &known), &prior)
            .unwrap_or_else(|error| panic!("arm {k}, noise {share}: {error}"));
        assert!(found.links.iter().all(is_consistent) && found.distance.is_finite());
        assert_eq!(found.exact, found.distance == 0.0);
        *(if found.exact { &mut reproduced } else { &mut moved }) += 1;
    }
    assert!(moved > 20 && reproduced > 20, "{moved} moved, {reproduced} reproduced");
}
