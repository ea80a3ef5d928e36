//! `plumbline payload`: the body on the flange from a short motion of the wrist, against a stored model.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::payload::{self, BodyOnFlange, Planned};
use crate::process::signals::Ending;
use crate::store::export::load::seen_from_flange;
use crate::store::save_plan;
use clap::Args;
use nalgebra::DVector;
use plumbline_core::BadInput;
use plumbline_identify::payload::Found;
use plumbline_identify::solve::student_975;
use plumbline_model::{Chain, LINK_COLUMNS};

/// Options of `plumbline payload`.
#[derive(Args)]
#[group(skip)]
pub struct Options {
    #[command(flatten)]
    payload: payload::Options,
}

/// Plans the motion, or finds the body along a recorded one.
pub fn run(Options { payload: options }: Options) -> Result<(), Failure> {
    if let Some(path) = &options.plan {
        let ending = Ending::interrupts()?;
        let Planned { plan, first, joints, ratio } = payload::plan(&options, &|| ending.arrived())?;
        save_plan(&plan, path).map_err(Failure::job)?;
        say!("{}: joints {first} to {joints} move for {} s; drive it twice", path.display(), plan.period);
        say!("weakest over strongest direction of the body's ten parameters: {ratio:.2e}");
        return Ok(());
    }
    let Some(run) = &options.run else {
        return Err(BadInput::new("command line", "--run", "no run", "--run FILE or --plan FILE").into());
    };
    let BodyOnFlange { found, model, without_uncertainty } = payload::find(&options, run)?;
    lines(&found, model.model.structure().chain()).iter().for_each(|line| say!("{line}"));
    if without_uncertainty {
        say!("note: the model file has no [uncertainty]: errors of the stored model are not part of the intervals");
    }
    if let Some(out) = &options.out {
        crate::atomic::write_result(out, model.to_toml().as_bytes())?;
        say!("{}", out.display());
    }
    Ok(())
}

/// Mass, centre of mass in the frame of the flange, moments of inertia about it, each with its 95 % interval.
fn lines(found: &Found, chain: &Chain) -> Vec<String> {
    let numbers = |values: &[f64; LINK_COLUMNS]| {
        seen_from_flange(chain, values).map_or([f64::NAN; 7], |body| {
            let i = body.inertia.diagonal();
            [body.mass, body.com.x, body.com.y, body.com.z, i.x, i.y, i.z]
        })
    };
    let at = numbers(&found.values);
    let std = |k: usize| found.spread.covariance[(k, k)].max(0.0).sqrt().max(1e-12);
    let slope = |k: usize, i: usize| {
        let moved = |by: f64| {
            let mut values = found.values;
            values[k] += by * std(k);
            numbers(&values)[i]
        };
        (moved(1e-3) - moved(-1e-3)) / (2e-3 * std(k))
    };
    let half = |i: usize| {
        let slopes = DVector::from_fn(LINK_COLUMNS, |k, _| slope(k, i));
        let freedom = found.spread.freedom.iter().copied().fold(f64::INFINITY, f64::min);
        student_975(freedom) * (&found.spread.covariance * &slopes).dot(&slopes).max(0.0).sqrt()
    };
    let metres = |i: usize| format!("{:.2} +- {:.2}", 1e3 * at[i], 1e3 * half(i));
    let inertia = |i: usize| format!("{:.5} +- {:.5}", at[i], half(i));
    let list = |values: &[f64]| values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(" ");
    vec![
        format!("mass {:.4} +- {:.4} kg (95 %)", at[0], half(0)),
        format!("centre of mass in the flange frame [mm]: x {}, y {}, z {}", metres(1), metres(2), metres(3)),
        format!("moments of inertia about it [kg m2]: xx {}, yy {}, zz {}", inertia(4), inertia(5), inertia(6)),
        format!("filtered error per joint [Nm]: {} -> {}", list(&found.rms[0]), list(&found.rms[1])),
    ]
}
