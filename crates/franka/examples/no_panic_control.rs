//! A function that can panic, the control of `hil/no-panic/run.sh`: with `--cfg no_panic` it must not link.

#[cfg(not(no_panic))]
fn main() {}

#[cfg(no_panic)]
#[no_panic::no_panic]
#[inline(never)]
fn out_of_reach(values: &[f64; 8], joint: usize) -> f64 {
    values[joint]
}

/// The same inside the bounds: it must not be named.
#[cfg(no_panic)]
#[no_panic::no_panic]
#[inline(never)]
fn in_reach(values: &[f64; 8], joint: usize) -> f64 {
    values[joint.min(7)]
}

#[cfg(no_panic)]
fn main() {
    std::hint::black_box(out_of_reach as fn(_, _) -> _);
    std::hint::black_box(in_reach as fn(_, _) -> _);
}
