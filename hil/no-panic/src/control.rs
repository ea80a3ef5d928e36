//! A function that can panic, for the control: a program with it must not link.

use no_panic::no_panic;
use std::hint::black_box;

#[no_panic]
#[inline(never)]
fn out_of_reach(values: &[f64; 8], joint: usize) -> f64 {
    values[joint]
}

/// The same with the bound in sight: nothing may be said about this one.
#[no_panic]
#[inline(never)]
fn in_reach(values: &[f64; 8], joint: usize) -> f64 {
    values[joint.min(7)]
}

fn main() {
    black_box(out_of_reach as fn(_, _) -> _);
    black_box(in_reach as fn(_, _) -> _);
}
