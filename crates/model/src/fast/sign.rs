//! The smoothed sign of many velocities at once.

use super::trig::tanh;
use super::vector_level;
use fearless_simd::{Simd, SimdBase, dispatch, f64x8};
use plumbline_core::{JointVec, MAX_JOINTS};

/// Slope of the smoothed sign of the velocity at rest, paper eq. 2 \[s/rad\].
pub const SHARPNESS: f64 = 100.0;

/// `tanh(100 dq)` (paper eq. 2).
#[inline(always)]
pub(crate) fn smooth_sign<S: Simd>(simd: S, dq: &JointVec, sign: &mut JointVec) {
    tanh(simd, f64x8::from_slice(simd, dq) * SHARPNESS).store_slice(sign);
}

/// `tanh(100 dq)` of as many velocities as there are.
pub(crate) fn smooth_signs(dq: &[f64], signs: &mut [f64]) {
    assert_eq!(dq.len(), signs.len(), "one sign per velocity");
    let level = vector_level();
    for (dq, signs) in dq.chunks(MAX_JOINTS).zip(signs.chunks_mut(MAX_JOINTS)) {
        let (mut from, mut to) = (JointVec::default(), JointVec::default());
        from[..dq.len()].copy_from_slice(dq);
        dispatch!(level, simd => smooth_sign(simd, &from, &mut to));
        signs.copy_from_slice(&to[..signs.len()]);
    }
}
