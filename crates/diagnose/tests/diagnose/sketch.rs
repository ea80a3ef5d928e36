//! A rough look at an effect that is integrated in time is nearly the careful one.

use plumbline_diagnose::{Candidate, Evidence, Span, Trial};
use plumbline_identify::{Experiment, Run};
use plumbline_model::term::effect::{Site, Spec};
use plumbline_model::{Chain, Mounting, Reduction, Structure};
use plumbline_testkit::diagnosis::trial::Bench;
use plumbline_testkit::scene::lab::{self, Noise};

#[test]
fn a_sketch_of_a_swinging_link_is_nearly_its_columns() {
    let Bench { chain, base, identify, .. } = Bench::new();
    let repeats =
        lab::period(&chain, &base, &identify[0], Mounting::WALL, "one").record(&base, 4, Noise { coloured: 0.05 }, 1);
    let once = Run { period: None, ..repeats.clone() };
    for (run, most) in [(repeats, 0.45), (once, 0.6)] {
        nearly(&chain, &run, most);
    }
}

/// Columns of links that swing along a run, and sketches that are apart by less than this share.
fn nearly(chain: &Chain, run: &Run, most: f64) {
    let experiment = Experiment::prepare(run, &plumbline_identify::Settings::default()).unwrap();
    let trials = [Trial::alone(&experiment)];
    let evidence = Evidence::of(chain, &trials, 10.0);
    let structure =
        Structure::of(chain.clone(), Reduction::in_mounting(chain, &Mounting::WALL), &["friction"]).unwrap();
    let beta = plumbline_identify::solve::identify(&structure, std::slice::from_ref(&experiment)).unwrap().beta;
    let operating_point = structure.operating_point(&beta);
    // Joint 7 flutters in its gap, joint 2 swings slowly.
    for (joint, settings) in [(6, vec![7.5e-4, 0.5, 5e-5, 5.0]), (1, vec![7.5e-4, 0.5, 5e-5, 2.5])] {
        let spec = Spec { family: "backlash", form: "swinging", site: Site::Joint(joint), settings };
        let careful = Candidate::of(&evidence, &operating_point, spec.clone(), Span::ALL).unwrap();
        let rough = Candidate::sketch(&evidence, &operating_point, spec, Span::ALL).unwrap();
        assert_ne!(careful.rows, rough.rows, "there is nothing rough about it");
        let of = |item: &Candidate, joint: usize| item.rows.of(joint).unwrap().into_owned();
        let square = |part: nalgebra::DMatrix<f64>| part.norm_squared();
        let joints = careful.joints();
        let apart: f64 = joints.iter().map(|&joint| square(of(&careful, joint) - of(&rough, joint))).sum();
        let whole: f64 = joints.iter().map(|&joint| square(of(&careful, joint))).sum();
        // Without the means a flank that is hit between two samples is lost or counts five times: several times as far off.
        let off = (apart / whole).sqrt();
        println!("period {:?}, joint {}: {off}", run.period, joint + 1);
        assert!(off < most, "joint {}: {off}", joint + 1);
    }
}
