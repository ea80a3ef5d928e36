//! Chosen columns of the rigid links for any arm, by the fastest route that it has.

use super::regressor::LinkRegressor;
use crate::chain::Chain;
use crate::motion::Sample;
use crate::regressor::{LINK_COLUMNS, regressor};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::MAX_JOINTS;

/// Columns `slots` of the standard regressor `Y` (`tau = Y delta`), one sample at a time.
#[derive(Clone, Debug)]
pub struct LinkColumns(Route);

#[derive(Clone, Debug)]
enum Route {
    Fast(Box<LinkRegressor>),
    /// An arm with a prismatic joint.
    Plain {
        chain: Box<Chain>,
        slots: Vec<usize>,
        gravity: Vector3<f64>,
        standard: DMatrix<f64>,
    },
}

impl LinkColumns {
    /// Columns `slots` (rising, `10 * link + position` in `[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m]`) under `gravity` in the base
    /// frame \[m/s2\]. Panics when the slots do not rise or name no link of the arm.
    pub fn new(chain: &Chain, slots: &[usize], gravity: &Vector3<f64>) -> LinkColumns {
        LinkColumns(match LinkRegressor::new(chain, slots, gravity) {
            Some(fast) => Route::Fast(Box::new(fast)),
            None => Route::Plain {
                chain: Box::new(chain.clone()),
                slots: slots.to_vec(),
                gravity: *gravity,
                standard: DMatrix::zeros(chain.len(), chain.len() * LINK_COLUMNS),
            },
        })
    }

    /// Number of columns.
    pub fn len(&self) -> usize {
        match &self.0 {
            Route::Fast(fast) => fast.len(),
            Route::Plain { slots, .. } => slots.len(),
        }
    }

    /// Whether there is no column.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes the columns at a sample: `out[c][j]` is `d tau_j / d delta_slots[c]`, zero for joints past the arm's. `out` has one element
    /// per column. Allocates nothing.
    pub fn fill(&mut self, sample: &Sample, out: &mut [[f64; MAX_JOINTS]]) {
        match &mut self.0 {
            Route::Fast(fast) => fast.fill(sample, out),
            Route::Plain { chain, slots, gravity, standard } => {
                debug_assert_eq!(out.len(), slots.len(), "one element per column");
                regressor(chain, gravity, &sample.q, &sample.dq, &sample.ddq, standard);
                let height = standard.nrows();
                for (column, &slot) in out.iter_mut().zip(slots.iter()) {
                    *column = [0.0; MAX_JOINTS];
                    let standard = standard.as_slice().get(slot * height..).unwrap_or_default();
                    column.iter_mut().zip(standard).take(height).for_each(|(entry, value)| *entry = *value);
                }
            }
        }
    }
}
