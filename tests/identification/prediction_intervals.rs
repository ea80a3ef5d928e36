//! Prediction intervals of a model file: the part of the parameters. `jobs predict_command` has the intervals of measured samples.

use nalgebra::DVector;
use plumbline::store::{ModelFile, Provenance, uncertainty_of};
use plumbline_core::{parallel, threads};
use plumbline_identify::{Experiment, Settings, TorqueUncertainty, solve};
use plumbline_model::{Robot, TorqueModel};
use plumbline_testkit::scene::{Coloured, Extra, Scene};

/// Recordings, each with the noise of its own seed.
const SEEDS: u64 = 32;
const PERIODS: usize = 4;

/// Parameters and uncertainty of a model that was identified from one recording, as read from the text of its file.
fn stored(scene: &Scene, seed: u64, extra: Extra) -> (Vec<f64>, TorqueUncertainty) {
    let experiment = Experiment::prepare(&scene.record_with(PERIODS, seed, extra), &Settings::default()).unwrap();
    let found = solve::identify(&scene.structure, &[experiment]).unwrap();
    let model = TorqueModel::new("panda", scene.structure.clone(), vec![scene.mounting], &found.values()).unwrap();
    let uncertainty = uncertainty_of(&found, &model, None);
    let (noise_floor, provenance) = (Vec::new(), Provenance::default());
    let file = ModelFile { model, noise_floor, validation: Vec::new(), uncertainty, consistent: None, provenance };
    let read = ModelFile::parse("model.toml", &file.to_toml(), |name| Ok(Robot::load(name, None)?.chain)).unwrap();
    (read.model.beta(), read.uncertainty.expect("an identified model has an uncertainty"))
}

/// Without the residual, the interval is that of the modelled torque: its true value on an unseen motion is known.
#[test]
#[ignore = "hil/long-tests/run.sh"]
fn the_covariance_of_a_model_file_gives_the_error_of_its_torques() {
    let scene = Scene::panda_on_the_wall();
    let n = scene.joints();
    let regressor = scene.structure.regressor(&scene.unseen());
    let truth = &regressor * DVector::from_column_slice(&scene.beta);
    for coloured in [0.0, 0.1] {
        let extra = Extra { coloured: Coloured::of(coloured), ..Extra::default() };
        let seeds: Vec<u64> = (0..SEEDS).collect();
        let coverages: Vec<f64> = parallel(&seeds, threads(), |&seed| {
            let (beta, uncertainty) = stored(&scene, seed, extra);
            let widths = TorqueUncertainty { residual_std: vec![0.0; n], ..uncertainty }.half_widths(&regressor);
            let error = &regressor * DVector::from_vec(beta) - &truth;
            let inside = error.iter().zip(&widths).filter(|(error, width)| error.abs() <= **width).count();
            inside as f64 / widths.len() as f64
        });
        let coverage = coverages.iter().sum::<f64>() / SEEDS as f64;
        let scatter = (coverages.iter().map(|own| (own - coverage).powi(2)).sum::<f64>() / (SEEDS - 1) as f64).sqrt();
        let of_mean = scatter / (SEEDS as f64).sqrt();
        println!(
            "coloured noise {coloured} Nm: {:.1} +- {:.1} % of the true torques",
            100.0 * coverage,
            100.0 * of_mean
        );
        // The errors of one recording come from the same parameters: each recording counts once.
        assert!((0.93..0.975).contains(&coverage) && of_mean < 0.01, "{coloured}: {coverage} +- {of_mean}");
    }
}
