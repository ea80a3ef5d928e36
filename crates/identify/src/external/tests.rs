//! The observer along exact motions of a Panda, by the model's own torque and a force through the Jacobian.

use super::*;
use plumbline_model::{Mounting, Robot, Structure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

const DT: f64 = 1e-3;

fn panda() -> TorqueModel {
    let chain = Robot::load("panda", None).unwrap().chain;
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let reduction = plumbline_model::Reduction::any_mounting(&chain);
    // Bodies of about a kilogram.
    let delta: Vec<f64> = (0..7)
        .flat_map(|_| {
            let [x, y, z] = [(); 3].map(|()| rng.random_range(-0.05..0.05));
            let body = plumbline_model::Body {
                mass: 1.5,
                com: [x, y, z].into(),
                inertia: nalgebra::Matrix3::identity() * 0.01,
            };
            body.link_parameters()
        })
        .collect();
    let base = reduction.base_of(&nalgebra::DVector::from_vec(delta));
    let structure = Structure::of(chain, reduction, &["friction"]).unwrap();
    let friction = [[0.05; 7], [0.3; 7]].concat();
    let values: Vec<_> = base.iter().copied().chain(friction).map(|value| (value, None)).collect();
    TorqueModel::new("panda", structure, vec![Mounting::WALL], &values).unwrap()
}

/// Position, velocity and acceleration of a motion that reverses at different times in each joint.
fn motion(t: f64) -> Sample {
    let mut sample = Sample::default();
    let middle = [0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5];
    for (j, middle) in middle.into_iter().enumerate() {
        let w = 1.5 + 0.4 * j as f64;
        let (sin, cos) = (w * t + j as f64).sin_cos();
        (sample.q[j], sample.dq[j], sample.ddq[j]) = (middle + 0.4 * sin, 0.4 * w * cos, -0.4 * w * w * sin);
    }
    sample
}

fn uncertainty(std: f64) -> TorqueUncertainty {
    let p = panda().structure().columns().len();
    // White noise: a power in proportion to the width of a band.
    let power: Vec<f64> =
        ResidualSpectrum::bands(1.0 / DT).map(|[low, high]| std * std * (high - low) / 500.0).collect();
    TorqueUncertainty {
        parameters: Spread::zero(p),
        residual_std: vec![std; 7],
        residual_freedom: 1e9,
        residual_spectrum: Some(ResidualSpectrum { rate: 1.0 / DT, power: vec![power; 7] }),
    }
}

fn observer(std: f64, settings: ObserverSettings) -> ExternalObserver {
    ExternalObserver::new(&panda(), &uncertainty(std), &Mounting::WALL.gravity(), settings).unwrap()
}

fn ways() -> [ObserverSettings; 2] {
    [Way::Momentum, Way::Acceleration].map(|way| ObserverSettings { way, ..ObserverSettings::default() })
}

/// Without noise the momentum observer finds the external torque late by its delay, also where friction reverses; that by accelerations errs there.
#[test]
fn a_slow_external_torque_is_found_late_by_the_delay() {
    let mut evaluator = panda().evaluator(&Mounting::WALL.gravity());
    let external = |t: f64, j: usize| (0.5 + 0.1 * j as f64) * (2.0 * t + j as f64).sin();
    let mut worst = [0.0f64; 2];
    for (settings, worst) in ways().into_iter().zip(&mut worst) {
        let mut observer = observer(0.1, settings);
        for k in 0..4000 {
            let t = f64::from(k) * DT;
            let sample = motion(t);
            let Torque(mut tau) = evaluator.torque(&sample);
            tau.iter_mut().take(7).enumerate().for_each(|(j, tau)| *tau += external(t, j));
            let found = observer.next(&sample.q, &sample.dq, &tau);
            assert_eq!(found.settled, k >= 60);
            if k > 300 {
                let late = t - observer.delay();
                (0..7).for_each(|j| *worst = worst.max((found.tau[j] - external(late, j)).abs()));
            }
        }
    }
    // The delay is constant for slow signals: the second derivative of 0.8 Nm at 2 rad/s leaves 1 mNm.
    assert!(worst[0] < 2e-3, "{worst:?}");
    // Coulomb friction of 0.3 Nm that reverses.
    assert!(worst[1] > 0.02 && worst[1] < 0.3, "{worst:?}");
}

/// White noise of the stated spectrum: intervals cover 95 %, thresholds are crossed as often as stated, and a torque of twice the threshold is found.
#[test]
fn intervals_cover_and_false_alarms_are_as_rare_as_stated() {
    // Many, so that a short record counts them.
    let often = ObserverSettings { false_alarms: 3600.0, ..ObserverSettings::default() };
    let mut observer = observer(0.15, often);
    let sample = Sample { dq: JointVec::default(), ..motion(0.3) };
    let Torque(at_rest) =
        panda().evaluator(&Mounting::WALL.gravity()).torque(&Sample { ddq: JointVec::default(), ..sample });
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (mut inside, mut counted, mut alarms, mut before) = (0, 0, 0, [false; 7]);
    let seconds = 60;
    for _ in 0..seconds * 1000 {
        let mut tau = at_rest;
        tau.iter_mut().take(7).for_each(|tau| *tau += 0.15 * rng.sample::<f64, _>(StandardNormal));
        let found = observer.next(&sample.q, &sample.dq, &tau);
        for (j, before) in before.iter_mut().enumerate().filter(|_| found.settled) {
            counted += 1;
            inside += u32::from(found.tau[j].abs() <= found.half_width[j]);
            let beyond = found.tau[j].abs() > found.threshold[j];
            alarms += u32::from(beyond && !*before);
            *before = beyond;
        }
    }
    let share = f64::from(inside) / f64::from(counted);
    assert!((0.94..0.96).contains(&share), "{share}");
    // One a second is stated: 60, with a standard deviation of 8.
    assert!((35..85).contains(&alarms), "{alarms}");

    let mut tau = at_rest;
    tau[1] += 2.0 * observer.next(&sample.q, &sample.dq, &at_rest).threshold[1];
    let after = (0..50).position(|_| observer.next(&sample.q, &sample.dq, &tau).contact);
    assert!(after.is_some_and(|ms| (5..30).contains(&ms)), "{after:?}");
}

/// The spectrum of a recorded motion holds its noise; a push that is excluded is not part of it.
#[test]
fn the_spectrum_of_a_recording_is_that_of_its_noise() {
    let model = panda();
    let mut evaluator = model.evaluator(&Mounting::WALL.gravity());
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let rows = 20_000;
    let zeros = || DMatrix::zeros(rows, 7);
    let (mut q, mut dq, mut tau) = (zeros(), zeros(), zeros());
    for k in 0..rows {
        let sample = motion(k as f64 * DT);
        let Torque(torque) = evaluator.torque(&sample);
        let push = if (5000..6000).contains(&k) { 5.0 } else { 0.0 };
        for j in 0..7 {
            (q[(k, j)], dq[(k, j)]) = (sample.q[j], sample.dq[j]);
            tau[(k, j)] = torque[j] + push + 0.15 * rng.sample::<f64, _>(StandardNormal);
        }
    }
    let t = (0..rows).map(|k| k as f64 * DT).collect();
    let run = Run { name: "run".into(), t, q, dq: Some(dq), tau, mounting: Mounting::WALL, period: None };
    let span = crate::ExcludedSpan { run: "run".into(), from: 5.0, to: 6.0 };
    let settings = Settings { leave_out: vec![span], ..Settings::default() };
    let spectrum = residual_spectrum(&model, &[&run], &settings).unwrap();
    assert_eq!(spectrum.rate, 1000.0);
    for power in &spectrum.power {
        // In the mean of two samples.
        let std = power.iter().sum::<f64>().sqrt();
        assert!((std / (0.15 / 2f64.sqrt()) - 1.0).abs() < 0.05, "{std}");
    }
    let all = residual_spectrum(&model, &[&run], &Settings::default()).unwrap();
    assert!(all.power[0].iter().sum::<f64>() > 1.0);

    // Along the same recording the push is contact, and nothing else is.
    let uncertainty = TorqueUncertainty { residual_spectrum: Some(spectrum), ..uncertainty(0.15) };
    let seen = observe(&model, &uncertainty, &run, true, ObserverSettings::default()).unwrap();
    let contact: Vec<usize> = (0..rows).filter(|&k| seen.samples[k].contact).collect();
    assert!(
        (5001..5030).contains(&contact[0]) && (6000..6060).contains(contact.last().unwrap()),
        "{} to {:?}",
        contact[0],
        contact.last()
    );
}

#[test]
fn settings_out_of_range_and_a_model_without_spectrum_are_refused() {
    let gravity = Mounting::WALL.gravity();
    let usual = ObserverSettings::default();
    let refused = |uncertainty: &TorqueUncertainty, settings| {
        ExternalObserver::new(&panda(), uncertainty, &gravity, settings).err().map(|error| error.to_string())
    };
    let without = TorqueUncertainty { residual_spectrum: None, ..uncertainty(0.1) };
    assert!(refused(&without, usual).unwrap().contains("residual spectrum"));
    for settings in [
        ObserverSettings { bandwidth: 500.0, ..usual },
        ObserverSettings { bandwidth: f64::NAN, ..usual },
        ObserverSettings { false_alarms: 0.0, ..usual },
        ObserverSettings { dt: 0.0, ..usual },
    ] {
        assert!(refused(&uncertainty(0.1), settings).is_some(), "{settings:?}");
    }
    let mut own = observer(0.1, usual);
    assert!(own.configure(ObserverSettings { bandwidth: -1.0, ..usual }).is_err());
    assert_eq!(own.settings(), &usual);
}
