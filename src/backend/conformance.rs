//! The promises of [`Backend`], as tests that run against every implementation. Each panics with what was broken.
