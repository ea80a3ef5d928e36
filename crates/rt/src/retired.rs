//! Boxes that the loop no longer uses.

use plumbline_core::{FeedForward, Reference};

/// A box that the loop no longer uses. Dropping it frees memory, so the loop hands it out.
pub enum Retired {
    /// A model that another has replaced.
    Model(Box<dyn FeedForward>),
    /// A motion that has ended, or an order that a stop discarded.
    Reference(Box<dyn Reference>),
}
