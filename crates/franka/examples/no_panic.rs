//! The code of the loop, for the check of `hil/no-panic/run.sh`. Empty without `--cfg no_panic`.

#[cfg(not(no_panic))]
fn main() {}

/// The targets of the loop's dynamic calls. Nothing is run.
#[cfg(no_panic)]
fn main() {
    use plumbline_core::{FeedForward, Kinematics, Reference};
    use plumbline_excite::PeriodicMotion;
    use plumbline_franka::FrankaArm;
    use plumbline_model::{NoModel, Reach, ServedModel, term};
    use plumbline_rt::cycle::Cycle;
    use plumbline_rt::recorder::RingSink;
    use std::hint::black_box;

    black_box(Cycle::<FrankaArm, RingSink>::run as fn(_) -> _);
    black_box::<fn(ServedModel) -> Box<dyn FeedForward>>(|model| Box::new(model));
    black_box::<fn(NoModel) -> Box<dyn FeedForward>>(|model| Box::new(model));
    black_box::<fn(Reach) -> Box<dyn Kinematics>>(|reach| Box::new(reach));
    black_box::<fn(PeriodicMotion) -> Box<dyn Reference>>(|motion| Box::new(motion));
    black_box(term::by_id as fn(_, _, _) -> _);
    black_box(term::effect::FAMILIES);
}
