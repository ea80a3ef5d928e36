//! What a recording of a fault tells, in words, as a page, and by running it again.
//!
//! | file | what |
//! |---|---|
//! | `story` | the facts, in order: decides from the recording alone |
//! | `timing` | how the loop kept its time |
//! | `advice` | what the operator does next |
//! | `text` | the story for a terminal |
//! | `page`, `plot` | the story as one HTML file |
//! | `replay` | the recording through the loop again, command by command |

mod advice;
mod page;
mod plot;
pub mod replay;
pub mod story;
mod text;
mod timing;

pub use page::page;
pub use text::text;
