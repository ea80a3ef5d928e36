//! The product's own files, and a program that makes the compiler produce the loop's code from them: `run.sh` says what for.

#[path = "../../../src/excite/error.rs"]
mod error;
#[path = "../../../src/excite/fourier.rs"]
mod fourier;
#[path = "../../../src/backend/franka/mod.rs"]
mod franka;
#[path = "../../../src/joint.rs"]
mod joint;
#[path = "../../../src/excite/limits.rs"]
mod limits;
#[path = "../../../src/model/mod.rs"]
mod model;
#[path = "../../../src/rt/mod.rs"]
mod rt;
#[path = "../../../src/app/served.rs"]
mod served;
#[path = "../../../src/excite/shape.rs"]
mod shape;

use error::ExciteError;
use fourier::PeriodicMotion;
use franka::FrankaArm;
use model::term;
use rt::recorder::RingSink;
use rt::{FeedForward, Kinematics, Reference};
use served::{NoModel, Reach, ServedModel};
use std::hint::black_box;

mod backend {
    pub(crate) use crate::franka;
}

/// What the loop's dynamic calls can lead to. None of it is run.
fn main() {
    black_box(rt::cycle::Cycle::<FrankaArm, RingSink>::run as fn(_) -> _);
    black_box::<fn(ServedModel) -> Box<dyn FeedForward>>(|model| Box::new(model));
    black_box::<fn(NoModel) -> Box<dyn FeedForward>>(|model| Box::new(model));
    black_box::<fn(Reach) -> Box<dyn Kinematics>>(|reach| Box::new(reach));
    black_box::<fn(PeriodicMotion) -> Box<dyn Reference>>(|motion| Box::new(motion));
    black_box(term::by_id as fn(_, _, _) -> _);
    black_box(term::effect::FAMILIES);
}
