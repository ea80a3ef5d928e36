//! Limits the number of tests that run at the same time.

use std::sync::{Condvar, Mutex, PoisonError};

pub struct Turns {
    free: Mutex<usize>,
    given_back: Condvar,
}

/// A slot, released on drop.
pub struct Turn<'t>(&'t Turns);

impl Turns {
    pub const fn new(at_a_time: usize) -> Turns {
        Turns { free: Mutex::new(at_a_time), given_back: Condvar::new() }
    }

    pub fn take(&self) -> Turn<'_> {
        let free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut free = self.given_back.wait_while(free, |free| *free == 0).unwrap_or_else(PoisonError::into_inner);
        *free -= 1;
        Turn(self)
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        *self.0.free.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        self.0.given_back.notify_one();
    }
}
