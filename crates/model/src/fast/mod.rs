//! The model's arithmetic at the speed of the machine: the same numbers as the plain routes ([`super::rnea()`], [`super::regressor()`]) but
//! for rounding, without zero terms and several lanes at a time.
//!
//! Vector instructions are chosen when the program starts (AVX2, SSE or NEON); there is one source for all of them.

pub mod closed;
mod frames;
pub mod links;
mod motion;
mod regressor;
pub mod sign;
mod torque;
pub(crate) mod trig;

use fearless_simd::{Level, Simd};
use plumbline_core::JointVec;

/// One number per link or joint, where a vector register is loaded from and stored to at once.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(64))]
pub struct Lanes([f64; 8]);

impl Lanes {
    fn add(&mut self, other: &JointVec) {
        self.0.iter_mut().zip(other).for_each(|(own, other)| *own += other);
    }
}

/// The instructions for short recursions that mix vectors with scalars: AVX2 where there is AVX-512, whose wide registers switch off
/// the scalars' second unit.
pub(crate) fn vector_level() -> Level {
    let level = Level::new();
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = level.as_avx2() {
        return Level::Avx2(avx2);
    }
    level
}

/// `a b + c`, fused where the CPU can do that in one instruction; without it the fused form would be a call of a library.
#[inline(always)]
fn fused<S: Simd>(simd: S, a: f64, b: f64, c: f64) -> f64 {
    match simd.level() {
        #[cfg(target_arch = "x86_64")]
        Level::Avx2(_) | Level::Avx512(_) => a.mul_add(b, c),
        #[cfg(target_arch = "aarch64")]
        Level::Neon(_) => a.mul_add(b, c),
        _ => a * b + c,
    }
}

/// Every set of instructions that this CPU has.
#[cfg(test)]
fn levels() -> Vec<Level> {
    let mut levels = vec![Level::new(), vector_level(), Level::baseline()];
    #[cfg(target_arch = "x86_64")]
    levels.extend(Level::new().as_sse4_2().map(Level::Sse4_2));
    levels
}
