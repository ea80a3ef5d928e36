//! Direction of gravity and its uncertainty.

use super::*;
use nalgebra::{Rotation3, Vector3};
use plumbline::inclinometer::attitude::{InstallationError, SlopeConvention};
use plumbline_model::{G, angle_between};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Slopes for a gravity vector and sensor axes, computed independently of the product \[deg\].
fn expected_slopes(axes: &Rotation3<f64>, gravity: &Vector3<f64>, slopes: SlopeConvention) -> [f64; 2] {
    let up = axes.inverse() * (-gravity.normalize());
    match slopes {
        SlopeConvention::Horizon => [up.x, up.y].map(|share| share.asin().to_degrees()),
        SlopeConvention::Projected => [(up.x / up.z).atan(), (up.y / up.z).atan()].map(f64::to_degrees),
    }
}

#[test]
fn random_installations_give_the_true_direction() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut checked = 0;
    while checked < 60 {
        let mut draw = |range: f64| rng.random_range(-range..range);
        let axes = Rotation3::from_euler_angles(draw(3.1), draw(1.5), draw(3.1));
        let declared = Mounting { rho: draw(1.57) + 1.57, phi: draw(3.1) };
        let tilted = Rotation3::from_euler_angles(draw(0.2), draw(0.2), draw(0.2)) * declared.gravity();
        let slopes = if checked % 2 == 0 { SlopeConvention::Horizon } else { SlopeConvention::Projected };
        let zero = [draw(0.02), draw(0.02)];
        let column = |k: usize| -> [f64; 3] { axes.matrix().column(k).into_owned().into() };
        let mut own = Installation::new(column(0), column(2)).unwrap();
        (own.slopes, own.zero) = (slopes, zero);
        let Ok(_) = own.hemisphere(&declared) else { continue };
        let raw = expected_slopes(&axes, &tilted, slopes);
        let tilt = [0, 1].map(|axis| raw[axis] + zero[axis].to_degrees());
        let up = axes.inverse() * -tilted;
        let same_side = up.z * (axes.inverse() * -declared.gravity()).z > 0.0;
        if tilt.iter().any(|slope| slope.abs() > 75.0) || up.z.abs() < 3.0 || !same_side {
            continue;
        }
        checked += 1;
        let mut device = Device::new(NODE, tilt, 0.0, 1, 0);
        device.set(0x6000, 0, &1_u16.to_le_bytes());
        let mut harness = Harness::with(SensorSettings { installation: own, declared, ..settings() }, device);
        harness.use_32_bits();
        harness.advance(3000);
        let reading = harness.reading();
        let off = angle_between(&reading.attitude.gravity, &tilted);
        // Resolution of 0.001 deg, amplified close to the horizontal.
        assert!(off < 1.5e-4, "{off} rad at {tilt:?}, z {}", up.z);
        assert!((reading.attitude.gravity.norm() - G).abs() < 1e-9);
        let back = reading.attitude.mounting().gravity();
        assert!(angle_between(&back, &reading.attitude.gravity) < 1e-9);
    }
}

impl Harness {
    /// Uses slopes of 32 bits: 16 bits of 0.001 deg end at 32.8 deg.
    fn use_32_bits(&mut self) {
        let mut settings = *self.sensor.settings();
        settings.node.width = Width::Bits32;
        self.sensor = Sensor::new(settings).unwrap();
    }
}

