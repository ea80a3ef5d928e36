//! Analysis of a recording: facts, text, HTML page, replay.
//!
//! | file | what |
//! |---|---|
//! | `facts` | facts of a recording, serialised as JSON |
//! | `timing` | cycle times of the loop |
//! | `advice` | next steps for the operator |
//! | `text` | facts as text for a terminal |
//! | `page`, `plot` | facts as one HTML file |
//! | `replay` | executes the loop on the recorded inputs and compares every command |

mod advice;
pub mod facts;
mod page;
mod plot;
pub mod replay;
mod text;
mod timing;

pub use page::page;
pub use text::text;