#[test]
fn the_covariance_matches_the_sample_variance() {
    let mut settings = settings();
    settings.installation.accuracy = 0.0;
    // A threshold of base motion above the noise.
    settings.filter = SlopeFilterSettings { time_constant: 0.2, still: 2f64.to_radians(), ..settings.filter };
    let true_up = |tilt: [f64; 2]| {
        let [x, y] = tilt.map(|slope| slope.to_radians().sin());
        Vector3::new(x, y, (1.0 - x * x - y * y).sqrt())
    };
    for tilt in [[0.0, 0.0], [30.0, -45.0]] {
        let mut device = Device::new(NODE, tilt, 0.2, 7, 0);
        device.set(0x6000, 0, &1_u16.to_le_bytes());
        let mut wide = settings;
        wide.node.width = Width::Bits32;
        let mut harness = Harness::with(wide, device).brought_up();
        let (mut square, mut predicted, mut count) = (0.0, 0.0, 0);
        for _ in 0..400 {
            // Five time constants apart: independent samples.
            harness.advance(1000);
            let reading = harness.reading();
            let off = -reading.attitude.gravity / G - true_up(tilt);
            square += off.norm_squared();
            predicted += reading.attitude.covariance.trace();
            count += 1;
        }
        let ratio = square / predicted;
        assert!(
            (0.75..1.33).contains(&ratio),
            "{tilt:?}: ratio of sample variance to predicted variance {ratio} ({count})"
        );
    }
}

#[test]
fn mounting_angles_and_their_standard_deviations() {
    let mut settings = settings();
    settings.installation.accuracy = 0.1f64.to_radians();
    let harness = Harness::new(settings, [20.0, 0.0]).brought_up();
    let attitude = harness.reading().attitude;
    let Mounting { rho, phi } = attitude.mounting();
    // Tilted 20 deg about -y: gravity leans towards -x.
    assert!((rho - 160f64.to_radians()).abs() < 1e-4 && (phi.abs() - std::f64::consts::PI).abs() < 1e-4, "{rho} {phi}");
    let [std_rho, std_phi] = attitude.std_of_angles();
    assert!((std_rho.to_degrees() - 0.1).abs() < 1e-3, "{std_rho}");
    assert!((std_phi.to_degrees() - 0.1 / 20f64.to_radians().sin()).abs() < 2e-3, "{std_phi}");
    // With gravity along axis 1, phi is undefined.
    let upright = Harness::new(settings, [0.0, 0.0]).brought_up().reading().attitude;
    assert_eq!(upright.std_of_angles()[1], std::f64::consts::PI);
    assert_eq!(Mounting::along(&Mounting::CEILING.gravity()), Mounting::CEILING);
}

#[test]
fn a_mounting_outside_the_range_is_refused() {
    // On a wall, a sensor flat on the base has a horizontal z axis.
    assert!(matches!(installation().hemisphere(&Mounting::WALL), Err(InstallationError::OutOfRange { .. })));
    // On a bracket: z axis of the sensor along -x of the base, which points up on the wall.
    let bracket = Installation::new([0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]).unwrap();
    assert_eq!(bracket.hemisphere(&Mounting::WALL), Ok(1.0));
    // Upright and ceiling have the same slopes; the declared mounting determines the sign.
    let level = |slopes: [f64; 2]| slopes.iter().all(|slope| slope.abs() < 1e-12);
    assert!(level(installation().expected(&Mounting::UPRIGHT)) && level(installation().expected(&Mounting::CEILING)));
    assert_eq!(installation().hemisphere(&Mounting::UPRIGHT), Ok(1.0));
    assert_eq!(installation().hemisphere(&Mounting::CEILING), Ok(-1.0));
    let hanging = Harness::new(SensorSettings { declared: Mounting::CEILING, ..settings() }, [0.0, 0.0]).brought_up();
    assert!(hanging.reading().attitude.mounting().angle_to(&Mounting::CEILING) < 1e-9);
    for (x, z) in [([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]), ([2.0, 0.0, 0.0], [0.0, 0.0, 1.0]), ([0.0; 3], [0.0; 3])] {
        assert!(matches!(Installation::new(x, z), Err(InstallationError::Axes { .. })));
    }
    assert!(matches!(Installation::new([f64::NAN, 0.0, 0.0], [0.0, 0.0, 1.0]), Err(InstallationError::Axes { .. })));
}
